//! Sparse association (P3 §3.1): rays from the body along its normals, one pair for each clothing vertex.
//!
//! Deviation: rays start a little inside the body, those that meet it again make no pair, and pairs must last over several
//! frames; all are settings.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, Topology, TriangleMesh, vertex_normals};
use rayon::prelude::*;

use super::config::{AssociationConfig, BlockedRays};

/// Rays per parallel piece.
const RAY_CHUNK: usize = 256;

/// A clothing vertex and the body vertex that it lies over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SparsePair {
    pub clothing: u32,
    pub body: u32,
}

/// The pairs that each clothing vertex has found so far, over one or several frames.
pub(super) struct SparsePairs {
    found: Vec<Vec<SparsePair>>,
}

impl SparsePairs {
    /// No pairs yet.
    pub fn new(clothing_vertex_count: usize) -> Self {
        Self { found: vec![Vec::new(); clothing_vertex_count] }
    }

    /// One pair for each clothing vertex, in their order: the one that stays nearest in all `frames`, each a posed body and
    /// its clothing, and of equally near ones the lowest. The paper keeps one and does not say which.
    ///
    /// Cloth hangs on what it stays with. A sleeve that touches the trunk in one frame, or trousers that a hand grazes, part
    /// from it in another; pairs that come apart farther than `largest_parting` metres are none.
    pub fn lasting(
        &self,
        frames: &[(&TriangleMesh, &TriangleMesh)],
        largest_parting: f64,
    ) -> Vec<SparsePair> {
        let parting = |pair: &SparsePair| {
            let apart = frames.iter().map(|(body, clothing)| {
                let (body, clothing) = (body.positions(), clothing.positions());
                body[pair.body as usize].distance(clothing[pair.clothing as usize])
            });
            apart.fold(0.0, f64::max)
        };
        let best = |pairs: &Vec<SparsePair>| {
            let near = pairs.iter().map(|pair| (parting(pair), pair));
            let near = near.filter(|(apart, _)| *apart <= largest_parting);
            near.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.body.cmp(&b.1.body))).map(|(_, pair)| *pair)
        };
        self.found.par_iter().filter_map(best).collect()
    }

    /// Shoots a ray from each body vertex of one frame; it makes a pair where it leaves through the clothing.
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
                if !leaves_through(clothing, hit.face, normal) {
                    return None;
                }
                let distance = hit.distance - config.ray_start_inside;
                if config.blocked_rays == BlockedRays::Drop
                    && leaves_through_the_body(body, &body_index, vertex, normal, distance)
                {
                    return None;
                }
                let point = start + normal * hit.distance;
                let clothing = nearest_vertex(clothing, topology, hit.face, point);
                Some(SparsePair { clothing, body: vertex as u32 })
            })
            .collect();
        for pair in found.into_iter().flatten() {
            let pairs = &mut self.found[pair.clothing as usize];
            if pairs.iter().all(|known| known.body != pair.body) {
                pairs.push(pair);
            }
        }
    }
}

/// Whether a ray comes through a face from inside. What is beneath clothes looks out of them; a palm that looks at the
/// trousers beside it meets them from outside, and they do not hang on it.
fn leaves_through(clothing: &TriangleMesh, face: u32, direction: DVec3) -> bool {
    let [a, b, c] = clothing.faces()[face as usize].map(|vertex| clothing.positions()[vertex as usize]);
    (b - a).cross(c - a).dot(direction) > 0.0
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_palm_beside_trousers_does_not_carry_them() {
        let cloth = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let cloth = TriangleMesh::new(cloth, vec![[0, 1, 2]]).unwrap();
        assert!(leaves_through(&cloth, 0, DVec3::Z), "skin beneath looks out");
        assert!(!leaves_through(&cloth, 0, DVec3::NEG_Z), "skin outside looks in");
    }

    #[test]
    fn cloth_hangs_on_what_it_stays_with() {
        let mesh = |places: [f64; 3]| {
            let positions = places.iter().zip([0.0, 0.0, 1.0]).map(|(x, z)| DVec3::new(*x, 0.0, z)).collect();
            TriangleMesh::new(positions, vec![[0, 1, 2]]).unwrap()
        };
        // Body vertex 1 grazes the cloth at 0 in the first frame and is far away in the second.
        let bodies = [mesh([0.1, 0.02, 0.0]), mesh([0.11, 0.5, 0.0])];
        let clothing = mesh([0.0, 1.0, 0.0]);
        let frames: Vec<_> = bodies.iter().map(|body| (body, &clothing)).collect();
        let mut pairs = SparsePairs::new(3);
        pairs.found[0] = vec![SparsePair { clothing: 0, body: 1 }, SparsePair { clothing: 0, body: 0 }];
        assert_eq!(pairs.lasting(&frames, 0.3), [SparsePair { clothing: 0, body: 0 }]);
        assert_eq!(
            pairs.lasting(&frames[..1], 0.3),
            [SparsePair { clothing: 0, body: 1 }],
            "as P3: one frame"
        );
        pairs.found[0].pop();
        assert!(pairs.lasting(&frames, 0.3).is_empty());
    }
}
