//! Principal components of stacked vectors (P1 Eq. 1) by the Gram trick.
//!
//! With n samples of d ≫ n coordinates the eigenvectors of the n × n matrix of inner products give the components; d × d
//! numbers are never formed. Above a number of samples even n × n is not: a block power iteration takes its place.
//! Both ways end in the same f64 Rayleigh–Ritz step, which makes the basis orthonormal and the deviations exact for it.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::centred::Centred;
use super::directions::{Directions, leading_directions};
use super::sample_matrix::SampleMatrix;

/// How a space is learnt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LinearSpaceSettings {
    /// Components that are kept, if the samples have as many. P1 §5 shows up to 50.
    pub components: usize,
    /// Samples up to which products are formed in f64; above in f32, if the spectrum allows it.
    pub double_precision_up_to_samples: usize,
    /// Samples up to which all products are formed (n² numbers); above, a randomized block power iteration is used.
    pub exact_up_to_samples: usize,
    /// Rounds of the block power iteration.
    pub power_iterations: usize,
    /// Vectors that the block power iteration carries beyond the components.
    pub oversampling: usize,
    /// Seed of the block power iteration.
    pub seed: u64,
}

impl Default for LinearSpaceSettings {
    fn default() -> Self {
        Self {
            components: 100,
            double_precision_up_to_samples: 1500,
            exact_up_to_samples: 6000,
            power_iterations: 8,
            oversampling: 40,
            seed: 0,
        }
    }
}

impl LinearSpaceSettings {
    /// The defaults with another number of components.
    pub fn with_components(components: usize) -> Self {
        Self { components, ..Self::default() }
    }
}

/// Why no space can be learnt or built.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum LinearSpaceError {
    /// One sample has no variation.
    #[error("{found} samples are too few for a space: at least 2 are needed")]
    TooFewSamples {
        /// How many there are.
        found: usize,
    },
    /// A sample holds something that is no number.
    #[error("sample {sample} (counted from 0) holds a value that is not finite at coordinate {coordinate}")]
    NotFinite {
        /// The sample.
        sample: usize,
        /// The coordinate.
        coordinate: usize,
    },
    /// All samples are the same.
    #[error("the {found} samples are all equal: there is nothing to learn")]
    NoVariation {
        /// How many there are.
        found: usize,
    },
    /// A weight is not positive.
    #[error("the weight of coordinate {coordinate} is {value}: weights must be positive and finite")]
    BadWeight {
        /// The coordinate.
        coordinate: usize,
        /// Its weight.
        value: f64,
    },
    /// Parts of a space contradict one another.
    #[error("the space's {what} has length {found}, {expected} is needed")]
    LengthMismatch {
        /// The part.
        what: &'static str,
        /// The length it should have.
        expected: usize,
        /// The length it has.
        found: usize,
    },
}

/// A mean and orthonormal directions with their standard deviations: `x = mean + Σ_k coefficient_k σ_k basis_k`.
///
/// Coefficients count in standard deviations. With weights, orthonormal means `basisᵀ · diag(weights) · basis = I`.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearSpace {
    pub(super) mean: Vec<f64>,
    pub(super) basis: DMatrix<f64>,
    pub(super) standard_deviations: Vec<f64>,
    pub(super) weights: Vec<f64>,
    pub(super) total_variance: f64,
}

impl LinearSpace {
    /// Learns a space in which all coordinates count the same.
    pub fn learn(samples: &SampleMatrix, settings: &LinearSpaceSettings) -> Result<Self, LinearSpaceError> {
        Self::learn_weighted(samples, &[], settings)
    }

    /// Learns a space whose coordinates count with these weights, such as the areas of vertices; none means one each.
    pub fn learn_weighted(
        samples: &SampleMatrix,
        weights: &[f64],
        settings: &LinearSpaceSettings,
    ) -> Result<Self, LinearSpaceError> {
        check(samples, weights)?;
        let mean = samples.mean();
        let scales: Vec<f64> = weights.iter().map(|weight| weight.sqrt()).collect();
        let centred = Centred { samples, mean: &mean, scales: &scales };
        let Some(found) = leading_directions(&centred, settings) else {
            return Err(LinearSpaceError::NoVariation { found: samples.len() });
        };
        let Directions { mut basis, standard_deviations, total_variance } = found;
        for (mut row, scale) in basis.row_iter_mut().zip(&scales) {
            row /= *scale;
        }
        settle_signs(&mut basis);
        Ok(Self { mean, basis, standard_deviations, weights: weights.to_vec(), total_variance })
    }

    /// Puts a space together; `basis` has a column for each deviation, orthonormal with respect to `weights`.
    pub fn from_parts(
        mean: Vec<f64>,
        basis: DMatrix<f64>,
        standard_deviations: Vec<f64>,
        weights: Vec<f64>,
        total_variance: f64,
    ) -> Result<Self, LinearSpaceError> {
        let expect = |what, expected, found| {
            if found == expected {
                Ok(())
            } else {
                Err(LinearSpaceError::LengthMismatch { what, expected, found })
            }
        };
        expect("basis", mean.len(), basis.nrows())?;
        expect("list of standard deviations", basis.ncols(), standard_deviations.len())?;
        if !weights.is_empty() {
            expect("list of weights", mean.len(), weights.len())?;
        }
        Ok(Self { mean, basis, standard_deviations, weights, total_variance })
    }

    /// The mean sample.
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// Orthonormal directions as columns.
    pub fn basis(&self) -> &DMatrix<f64> {
        &self.basis
    }

    /// Standard deviation of the samples along each direction, largest first.
    pub fn standard_deviations(&self) -> &[f64] {
        &self.standard_deviations
    }

    /// Weight of each coordinate; empty if all count the same.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Variance of the samples along all directions, also those that are not in the basis.
    pub fn total_variance(&self) -> f64 {
        self.total_variance
    }

    /// Number of components.
    pub fn component_count(&self) -> usize {
        self.standard_deviations.len()
    }

    /// Numbers in a sample.
    pub fn sample_length(&self) -> usize {
        self.mean.len()
    }

    /// The sample of these coefficients (in standard deviations); missing ones are zero.
    pub fn instance(&self, coefficients: &[f64]) -> Vec<f64> {
        let mut sample = self.mean.clone();
        for ((column, deviation), coefficient) in
            self.basis.column_iter().zip(&self.standard_deviations).zip(coefficients)
        {
            let amount = deviation * coefficient;
            sample.iter_mut().zip(column.iter()).for_each(|(value, direction)| *value += amount * direction);
        }
        sample
    }

    /// The coefficients (in standard deviations) of the sample of the space that is closest to this one.
    pub fn coefficients(&self, sample: &[f64]) -> Vec<f64> {
        assert_eq!(sample.len(), self.mean.len(), "a sample of this space's length");
        let mut difference: Vec<f64> =
            sample.iter().zip(&self.mean).map(|(value, mean)| value - mean).collect();
        difference.iter_mut().zip(&self.weights).for_each(|(value, weight)| *value *= weight);
        self.basis
            .column_iter()
            .zip(&self.standard_deviations)
            .map(|(column, deviation)| {
                let along: f64 = column.iter().zip(&difference).map(|(x, y)| x * y).sum();
                if *deviation > 0.0 { along / deviation } else { 0.0 }
            })
            .collect()
    }

    /// The sample of the space that is closest to this one.
    pub fn project(&self, sample: &[f64]) -> Vec<f64> {
        self.instance(&self.coefficients(sample))
    }

    /// The same space with its first components only.
    #[must_use]
    pub fn truncated(&self, components: usize) -> Self {
        let kept = components.min(self.component_count());
        Self {
            mean: self.mean.clone(),
            basis: self.basis.columns(0, kept).into_owned(),
            standard_deviations: self.standard_deviations[..kept].to_vec(),
            weights: self.weights.clone(),
            total_variance: self.total_variance,
        }
    }
}

fn check(samples: &SampleMatrix, weights: &[f64]) -> Result<(), LinearSpaceError> {
    if samples.len() < 2 {
        return Err(LinearSpaceError::TooFewSamples { found: samples.len() });
    }
    for (index, sample) in samples.samples().enumerate() {
        if let Some(coordinate) = sample.iter().position(|value| !value.is_finite()) {
            return Err(LinearSpaceError::NotFinite { sample: index, coordinate });
        }
    }
    if !weights.is_empty() && weights.len() != samples.sample_length() {
        let (expected, found) = (samples.sample_length(), weights.len());
        return Err(LinearSpaceError::LengthMismatch { what: "list of weights", expected, found });
    }
    match weights.iter().position(|weight| !(weight.is_finite() && *weight > 0.0)) {
        Some(coordinate) => Err(LinearSpaceError::BadWeight { coordinate, value: weights[coordinate] }),
        None => Ok(()),
    }
}

/// A direction and its opposite are the same component: the largest entry (the first of equals) is made positive.
fn settle_signs(basis: &mut DMatrix<f64>) {
    for mut column in basis.column_iter_mut() {
        let largest =
            column.iter().fold(0.0_f64, |best, value| if value.abs() > best.abs() { *value } else { best });
        if largest < 0.0 {
            column.neg_mut();
        }
    }
}

#[cfg(test)]
mod tests;
