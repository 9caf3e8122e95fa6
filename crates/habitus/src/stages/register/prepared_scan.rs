//! A scan in metres, y up, cleaned, with some of its points held out.

use glam::DVec3;
use habitus_geometry::{
    FrameOfReference, SignedAxis, Surface, SurfaceIndex, TriangleMesh, estimate_cloud_normals, guess_unit,
    guess_up_axis, remove_small_components, vertex_normals,
};

use super::RegisterError;
use super::config::{RegisterConfig, ScanUnit, ScanUp};
use crate::artifacts::scan::Scan;
use crate::fitting::gaps::ScanPoints;

/// A scan that is ready to be fitted to.
pub(super) struct PreparedScan {
    /// Search index without the held-out points.
    pub index: SurfaceIndex,
    /// The points that the fit may see, metres.
    pub positions: Vec<DVec3>,
    pub normals: Vec<DVec3>,
    /// Points that the fit never sees, metres.
    pub held_out: Vec<DVec3>,
    /// From the scan's own frame to metres, y up.
    pub frame: FrameOfReference,
    /// Whether unit and up axis are beyond doubt.
    pub is_frame_certain: bool,
    /// Landmarks with the template's vertices, metres.
    pub landmarks: Vec<(u32, DVec3)>,
}

/// A person needs at least this many points to be told from noise.
const FEWEST_POINTS: usize = 500;
/// Neighbours of a bare point that its normal is estimated from.
const NORMAL_NEIGHBOURS: usize = 12;

impl PreparedScan {
    pub fn new(
        scan: &Scan,
        landmark_vertices: &[(String, u32)],
        config: &RegisterConfig,
    ) -> Result<Self, RegisterError> {
        let (surface, positions) = cleaned(&scan.surface, config.smallest_piece_share);
        if positions.len() < FEWEST_POINTS {
            return Err(RegisterError::TooFewPoints {
                scan: scan.name.clone(),
                found: positions.len(),
                needed: FEWEST_POINTS,
            });
        }
        let (frame, is_frame_certain) = frame_of_reference(&positions, config);
        let is_held_out = held_out(positions.len(), config, &scan.name);
        let move_in = |point: &DVec3| frame.to_internal(*point);
        let (index, kept, normals) = match surface {
            Surface::Mesh(mesh) => of_mesh(&mesh, &is_held_out, move_in)
                .map_err(|source| RegisterError::UnusableScan { scan: scan.name.clone(), source })?,
            Surface::Cloud(cloud) => {
                let all: Vec<DVec3> = cloud.positions().iter().map(move_in).collect();
                let turn = frame.internal_from_input_rotation();
                let normals = match cloud.normals() {
                    Some(normals) => normals.iter().map(|normal| turn * *normal).collect(),
                    None => estimate_cloud_normals(&all, NORMAL_NEIGHBOURS),
                };
                let kept = kept_of(&all, &is_held_out);
                let normals = kept_of(&normals, &is_held_out);
                (SurfaceIndex::of_cloud(&kept, &normals), kept, normals)
            }
        };
        let held_out = positions
            .iter()
            .zip(&is_held_out)
            .filter(|(_, is_held_out)| **is_held_out)
            .map(|(point, _)| frame.to_internal(*point))
            .collect();
        let landmarks = landmark_vertices
            .iter()
            .filter_map(|(name, vertex)| Some((*vertex, frame.to_internal(scan.landmarks.position(name)?))))
            .collect();
        Ok(Self { index, positions: kept, normals, held_out, frame, is_frame_certain, landmarks })
    }

    /// What the fit sees.
    pub fn points(&self) -> ScanPoints<'_> {
        ScanPoints { index: &self.index, positions: &self.positions, normals: &self.normals }
    }
}

/// Without crumbs; the vertices that remain.
fn cleaned(surface: &Surface, smallest_share: f64) -> (Surface, Vec<DVec3>) {
    let surface = match surface {
        Surface::Mesh(mesh) => Surface::Mesh(remove_small_components(mesh, smallest_share).0),
        Surface::Cloud(cloud) => Surface::Cloud(cloud.clone()),
    };
    let positions = surface.positions().to_vec();
    (surface, positions)
}

fn kept_of(values: &[DVec3], is_held_out: &[bool]) -> Vec<DVec3> {
    values
        .iter()
        .zip(is_held_out)
        .filter(|(_, is_held_out)| !**is_held_out)
        .map(|(value, _)| *value)
        .collect()
}

/// The mesh without its held-out vertices: each is pulled into a neighbour, so that no hole opens.
fn of_mesh(
    mesh: &TriangleMesh,
    is_held_out: &[bool],
    move_in: impl Fn(&DVec3) -> DVec3,
) -> Result<(SurfaceIndex, Vec<DVec3>, Vec<DVec3>), habitus_geometry::MeshError> {
    let positions: Vec<DVec3> = mesh.positions().iter().map(move_in).collect();
    let mut stand_in: Vec<u32> = (0..positions.len() as u32).collect();
    let mut nearest = vec![f64::INFINITY; positions.len()];
    for face in mesh.faces() {
        for (vertex, other) in
            [(0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)].map(|(a, b)| (face[a], face[b]))
        {
            let squared = positions[vertex as usize].distance_squared(positions[other as usize]);
            let is_better = squared < nearest[vertex as usize];
            if is_held_out[vertex as usize] && !is_held_out[other as usize] && is_better {
                nearest[vertex as usize] = squared;
                stand_in[vertex as usize] = other;
            }
        }
    }
    let faces: Vec<[u32; 3]> = mesh
        .faces()
        .iter()
        .map(|face| face.map(|vertex| stand_in[vertex as usize]))
        .filter(|[a, b, c]| {
            a != b && b != c && a != c && [a, b, c].iter().all(|vertex| !is_held_out[**vertex as usize])
        })
        .collect();
    let reduced = TriangleMesh::new(positions, faces)?;
    let all_normals = vertex_normals(reduced.positions(), reduced.faces());
    let mut is_used = vec![false; reduced.positions().len()];
    for vertex in reduced.faces().iter().flatten() {
        is_used[*vertex as usize] = true;
    }
    let used = |values: &[DVec3]| -> Vec<DVec3> {
        values.iter().zip(&is_used).filter(|(_, is_used)| **is_used).map(|(value, _)| *value).collect()
    };
    let (kept, normals) = (used(reduced.positions()), used(&all_normals));
    Ok((SurfaceIndex::of_mesh(&reduced), kept, normals))
}

/// Which points are held out: by the scan's name, the same in every run.
fn held_out(count: usize, config: &RegisterConfig, name: &str) -> Vec<bool> {
    let mut random = named_random(config.seed, name, "held out");
    (0..count).map(|_| random.unit() < config.held_out_share).collect()
}

/// A stream of random numbers of its own for each scan and purpose.
pub(super) fn named_random(seed: u64, name: &str, purpose: &str) -> habitus_geometry::sampling::SplitMix {
    let text = name.bytes().chain([0]).chain(purpose.bytes());
    let hash = text
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3));
    habitus_geometry::sampling::SplitMix::new(hash ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15))
}

/// Unit and up axis, as given or guessed, and whether they are certain.
fn frame_of_reference(positions: &[DVec3], config: &RegisterConfig) -> (FrameOfReference, bool) {
    let (up, is_up_certain) = match config.up {
        ScanUp::X => (SignedAxis::PlusX, true),
        ScanUp::Y => (SignedAxis::PlusY, true),
        ScanUp::Z => (SignedAxis::PlusZ, true),
        ScanUp::Auto => {
            let candidates = guess_up_axis(&[positions]);
            let best = candidates.first().map_or(SignedAxis::PlusY, |candidate| candidate.up);
            (best, candidates.first().is_some_and(|candidate| candidate.score > 0.8))
        }
    };
    let mut heights: Vec<f64> = positions.iter().map(|point| point.dot(up.vector())).collect();
    heights.sort_by(f64::total_cmp);
    // Crumbs in the air are no part of the stature.
    let cut = heights.len() / 1000;
    let stature = heights[heights.len() - 1 - cut] - heights[cut];
    let guess = guess_unit(stature);
    let (metres_per_unit, is_unit_certain) = match config.unit {
        ScanUnit::M => (1.0, true),
        ScanUnit::Cm => (0.01, true),
        ScanUnit::Mm => (0.001, true),
        ScanUnit::Auto => (guess.metres_per_unit, guess.certain),
    };
    (FrameOfReference { metres_per_unit, up }, is_up_certain && is_unit_certain)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid over the unit square.
    fn grid(count: u32) -> TriangleMesh {
        let at = |k: u32| f64::from(k) / f64::from(count - 1);
        let positions = (0..count * count).map(|k| DVec3::new(at(k % count), at(k / count), 0.0)).collect();
        let faces = (0..(count - 1) * (count - 1))
            .flat_map(|k| {
                let a = k / (count - 1) * count + k % (count - 1);
                [[a, a + 1, a + count + 1], [a, a + count + 1, a + count]]
            })
            .collect();
        TriangleMesh::new(positions, faces).expect("valid")
    }

    #[test]
    fn holding_points_out_opens_no_hole() {
        let mesh = grid(30);
        let config = RegisterConfig { held_out_share: 0.1, ..RegisterConfig::default() };
        let is_held_out = held_out(mesh.positions().len(), &config, "grid");
        assert!((50..130).contains(&is_held_out.iter().filter(|held| **held).count()));
        let (index, kept, normals) = of_mesh(&mesh, &is_held_out, |point| *point).expect("a mesh");
        assert!(normals.iter().all(|normal| normal.z > 0.9));
        for (point, is_held_out) in mesh.positions().iter().zip(&is_held_out) {
            assert!(!(*is_held_out && kept.contains(point)));
            let is_inside = point.x > 0.05 && point.x < 0.95 && point.y > 0.05 && point.y < 0.95;
            // What remains covers the places of the held-out points.
            assert!(!is_inside || index.closest(*point).distance_squared < 1e-12, "{point}");
        }
    }
}
