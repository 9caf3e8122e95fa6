//! Brings a template onto raw scans (P1 §3.1–3.2).
//!
//! ```text
//! Scan ─ clean, metres, held-out points ─▶ start: landmarks │ standing start │ rigid landmarks
//!      ─▶ model fit (pose and shape) ─▶ displacements (default) │ per-vertex affines (paper) ─▶ quality, codes
//! ```
//! Deviation: the default recipe is not P1's; `paper` is, see the book.

mod affines;
pub mod config;
mod displacements;
mod paper;
mod prepared_scan;
mod quality;
mod template;

use glam::DVec3;
use habitus_geometry::{MeshError, TriangleMesh, procrustes};
use habitus_optimize::SolveError;
use thiserror::Error;

use crate::artifacts::registered_scan::{FittedModel, RegisteredScan, RegistrationRecord};
use crate::artifacts::scan::Scan;
use crate::body::{BodyModel, IdentityCoefficients, rotation_vector};
use crate::fitting::model_fit::{GivenLandmark, ModelFitter, ModelState};
use crate::fitting::standing_start::standing_start;

use config::PaperStart;
pub use config::{RegisterConfig, RegisterRecipe};
use paper::SubsampledScan;
use prepared_scan::PreparedScan;
use quality::Circumstances;
pub use template::{PreparedTemplate, Template};

/// Why a scan cannot be registered.
#[derive(Debug, Error)]
pub enum RegisterError {
    /// The scan is almost empty.
    #[error("scan '{scan}' has {found} points after cleaning, but {needed} are needed; check its export")]
    TooFewPoints {
        /// The scan.
        scan: String,
        /// Points that are left.
        found: usize,
        /// Points that are needed.
        needed: usize,
    },
    /// The scan's faces cannot be used.
    #[error("scan '{scan}' cannot be used ({source})")]
    UnusableScan {
        /// The scan.
        scan: String,
        /// What is wrong.
        source: MeshError,
    },
    /// A mesh as template needs landmarks.
    #[error(
        "scan '{scan}' shares {found} landmarks with the template, but {needed} are needed without a body model; give --landmarks, or use --model"
    )]
    TooFewLandmarks {
        /// The scan.
        scan: String,
        /// Common landmarks.
        found: usize,
        /// Landmarks that are needed.
        needed: usize,
    },
    /// The registered surface is no mesh.
    #[error("the registered surface is unusable ({0})")]
    Surface(#[from] MeshError),
    /// A solve failed.
    #[error("the fit failed ({0})")]
    Solve(#[from] SolveError),
    /// The template was prepared for another recipe.
    #[error("the template was not prepared for per-vertex affines")]
    NotPrepared,
}

/// Registers one scan; the caller measures the time.
pub fn register(scan: &Scan, template: &PreparedTemplate<'_>) -> Result<RegisteredScan, RegisterError> {
    let config = template.config;
    let prepared = PreparedScan::new(scan, &template.landmarks, config)?;
    let started = start(template, &prepared, &scan.name)?;
    let vertices = match (config.recipe, &template.fitter) {
        (RegisterRecipe::Default, Some(_)) => {
            displacements::displace(template, &prepared, &started.vertices)?
        }
        (RegisterRecipe::Default, None) => {
            // Far from the scan displacements alone would fold: affine maps bend the template near it first.
            let subsampled = SubsampledScan::new(template, &prepared, &scan.name);
            let bent = paper::deform(template, &subsampled, &started.vertices, &prepared.landmarks)?;
            displacements::displace(template, &prepared, &bent)?
        }
        (RegisterRecipe::Paper, _) => {
            let subsampled = SubsampledScan::new(template, &prepared, &scan.name);
            paper::deform(template, &subsampled, &started.vertices, &prepared.landmarks)?
        }
    };
    let limit = IdentityCoefficients::LIMIT - 1e-6;
    let circumstances = Circumstances {
        margin: started.margin,
        is_identity_at_limit: started
            .state
            .as_ref()
            .is_some_and(|state| state.identity.iter().any(|value| value.abs() >= limit)),
    };
    let (quality, codes) =
        quality::measure(template, &prepared, &started.vertices, &vertices, &circumstances)?;
    let own_frame: Vec<DVec3> = vertices.iter().map(|vertex| prepared.frame.to_input(*vertex)).collect();
    // Local shapes mean nothing to other readers of the model.
    let component_count = template.fitter.as_ref().map_or(0, |fitter| fitter.model().component_count());
    let fitted_model = started.state.map(|state| FittedModel {
        model: template.template.name().into(),
        identity: state.identity.into_iter().take(component_count).collect(),
        pose: state.pose,
    });
    let record = RegistrationRecord {
        name: scan.name.clone(),
        key: String::new(),
        quality,
        codes,
        fitted_model,
        metres_per_unit: prepared.frame.metres_per_unit,
    };
    Ok(RegisteredScan { mesh: TriangleMesh::new(own_frame, template.faces.clone())?, record })
}

/// Where the non-rigid part begins.
struct Start {
    vertices: Vec<DVec3>,
    state: Option<ModelState>,
    margin: Option<f64>,
}

fn start(template: &PreparedTemplate<'_>, scan: &PreparedScan, name: &str) -> Result<Start, RegisterError> {
    let config = template.config;
    let (Some(fitter), Template::Model(model)) = (&template.fitter, template.template) else {
        return rigid_start(template, scan, name);
    };
    if config.recipe == RegisterRecipe::Paper && config.paper.start == PaperStart::Rigid {
        return rigid_start(template, scan, name);
    }
    let landmarks: Vec<GivenLandmark> = scan
        .landmarks
        .iter()
        .map(|(vertex, position)| GivenLandmark { vertex: *vertex, position: *position })
        .collect();
    let (mut state, margin) = if landmarks.len() >= config.landmark_start.fewest {
        (landmark_start(template, fitter, model, &landmarks)?, None)
    } else {
        let found = standing_start(fitter, &scan.points(), config.landmark_start.deciding_levels)?;
        (found.state, Some(found.margin))
    };
    match config.recipe {
        RegisterRecipe::Default => {
            let first = if margin.is_some() { config.landmark_start.deciding_levels } else { 0 };
            for level in first..fitter.level_count() {
                fitter.fit_level(level, &mut state, &scan.points(), &landmarks)?;
            }
        }
        RegisterRecipe::Paper => {
            let subsampled = SubsampledScan::new(template, scan, name);
            paper::fit_model(template, model, &subsampled, &mut state)?;
        }
    }
    Ok(Start { vertices: fitter.vertices(&state), state: Some(state), margin })
}

/// P1 §3.2, first step: rigid alignment of landmarks, then the pose by landmarks alone.
fn landmark_start(
    template: &PreparedTemplate<'_>,
    fitter: &ModelFitter<'_>,
    model: &BodyModel,
    landmarks: &[GivenLandmark],
) -> Result<ModelState, RegisterError> {
    let config = &template.config.landmark_start;
    let rest: Vec<DVec3> = landmarks.iter().map(|landmark| template.rest[landmark.vertex as usize]).collect();
    let targets: Vec<DVec3> = landmarks.iter().map(|landmark| landmark.position).collect();
    let mut state =
        ModelState { identity: Vec::new(), pose: model.skeleton().rest_pose().parameters().to_vec() };
    if let Some(motion) = procrustes(&rest, &targets) {
        let root = model.surface().rest_joints(&[])[0];
        let turn = rotation_vector(glam::DQuat::from_mat3(&motion.rotation));
        state.pose[..3].copy_from_slice(&(motion.apply(root) - root).to_array());
        state.pose[3..6].copy_from_slice(&turn.to_array());
    }
    // P1 fixes the shape; a few components let tall and short people start right.
    let components = match template.config.recipe {
        RegisterRecipe::Default => config.components,
        RegisterRecipe::Paper => 0,
    };
    fitter.fit_landmarks(&mut state, landmarks, components, config.iterations)?;
    Ok(state)
}

/// P1 §3.2: a static template, rigidly aligned by its landmarks.
fn rigid_start(
    template: &PreparedTemplate<'_>,
    scan: &PreparedScan,
    name: &str,
) -> Result<Start, RegisterError> {
    let needed = template.config.landmark_start.fewest;
    let too_few =
        || RegisterError::TooFewLandmarks { scan: name.into(), found: scan.landmarks.len(), needed };
    if scan.landmarks.len() < needed {
        return Err(too_few());
    }
    let rest: Vec<DVec3> = scan.landmarks.iter().map(|(vertex, _)| template.rest[*vertex as usize]).collect();
    let targets: Vec<DVec3> = scan.landmarks.iter().map(|(_, target)| *target).collect();
    let motion = procrustes(&rest, &targets).ok_or_else(too_few)?;
    let vertices = template.rest.iter().map(|vertex| motion.apply(*vertex)).collect();
    Ok(Start { vertices, state: None, margin: None })
}
