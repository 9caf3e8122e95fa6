//! The exact minimum of a convex quadratic in a box.

use nalgebra::{DMatrix, DVector};

use crate::SolveError;
use crate::dense_cholesky::solve_positive_definite;

/// Where a variable of a box-constrained minimum lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Position {
    /// Inside its interval: its derivative is zero.
    Free,
    /// At its lower bound, which holds it up.
    AtLower,
    /// At its upper bound, which holds it down.
    AtUpper,
}

/// A minimum of a quadratic in a box.
#[derive(Debug, Clone, PartialEq)]
pub struct BoxStep {
    /// The minimiser; variables at a bound equal it exactly.
    pub step: DVector<f64>,
    /// Where each variable lies.
    pub positions: Vec<Position>,
    /// Factorisations it took.
    pub rounds: usize,
}

/// Rounds in which many variables may change sides at once although that has not reduced the number of wrong ones.
const PATIENCE: usize = 3;

/// Returns argmin ½ dᵀ H d + gᵀ d over lower ≤ d ≤ upper, for a symmetric positive definite `h`.
///
/// Block principal pivoting (Júdice and Pires 1994): guess which variables are free, solve for them exactly, move every
/// variable that violates its bound or its sign to the other side, and repeat. When that stops helping, only the variable
/// of highest index moves (Murty 1974), for which termination is proved. The first-order conditions of the result hold to
/// rounding; no component is clamped.
pub fn minimize_box_quadratic(
    h: &DMatrix<f64>,
    g: &DVector<f64>,
    lower: &[f64],
    upper: &[f64],
) -> Result<BoxStep, SolveError> {
    let count = g.len();
    for (quantity, found) in [
        ("matrix", h.nrows()),
        ("matrix", h.ncols()),
        ("list of lower bounds", lower.len()),
        ("list of upper bounds", upper.len()),
    ] {
        if found != count {
            return Err(SolveError::SizeMismatch { quantity, found, expected: count });
        }
    }
    if let Some(index) = (0..count).find(|&i| !is_ordered(lower[i], upper[i])) {
        return Err(SolveError::InvalidBounds { index, lower: lower[index], upper: upper[index] });
    }

    let mut positions: Vec<Position> = (0..count).map(|i| first_guess(g[i], lower[i], upper[i])).collect();
    let mut step = DVector::zeros(count);
    let mut wrong: Vec<(usize, Position)> = Vec::with_capacity(count);
    let mut fewest_wrong = usize::MAX;
    let mut patience = PATIENCE;
    let round_limit = 100 + 20 * count;
    for round in 1..=round_limit {
        solve_free(h, g, lower, upper, &positions, &mut step)?;
        find_wrong(h, g, lower, upper, &positions, &step, &mut wrong);
        if wrong.is_empty() {
            return Ok(BoxStep { step, positions, rounds: round });
        }
        if wrong.len() < fewest_wrong {
            fewest_wrong = wrong.len();
            patience = PATIENCE;
        } else {
            patience = patience.saturating_sub(1);
        }
        let moved = if patience > 0 { &wrong[..] } else { &wrong[wrong.len() - 1..] };
        for &(index, position) in moved {
            positions[index] = position;
        }
    }
    Err(SolveError::ActiveSetUnsettled { variable_count: count, rounds: round_limit })
}

fn is_ordered(lower: f64, upper: f64) -> bool {
    lower <= upper && lower < f64::INFINITY && upper > f64::NEG_INFINITY
}

/// A variable whose bound is already touched at d = 0 and that the gradient pushes further starts at that bound.
fn first_guess(gradient: f64, lower: f64, upper: f64) -> Position {
    if lower == upper || (lower >= 0.0 && gradient > 0.0) {
        Position::AtLower
    } else if upper <= 0.0 && gradient < 0.0 {
        Position::AtUpper
    } else {
        Position::Free
    }
}

/// Puts held variables at their bounds and solves H_FF d_F = −(g_F + H_FA d_A) for the free ones.
fn solve_free(
    h: &DMatrix<f64>,
    g: &DVector<f64>,
    lower: &[f64],
    upper: &[f64],
    positions: &[Position],
    step: &mut DVector<f64>,
) -> Result<(), SolveError> {
    let mut free = Vec::with_capacity(positions.len());
    for (i, position) in positions.iter().enumerate() {
        step[i] = match position {
            Position::Free => {
                free.push(i);
                0.0
            }
            Position::AtLower => lower[i],
            Position::AtUpper => upper[i],
        };
    }
    if free.is_empty() {
        return Ok(());
    }
    let matrix = if free.len() == positions.len() {
        h.clone()
    } else {
        DMatrix::from_fn(free.len(), free.len(), |r, c| h[(free[r], free[c])])
    };
    let full = slopes(h, g, step);
    let mut right = DVector::from_iterator(free.len(), free.iter().map(|&i| -full[i]));
    let is_definite = solve_positive_definite(matrix, &mut right);
    if !is_definite || right.iter().any(|entry| !entry.is_finite()) {
        return Err(SolveError::NotPositiveDefinite { free_count: free.len() });
    }
    for (&i, &entry) in free.iter().zip(right.iter()) {
        step[i] = entry;
    }
    Ok(())
}

/// The derivative H d + g.
fn slopes(h: &DMatrix<f64>, g: &DVector<f64>, step: &DVector<f64>) -> DVector<f64> {
    let mut slopes = g.clone();
    slopes.gemv(1.0, h, step, 1.0);
    slopes
}

/// Lists the variables on the wrong side, in rising index order, with the side they belong to.
fn find_wrong(
    h: &DMatrix<f64>,
    g: &DVector<f64>,
    lower: &[f64],
    upper: &[f64],
    positions: &[Position],
    step: &DVector<f64>,
    wrong: &mut Vec<(usize, Position)>,
) {
    wrong.clear();
    let slopes = slopes(h, g, step);
    for (i, position) in positions.iter().enumerate() {
        let target = match position {
            Position::Free if step[i] < lower[i] => Position::AtLower,
            Position::Free if step[i] > upper[i] => Position::AtUpper,
            Position::Free => continue,
            _ if lower[i] == upper[i] => continue,
            Position::AtLower if slopes[i] >= -rounding(h, g, step, i) => continue,
            Position::AtUpper if slopes[i] <= rounding(h, g, step, i) => continue,
            _ => Position::Free,
        };
        wrong.push((i, target));
    }
}

/// Size of slope `index` that its own rounding can make: without it a variable exactly on its bound could change sides for ever.
fn rounding(h: &DMatrix<f64>, g: &DVector<f64>, step: &DVector<f64>, index: usize) -> f64 {
    let magnitude: f64 = h.column(index).iter().zip(step.iter()).map(|(a, d)| (a * d).abs()).sum();
    1e-13 * (magnitude + g[index].abs())
}
