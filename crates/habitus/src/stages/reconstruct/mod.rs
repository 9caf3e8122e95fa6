//! One body from a front and a back view (P1 §6): each view is fitted alone, then the identity is shared and the poses stay
//! free, because a person moves between two views.

pub mod config;
mod partial_view;

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, TriangleMesh};
use habitus_optimize::{Event, Flow, Observer, SolveError};
use thiserror::Error;

pub use config::ReconstructConfig;
pub use partial_view::{PartialView, Side};

use crate::body::BodyModel;
use crate::fitting::model_fit::{ModelFitter, ModelState};
use crate::fitting::standing_start::facing_start;

/// Why no body can be reconstructed.
#[derive(Debug, Error)]
pub enum ReconstructError {
    /// A view shows no surface.
    #[error(
        "the {side} view shows no surface within the range of depths; check depth_scale and reconstruct.depth_range"
    )]
    NothingSeen {
        /// The side.
        side: &'static str,
    },
    /// Body and surface do not meet.
    #[error(
        "the {side} view: the body stays {residual_mm:.0} mm off on average; is the person upright and whole in the image, and does y point up?"
    )]
    NotFound {
        /// The side.
        side: &'static str,
        /// Mean distance, millimetres.
        residual_mm: f64,
    },
    /// The solver fails.
    #[error("the {side} view cannot be fitted ({source})")]
    Solve {
        /// The side, or both.
        side: &'static str,
        /// What the solver says.
        source: SolveError,
    },
    /// The observer asked to stop.
    #[error("cancelled")]
    Cancelled,
}

/// One body in the poses of its views.
#[derive(Clone, Debug, PartialEq)]
pub struct ReconstructedBody {
    /// Identity in standard deviations of the model's components.
    pub identity: Vec<f64>,
    /// The body at rest, with what the model's components cannot express; metres.
    pub rest_vertices: Vec<DVec3>,
    /// Pose of each view, in its camera's frame.
    pub poses: Vec<Vec<f64>>,
    /// The body as each view saw it, in its camera's frame; metres.
    pub posed_vertices: Vec<Vec<DVec3>>,
    /// Mean distance from what each view shows to the body, metres.
    pub residuals: Vec<f64>,
}

/// A body this far from what a view shows, on average, was not found, metres.
const LARGEST_RESIDUAL: f64 = 0.03;

/// Fits one body to partial views of one person.
pub fn reconstruct(
    views: &[PartialView],
    model: &BodyModel,
    config: &ReconstructConfig,
    observer: &mut dyn Observer,
) -> Result<ReconstructedBody, ReconstructError> {
    let fitter = ModelFitter::new(model, &config.model, &[]);
    let alone = config.levels_alone.clamp(1, fitter.level_count().max(1));
    let total = views.len() + fitter.level_count();
    let mut states = Vec::with_capacity(views.len());
    for (done, view) in views.iter().enumerate() {
        tell(observer, done, total)?;
        let failed = |source| ReconstructError::Solve { side: view.side.name(), source };
        let heading = if view.side == Side::Front { 0.0 } else { std::f64::consts::PI };
        let mut state = facing_start(&fitter, &view.points(), heading).map_err(failed)?.state;
        for level in 1..alone {
            fitter.fit_level(level, &mut state, &view.points(), &[]).map_err(failed)?;
        }
        states.push(state);
    }
    // P1 §6: starting with the views' own results, shape is optimised jointly and pose independently.
    share_identity(&mut states);
    let points: Vec<_> = views.iter().map(PartialView::points).collect();
    for level in alone - 1..fitter.level_count() {
        tell(observer, views.len() + level, total)?;
        fitter
            .fit_level_together(level, &mut states, &points)
            .map_err(|source| ReconstructError::Solve { side: "front and back", source })?;
    }
    tell(observer, total, total)?;
    finish(views, &fitter, states)
}

fn share_identity(states: &mut [ModelState]) {
    let length = states.iter().map(|state| state.identity.len()).max().unwrap_or(0);
    let count = states.len().max(1) as f64;
    let mean: Vec<f64> = (0..length)
        .map(|k| states.iter().map(|s| s.identity.get(k).copied().unwrap_or(0.0)).sum::<f64>() / count)
        .collect();
    states.iter_mut().for_each(|state| state.identity.clone_from(&mean));
}

fn finish(
    views: &[PartialView],
    fitter: &ModelFitter<'_>,
    states: Vec<ModelState>,
) -> Result<ReconstructedBody, ReconstructError> {
    let posed_vertices: Vec<Vec<DVec3>> = states.iter().map(|state| fitter.vertices(state)).collect();
    let mut residuals = Vec::with_capacity(views.len());
    for (view, vertices) in views.iter().zip(&posed_vertices) {
        let residual = TriangleMesh::new(vertices.clone(), fitter.model().faces().to_vec()).map_or(
            f64::INFINITY,
            |mesh| {
                let index = SurfaceIndex::of_mesh(&mesh);
                let sum: f64 =
                    view.positions.iter().map(|point| index.closest(*point).distance_squared.sqrt()).sum();
                sum / view.positions.len().max(1) as f64
            },
        );
        if residual > LARGEST_RESIDUAL {
            return Err(ReconstructError::NotFound {
                side: view.side.name(),
                residual_mm: 1000.0 * residual,
            });
        }
        residuals.push(residual);
    }
    let mut identity = states.first().map_or_else(Vec::new, |state| state.identity.clone());
    let rest_vertices = fitter.rest_vertices(&identity);
    identity.resize(fitter.model().component_count(), 0.0);
    let poses = states.into_iter().map(|state| state.pose).collect();
    Ok(ReconstructedBody { identity, rest_vertices, poses, posed_vertices, residuals })
}

fn tell(observer: &mut dyn Observer, done: usize, total: usize) -> Result<(), ReconstructError> {
    match observer.on_event(&Event::Progress { stage: "fit", done, total }) {
        Flow::Continue => Ok(()),
        Flow::Stop => Err(ReconstructError::Cancelled),
    }
}
