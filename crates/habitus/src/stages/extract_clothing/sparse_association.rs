//! Sparse association (P3 §3.1): rays from the body along its normals, one pair for each clothing vertex.
//!
//! Deviation: rays start a little inside the body, and those that meet it again make no pair; both are settings.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, Topology, TriangleMesh, vertex_normals};
use rayon::prelude::*;

use super::config::{AssociationConfig, BlockedRays};

/// Rays per parallel piece.
const RAY_CHUNK: usize = 256;

/// A clothing vertex, the body vertex that it lies over, and how far out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SparsePair {
    pub clothing: u32,
    pub body: u32,
    pub distance: f64,
}

/// The pair that each clothing vertex has found so far, over one or several frames.
pub(super) struct SparsePairs {
    best: Vec<Option<SparsePair>>,
}

impl SparsePairs {
    /// No pairs yet.
    pub fn new(clothing_vertex_count: usize) -> Self {
        Self { best: vec![None; clothing_vertex_count] }
    }

    /// The pairs in the order of the clothing vertices.
    pub fn pairs(&self) -> Vec<SparsePair> {
        self.best.iter().flatten().copied().collect()
    }

    /// Shoots a ray from each body vertex of one frame. Of several body vertices that find the same clothing vertex, the
    /// nearest keeps it, and of equally near ones the lowest; the paper keeps one and does not say which.
    pub fn add_frame(
        &mut self,
        body: &TriangleMesh,
        clothing: &TriangleMesh,
        topology: &Topology,
        config: &AssociationConfig,
    ) {
        let normals = vertex_normals(body.positions(), body.faces());
        let (body_index, clothing_index) = (SurfaceIndex::of_mesh(body), SurfaceIndex::of_mesh(clothing));
        let found: Vec<Option<SparsePair>> = (0..body.positions().len())
            .into_par_iter()
            .with_min_len(RAY_CHUNK)
            .map(|vertex| {
                let normal = normals[vertex];
                let start = body.positions()[vertex] - normal * config.ray_start_inside;
                let reach = config.ray_length + config.ray_start_inside;
                let hit = clothing_index.ray_hit(start, normal, reach)?;
                let distance = hit.distance - config.ray_start_inside;
                if config.blocked_rays == BlockedRays::Drop
                    && leaves_through_the_body(body, &body_index, vertex, normal, distance)
                {
                    return None;
                }
                let point = start + normal * hit.distance;
                let clothing = nearest_vertex(clothing, topology, hit.face, point);
                Some(SparsePair { clothing, body: vertex as u32, distance: distance.abs() })
            })
            .collect();
        for pair in found.into_iter().flatten() {
            let best = &mut self.best[pair.clothing as usize];
            if best.is_none_or(|best| pair.distance < best.distance) {
                *best = Some(pair);
            }
        }
    }
}

/// Whether the body itself lies between a body vertex and a point `distance` in front of it.
fn leaves_through_the_body(
    body: &TriangleMesh,
    index: &SurfaceIndex,
    vertex: usize,
    normal: DVec3,
    distance: f64,
) -> bool {
    /// Past the vertex's own faces, in metres.
    const CLEAR: f64 = 1e-4;
    let start = body.positions()[vertex] + normal * CLEAR;
    distance > 2.0 * CLEAR
        && index
            .ray_hit(start, normal, distance - CLEAR)
            .is_some_and(|hit| !body.faces()[hit.face as usize].contains(&(vertex as u32)))
}

/// The vertex nearest to a point of a face, on the same sheet: from the face's nearest corner downhill along edges.
fn nearest_vertex(mesh: &TriangleMesh, topology: &Topology, face: u32, point: DVec3) -> u32 {
    let distance = |vertex: u32| mesh.positions()[vertex as usize].distance_squared(point);
    let nearer = |a: u32, b: u32| if distance(b) < distance(a) { b } else { a };
    let [a, b, c] = mesh.faces()[face as usize];
    let mut vertex = nearer(nearer(a, b), c);
    loop {
        let next = topology.one_ring(vertex as usize).iter().copied().fold(vertex, nearer);
        if next == vertex {
            return vertex;
        }
        vertex = next;
    }
}
