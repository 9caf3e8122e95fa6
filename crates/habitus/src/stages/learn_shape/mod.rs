//! From registrations to a body model (P1 §2 and §3.4).
//!
//! ```text
//! registrations ──align──▶ ──pose_normalization──▶ ──align──▶ LinearSpace ──rest pose──▶ BodyModel
//! ```
//! Topology, skeleton, skin weights, joint regressor and names are carried over from the base model, whose template the
//! registrations share: P1 keeps the rig of the model that it rebuilds as well.

pub mod config;
mod laplacian_surface;
mod pose_normalization;
mod rest_pose;

use glam::DVec3;
use habitus_geometry::{MeshError, TriangleMesh};
use habitus_optimize::{Event, Flow, Observer, SolveError};
use thiserror::Error;

pub use config::{LearnShapeConfig, PoseNormalization, VertexWeighting};
pub use pose_normalization::{NormalizedSamples, normalize_pose};

use crate::body::{BodyModel, SpaceOrigin};
use crate::statistics::{LinearSpace, LinearSpaceError, SampleMatrix, align_samples};

/// Why no model can be learnt.
#[derive(Debug, Error)]
pub enum LearnShapeError {
    /// Nothing to learn from.
    #[error("{found} usable registrations are too few for a shape space: give at least 3")]
    TooFewRegistrations {
        /// How many there are.
        found: usize,
    },
    /// A registration has another topology.
    #[error(
        "registration '{name}' has {found} vertices, the base model has {expected}: give the model that the registrations were made with (--base)"
    )]
    OtherTopology {
        /// The registration.
        name: String,
        /// Vertices of the base model.
        expected: usize,
        /// Its vertices.
        found: usize,
    },
    /// The base model cannot be laid on a registration.
    #[error(
        "registration '{name}': the base model cannot be laid on it ({source}); reject it or learn without pose normalization"
    )]
    PoseFit {
        /// The registration.
        name: String,
        /// What the solver says.
        source: SolveError,
    },
    /// A sparse system cannot be solved.
    #[error(
        "the Laplacian of the template cannot be solved ({0}); check that the template is one connected surface"
    )]
    Laplacian(SolveError),
    /// The components cannot be computed.
    #[error(transparent)]
    Space(#[from] LinearSpaceError),
    /// The mean is no usable surface.
    #[error("the mean of the registrations is no usable surface: {0}")]
    Mean(#[from] MeshError),
    /// The observer asked to stop.
    #[error("cancelled")]
    Cancelled,
}

/// A registered body to learn from.
#[derive(Clone, Debug, PartialEq)]
pub struct Registration {
    /// Its name.
    pub name: String,
    /// Vertices in the base model's topology, metres.
    pub vertices: Vec<DVec3>,
}

/// What was learnt.
#[derive(Clone, Debug)]
pub struct LearntShape {
    /// The model.
    pub model: BodyModel,
    /// The space in the pose of the registrations' mean, or in the rest pose after `unpose`.
    pub space: LinearSpace,
    /// The aligned, pose-normalized registrations that the space was learnt from.
    pub samples: SampleMatrix,
}

/// Learns a body model from registrations in the topology of `base`.
pub fn learn_shape(
    registrations: &[Registration],
    base: &BodyModel,
    config: &LearnShapeConfig,
    origin: SpaceOrigin,
    observer: &mut dyn Observer,
) -> Result<LearntShape, LearnShapeError> {
    let normalized = prepare_samples(registrations, base, config, observer)?;
    tell(observer, "learn", 0, 1)?;
    let mean: Vec<DVec3> = normalized.samples.mean().chunks_exact(3).map(DVec3::from_slice).collect();
    let weights = match config.weighting {
        VertexWeighting::Uniform => Vec::new(),
        VertexWeighting::Area => area_weights(&mean, base.faces())?,
    };
    let space = LinearSpace::learn_weighted(&normalized.samples, &weights, &config.space)?;
    let in_rest_pose = if normalized.is_in_rest_pose {
        space.clone()
    } else {
        rest_pose::brought_into_rest_pose(&space, base, config)?
    };
    let model = base.with_identity_space(&in_rest_pose, origin)?;
    tell(observer, "learn", 1, 1)?;
    Ok(LearntShape { model, space, samples: normalized.samples })
}

/// The aligned and pose-normalized registrations: what a space is learnt from, and what spaces are evaluated with.
pub fn prepare_samples(
    registrations: &[Registration],
    base: &BodyModel,
    config: &LearnShapeConfig,
    observer: &mut dyn Observer,
) -> Result<NormalizedSamples, LearnShapeError> {
    if registrations.len() < 3 {
        return Err(LearnShapeError::TooFewRegistrations { found: registrations.len() });
    }
    let expected = base.vertex_count();
    if let Some(other) = registrations.iter().find(|registration| registration.vertices.len() != expected) {
        let (name, found) = (other.name.clone(), other.vertices.len());
        return Err(LearnShapeError::OtherTopology { name, expected, found });
    }
    let mut samples = SampleMatrix::of_points(registrations.iter().map(|r| r.vertices.as_slice()));
    align_samples(&mut samples, base.mean_vertices(), &config.alignment);
    let names: Vec<&str> = registrations.iter().map(|registration| registration.name.as_str()).collect();
    let mut normalized = normalize_pose(samples, &names, base, config, observer)?;
    align_samples(&mut normalized.samples, base.mean_vertices(), &config.alignment);
    Ok(normalized)
}

/// For each coordinate the share of the surface that its vertex stands for, one on average.
fn area_weights(mean: &[DVec3], faces: &[[u32; 3]]) -> Result<Vec<f64>, MeshError> {
    let mesh = TriangleMesh::new(mean.to_vec(), faces.to_vec())?;
    let mut areas = vec![0.0; mean.len()];
    for (face, vertices) in mesh.faces().iter().enumerate() {
        let [a, b, c] = mesh.corners(face);
        let third = (b - a).cross(c - a).length() / 6.0;
        vertices.iter().for_each(|vertex| areas[*vertex as usize] += third);
    }
    let average = areas.iter().sum::<f64>() / areas.len() as f64;
    // A vertex without area, in a folded or unused corner, must still have a weight.
    let smallest = 1e-3;
    Ok(areas.iter().flat_map(|area| [(area / average).max(smallest); 3]).collect())
}

fn tell(
    observer: &mut dyn Observer,
    stage: &'static str,
    done: usize,
    total: usize,
) -> Result<(), LearnShapeError> {
    match observer.on_event(&Event::Progress { stage, done, total }) {
        Flow::Continue => Ok(()),
        Flow::Stop => Err(LearnShapeError::Cancelled),
    }
}

#[cfg(test)]
mod tests;
