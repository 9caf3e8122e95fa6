//! Ridge regression in the space of a kernel: linear ridge, radial functions, or both at once.
//!
//! Minimises Σ ‖y_i − f(x_i)‖² + damping · ‖f‖², so that `f(x) = mean + Σ_i k(x, x_i) dual_i` with
//! `dual = (K + damping · I)⁻¹ (Y − mean)` (Saunders, Gammerman and Vovk 1998). Kernel and damping are chosen by leaving
//! out whole blocks of consecutive rows: frames beside a left-out frame would give it away.
//!
//! The last inputs may be controls, which hold still throughout a sequence (a fabric, a size). They have a kernel of their own,
//! `k((m, c), (n, d)) = k_motion(m, n) · (1 + with_motion · k_control(c, d)) + alone · k_control(c, d)`, so that what all
//! sequences share is learnt from all of them, and a control far from those seen changes that without taking it away.

use std::ops::Range;

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
    /// How controls enter; none: like all other inputs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controls: Option<ControlKernel>,
}

/// How inputs that hold still throughout a sequence enter a kernel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlKernel {
    /// Weight of what the controls change whatever the motion.
    pub alone: f64,
    /// Weight of what they change in one pose and not in another.
    pub with_motion: f64,
    /// Share of the radial part in the similarity of controls; the rest is linear and goes on beyond the controls seen.
    pub radial_share: f64,
    /// Distance over which controls resemble one another, in root mean square distances from their mean.
    pub reach: f64,
}

impl Kernel {
    /// Plain linear ridge.
    pub const LINEAR: Self = Self { radial_share: 0.0, reach: 1.0, linear_share: 1.0, controls: None };

    /// Similarities of the columns of `a` to those of `b`, whose last `control_count` rows are controls.
    fn between(&self, a: &DMatrix<f64>, b: &DMatrix<f64>, control_count: usize) -> DMatrix<f64> {
        let Some(controls) = self.controls.filter(|_| control_count > 0) else {
            return self.of_one_kind(a, b);
        };
        let motion = |m: &DMatrix<f64>| m.rows(0, m.nrows() - control_count).into_owned();
        let held = |m: &DMatrix<f64>| m.rows(m.nrows() - control_count, control_count).into_owned();
        let mut similarities = self.of_one_kind(&motion(a), &motion(b));
        let ControlKernel { alone, with_motion, radial_share, reach } = controls;
        let of_controls = Self { radial_share, reach, linear_share: 1.0 - radial_share, controls: None };
        let held = of_controls.of_one_kind(&held(a), &held(b));
        for (value, held) in similarities.iter_mut().zip(held.iter()) {
            *value = *value * (1.0 + with_motion * held) + alone * held;
        }
        similarities
    }

    /// Similarities where all rows of `a` and `b` are inputs of one kind.
    fn of_one_kind(&self, a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
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
    /// How many of the last inputs are controls, which have a mean squared length of their own.
    pub control_count: usize,
}

impl InputScale {
    /// The scale at which inputs count in proportion to `relevance`, and rows have a mean squared length of one; so have
    /// their last `control_count` inputs among themselves.
    pub fn new(inputs: &DMatrix<f64>, relevance: &[f64], control_count: usize) -> Self {
        assert_eq!(inputs.ncols(), relevance.len(), "one relevance for each input");
        let means = Standardization::of(inputs).means;
        let first = inputs.ncols() - control_count;
        let mut scales = relevance.to_vec();
        for kind in [0..first, first..inputs.ncols()] {
            let mean_square: f64 = kind
                .clone()
                .map(|k| {
                    let squares: f64 = inputs.column(k).iter().map(|value| (value - means[k]).powi(2)).sum();
                    relevance[k] * relevance[k] * squares / inputs.nrows().max(1) as f64
                })
                .sum();
            let factor = if mean_square > 0.0 { mean_square.sqrt().recip() } else { 1.0 };
            scales[kind].iter_mut().for_each(|scale| *scale *= factor);
        }
        Self { means, scales, control_count }
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
    /// Of inputs that hold still throughout a sequence, each with each of `kernels`; without such inputs nothing.
    pub controls: Vec<ControlKernel>,
    /// Further kernels of the motion that are tried where there are controls.
    pub kernels_with_controls: Vec<Kernel>,
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
        let kernels = [0.35, 0.5, 0.7].map(|reach| Kernel {
            radial_share: 1.0,
            reach,
            linear_share: 0.0,
            controls: None,
        });
        Self {
            kernels: kernels.to_vec(),
            dampings: vec![3e-3, 1e-2, 3e-2, 0.1],
            // Linear alone runs away beyond the controls seen, radial alone says nothing there: half of each.
            controls: [0.1, 0.3, 1.0]
                .map(|alone| ControlKernel { alone, with_motion: 0.3 * alone, radial_share: 0.5, reach: 1.0 })
                .to_vec(),
            kernels_with_controls: vec![Kernel {
                radial_share: 0.5,
                reach: 0.7,
                linear_share: 0.5,
                controls: None,
            }],
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
            controls: Vec::new(),
            kernels_with_controls: Vec::new(),
            ..Self::default()
        }
    }

    /// The same where a kernel of the controls is settled: of each kernel, the one with these controls.
    pub fn with_controls(&self, controls: ControlKernel) -> Self {
        let kernels = self.kernels.iter().chain(&self.kernels_with_controls);
        let kernels = kernels.map(|kernel| Kernel { controls: Some(controls), ..*kernel }).collect();
        Self { kernels, ..self.clone() }
    }
}

/// Rows of inputs and targets in the order of time, with what is known about them.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    /// One row a sample.
    pub inputs: &'a DMatrix<f64>,
    /// What is to be predicted, one row a sample.
    pub targets: &'a DMatrix<f64>,
    /// How many of the last inputs are controls.
    pub control_count: usize,
    /// First row of each sequence; beside blocks of rows, whole sequences are left out in turn. None: blocks alone.
    pub sequences: &'a [usize],
}

impl<'a> Samples<'a> {
    /// Rows of one sequence without controls.
    pub fn of_one_sequence(inputs: &'a DMatrix<f64>, targets: &'a DMatrix<f64>) -> Self {
        Self { inputs, targets, control_count: 0, sequences: &[] }
    }

    /// Ways to leave out each of the `kept` rows once: in blocks, and with its whole sequence.
    fn left_out(&self, kept: &[usize], folds: usize) -> Vec<Vec<Range<usize>>> {
        let count = kept.len();
        let folds = folds.clamp(2, count);
        let blocks = (0..folds).map(|fold| fold * count / folds..(fold + 1) * count / folds).collect();
        let mut ways = vec![blocks];
        // Two sequences say nothing about a third.
        if self.sequences.len() > 2 {
            let ends = self.sequences.iter().skip(1).copied().chain([usize::MAX]);
            let place = |row: usize| kept.partition_point(|kept| *kept < row);
            let whole = self.sequences.iter().zip(ends).map(|(start, end)| place(*start)..place(end));
            ways.push(whole.filter(|range| !range.is_empty()).collect());
        }
        ways
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
        samples: &Samples<'_>,
        relevance: &[f64],
        config: &KernelRidgeConfig,
    ) -> Result<Self, KernelRidgeError> {
        let choice = KernelChoice::by_left_out_blocks(samples, relevance, config)?;
        let kept = evenly_spread(samples.inputs.nrows(), config.most_rows);
        let (inputs, targets) = (samples.inputs.select_rows(&kept), samples.targets.select_rows(&kept));
        let kept = Samples { inputs: &inputs, targets: &targets, ..*samples };
        Self::learn_with(&kept, relevance, &choice)
    }

    /// Learns from all rows with a kernel and a damping that are given.
    pub fn learn_with(
        samples: &Samples<'_>,
        relevance: &[f64],
        choice: &KernelChoice,
    ) -> Result<Self, KernelRidgeError> {
        let prepared = Prepared::new(samples, relevance, samples.inputs.nrows(), 2)?;
        let Prepared { scale, centres, targets, output_means, .. } = prepared;
        let mut similarities = choice.kernel.between(&centres, &centres, scale.control_count);
        add_to_diagonal(&mut similarities, choice.damping);
        let factor = similarities.cholesky().ok_or(KernelRidgeError::NotPositiveDefinite)?;
        let dual = factor.solve(&targets);
        Ok(Self { inputs: scale, output_means, kernel: choice.kernel, centres, dual })
    }

    /// Outputs for rows of inputs.
    pub fn predict(&self, inputs: &DMatrix<f64>) -> DMatrix<f64> {
        let columns = self.inputs.columns(inputs);
        let mut outputs =
            self.kernel.between(&columns, &self.centres, self.inputs.control_count) * &self.dual;
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
    /// Sum of squared errors on the left-out blocks, and on the left-out sequences where there are several.
    pub left_out_error: f64,
}

impl KernelChoice {
    /// Kernel and damping with the smallest squared error on left-out blocks; where there are several sequences, on left-out
    /// blocks and left-out sequences together.
    ///
    /// The errors of a block B that was left out are `(G_BB)⁻¹ (G y)_B` with `G = (K + damping · I)⁻¹` (the block form of
    /// the leave-one-out formula of Craven and Wahba 1979), so that each pair costs one inverse.
    pub fn by_left_out_blocks(
        samples: &Samples<'_>,
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
        let prepared = Prepared::new(samples, relevance, config.rows_for_choice, config.folds)?;
        let mut best: Option<Self> = None;
        for kernel in &config.kernels {
            let similarities = kernel.between(&prepared.centres, &prepared.centres, samples.control_count);
            for damping in &config.dampings {
                let Some(misses) = left_out_residuals(&similarities, *damping, &prepared) else { continue };
                let error = misses.iter().map(DMatrix::norm_squared).sum();
                if best.is_none_or(|best| error < best.left_out_error) {
                    best = Some(Self { kernel: *kernel, damping: *damping, left_out_error: error });
                }
            }
        }
        best.ok_or(KernelRidgeError::NotPositiveDefinite)
    }
}

/// What a regressor with a given kernel and damping misses of each row when it is left out, for each way to leave it out.
pub(super) fn misses_of_left_out_blocks(
    samples: &Samples<'_>,
    relevance: &[f64],
    choice: &KernelChoice,
    config: &KernelRidgeConfig,
) -> Result<Vec<DMatrix<f64>>, KernelRidgeError> {
    let prepared = Prepared::new(samples, relevance, config.rows_for_choice, config.folds)?;
    let similarities = choice.kernel.between(&prepared.centres, &prepared.centres, samples.control_count);
    left_out_residuals(&similarities, choice.damping, &prepared).ok_or(KernelRidgeError::NotPositiveDefinite)
}

/// For each way to leave rows out, what a regressor without them misses of their targets.
fn left_out_residuals(
    similarities: &DMatrix<f64>,
    damping: f64,
    prepared: &Prepared,
) -> Option<Vec<DMatrix<f64>>> {
    let mut damped = similarities.clone();
    add_to_diagonal(&mut damped, damping);
    let inverse = damped.cholesky()?.inverse();
    let dual = &inverse * &prepared.targets;
    let missed = |blocks: &Vec<Range<usize>>| {
        let mut residuals = dual.clone();
        for Range { start, end } in blocks.iter().cloned() {
            let block = inverse.view((start, start), (end - start, end - start)).into_owned().cholesky()?;
            let missed = block.solve(&dual.rows(start, end - start).into_owned());
            residuals.rows_mut(start, end - start).copy_from(&missed);
        }
        Some(residuals)
    };
    prepared.left_out.iter().map(missed).collect()
}

/// Samples where a kernel compares them.
struct Prepared {
    scale: InputScale,
    /// Scaled inputs of the kept rows, as columns.
    centres: DMatrix<f64>,
    /// Targets of the kept rows without their means.
    targets: DMatrix<f64>,
    output_means: Vec<f64>,
    left_out: Vec<Vec<Range<usize>>>,
}

impl Prepared {
    fn new(
        samples: &Samples<'_>,
        relevance: &[f64],
        most_rows: usize,
        folds: usize,
    ) -> Result<Self, KernelRidgeError> {
        let (inputs, targets) = (samples.inputs, samples.targets);
        if inputs.nrows() != targets.nrows() || inputs.nrows() < 2 {
            return Err(KernelRidgeError::Rows { inputs: inputs.nrows(), targets: targets.nrows() });
        }
        let kept = evenly_spread(inputs.nrows(), most_rows);
        let scale = InputScale::new(inputs, relevance, samples.control_count);
        let centres = scale.columns(&inputs.select_rows(&kept));
        let mut targets = targets.select_rows(&kept);
        let output_means: Vec<f64> = targets.column_iter().map(|column| column.mean()).collect();
        for (mut column, mean) in targets.column_iter_mut().zip(&output_means) {
            column.add_scalar_mut(-mean);
        }
        Ok(Self { scale, centres, targets, output_means, left_out: samples.left_out(&kept, folds) })
    }
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
        let regressor =
            KernelRidge::learn(&Samples::of_one_sequence(&inputs, &targets), &[1.0; 3], &config).unwrap();
        let found = regressor.predict(&DMatrix::from_row_slice(1, 3, &[0.3, -0.7, 0.2]));
        assert!((found[0] - (0.6 + 0.7 + 5.0)).abs() < 1e-6, "{found}");
    }

    #[test]
    fn the_block_formula_gives_the_errors_of_models_that_never_saw_the_block() {
        let (inputs, targets) = samples(40);
        let kernel = Kernel { radial_share: 1.0, reach: 1.0, linear_share: 0.3, controls: None };
        let columns = inputs.transpose();
        let mut damped = kernel.between(&columns, &columns, 0);
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
            let regressor =
                KernelRidge::learn(&Samples::of_one_sequence(&inputs, &targets), &[1.0; 3], config).unwrap();
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
            KernelRidge::learn(&Samples::of_one_sequence(&one, &targets), &[1.0; 3], &config),
            Err(KernelRidgeError::Rows { .. })
        ));
        let none = KernelRidgeConfig { kernels: Vec::new(), ..config };
        assert_eq!(
            KernelRidge::learn(&Samples::of_one_sequence(&inputs, &targets), &[1.0; 3], &none),
            Err(KernelRidgeError::Settings)
        );
    }

    /// Eight sequences of one motion whose targets are a wave of it, moved and scaled by a control.
    fn sequences() -> (DMatrix<f64>, DMatrix<f64>, Vec<usize>) {
        let controls = [-1.6, -1.0, -0.7, -0.2, 0.1, 0.5, 0.9, 2.0];
        let (inputs, targets): (Vec<_>, Vec<_>) = controls
            .iter()
            .flat_map(|control| (0..20).map(move |frame| (f64::from(frame) * 0.3, *control)))
            .map(|(time, control)| {
                let motion = [time.sin(), time.cos(), control];
                (motion, [3.0 * (2.0 * time).sin() * (1.0 + 0.4 * control) + 2.0 * control])
            })
            .unzip();
        let matrix = |rows: Vec<f64>, width| DMatrix::from_row_slice(160, width, &rows);
        (
            matrix(inputs.concat(), 3),
            matrix(targets.concat(), 1),
            (0..controls.len()).map(|sequence| 20 * sequence).collect(),
        )
    }

    #[test]
    fn a_control_beyond_all_seen_changes_what_all_sequences_share() {
        let (inputs, targets, _) = sequences();
        let seen: Vec<usize> = (0..140).collect();
        let unseen: Vec<usize> = (140..160).collect();
        let (known, wanted) = (inputs.select_rows(&seen), targets.select_rows(&seen));
        let starts: Vec<usize> = (0..7).map(|sequence| 20 * sequence).collect();
        let relevance = equal_relevance(&known);
        let error = |controls: &[ControlKernel]| {
            let samples = Samples { inputs: &known, targets: &wanted, control_count: 1, sequences: &starts };
            let defaults = KernelRidgeConfig::default();
            let kernels: Vec<Kernel> =
                controls.iter().flat_map(|controls| defaults.with_controls(*controls).kernels).collect();
            let kernels = if kernels.is_empty() { defaults.kernels.clone() } else { kernels };
            let config = KernelRidgeConfig { kernels, ..defaults };
            let regressor = KernelRidge::learn(&samples, &relevance, &config).unwrap();
            let missed = regressor.predict(&inputs.select_rows(&unseen)) - targets.select_rows(&unseen);
            missed.norm() / targets.select_rows(&unseen).norm()
        };
        let (as_one_kind, apart) = (error(&[]), error(&KernelRidgeConfig::default().controls));
        assert!(
            apart < 0.15 && apart < 0.3 * as_one_kind,
            "{apart}, with controls as other inputs {as_one_kind}"
        );
    }

    #[test]
    fn each_row_is_left_out_once_in_a_block_and_once_with_its_sequence() {
        let (inputs, targets, starts) = sequences();
        let samples = Samples { inputs: &inputs, targets: &targets, control_count: 1, sequences: &starts };
        let kept = evenly_spread(160, 50);
        let ways = samples.left_out(&kept, 5);
        assert_eq!(ways.iter().map(Vec::len).collect::<Vec<_>>(), [5, 8]);
        for way in &ways {
            let rows: Vec<usize> = way.iter().cloned().flatten().collect();
            assert_eq!(rows, (0..kept.len()).collect::<Vec<_>>());
        }
        for (range, start) in ways[1].iter().zip(&starts) {
            assert!(kept[range.clone()].iter().all(|row| (*start..start + 20).contains(row)));
        }
        assert_eq!(Samples { sequences: &[0, 80], ..samples }.left_out(&kept, 5).len(), 1);
    }
}
