//! Ridge regression in the space of a kernel: linear ridge, radial functions, or both at once.
//!
//! Minimises Σ ‖y_i − f(x_i)‖² + damping · ‖f‖², so that `f(x) = mean + Σ_i k(x, x_i) dual_i` with
//! `dual = (K + damping · I)⁻¹ (Y − mean)` (Saunders, Gammerman and Vovk 1998). Kernel and damping are chosen by leaving
//! out whole blocks of consecutive rows: frames beside a left-out frame would give it away.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::standardization::Standardization;

/// Similarity of two rows of scaled inputs, whose mean squared length is one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kernel {
    /// Share of the radial part `exp(−‖u − v‖² / (2 reach²))`; 0 for linear ridge.
    pub radial_share: f64,
    /// Distance over which rows resemble one another, in root mean square distances of a row from the mean.
    pub reach: f64,
    /// Share of the linear part `u · v`, which goes on beyond the data.
    pub linear_share: f64,
}

impl Kernel {
    /// Plain linear ridge.
    pub const LINEAR: Self = Self { radial_share: 0.0, reach: 1.0, linear_share: 1.0 };

    /// Similarities of the columns of `a` to those of `b`.
    fn between(&self, a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
        let norms = |m: &DMatrix<f64>| -> Vec<f64> { m.column_iter().map(|c| c.norm_squared()).collect() };
        let (norms_a, norms_b) = (norms(a), norms(b));
        let mut similarities = a.tr_mul(b);
        let scale = 1.0 / (2.0 * self.reach * self.reach);
        for (mut column, norm_b) in similarities.column_iter_mut().zip(&norms_b) {
            for (value, norm_a) in column.iter_mut().zip(&norms_a) {
                let product = *value;
                let radial = if self.radial_share > 0.0 {
                    self.radial_share * (-(norm_a + norm_b - 2.0 * product).max(0.0) * scale).exp()
                } else {
                    0.0
                };
                *value = radial + self.linear_share * product;
            }
        }
        similarities
    }
}

/// Takes inputs to where the kernel compares them: `u_k = (x_k − mean_k) · scale_k`.
#[derive(Clone, Debug, PartialEq)]
pub struct InputScale {
    /// Mean of each input.
    pub means: Vec<f64>,
    /// What each input is multiplied by.
    pub scales: Vec<f64>,
}

impl InputScale {
    /// The scale at which inputs count in proportion to `relevance`, and rows have a mean squared length of one.
    pub fn new(inputs: &DMatrix<f64>, relevance: &[f64]) -> Self {
        assert_eq!(inputs.ncols(), relevance.len(), "one relevance for each input");
        let spread = Standardization::of(inputs);
        let mean_square: f64 = inputs
            .column_iter()
            .zip(&spread.means)
            .zip(relevance)
            .map(|((column, mean), relevance)| {
                let squares: f64 = column.iter().map(|value| (value - mean).powi(2)).sum();
                relevance * relevance * squares / inputs.nrows().max(1) as f64
            })
            .sum();
        let factor = if mean_square > 0.0 { mean_square.sqrt().recip() } else { 1.0 };
        Self { means: spread.means, scales: relevance.iter().map(|value| value * factor).collect() }
    }

    /// Scaled rows, as columns.
    pub fn columns(&self, inputs: &DMatrix<f64>) -> DMatrix<f64> {
        assert_eq!(inputs.ncols(), self.means.len(), "as many inputs as were learnt from");
        DMatrix::from_fn(inputs.ncols(), inputs.nrows(), |k, row| {
            (inputs[(row, k)] - self.means[k]) * self.scales[k]
        })
    }
}

/// Relevances at which every input counts the same, whatever its unit.
pub fn equal_relevance(inputs: &DMatrix<f64>) -> Vec<f64> {
    Standardization::of(inputs).deviations.iter().map(|deviation| deviation.recip()).collect()
}

/// Which kernels and dampings are tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KernelRidgeConfig {
    /// Kernels, of which the best on left-out blocks is used.
    pub kernels: Vec<Kernel>,
    /// Weights of the penalty, of which the best is used; a kernel's own size is about one.
    pub dampings: Vec<f64>,
    /// Blocks of consecutive rows that are left out in turn.
    pub folds: usize,
    /// Rows at most that the choice looks at, evenly spread; the regressor itself uses up to `most_rows`.
    pub rows_for_choice: usize,
    /// Rows at most that the regressor keeps, evenly spread: work grows with their cube.
    pub most_rows: usize,
}

impl Default for KernelRidgeConfig {
    fn default() -> Self {
        // Without a linear part, poses far from all data get the mean layer and not a wild guess.
        let kernels = [0.35, 0.5, 0.7].map(|reach| Kernel { radial_share: 1.0, reach, linear_share: 0.0 });
        Self {
            kernels: kernels.to_vec(),
            dampings: vec![3e-3, 1e-2, 3e-2, 0.1],
            folds: 5,
            rows_for_choice: 400,
            most_rows: 2000,
        }
    }
}

impl KernelRidgeConfig {
    /// Linear ridge with the damping chosen in the same way.
    pub fn linear() -> Self {
        Self {
            kernels: vec![Kernel::LINEAR],
            dampings: vec![1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0, 10.0],
            ..Self::default()
        }
    }
}

/// Why no regressor can be made.
#[derive(Debug, Error, PartialEq)]
pub enum KernelRidgeError {
    /// Nothing to learn from.
    #[error(
        "{inputs} rows of inputs and {targets} rows of targets: as many of both are needed, and at least two"
    )]
    Rows {
        /// Rows of inputs.
        inputs: usize,
        /// Rows of targets.
        targets: usize,
    },
    /// The settings name no kernel or no usable damping.
    #[error("kernel ridge needs at least one kernel and one positive damping, and at least two folds")]
    Settings,
    /// The kernel's matrix cannot be factorised.
    #[error("the kernel's matrix is not positive definite: use larger dampings")]
    NotPositiveDefinite,
}

/// A trained regressor from rows of inputs to rows of outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelRidge {
    /// Where inputs are compared.
    pub inputs: InputScale,
    /// Mean of each output.
    pub output_means: Vec<f64>,
    /// Similarity of inputs.
    pub kernel: Kernel,
    /// Scaled inputs of the kept rows, one column each.
    pub centres: DMatrix<f64>,
    /// One row for each kept row, one column for each output.
    pub dual: DMatrix<f64>,
}

impl KernelRidge {
    /// Learns from rows in the order of time, which the left-out blocks rely on; inputs count by their `relevance`.
    pub fn learn(
        inputs: &DMatrix<f64>,
        targets: &DMatrix<f64>,
        relevance: &[f64],
        config: &KernelRidgeConfig,
    ) -> Result<Self, KernelRidgeError> {
        let choice = KernelChoice::by_left_out_blocks(inputs, targets, relevance, config)?;
        let kept = evenly_spread(inputs.nrows(), config.most_rows);
        Self::learn_with(&inputs.select_rows(&kept), &targets.select_rows(&kept), relevance, &choice)
    }

    /// Learns from all rows with a kernel and a damping that are given.
    pub fn learn_with(
        inputs: &DMatrix<f64>,
        targets: &DMatrix<f64>,
        relevance: &[f64],
        choice: &KernelChoice,
    ) -> Result<Self, KernelRidgeError> {
        let (scale, centres, targets, output_means) = prepared(inputs, targets, relevance, inputs.nrows())?;
        let mut similarities = choice.kernel.between(&centres, &centres);
        add_to_diagonal(&mut similarities, choice.damping);
        let factor = similarities.cholesky().ok_or(KernelRidgeError::NotPositiveDefinite)?;
        let dual = factor.solve(&targets);
        Ok(Self { inputs: scale, output_means, kernel: choice.kernel, centres, dual })
    }

    /// Outputs for rows of inputs.
    pub fn predict(&self, inputs: &DMatrix<f64>) -> DMatrix<f64> {
        let columns = self.inputs.columns(inputs);
        let mut outputs = self.kernel.between(&columns, &self.centres) * &self.dual;
        outputs
            .column_iter_mut()
            .zip(&self.output_means)
            .for_each(|(mut column, mean)| column.add_scalar_mut(*mean));
        outputs
    }
}

/// At most `most` of `count` indices, evenly spread.
pub fn evenly_spread(count: usize, most: usize) -> Vec<usize> {
    let kept = count.min(most.max(2));
    (0..kept).map(|k| k * count / kept.max(1)).collect()
}

fn add_to_diagonal(matrix: &mut DMatrix<f64>, value: f64) {
    (0..matrix.nrows()).for_each(|k| matrix[(k, k)] += value);
}

/// A kernel, a damping, and how well they did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KernelChoice {
    /// Similarity of inputs.
    pub kernel: Kernel,
    /// Weight of the penalty.
    pub damping: f64,
    /// Sum of squared errors on the left-out blocks.
    pub left_out_error: f64,
}

impl KernelChoice {
    /// Kernel and damping with the smallest squared error on left-out blocks.
    ///
    /// The errors of a block B that was left out are `(G_BB)⁻¹ (G y)_B` with `G = (K + damping · I)⁻¹` (the block form of
    /// the leave-one-out formula of Craven and Wahba 1979), so that each pair costs one inverse.
    pub fn by_left_out_blocks(
        inputs: &DMatrix<f64>,
        targets: &DMatrix<f64>,
        relevance: &[f64],
        config: &KernelRidgeConfig,
    ) -> Result<Self, KernelRidgeError> {
        let is_usable = config.dampings.iter().all(|damping| *damping > 0.0)
            && !config.dampings.is_empty()
            && !config.kernels.is_empty()
            && config.folds >= 2;
        if !is_usable {
            return Err(KernelRidgeError::Settings);
        }
        let (_, centres, targets, _) = prepared(inputs, targets, relevance, config.rows_for_choice)?;
        let folds = config.folds.min(centres.ncols());
        let mut best: Option<Self> = None;
        for kernel in &config.kernels {
            let similarities = kernel.between(&centres, &centres);
            for damping in &config.dampings {
                let Some(error) = left_out_error(&similarities, *damping, &targets, folds) else { continue };
                if best.is_none_or(|best| error < best.left_out_error) {
                    best = Some(Self { kernel: *kernel, damping: *damping, left_out_error: error });
                }
            }
        }
        best.ok_or(KernelRidgeError::NotPositiveDefinite)
    }
}

/// What a regressor with a given kernel and damping misses of each row when the row's block is left out.
pub(super) fn misses_of_left_out_blocks(
    inputs: &DMatrix<f64>,
    targets: &DMatrix<f64>,
    relevance: &[f64],
    choice: &KernelChoice,
    config: &KernelRidgeConfig,
) -> Result<DMatrix<f64>, KernelRidgeError> {
    let (_, centres, targets, _) = prepared(inputs, targets, relevance, config.rows_for_choice)?;
    let folds = config.folds.clamp(2, centres.ncols());
    let similarities = choice.kernel.between(&centres, &centres);
    left_out_residuals(&similarities, choice.damping, &targets, folds)
        .ok_or(KernelRidgeError::NotPositiveDefinite)
}

fn left_out_error(
    similarities: &DMatrix<f64>,
    damping: f64,
    targets: &DMatrix<f64>,
    folds: usize,
) -> Option<f64> {
    Some(left_out_residuals(similarities, damping, targets, folds)?.norm_squared())
}

/// For each row what a regressor without its block misses of the target.
fn left_out_residuals(
    similarities: &DMatrix<f64>,
    damping: f64,
    targets: &DMatrix<f64>,
    folds: usize,
) -> Option<DMatrix<f64>> {
    let count = similarities.nrows();
    let mut damped = similarities.clone();
    add_to_diagonal(&mut damped, damping);
    let inverse = damped.cholesky()?.inverse();
    let dual = &inverse * targets;
    let mut residuals = dual.clone();
    for fold in 0..folds {
        let (start, end) = (fold * count / folds, (fold + 1) * count / folds);
        let block = inverse.view((start, start), (end - start, end - start)).into_owned().cholesky()?;
        let missed = block.solve(&dual.rows(start, end - start).into_owned());
        residuals.rows_mut(start, end - start).copy_from(&missed);
    }
    Some(residuals)
}

/// Scale, scaled inputs of the kept rows as columns, and their targets without their means, which come last.
type Prepared = (InputScale, DMatrix<f64>, DMatrix<f64>, Vec<f64>);

fn prepared(
    inputs: &DMatrix<f64>,
    targets: &DMatrix<f64>,
    relevance: &[f64],
    most_rows: usize,
) -> Result<Prepared, KernelRidgeError> {
    if inputs.nrows() != targets.nrows() || inputs.nrows() < 2 {
        return Err(KernelRidgeError::Rows { inputs: inputs.nrows(), targets: targets.nrows() });
    }
    let kept = evenly_spread(inputs.nrows(), most_rows);
    let scale = InputScale::new(inputs, relevance);
    let centres = scale.columns(&inputs.select_rows(&kept));
    let mut targets = targets.select_rows(&kept);
    let means: Vec<f64> = targets.column_iter().map(|column| column.mean()).collect();
    targets.column_iter_mut().zip(&means).for_each(|(mut column, mean)| column.add_scalar_mut(-mean));
    Ok((scale, centres, targets, means))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::RandomStream;

    fn samples(count: usize) -> (DMatrix<f64>, DMatrix<f64>) {
        let mut random = RandomStream::named(4, "kernel ridge");
        let inputs = DMatrix::from_fn(count, 3, |_, _| random.normal());
        let targets = DMatrix::from_fn(count, 2, |row, k| {
            let x = inputs.row(row);
            if k == 0 { 2.0 * x[0] - x[1] + 5.0 } else { (1.5 * x[2]).sin() + x[0] }
        });
        (inputs, targets)
    }

    #[test]
    fn linear_ridge_without_damping_recovers_a_linear_law() {
        let (inputs, targets) = samples(60);
        let config = KernelRidgeConfig { dampings: vec![1e-9], ..KernelRidgeConfig::linear() };
        let regressor = KernelRidge::learn(&inputs, &targets, &[1.0; 3], &config).unwrap();
        let found = regressor.predict(&DMatrix::from_row_slice(1, 3, &[0.3, -0.7, 0.2]));
        assert!((found[0] - (0.6 + 0.7 + 5.0)).abs() < 1e-6, "{found}");
    }

    #[test]
    fn the_block_formula_gives_the_errors_of_models_that_never_saw_the_block() {
        let (inputs, targets) = samples(40);
        let kernel = Kernel { radial_share: 1.0, reach: 1.0, linear_share: 0.3 };
        let columns = inputs.transpose();
        let mut damped = kernel.between(&columns, &columns);
        add_to_diagonal(&mut damped, 0.1);
        let inverse = damped.clone().cholesky().unwrap().inverse();
        let block = inverse.view((10, 10), (8, 8)).into_owned();
        let short_cut = block.cholesky().unwrap().solve(&(&inverse * &targets).rows(10, 8));
        let others: Vec<usize> = (0..40).filter(|row| !(10..18).contains(row)).collect();
        let left: Vec<usize> = (10..18).collect();
        let factor = damped.select_rows(&others).select_columns(&others).cholesky().unwrap();
        let dual = factor.solve(&targets.select_rows(&others));
        let predicted = damped.select_rows(&left).select_columns(&others) * dual;
        assert!((targets.select_rows(&left) - predicted - short_cut).norm() < 1e-9);
    }

    #[test]
    fn radial_functions_learn_what_a_line_cannot() {
        let (inputs, targets) = samples(200);
        let (unseen, truth) = samples(260);
        let rows: Vec<usize> = (200..260).collect();
        let error = |config: &KernelRidgeConfig| {
            let regressor = KernelRidge::learn(&inputs, &targets, &[1.0; 3], config).unwrap();
            (regressor.predict(&unseen.select_rows(&rows)) - truth.select_rows(&rows)).norm()
        };
        let (radial, linear) = (error(&KernelRidgeConfig::default()), error(&KernelRidgeConfig::linear()));
        assert!(radial < 0.5 * linear, "{radial} against {linear}");
    }

    #[test]
    fn unusable_rows_and_settings_are_refused() {
        let (inputs, targets) = samples(5);
        let config = KernelRidgeConfig::default();
        let one = inputs.rows(0, 1).into_owned();
        assert!(matches!(
            KernelRidge::learn(&one, &targets, &[1.0; 3], &config),
            Err(KernelRidgeError::Rows { .. })
        ));
        let none = KernelRidgeConfig { kernels: Vec::new(), ..config };
        assert_eq!(KernelRidge::learn(&inputs, &targets, &[1.0; 3], &none), Err(KernelRidgeError::Settings));
    }
}
