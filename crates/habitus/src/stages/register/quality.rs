//! How well a registration lies on its scan, and whether it may be used unseen.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, TriangleMesh, vertex_normals};

use super::RegisterError;
use super::prepared_scan::PreparedScan;
use super::template::{PreparedTemplate, folded_faces};
use crate::artifacts::codes::Code;
use crate::artifacts::registered_scan::{DistanceSummary, EdgeRatio, RegistrationQuality};
use crate::fitting::gaps::{GapRules, gaps_of_vertices};

/// Points of the scan that are compared at most.
const COMPARED_POINTS: usize = 10_000;
/// A vertex that is farther than this from the scan lies in a hole, not beside the surface, millimetres.
const COVERED_MM: f64 = 50.0;

/// What the stage knows besides the surfaces.
pub(super) struct Circumstances {
    /// Energy of the second facing over the first; without landmarks only.
    pub margin: Option<f64>,
    /// Whether an identity coefficient rests on its limit.
    pub is_identity_at_limit: bool,
}

/// Measures a registration; all in metres.
pub(super) fn measure(
    template: &PreparedTemplate<'_>,
    scan: &PreparedScan,
    start: &[DVec3],
    vertices: &[DVec3],
    circumstances: &Circumstances,
) -> Result<(RegistrationQuality, Vec<Code>), RegisterError> {
    let mesh = TriangleMesh::new(vertices.to_vec(), template.faces.clone())?;
    let index = SurfaceIndex::of_mesh(&mesh);
    let distances = |points: &[DVec3]| -> Vec<f64> {
        let stride = points.len().div_ceil(COMPARED_POINTS).max(1);
        let chosen: Vec<DVec3> = points.iter().step_by(stride).copied().collect();
        let mut found = Vec::new();
        index.closest_many(&chosen, None, &mut found);
        found.iter().map(|point| point.distance_squared.sqrt()).collect()
    };
    let thresholds = &template.config.codes;
    let from_scan = distances(&scan.positions);
    let unexplained =
        from_scan.iter().filter(|distance| **distance * 1000.0 > thresholds.unexplained_mm).count() as f64
            / from_scan.len().max(1) as f64;
    let covered = covered_distances(template, scan, vertices);
    let covered_share = covered.len() as f64 / vertices.len().max(1) as f64;
    let flipped_faces =
        folded_faces(&template.faces, &template.face_neighbours, &template.rest, vertices).len();
    let edge_ratio = edge_ratio(&template.edges, start, vertices);
    let landmark_mm = (!scan.landmarks.is_empty()).then(|| {
        let sum: f64 =
            scan.landmarks.iter().map(|(vertex, target)| vertices[*vertex as usize].distance(*target)).sum();
        sum / scan.landmarks.len() as f64 * 1000.0
    });
    let mut codes = Vec::new();
    let mut add = |code: Code, has_fired: bool| {
        if has_fired {
            codes.push(code);
        }
    };
    add(Code::TooFewInliers, covered_share < thresholds.smallest_covered_share);
    add(Code::CaptureNotCovered, unexplained > thresholds.largest_unexplained_share);
    add(Code::SurfaceFolded, flipped_faces > thresholds.most_flipped_faces);
    let [smallest, largest] = thresholds.edge_ratio;
    add(Code::SurfaceStretched, edge_ratio.p1 < smallest || edge_ratio.p99 > largest);
    add(Code::LandmarksMissed, landmark_mm.is_some_and(|distance| distance > thresholds.landmark_mm));
    add(Code::AmbiguousStart, circumstances.margin.is_some_and(|margin| margin < thresholds.smallest_margin));
    add(Code::IdentityAtLimit, circumstances.is_identity_at_limit);
    add(Code::UncertainFrameOfReference, !scan.is_frame_certain);
    let worst = codes.iter().find(|code| code.is_failure()).or(codes.first());
    let quality = RegistrationQuality {
        point_to_surface_mm: DistanceSummary::of(from_scan),
        held_out_mm: DistanceSummary::of(distances(&scan.held_out)),
        surface_to_point_mm: DistanceSummary::of(covered),
        covered_share,
        edge_ratio,
        flipped_faces,
        landmark_mm,
        seconds: 0.0,
        code: worst.map_or("ok", |code| code.name()).into(),
    };
    Ok((quality, codes))
}

/// Distances to the scan of the vertices that lie over it.
fn covered_distances(template: &PreparedTemplate<'_>, scan: &PreparedScan, vertices: &[DVec3]) -> Vec<f64> {
    let normals = vertex_normals(vertices, &template.faces);
    let all: Vec<u32> = (0..vertices.len() as u32).collect();
    let rules = GapRules { distance_mm: COVERED_MM, angle_deg: 80.0, robust_mm: COVERED_MM };
    gaps_of_vertices(&scan.points(), &all, vertices, &normals, &rules, &mut Vec::new())
        .iter()
        .map(|gap| gap.gap.abs())
        .collect()
}

fn edge_ratio(edges: &[[u32; 2]], start: &[DVec3], vertices: &[DVec3]) -> EdgeRatio {
    let length = |points: &[DVec3], [a, b]: [u32; 2]| points[a as usize].distance(points[b as usize]);
    let mut ratios: Vec<f64> =
        edges.iter().map(|edge| length(vertices, *edge) / length(start, *edge).max(1e-9)).collect();
    ratios.sort_by(f64::total_cmp);
    let at = |percent: usize| {
        ratios.get((ratios.len() * percent / 100).min(ratios.len().saturating_sub(1))).copied().unwrap_or(1.0)
    };
    EdgeRatio { p1: at(1), p99: at(99) }
}
