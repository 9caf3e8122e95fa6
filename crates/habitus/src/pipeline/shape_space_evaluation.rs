//! All numbers about a shape space in one file (P1 §5): `metrics.json`. The names of its keys are a contract.

use habitus_optimize::{Event, Flow, Observer};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::learnt_shape::settings_of_model;
use crate::body::BodyModel;
use crate::evaluation::shape_space_quality::{
    ShapeSpaceQuality, ShapeSpaceQualitySettings, quality_by_training_samples, shape_space_quality,
};
use crate::stages::learn_shape::{
    LearnShapeConfig, LearnShapeError, PoseNormalization, Registration, prepare_samples,
};
use crate::statistics::{LinearSpaceError, align_to};

/// Why a space cannot be evaluated.
#[derive(Debug, Error)]
pub enum EvaluateSpaceError {
    /// The registrations cannot be prepared as for learning.
    #[error(transparent)]
    Prepare(#[from] LearnShapeError),
    /// A space cannot be learnt.
    #[error(transparent)]
    Space(#[from] LinearSpaceError),
}

/// Measures of a space of one kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedQuality {
    /// What the space is, for example the name of a pose normalization.
    pub name: String,
    /// Its measures.
    #[serde(flatten)]
    pub quality: ShapeSpaceQuality,
}

/// The contents of `metrics.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShapeSpaceMetrics {
    /// Name of the model.
    pub model: String,
    /// Pose normalization of the registrations before all measures.
    pub pose_normalization: String,
    /// Number of registrations.
    pub registrations: usize,
    /// The measures of the space of all registrations.
    #[serde(flatten)]
    pub quality: ShapeSpaceQuality,
    /// Mean vertex distance of the registrations to what the model's own space makes of them, by number of components. Not
    /// a generalization if the model was learnt from these registrations.
    pub model_reconstruction_mm: Vec<f64>,
    /// The measures by number of training samples (P1 §5.3).
    pub by_training_samples: Vec<ShapeSpaceQuality>,
    /// The measures by pose normalization (P1 §5.4), if asked for.
    pub by_pose_normalization: Vec<NamedQuality>,
    /// The measures by bootstrapping round against the last round (P1 §5.2), if the run has rounds.
    pub by_round: Vec<NamedQuality>,
}

/// What besides the space of all registrations is evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EvaluationScope {
    /// The space, and spaces of fewer training samples.
    Space,
    /// Also the space under every pose normalization.
    PoseNormalizations,
}

/// Evaluates the space of registrations that are prepared as the model's were.
pub fn evaluate_shape_space(
    registrations: &[Registration],
    model: &BodyModel,
    settings: &ShapeSpaceQualitySettings,
    scope: EvaluationScope,
    observer: &mut dyn Observer,
) -> Result<ShapeSpaceMetrics, EvaluateSpaceError> {
    let config = settings_of_model(model).unwrap_or_default();
    let prepared = prepare_samples(registrations, model, &config, observer)?.samples;
    tell(observer, 0)?;
    let quality = shape_space_quality(&prepared, settings)?;
    tell(observer, 1)?;
    let by_training_samples = quality_by_training_samples(&prepared, settings)?;
    tell(observer, 2)?;
    let mut by_pose_normalization = Vec::new();
    if scope == EvaluationScope::PoseNormalizations {
        for method in PoseNormalization::ALL {
            let quality = if method == config.pose_normalization {
                quality.clone()
            } else {
                let other = LearnShapeConfig { pose_normalization: method, ..config.clone() };
                let samples = prepare_samples(registrations, model, &other, observer)?.samples;
                shape_space_quality(&samples, settings)?
            };
            by_pose_normalization.push(NamedQuality { name: method.name().into(), quality });
        }
    }
    tell(observer, 3)?;
    Ok(ShapeSpaceMetrics {
        model: model.metadata().name.clone(),
        pose_normalization: config.pose_normalization.name().into(),
        registrations: registrations.len(),
        model_reconstruction_mm: reconstruction(
            registrations,
            model,
            &config,
            &quality.components,
            observer,
        )?,
        quality,
        by_training_samples,
        by_pose_normalization,
        by_round: Vec::new(),
    })
}

/// Registrations in the model's rest pose, projected onto its space.
fn reconstruction(
    registrations: &[Registration],
    model: &BodyModel,
    config: &LearnShapeConfig,
    components: &[usize],
    observer: &mut dyn Observer,
) -> Result<Vec<f64>, EvaluateSpaceError> {
    let unposing = LearnShapeConfig { pose_normalization: PoseNormalization::Unpose, ..config.clone() };
    let mut samples = prepare_samples(registrations, model, &unposing, observer)?.samples;
    let space = model.identity_space()?;
    let mut sums = vec![0.0; components.len()];
    for index in 0..samples.len() {
        align_to(samples.sample_mut(index), model.mean_vertices());
        let sample = samples.sample(index);
        let coefficients = space.coefficients(sample);
        for (sum, count) in sums.iter_mut().zip(components) {
            let found = space.instance(&coefficients[..(*count).min(coefficients.len())]);
            *sum += mean_distance(sample, &found);
        }
    }
    Ok(sums.into_iter().map(|sum| 1000.0 * sum / samples.len().max(1) as f64).collect())
}

fn mean_distance(left: &[f64], right: &[f64]) -> f64 {
    let squared = |(x, y): (&[f64], &[f64])| -> f64 { x.iter().zip(y).map(|(x, y)| (x - y).powi(2)).sum() };
    let distances = left.chunks_exact(3).zip(right.chunks_exact(3)).map(|pair| squared(pair).sqrt());
    distances.sum::<f64>() / (left.len() / 3).max(1) as f64
}

fn tell(observer: &mut dyn Observer, done: usize) -> Result<(), EvaluateSpaceError> {
    match observer.on_event(&Event::Progress { stage: "evaluate", done, total: 3 }) {
        Flow::Continue => Ok(()),
        Flow::Stop => Err(LearnShapeError::Cancelled.into()),
    }
}
