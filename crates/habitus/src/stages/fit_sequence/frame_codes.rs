//! Decides what is suspicious about a fitted frame.

use glam::DVec3;

use super::body_levels::{BodyLevel, PreparedIdentity};
use super::captured_frame::CapturedFrame;
use super::clothed_surface::{ClothedPairs, clothed_pairs, uncovered_share, uncovered_sole_share};
use super::config::{CodeThresholds, SurfaceConfig};
use super::limb_watch::{SpreadBody, has_lost_a_limb};
use super::refine_identity::{OUTSIDE_DEPTH, outside, signed_distances};
use crate::artifacts::codes::Code;
use crate::artifacts::fitted_sequence::Landmark;
use crate::body::{BodyModel, ROOT_LENGTH};
use crate::fitting::correspondence::ClosestField;

/// What a frame's body looks like against its capture.
pub(super) struct FrameQuality {
    pub codes: Vec<Code>,
    pub inlier_share: f64,
    /// Mean robust energy per vertex in square metres.
    pub energy: f64,
    pub outside_share_5mm: f64,
    pub outside_mean: f64,
    pub landmarks: Vec<Landmark>,
    /// Clearance of each vertex in metres, negative outside.
    pub clearance: Vec<f64>,
}

/// Compares a posed body with its capture. `body` is at full resolution; the pose comes with the closest points of a pose
/// near it, if there are any.
pub(super) fn judge_frame(
    model: &BodyModel,
    body: &PreparedIdentity<'_>,
    capture: &CapturedFrame,
    (pose, field_nearby): (&[f64], Option<&ClosestField>),
    surface: &SurfaceConfig,
    thresholds: &CodeThresholds,
) -> FrameQuality {
    let posed = body.posed(pose);
    let (vertices, normals) = body.vertices_and_normals(&posed);
    let field = ClosestField::find(&capture.index, &vertices, field_nearby);
    let distances = signed_distances(&field, &vertices);
    let ClothedPairs { pairs, energy, inlier_share } =
        clothed_pairs(body.level, &field, &vertices, &normals, surface);
    let (outside_share_5mm, outside_mean) = outside(&distances, OUTSIDE_DEPTH);
    let mut codes = Vec::new();
    let mut fire = |condition: bool, code: Code| {
        if condition {
            codes.push(code);
        }
    };
    fire(inlier_share < thresholds.inlier_share, Code::TooFewInliers);
    let is_outside = outside_share_5mm > thresholds.outside_share_5mm
        || outside(&distances, 0.02).0 > thresholds.outside_share_20mm;
    fire(is_outside, Code::BodyOutsideCapture);
    let spread: Vec<DVec3> = vertices.iter().step_by(SPREAD_STRIDE).copied().collect();
    let spread_normals: Vec<DVec3> = normals.iter().step_by(SPREAD_STRIDE).copied().collect();
    let spread_bones: Vec<u8> = body.level.main_bones.iter().step_by(SPREAD_STRIDE).copied().collect();
    let uncovered = uncovered_share(capture, &spread, thresholds.uncovered_distance, |_| true);
    let bare_soles = uncovered_sole_share(capture, &spread, thresholds.sole_distance, surface);
    let are_soles_bare = bare_soles > thresholds.uncovered_sole_share;
    fire(uncovered > thresholds.uncovered_share || are_soles_bare, Code::CaptureNotCovered);
    fire(uncovered > FOREIGN_FACTOR * thresholds.uncovered_share, Code::ForeignObject);
    let spread = SpreadBody { vertices: &spread, normals: &spread_normals, bones: &spread_bones };
    let is_missing = has_lost_a_limb(body, &posed, &field, capture, &spread, thresholds);
    fire(is_missing, Code::BodyNotCovered);
    fire(is_joint_at_limit(body, pose), Code::JointAtLimit);
    let landmarks =
        landmarks(model, body.level, &vertices, &field, &pairs.iter().map(|p| p.vertex).collect::<Vec<_>>());
    FrameQuality {
        codes,
        inlier_share,
        energy,
        outside_share_5mm,
        outside_mean,
        landmarks,
        clearance: distances.iter().map(|distance| -distance).collect(),
    }
}

/// Every eighth vertex is within 4 cm of the others, below the distances that matter for coverage.
const SPREAD_STRIDE: usize = 8;
/// Beyond this multiple of the uncovered share, what is uncovered is something of its own.
const FOREIGN_FACTOR: f64 = 2.0;

fn is_joint_at_limit(body: &PreparedIdentity<'_>, pose: &[f64]) -> bool {
    const TOUCH: f64 = 1e-6;
    let axes = body.level.surface.skeleton().axes();
    axes.iter()
        .zip(&pose[ROOT_LENGTH..])
        .any(|(axis, angle)| angle - axis.limits[0] < TOUCH || axis.limits[1] - angle < TOUCH)
}

/// P2 §4.2: landmark vertices of the fitted body. The confidence falls with the distance from the capture and halves
/// where the pair is not credible.
fn landmarks(
    model: &BodyModel,
    level: &BodyLevel,
    vertices: &[DVec3],
    field: &ClosestField,
    credible: &[u32],
) -> Vec<Landmark> {
    /// Distance at which a landmark is half trusted: the thickness of loose clothing.
    const HALF_TRUST: f64 = 0.04;
    model
        .landmark_vertices()
        .iter()
        .map(|vertex| {
            let slot = level.vertices.binary_search(vertex).unwrap_or(0);
            let squared = field.points[slot].distance_squared;
            let trust = HALF_TRUST * HALF_TRUST / (HALF_TRUST * HALF_TRUST + squared);
            let factor = if credible.binary_search(&(slot as u32)).is_ok() { 1.0 } else { 0.5 };
            Landmark { position: vertices[slot], confidence: trust * factor }
        })
        .collect()
}

/// A person's joints do not jump: compares a pose with the one before.
pub(super) fn is_temporal_jump(pose: &[f64], before: &[f64], thresholds: &CodeThresholds) -> bool {
    let moved = DVec3::from_slice(pose).distance(DVec3::from_slice(before)) > thresholds.jump_distance;
    let turned = pose[ROOT_LENGTH..]
        .iter()
        .zip(&before[ROOT_LENGTH..])
        .any(|(a, b)| (a - b).abs() > thresholds.jump_angle);
    moved || turned
}
