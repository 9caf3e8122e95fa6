//! How far a moving mesh is from a fixed scan along its own normals, both ways.
//!
//! Only the mesh's normals are used: a scan's are rough, and a closest point on a rough surface is its nearest bump.
//! Sideways nothing is pulled, so that correspondence comes from elsewhere (a body model, stiffness, landmarks).

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, SurfacePoint};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// When a pair of a mesh point and a scan point is credible, and how much it counts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GapRules {
    /// Largest distance, millimetres.
    pub distance_mm: f64,
    /// Largest angle between the outer normals, degrees.
    pub angle_deg: f64,
    /// Geman–McClure scale of the gap, millimetres.
    pub robust_mm: f64,
}

/// A point of the mesh should move by `gap` along `normal`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// Corners of the mesh point's face.
    pub vertices: [u32; 3],
    /// Their shares in the mesh point.
    pub barycentric: [f64; 3],
    /// Outward unit normal of the mesh.
    pub normal: DVec3,
    /// Signed distance to the scan along the normal, metres, positive outwards.
    pub gap: f64,
    /// Between 0 and 1.
    pub weight: f64,
}

/// A pair whose connection leans this much (tangent) is at a border of the scan: nothing is known there.
const LARGEST_LEAN: f64 = 0.5;
/// Noise of the scan's surface leans pairs of small distance, metres.
const LEAN_ALLOWANCE: f64 = 0.002;
/// Items per parallel piece.
const CHUNK: usize = 512;

impl GapRules {
    /// The pair's gap and weight, if it is credible.
    fn judge(&self, from: DVec3, normal: DVec3, to: DVec3, other_normal: DVec3) -> Option<(f64, f64)> {
        let offset = to - from;
        let distance = offset.length();
        let gap = offset.dot(normal);
        let sideways = (offset - normal * gap).length();
        let is_credible = distance <= self.distance_mm / 1000.0
            && normal.dot(other_normal) >= self.angle_deg.to_radians().cos()
            && sideways <= LARGEST_LEAN * distance + LEAN_ALLOWANCE;
        let scale = (self.robust_mm / 1000.0).powi(2);
        is_credible.then(|| (gap, (scale / (scale + gap * gap)).powi(2)))
    }
}

/// A fixed scan: a search index, and its points with their normals.
#[derive(Clone, Copy)]
pub struct ScanPoints<'a> {
    /// Closest points on the scan.
    pub index: &'a SurfaceIndex,
    /// Some of its points, metres.
    pub positions: &'a [DVec3],
    /// Their outward unit normals.
    pub normals: &'a [DVec3],
}

/// Gaps from vertices of the mesh to the scan; `hints` are the faces of the last search and are renewed.
pub fn gaps_of_vertices(
    scan: &ScanPoints<'_>,
    chosen: &[u32],
    vertices: &[DVec3],
    normals: &[DVec3],
    rules: &GapRules,
    hints: &mut Vec<u32>,
) -> Vec<Gap> {
    let has_hints = hints.len() == chosen.len();
    let found: Vec<SurfacePoint> = chosen
        .par_iter()
        .enumerate()
        .with_min_len(CHUNK)
        .map(|(slot, vertex)| {
            let position = vertices[*vertex as usize];
            if has_hints {
                scan.index.closest_warm(position, hints[slot])
            } else {
                scan.index.closest(position)
            }
        })
        .collect();
    hints.clear();
    hints.extend(found.iter().map(|point| point.face));
    chosen
        .iter()
        .zip(&found)
        .filter_map(|(vertex, point)| {
            let normal = normals[*vertex as usize];
            let (gap, weight) =
                rules.judge(vertices[*vertex as usize], normal, point.position, point.normal)?;
            Some(Gap { vertices: [*vertex; 3], barycentric: [1.0, 0.0, 0.0], normal, gap, weight })
        })
        .collect()
}

/// Gaps from every `stride`-th point of the scan, beginning with `first`, to the mesh.
pub fn gaps_of_scan(
    scan: &ScanPoints<'_>,
    [first, stride]: [usize; 2],
    mesh: &SurfaceIndex,
    faces: &[[u32; 3]],
    normals: &[DVec3],
    rules: &GapRules,
) -> Vec<Gap> {
    let count = scan.positions.len().saturating_sub(first).div_ceil(stride.max(1));
    (0..count)
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|slot| {
            let place = first + slot * stride;
            let point = mesh.closest_within(scan.positions[place], rules.distance_mm / 1000.0)?;
            let corners = faces[point.face as usize];
            let normal: DVec3 = corners
                .iter()
                .zip(point.barycentric)
                .map(|(vertex, share)| normals[*vertex as usize] * share)
                .sum();
            let normal = normal.normalize_or_zero();
            let (gap, weight) =
                rules.judge(point.position, normal, scan.positions[place], scan.normals[place])?;
            Some(Gap { vertices: corners, barycentric: point.barycentric, normal, gap, weight })
        })
        .collect::<Vec<Option<Gap>>>()
        .into_iter()
        .flatten()
        .collect()
}

#[cfg(test)]
mod tests {
    use habitus_geometry::TriangleMesh;

    use super::*;

    const RULES: GapRules = GapRules { distance_mm: 50.0, angle_deg: 60.0, robust_mm: 20.0 };

    /// A plate of two metres in the plane z = height, outward +z.
    fn plate(height: f64) -> TriangleMesh {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let corners = corners.map(|(x, y)| DVec3::new(x, y, height)).to_vec();
        TriangleMesh::new(corners, vec![[0, 1, 2], [0, 2, 3]]).expect("a plate")
    }

    #[test]
    fn gaps_are_signed_distances_along_the_mesh_normal_both_ways() {
        let (scan, mesh) = (plate(0.03), plate(0.0));
        let index = SurfaceIndex::of_mesh(&scan);
        let points = [DVec3::new(0.5, 0.25, 0.03), DVec3::new(0.1, -0.2, 0.03)];
        let target = ScanPoints { index: &index, positions: &points, normals: &[DVec3::Z; 2] };
        let vertices = [DVec3::new(0.2, 0.3, 0.0), DVec3::new(0.2, 0.3, 0.1)];
        let mut hints = Vec::new();
        let found = gaps_of_vertices(&target, &[0, 1], &vertices, &[DVec3::Z; 2], &RULES, &mut hints);
        // The second is 70 mm off.
        assert_eq!(found.len(), 1);
        assert!((found[0].gap - 0.03).abs() < 1e-12 && found[0].vertices[0] == 0);
        // (s² / (s² + g²))² = (400 / 1300)².
        assert!((found[0].weight - (4.0_f64 / 13.0).powi(2)).abs() < 1e-9);
        let body = SurfaceIndex::of_mesh(&mesh);
        let found = gaps_of_scan(&target, [0, 1], &body, mesh.faces(), &[DVec3::Z; 4], &RULES);
        assert_eq!(found.len(), 2);
        for (pair, point) in found.iter().zip(points) {
            let foot: DVec3 = pair
                .vertices
                .iter()
                .zip(pair.barycentric)
                .map(|(v, share)| mesh.positions()[*v as usize] * share)
                .sum();
            assert!((pair.gap - 0.03).abs() < 1e-12);
            assert!(foot.distance(DVec3::new(point.x, point.y, 0.0)) < 1e-12);
        }
    }

    #[test]
    fn beyond_a_border_of_the_scan_nothing_is_known() {
        let scan = plate(0.0);
        let index = SurfaceIndex::of_mesh(&scan);
        let target = ScanPoints { index: &index, positions: &[], normals: &[] };
        let vertices = [DVec3::new(1.02, 0.0, 0.001), DVec3::new(0.98, 0.0, 0.001)];
        let found = gaps_of_vertices(&target, &[0, 1], &vertices, &[DVec3::Z; 2], &RULES, &mut Vec::new());
        assert_eq!(found.iter().map(|pair| pair.vertices[0]).collect::<Vec<_>>(), [1]);
    }
}
