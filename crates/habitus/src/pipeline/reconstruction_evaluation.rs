//! `reconstruct` over many pairs of views whose bodies are known, by space: P1 §6.2.

use glam::DVec3;
use habitus_optimize::{Event, Flow, Observer, Silent};
use rayon::prelude::*;
use thiserror::Error;

use crate::body::{BodyModel, SpaceOrigin};
use crate::evaluation::reconstruction_accuracy::{
    ComparedBody, ReconstructionAccuracy, ReconstructionAccuracySettings,
};
use crate::stages::learn_shape::{LearnShapeConfig, LearnShapeError, Registration, learn_shape};
use crate::stages::reconstruct::{
    PartialView, ReconstructConfig, ReconstructError, ReconstructedBody, reconstruct,
};
use crate::statistics::{LinearSpaceError, RandomStream};

/// Why reconstructions cannot be evaluated.
#[derive(Debug, Error)]
pub enum EvaluateReconstructionsError {
    /// A truth has another topology.
    #[error(
        "'{name}' has {found} true vertices, but the model has {expected}; give the model that the pairs were made for"
    )]
    OtherTopology {
        /// The person.
        name: String,
        /// Vertices of the model.
        expected: usize,
        /// Vertices of the truth.
        found: usize,
    },
    /// A space cannot be learnt.
    #[error(transparent)]
    Learn(#[from] LearnShapeError),
    /// A space cannot be cut.
    #[error(transparent)]
    Space(#[from] LinearSpaceError),
    /// The solver or its settings fail.
    #[error(transparent)]
    Reconstruct(#[from] ReconstructError),
    /// The observer asked to stop.
    #[error("cancelled")]
    Cancelled,
}

/// A person's views and the truth about them; metres.
pub struct KnownPair {
    /// Name of the person.
    pub name: String,
    /// The views.
    pub views: Vec<PartialView>,
    /// The true body in each view's camera frame.
    pub posed: Vec<Vec<DVec3>>,
    /// The true body at rest.
    pub rest: Vec<DVec3>,
}

/// The model's space with fewer and fewer components, and with all.
pub fn by_components(
    pairs: &[KnownPair],
    model: &BodyModel,
    config: &ReconstructConfig,
    settings: &ReconstructionAccuracySettings,
    observer: &mut dyn Observer,
) -> Result<Vec<ReconstructionAccuracy>, EvaluateReconstructionsError> {
    let mut counts: Vec<usize> =
        settings.components.iter().map(|count| (*count).clamp(1, model.component_count().max(1))).collect();
    counts.sort_unstable();
    counts.dedup();
    let space = model.identity_space()?;
    let mut found = Vec::with_capacity(counts.len());
    for count in counts {
        let cut = model.with_identity_space(&space.truncated(count), origin_of(model))?;
        found.push(accuracy(pairs, &cut, config, settings, observer)?);
    }
    Ok(found)
}

/// Spaces of more and more registrations, drawn at random, over the rig of `base`; each holds the smaller ones.
pub fn by_training_samples(
    pairs: &[KnownPair],
    registrations: &[Registration],
    base: &BodyModel,
    learn: &LearnShapeConfig,
    config: &ReconstructConfig,
    settings: &ReconstructionAccuracySettings,
    observer: &mut dyn Observer,
) -> Result<Vec<ReconstructionAccuracy>, EvaluateReconstructionsError> {
    let mut stream = RandomStream::named(settings.seed, "training samples of reconstructions");
    let order = stream.choose(registrations.len(), registrations.len());
    let mut counts: Vec<usize> =
        settings.training_samples.iter().copied().filter(|count| *count < registrations.len()).collect();
    counts.push(registrations.len());
    counts.sort_unstable();
    counts.dedup();
    let mut found = Vec::with_capacity(counts.len());
    for count in counts {
        let samples: Vec<Registration> =
            order[..count].iter().map(|place| registrations[*place].clone()).collect();
        let model = learn_shape(&samples, base, learn, origin_of(base), &mut Silent)?.model;
        let mut accuracy = accuracy(pairs, &model, config, settings, observer)?;
        accuracy.training_samples = Some(count);
        found.push(accuracy);
    }
    Ok(found)
}

fn origin_of(model: &BodyModel) -> SpaceOrigin {
    let metadata = model.metadata();
    SpaceOrigin {
        name: metadata.name.clone(),
        license: metadata.license.clone(),
        provenance: serde_json::Value::Null,
    }
}

/// One space over all pairs. A person who is not found counts as failed; what is wrong with the solver ends it.
fn accuracy(
    pairs: &[KnownPair],
    model: &BodyModel,
    config: &ReconstructConfig,
    settings: &ReconstructionAccuracySettings,
    observer: &mut dyn Observer,
) -> Result<ReconstructionAccuracy, EvaluateReconstructionsError> {
    if let Some(other) = pairs.iter().find(|pair| pair.rest.len() != model.vertex_count()) {
        return Err(EvaluateReconstructionsError::OtherTopology {
            name: other.name.clone(),
            expected: model.vertex_count(),
            found: other.rest.len(),
        });
    }
    let mut found: Vec<(&KnownPair, Option<ReconstructedBody>)> = Vec::with_capacity(pairs.len());
    for batch in pairs.chunks(rayon::current_num_threads().max(1)) {
        let bodies: Vec<_> =
            batch.par_iter().map(|pair| reconstruct(&pair.views, model, config, &mut Silent)).collect();
        for (pair, body) in batch.iter().zip(bodies) {
            match body {
                Ok(body) => found.push((pair, Some(body))),
                Err(ReconstructError::NotFound { .. }) => found.push((pair, None)),
                Err(error) => return Err(error.into()),
            }
        }
        let event = Event::Progress { stage: "reconstruct", done: found.len(), total: pairs.len() };
        if observer.on_event(&event) == Flow::Stop {
            return Err(EvaluateReconstructionsError::Cancelled);
        }
    }
    let compared: Vec<ComparedBody<'_>> = found
        .iter()
        .filter_map(|(pair, body)| {
            let body = body.as_ref()?;
            let posed = body.posed_vertices.iter().zip(&pair.posed);
            Some(ComparedBody {
                rest: [&body.rest_vertices, &pair.rest],
                posed: posed.map(|(found, truth)| [found.as_slice(), truth.as_slice()]).collect(),
            })
        })
        .collect();
    let failed = found.len() - compared.len();
    let mut accuracy = ReconstructionAccuracy::of(&compared, failed, &settings.thresholds_mm);
    accuracy.components = model.component_count();
    Ok(accuracy)
}
