//! A registration over its scan for the 3D view: little endian, each part padded to four bytes.
//!
//! Length of the head u32, head as JSON; registration f32×3, its errors i16, its faces u16×3 (u32×3 above 65,536
//! vertices); scan u16×3 in its box, its errors i16, its faces. Errors are signed, in hundredths of a millimetre.

use glam::DVec3;
use habitus::evaluation::registration_ranking::{RankingConfig, Residuals, residuals};
use habitus::geometry::{PointCloud, RigidTransform, Surface, TriangleMesh, procrustes};
use serde::Serialize;

use crate::report::blocks::Bytes;
use crate::report::{CaptureView, decimated};

/// Vertices of a scan that are shown at most; all numbers come from the whole scan.
const SCAN_VERTEX_LIMIT: usize = 150_000;
/// An error that is not known.
const UNKNOWN: i16 = i16::MIN;

/// What is shown of one scan, in metres and in the scan's own frame.
pub struct ScanView<'a> {
    /// Name of the scan.
    pub name: &'a str,
    /// The registration.
    pub registration: &'a TriangleMesh,
    /// The scan.
    pub scan: &'a Surface,
    /// Vertex in the middle of the worst patch.
    pub worst_vertex: u32,
    /// The template upright, y up and facing +z; with it all scans stand and look the same way. Empty if not known.
    pub upright: &'a [DVec3],
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Head<'a> {
    name: &'a str,
    worst_vertex: u32,
    vertex_count: usize,
    face_count: usize,
    scan_vertex_count: usize,
    scan_face_count: usize,
    scan_low: [f32; 3],
    scan_size: [f32; 3],
}

/// The block of a scan.
pub fn registration_block(view: &ScanView<'_>, config: &RankingConfig) -> Vec<u8> {
    let scan = shown_scan(view.scan);
    let found = residuals(view.registration, &scan, config);
    let to_view = procrustes(view.registration.positions(), view.upright)
        .unwrap_or(RigidTransform { rotation: glam::DMat3::IDENTITY, translation: DVec3::ZERO });
    let moved = |positions: &[DVec3]| -> Vec<DVec3> { positions.iter().map(|p| to_view.apply(*p)).collect() };
    let (registration, positions) = (moved(view.registration.positions()), moved(scan.positions()));
    let faces = match &scan {
        Surface::Mesh(mesh) => mesh.faces(),
        Surface::Cloud(_) => &[],
    };
    let (low, high) = positions
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    let (low, size) = if positions.is_empty() { (DVec3::ZERO, DVec3::ZERO) } else { (low, high - low) };
    let head = Head {
        name: view.name,
        worst_vertex: view.worst_vertex,
        vertex_count: registration.len(),
        face_count: view.registration.faces().len(),
        scan_vertex_count: positions.len(),
        scan_face_count: faces.len(),
        scan_low: low.as_vec3().to_array(),
        scan_size: size.as_vec3().to_array(),
    };
    // Numbers and names only: this has a form in JSON.
    let head = serde_json::to_vec(&head).unwrap_or_default();
    let mut bytes = Bytes::default();
    bytes.small((head.len() as u32).to_le_bytes().into_iter().chain(head));
    bytes.floats(registration.iter().flat_map(|vertex| vertex.as_vec3().to_array()));
    let Residuals { signed_distance, scan_distance, .. } = found;
    bytes.small(hundredths(&signed_distance));
    bytes.indices(view.registration.faces(), registration.len());
    let cell = (size / 65535.0).max(DVec3::splat(f64::MIN_POSITIVE));
    let steps = positions.iter().flat_map(|position| ((*position - low) / cell).round().to_array());
    bytes.small(steps.flat_map(|step| (step as u16).to_le_bytes()));
    bytes.small(hundredths(&scan_distance));
    bytes.indices(faces, positions.len());
    bytes.0
}

/// Metres as hundredths of a millimetre.
fn hundredths(metres: &[f64]) -> impl Iterator<Item = u8> + '_ {
    let whole = |value: &f64| {
        if value.is_finite() { (value * 1e5).round().clamp(-32767.0, 32767.0) as i16 } else { UNKNOWN }
    };
    metres.iter().flat_map(move |value| whole(value).to_le_bytes())
}

/// The scan, or a simpler one where it is too large for a page.
fn shown_scan(scan: &Surface) -> Surface {
    if scan.positions().len() <= SCAN_VERTEX_LIMIT {
        return scan.clone();
    }
    let faces = match scan {
        Surface::Mesh(mesh) => mesh.faces().to_vec(),
        Surface::Cloud(_) => Vec::new(),
    };
    let whole = CaptureView { positions: scan.positions().to_vec(), faces };
    let simple = decimated(&whole, SCAN_VERTEX_LIMIT);
    let built = if simple.faces.is_empty() {
        PointCloud::new(simple.positions, None).map(Surface::Cloud)
    } else {
        TriangleMesh::new(simple.positions, simple.faces).map(Surface::Mesh)
    };
    built.unwrap_or_else(|_| scan.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron(offset: DVec3) -> TriangleMesh {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|corner| corner + offset);
        TriangleMesh::new(corners.to_vec(), vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).expect("valid")
    }

    #[test]
    fn a_block_has_every_part_where_the_script_looks_for_it() {
        let registration = tetrahedron(DVec3::ZERO);
        let scan = Surface::Mesh(tetrahedron(DVec3::new(0.0, 0.0, -0.002)));
        // Upright is a quarter turn about x: what was z is y.
        let upright: Vec<DVec3> =
            registration.positions().iter().map(|p| DVec3::new(p.x, p.z, -p.y)).collect();
        let view = ScanView {
            name: "a \"b\"",
            registration: &registration,
            scan: &scan,
            worst_vertex: 3,
            upright: &upright,
        };
        let block = registration_block(&view, &RankingConfig::default());
        let length = u32::from_le_bytes(block[..4].try_into().expect("four")) as usize;
        let head: serde_json::Value = serde_json::from_slice(&block[4..4 + length]).expect("JSON");
        assert_eq!((&head["name"], &head["worstVertex"]), (&"a \"b\"".into(), &3.into()));
        let start = (4 + length).next_multiple_of(4);
        let float = |at: usize| f32::from_le_bytes(block[at..at + 4].try_into().expect("four"));
        // Vertex 3 was (0, 0, 1) and stands upright at (0, 1, 0).
        let top = [0, 4, 8].map(|k| float(start + 36 + k));
        assert!(top.iter().zip([0.0, 1.0, 0.0]).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-6), "{top:?}");
        let errors = start + 48;
        let error = |vertex: usize| {
            i16::from_le_bytes(block[errors + 2 * vertex..errors + 2 * vertex + 2].try_into().expect("two"))
        };
        // The top lies 2 mm above the scan's: outside.
        assert_eq!(error(3), 200);
        // Errors 8 bytes, faces 24, scan 24, errors 8, faces 24.
        assert_eq!(block.len(), errors + 8 + 24 + 24 + 8 + 24);
    }
}
