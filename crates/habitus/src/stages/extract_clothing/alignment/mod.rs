//! One connectivity for all frames of a dressed sequence, without correspondences (P3 §3, after Li et al. 2009).
//!
//! ```text
//! template: the dressed surface of one frame ──associate, unpose──▶ offsets over the rest body
//! frame: the frame before ──motion of the body──▶ base ──deformation graph──▶ near ──along normals──▶ on the capture
//!        where that fails: template offsets ──pose of the body──▶ base
//! ```
//! Surfaces decide where a vertex lies along its normal. Where it lies along the surface is what the base says, and a
//! fitted body may be turned about its limbs from frame to frame: the frame before knows better than the template
//! over this frame's body. Its shape does not drift, because the base takes from it the motions of the graph's nodes
//! only; lengths and folds are the template's.

mod detail;
mod frame_solver;
mod quality;
mod template;

use glam::DVec3;
use habitus_geometry::{Surface, SurfaceIndex, TriangleMesh, estimate_cloud_normals};
use habitus_optimize::Observer;
use serde::{Deserialize, Serialize};

use super::config::AlignmentConfig;
use super::{ExtractClothingError, LeftOutFrame, progress};
use crate::artifacts::clothing_layer::AlignmentQuality;
use crate::artifacts::codes::Code;
use crate::artifacts::frames::FrameSource;
use crate::artifacts::journal::Journal;
use crate::artifacts::rigged_sequence::RiggedSequence;
use frame_solver::FrameSolver;
use quality::measure_quality;
pub use template::ClothingTemplate;

/// The dressed surface of one frame in the template's connectivity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AlignedFrame {
    /// The fitted frame.
    pub frame: usize,
    /// Vertices in metres, y up, at the scale of the body. In f32, so that a journal holds exactly what is used.
    pub positions: Vec<[f32; 3]>,
    /// How well it lies on the capture.
    pub quality: AlignmentQuality,
    /// What fired.
    pub codes: Vec<Code>,
}

/// A dressed sequence in one connectivity.
#[derive(Clone, Debug, PartialEq)]
pub struct AlignedSequence {
    /// Triangles of the template.
    pub faces: Vec<[u32; 3]>,
    /// The frames that could be aligned, in order.
    pub frames: Vec<AlignedFrame>,
    /// Frames that could not be used.
    pub left_out: Vec<LeftOutFrame>,
}

impl AlignedSequence {
    /// An aligned frame, if it could be aligned.
    pub fn frame(&self, frame: usize) -> Option<&AlignedFrame> {
        let place = self.frames.binary_search_by_key(&frame, |aligned| aligned.frame).ok()?;
        Some(&self.frames[place])
    }

    /// The surface of a frame in metres, y up; or why there is none.
    pub(super) fn surface(&self, frame: usize) -> Result<TriangleMesh, String> {
        let aligned = self.frame(frame).ok_or("it could not be aligned")?;
        let positions = aligned.positions.iter().map(|p| DVec3::from_array(p.map(f64::from))).collect();
        TriangleMesh::new(positions, self.faces.clone()).map_err(|error| error.to_string())
    }
}

/// A capture as the solver sees it, in metres, y up, at the scale of the body.
pub(super) struct Capture {
    pub index: SurfaceIndex,
    /// Points spread evenly over the capture, with normals.
    pub samples: Vec<(DVec3, DVec3)>,
    pub mesh: Option<TriangleMesh>,
}

/// Brings every capture of a fitted sequence into the connectivity of the template, from the template's frame
/// outwards.
///
/// The journal keeps finished frames, so that a killed run goes on where it stopped.
pub fn align_clothing(
    fit: &RiggedSequence,
    captures: &dyn FrameSource,
    template: &ClothingTemplate,
    config: &AlignmentConfig,
    journal: &mut Journal,
    observer: &mut dyn Observer,
) -> Result<AlignedSequence, ExtractClothingError> {
    let total = fit.sequence.frames.len();
    let mut solver = FrameSolver::new(template, config)?;
    let mut frames: Vec<AlignedFrame> = journal.finished();
    frames.retain(|frame| frame.frame < total && frame.positions.len() == template.vertex_count());
    let mut left_out = Vec::new();
    // From the template's frame to the end, then from there back to the start: each frame begins where its neighbour ended.
    let start = template.frame().unwrap_or(0);
    let order = (start..total).chain((0..start).rev());
    let mut done = 0;
    for frame in order {
        if !frames.iter().any(|finished| finished.frame == frame) {
            match read_capture(fit, captures, frame, config) {
                Err(reason) => {
                    left_out.push(LeftOutFrame { name: fit.sequence.frames[frame].name.clone(), reason });
                }
                Ok(capture) => {
                    let neighbour = frames.iter().min_by_key(|other| other.frame.abs_diff(frame));
                    let aligned = align_frame(&mut solver, fit, frame, &capture, neighbour, config)?;
                    // A journal that cannot be written costs a repetition, not the result.
                    let _ = journal.append(&aligned);
                    frames.push(aligned);
                }
            }
        }
        done += 1;
        progress(observer, "align", done, total, frames.len())?;
    }
    frames.sort_by_key(|frame| frame.frame);
    if frames.is_empty() {
        let first_reason =
            left_out.first().map(|frame: &LeftOutFrame| frame.reason.clone()).unwrap_or_default();
        return Err(ExtractClothingError::NoUsableFrame { first_reason });
    }
    Ok(AlignedSequence { faces: template.faces().to_vec(), frames, left_out })
}

/// Aligns one frame, from its neighbour if there is one; where that goes wrong, from the template over the body,
/// looked for where the neighbour was; and where that goes wrong, from the template alone.
fn align_frame(
    solver: &mut FrameSolver<'_>,
    fit: &RiggedSequence,
    frame: usize,
    capture: &Capture,
    neighbour: Option<&AlignedFrame>,
    config: &AlignmentConfig,
) -> Result<AlignedFrame, ExtractClothingError> {
    let base = solver.template.posed(fit, frame);
    let carried = neighbour.map(|neighbour| {
        let positions: Vec<DVec3> =
            neighbour.positions.iter().map(|p| DVec3::from_array(p.map(f64::from))).collect();
        solver.template.carried(fit, neighbour.frame, frame, &positions)
    });
    // What is bent, and where closest points are sought first.
    let mut tries: Vec<(&[DVec3], &[DVec3])> = Vec::new();
    if let Some(carried) = &carried {
        tries.extend([(carried.as_slice(), carried.as_slice()), (&base, carried)]);
    }
    tries.push((&base, &base));
    let mut best: Option<(Vec<DVec3>, AlignmentQuality)> = None;
    let mut codes = Vec::new();
    for (place, (bent, guess)) in tries.into_iter().enumerate() {
        if place == 1 {
            codes.push(Code::AlignmentRestarted);
        }
        let surface = solver.solve(bent, guess, capture)?;
        let quality = measure_quality(&surface, solver.template, capture);
        if best.as_ref().is_none_or(|(_, known)| badness(&quality, config) < badness(known, config)) {
            best = Some((surface, quality));
        }
        if !is_bad(&quality, config) {
            break;
        }
    }
    let (surface, quality) = best.unwrap_or_else(|| (base.clone(), AlignmentQuality::default()));
    if quality.mean_to_capture.max(quality.mean_from_capture) > config.largest_error {
        codes.push(Code::ClothingOffCapture);
    }
    if quality.folded_share > config.largest_folded_share {
        codes.push(Code::ClothingFolded);
    }
    Ok(AlignedFrame {
        frame,
        positions: surface.iter().map(|position| position.as_vec3().to_array()).collect(),
        quality,
        codes,
    })
}

fn is_bad(quality: &AlignmentQuality, config: &AlignmentConfig) -> bool {
    quality.mean_to_capture.max(quality.mean_from_capture) > config.largest_error
        || quality.folded_share > config.largest_folded_share
}

/// In units of what is allowed.
fn badness(quality: &AlignmentQuality, config: &AlignmentConfig) -> f64 {
    quality.mean_to_capture.max(quality.mean_from_capture) / config.largest_error
        + quality.folded_share / config.largest_folded_share
}

/// Reads a capture into the coordinates of the body, or says why it cannot be used.
fn read_capture(
    fit: &RiggedSequence,
    captures: &dyn FrameSource,
    frame: usize,
    config: &AlignmentConfig,
) -> Result<Capture, String> {
    let fitted = &fit.sequence.frames[frame];
    if let Some(code) = fitted.codes.iter().find(|code| code.is_failure()) {
        return Err(format!("its body is not to be trusted ({code})"));
    }
    let to_body = |p: &DVec3| fit.sequence.input_frame.to_internal(*p) / fitted.capture_scale;
    match captures.surface(frame).map_err(|error| error.to_string())? {
        Surface::Mesh(mesh) => {
            let positions: Vec<DVec3> = mesh.positions().iter().map(to_body).collect();
            let mesh = template::cleaned(&positions, mesh.faces(), config.smallest_component_share)
                .ok_or("nothing is left of it after cleaning")?;
            let index = SurfaceIndex::of_mesh(&mesh);
            let normals = habitus_geometry::face_normals(mesh.positions(), mesh.faces());
            let samples = habitus_geometry::area_weighted_points(&mesh, config.capture_samples, 1)
                .into_iter()
                .map(|(point, face)| (point, normals[face as usize]))
                .collect();
            Ok(Capture { index, samples, mesh: Some(mesh) })
        }
        Surface::Cloud(cloud) => {
            let positions: Vec<DVec3> = cloud.positions().iter().map(to_body).collect();
            let turn = fit.sequence.input_frame.internal_from_input;
            let normals = match cloud.normals() {
                Some(normals) => normals.iter().map(|normal| turn * *normal).collect(),
                None => estimate_cloud_normals(&positions, config.normal_neighbours),
            };
            let stride = positions.len().div_ceil(config.capture_samples.max(1)).max(1);
            let samples = positions.iter().copied().zip(normals.iter().copied()).step_by(stride).collect();
            Ok(Capture { index: SurfaceIndex::of_cloud(&positions, &normals), samples, mesh: None })
        }
    }
}
