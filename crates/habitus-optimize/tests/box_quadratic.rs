//! The minimum of a quadratic in a box, against its first-order conditions and brute force.
#![allow(clippy::unwrap_used, reason = "a failed solve is a failed test")]

mod problems;

use habitus_optimize::{Position, SolveError, minimize_box_quadratic};
use nalgebra::{DMatrix, DVector};
use problems::Random;

fn random_quadratic(
    random: &mut Random,
    count: usize,
    rank: usize,
    ridge: f64,
) -> (DMatrix<f64>, DVector<f64>) {
    let factor = DMatrix::from_fn(rank, count, |_, _| random.signed());
    let h = factor.transpose() * factor + ridge * DMatrix::identity(count, count);
    (h, DVector::from_fn(count, |_, _| 3.0 * random.signed()))
}

fn energy(h: &DMatrix<f64>, g: &DVector<f64>, d: &DVector<f64>) -> f64 {
    0.5 * (h * d).dot(d) + g.dot(d)
}

/// Asserts the Karush–Kuhn–Tucker conditions, which for a convex quadratic prove the minimum.
fn assert_minimum(h: &DMatrix<f64>, g: &DVector<f64>, lower: &[f64], upper: &[f64]) -> Vec<Position> {
    let found = minimize_box_quadratic(h, g, lower, upper).unwrap();
    let slope = h * &found.step + g;
    let tolerance = 1e-9 * (1.0 + g.amax());
    for i in 0..g.len() {
        assert!(lower[i] <= found.step[i] && found.step[i] <= upper[i], "variable {i} leaves its interval");
        match found.positions[i] {
            Position::Free => {
                assert!(slope[i].abs() <= tolerance, "free variable {i} has slope {}", slope[i])
            }
            Position::AtLower => {
                assert_eq!(found.step[i], lower[i]);
                assert!(slope[i] >= -tolerance || lower[i] == upper[i], "variable {i} wants to rise");
            }
            Position::AtUpper => {
                assert_eq!(found.step[i], upper[i]);
                assert!(slope[i] <= tolerance, "variable {i} wants to fall");
            }
        }
    }
    found.positions
}

#[test]
fn random_boxes_meet_the_first_order_conditions() {
    let mut random = Random(1);
    let mut held = 0;
    for case in 0..300 {
        let count = 1 + case % 40;
        let ridge = [1.0, 1e-3, 1e-6][case % 3];
        let (h, g) = random_quadratic(&mut random, count, 1 + case % (count + 5), ridge);
        let lower: Vec<f64> = (0..count)
            .map(|_| if random.unit() < 0.2 { f64::NEG_INFINITY } else { -random.unit() })
            .collect();
        let upper: Vec<f64> =
            (0..count).map(|_| if random.unit() < 0.2 { f64::INFINITY } else { random.unit() }).collect();
        held += assert_minimum(&h, &g, &lower, &upper).iter().filter(|p| **p != Position::Free).count();
    }
    assert!(held > 1000, "only {held} variables met a bound: the cases prove little");
}

#[test]
fn three_variables_agree_with_brute_force_over_all_active_sets() {
    let mut random = Random(2);
    for _ in 0..200 {
        let (h, g) = random_quadratic(&mut random, 3, 3, 0.05);
        let lower = [-random.unit(), -random.unit(), -random.unit()];
        let upper = [random.unit(), random.unit(), random.unit()];
        let mut best = f64::INFINITY;
        for code in 0..27_usize {
            let choice = [code % 3, code / 3 % 3, code / 9];
            let free: Vec<usize> = (0..3).filter(|&i| choice[i] == 0).collect();
            let mut d = DVector::from_fn(3, |i, _| [0.0, lower[i], upper[i]][choice[i]]);
            let right = DVector::from_fn(free.len(), |k, _| -((&h * &d)[free[k]] + g[free[k]]));
            let block = DMatrix::from_fn(free.len(), free.len(), |r, c| h[(free[r], free[c])]);
            if !free.is_empty() {
                let solved = block.lu().solve(&right).unwrap();
                free.iter().enumerate().for_each(|(k, &i)| d[i] = solved[k]);
            }
            if (0..3).all(|i| lower[i] <= d[i] && d[i] <= upper[i]) {
                best = best.min(energy(&h, &g, &d));
            }
        }
        let found = minimize_box_quadratic(&h, &g, &lower, &upper).unwrap();
        assert!((energy(&h, &g, &found.step) - best).abs() <= 1e-11 * (1.0 + best.abs()));
    }
}

#[test]
fn large_ill_conditioned_boxes_settle_in_few_rounds() {
    let mut random = Random(3);
    for _ in 0..5 {
        let (h, g) = random_quadratic(&mut random, 130, 140, 1e-6);
        let (lower, upper) = (vec![-0.05; 130], vec![0.05; 130]);
        assert_minimum(&h, &g, &lower, &upper);
        let rounds = minimize_box_quadratic(&h, &g, &lower, &upper).unwrap().rounds;
        // Far below the number of variables: many change sides at once.
        assert!(rounds <= 40, "{rounds} rounds");
    }
}

#[test]
fn a_minimum_exactly_on_a_bound_settles() {
    let h = DMatrix::identity(3, 3);
    let g = DVector::from_vec(vec![-1.0, 1.0, 0.0]);
    let found = minimize_box_quadratic(&h, &g, &[-1.0, -1.0, 0.0], &[1.0, 1.0, 0.0]).unwrap();
    assert_eq!(found.step.as_slice(), [1.0, -1.0, 0.0]);
}

#[test]
fn equal_bounds_hold_a_variable() {
    let h = DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 2.0]);
    let g = DVector::from_vec(vec![0.0, 0.0]);
    let found = minimize_box_quadratic(&h, &g, &[1.0, -9.0], &[1.0, 9.0]).unwrap();
    assert_eq!(found.step[0], 1.0);
    assert!((found.step[1] + 0.5).abs() < 1e-15);
}

#[test]
fn what_has_no_minimum_is_an_error() {
    let indefinite = DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, -1.0]));
    let g = DVector::from_vec(vec![1.0, 1.0]);
    let wide = [f64::NEG_INFINITY; 2];
    let error = minimize_box_quadratic(&indefinite, &g, &wide, &[f64::INFINITY; 2]).unwrap_err();
    assert_eq!(error, SolveError::NotPositiveDefinite { free_count: 2 });
    let swapped =
        minimize_box_quadratic(&DMatrix::identity(1, 1), &DVector::zeros(1), &[1.0], &[0.0]).unwrap_err();
    assert!(matches!(swapped, SolveError::InvalidBounds { index: 0, .. }));
    let short = minimize_box_quadratic(&DMatrix::identity(2, 2), &g, &[0.0], &[1.0, 1.0]).unwrap_err();
    assert!(matches!(short, SolveError::SizeMismatch { found: 1, expected: 2, .. }));
}
