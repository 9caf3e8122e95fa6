//! All numbers about a shape space in one file (P1 §5): `metrics.json`. The names of its keys are a contract.

use std::path::Path;

use habitus_optimize::{Event, Flow, Observer};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::bootstrap::accepted_of_round;
use super::learnt_shape::{LearnFolderError, RegistrationFolder, settings_of_model};
use super::registered_run::{
    RegisteredRun, RegisteredRunError, ScanPlaces, finished_rounds, registration_folder, round_folder,
};
use super::run_folder::StageName;
use crate::body::BodyModel;
use crate::evaluation::fit_error::FitError;
use crate::evaluation::shape_space_quality::{
    ShapeSpaceQuality, ShapeSpaceQualitySettings, quality_against, quality_by_training_samples,
    shape_space_quality,
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
    /// Registrations cannot be compared with their scans.
    #[error(transparent)]
    Compare(#[from] RegisteredRunError),
    /// The registrations of a round cannot be read.
    #[error(transparent)]
    Round(#[from] LearnFolderError),
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
    /// How far registrations are from their scans (P1 §4.2), if the folder is a run that knows where its scans are: of the
    /// run, or of each bootstrapping round.
    pub fit_errors: Vec<NamedFitError>,
}

/// A fit error and what it is of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedFitError {
    /// What it is of.
    pub name: String,
    /// The fit error.
    #[serde(flatten)]
    pub error: FitError,
}

/// The rounds of a run against its last (P1 §5.2), and how far registrations are from their scans (P1 §4); nothing of either
/// for a folder that is no run. Poses are taken out of all rounds in the same way, as the model's were.
pub fn evaluate_run(
    run: &Path,
    model: &BodyModel,
    settings: &ShapeSpaceQualitySettings,
    metrics: &mut ShapeSpaceMetrics,
    observer: &mut dyn Observer,
) -> Result<(), EvaluateSpaceError> {
    let rounds = finished_rounds(run);
    metrics.by_round = quality_by_round(run, &rounds, model, settings, observer)?;
    let Some(places) = ScanPlaces::read(run) else { return Ok(()) };
    let folders = if rounds.is_empty() {
        vec![("registrations".to_string(), registration_folder(run))]
    } else {
        let folder = |round: &usize| round_folder(run, *round).join(StageName::Register.folder());
        rounds.iter().map(|round| (round_name(*round), folder(round))).collect()
    };
    for (name, folder) in folders {
        let registered = RegisteredRun::open(&folder, &places.scans, model)?;
        let error = registered.fit_error(registered.names(), &settings.fit_error, observer)?;
        if error.registrations > 0 {
            metrics.fit_errors.push(NamedFitError { name, error });
        }
    }
    Ok(())
}

fn round_name(round: usize) -> String {
    format!("round {round}")
}

fn quality_by_round(
    run: &Path,
    rounds: &[usize],
    model: &BodyModel,
    settings: &ShapeSpaceQualitySettings,
    observer: &mut dyn Observer,
) -> Result<Vec<NamedQuality>, EvaluateSpaceError> {
    let Some((last, _)) = rounds.split_last() else { return Ok(Vec::new()) };
    let config = settings_of_model(model).unwrap_or_default();
    let mut prepared = |round: usize| -> Result<_, EvaluateSpaceError> {
        let path = round_folder(run, round);
        let accepted = accepted_of_round(&path);
        let mut folder = RegistrationFolder::read(&path, model, Default::default(), |_, _| {})?;
        folder.registrations.retain(|registration| accepted.contains(&registration.name));
        let names: Vec<String> = folder.registrations.iter().map(|r| r.name.clone()).collect();
        let mut samples = prepare_samples(&folder.registrations, model, &config, observer)?.samples;
        (0..samples.len()).for_each(|index| align_to(samples.sample_mut(index), model.mean_vertices()));
        Ok((names, samples))
    };
    let (truth_names, truth) = prepared(*last)?;
    let mut qualities = Vec::with_capacity(rounds.len());
    for round in rounds {
        let (names, samples) = prepared(*round)?;
        let own: Vec<Option<usize>> =
            truth_names.iter().map(|name| names.iter().position(|other| other == name)).collect();
        let quality = quality_against(&samples, &truth, &own, settings)?;
        qualities.push(NamedQuality { name: round_name(*round), quality });
    }
    Ok(qualities)
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
        fit_errors: Vec::new(),
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
