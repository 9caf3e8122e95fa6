//! Compactness, generalization and specificity of a shape space (P1 §5.1, after Styner et al. 2003), by number of
//! components.

mod leave_one_out;
mod specificity;

use serde::{Deserialize, Serialize};

use super::fit_error::FitErrorSettings;
use crate::statistics::{LinearSpace, LinearSpaceError, LinearSpaceSettings, RandomStream, SampleMatrix};

pub use leave_one_out::{CrossValidation, Fold};
pub use specificity::specificity;

/// What is evaluated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ShapeSpaceQualitySettings {
    /// Numbers of components at which the measures are taken. P1 Fig. 3: up to 50.
    pub components: Vec<usize>,
    /// Random bodies for the specificity. P1 §5.1: 10,000.
    pub specificity_samples: usize,
    /// Numbers of training samples that spaces are learnt from. P1 §5.3: 50, 100, 1,000 and all but one.
    pub training_samples: Vec<usize>,
    /// Left-out bodies for each number of training samples; more are not needed for a mean.
    pub training_sample_folds: usize,
    /// How registrations are compared with their scans.
    pub fit_error: FitErrorSettings,
    /// Seed of the random bodies and of the training subsets.
    pub seed: u64,
}

impl Default for ShapeSpaceQualitySettings {
    fn default() -> Self {
        Self {
            components: vec![0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 35, 40, 45, 50],
            specificity_samples: 10_000,
            training_samples: vec![50, 100, 1000],
            training_sample_folds: 200,
            fit_error: FitErrorSettings::default(),
            seed: 0,
        }
    }
}

impl ShapeSpaceQualitySettings {
    /// Numbers of components that a space of `sample_count` samples can have, in rising order.
    pub fn components_for(&self, sample_count: usize) -> Vec<usize> {
        let mut components = self.components.clone();
        components.sort_unstable();
        components.dedup();
        components.retain(|count| *count + 1 < sample_count.max(2));
        components
    }
}

/// The measures of one space; the lists go with `components`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ShapeSpaceQuality {
    /// Samples that the space was learnt from.
    pub samples: usize,
    /// Numbers of components.
    pub components: Vec<usize>,
    /// Share of the samples' variance.
    pub compactness: Vec<f64>,
    /// Mean vertex distance of left-out bodies to what the others' space makes of them.
    pub generalization_mm: Vec<f64>,
    /// Standard error of the generalization's mean over bodies.
    pub generalization_error_mm: Vec<f64>,
    /// Mean vertex distance of random bodies of the space to the nearest training body.
    pub specificity_mm: Vec<f64>,
}

/// All three measures of the space of aligned samples.
pub fn shape_space_quality(
    samples: &SampleMatrix,
    settings: &ShapeSpaceQualitySettings,
) -> Result<ShapeSpaceQuality, LinearSpaceError> {
    let components = settings.components_for(samples.len());
    let space = space_of(samples, &components)?;
    let validation = CrossValidation::new(samples);
    let generalization = mean_over_folds(&validation, &validation.leave_one_out_folds(), &components);
    Ok(ShapeSpaceQuality {
        samples: samples.len(),
        compactness: compactness(&space, &components),
        specificity_mm: specificity(&space, samples, &components, settings),
        generalization_mm: generalization.iter().map(|(mean, _)| *mean).collect(),
        generalization_error_mm: generalization.iter().map(|(_, error)| *error).collect(),
        components,
    })
}

/// The same measures of the space of some samples against others, which stand for the truth (P1 §5.2: registrations of an
/// earlier round against those of the last). `own_of[k]` is the place among `samples` of the body of truth `k`, if it is there:
/// it is left out when that body is reconstructed.
pub fn quality_against(
    samples: &SampleMatrix,
    truth: &SampleMatrix,
    own_of: &[Option<usize>],
    settings: &ShapeSpaceQualitySettings,
) -> Result<ShapeSpaceQuality, LinearSpaceError> {
    let components = settings.components_for(samples.len());
    let space = space_of(samples, &components)?;
    let mut both = SampleMatrix::with_capacity(samples.sample_length(), samples.len() + truth.len());
    samples.samples().chain(truth.samples()).for_each(|sample| both.push(sample));
    let folds: Vec<Fold> = own_of
        .iter()
        .enumerate()
        .map(|(test, own)| Fold {
            test: samples.len() + test,
            training: (0..samples.len()).filter(|other| Some(*other) != *own).collect(),
        })
        .collect();
    let generalization = mean_over_folds(&CrossValidation::new(&both), &folds, &components);
    Ok(ShapeSpaceQuality {
        samples: samples.len(),
        compactness: compactness(&space, &components),
        specificity_mm: specificity(&space, truth, &components, settings),
        generalization_mm: generalization.iter().map(|(mean, _)| *mean).collect(),
        generalization_error_mm: generalization.iter().map(|(_, error)| *error).collect(),
        components,
    })
}

/// The same measures of spaces of fewer, randomly chosen samples; generalization and specificity are taken against all
/// samples (P1 §5.3).
pub fn quality_by_training_samples(
    samples: &SampleMatrix,
    settings: &ShapeSpaceQualitySettings,
) -> Result<Vec<ShapeSpaceQuality>, LinearSpaceError> {
    let validation = CrossValidation::new(samples);
    let sizes = settings.training_samples.iter().filter(|size| **size + 1 < samples.len() && **size >= 3);
    sizes
        .map(|size| {
            let components = settings.components_for(*size);
            let mut stream = RandomStream::named(settings.seed, &format!("training subset of {size}"));
            let space = space_of(&samples.subset(&stream.choose(*size, samples.len())), &components)?;
            let tests = stream.choose(settings.training_sample_folds, samples.len());
            let folds: Vec<Fold> = tests
                .into_iter()
                .map(|test| {
                    let others: Vec<usize> = (0..samples.len()).filter(|other| *other != test).collect();
                    let mut training: Vec<usize> =
                        stream.choose(*size, others.len()).into_iter().map(|place| others[place]).collect();
                    training.sort_unstable();
                    Fold { test, training }
                })
                .collect();
            let generalization = mean_over_folds(&validation, &folds, &components);
            Ok(ShapeSpaceQuality {
                samples: *size,
                compactness: compactness(&space, &components),
                specificity_mm: specificity(&space, samples, &components, settings),
                generalization_mm: generalization.iter().map(|(mean, _)| *mean).collect(),
                generalization_error_mm: generalization.iter().map(|(_, error)| *error).collect(),
                components,
            })
        })
        .collect()
}

fn space_of(samples: &SampleMatrix, components: &[usize]) -> Result<LinearSpace, LinearSpaceError> {
    let most = components.last().copied().unwrap_or(0).max(1);
    LinearSpace::learn(samples, &LinearSpaceSettings::with_components(most))
}

/// Share of the variance that the first components carry.
pub fn compactness(space: &LinearSpace, components: &[usize]) -> Vec<f64> {
    let variances: Vec<f64> =
        space.standard_deviations().iter().map(|deviation| deviation * deviation).collect();
    components
        .iter()
        .map(|count| {
            variances.iter().take(*count).fold(0.0, |sum, variance| sum + variance)
                / space.total_variance().max(f64::MIN_POSITIVE)
        })
        .collect()
}

/// Mean and standard error over folds, in millimetres, for each number of components.
fn mean_over_folds(validation: &CrossValidation, folds: &[Fold], components: &[usize]) -> Vec<(f64, f64)> {
    let errors = validation.errors(folds, components);
    let count = errors.len().max(1) as f64;
    (0..components.len())
        .map(|place| {
            let mean = errors.iter().map(|fold| fold[place]).sum::<f64>() / count;
            let variance = errors.iter().map(|fold| (fold[place] - mean).powi(2)).sum::<f64>();
            (1000.0 * mean, 1000.0 * (variance / (count - 1.0).max(1.0) / count).sqrt())
        })
        .collect()
}

#[cfg(test)]
mod tests;
