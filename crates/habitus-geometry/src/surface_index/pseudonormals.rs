//! Normals of faces, edges and vertices whose sign tells inside from outside (Bærentzen and Aanæs 2005).

use glam::DVec3;
use rayon::prelude::*;

use crate::normals::corner_angles;
use crate::triangle::Feature;

/// Faces per parallel piece.
const CHUNK: usize = 4096;

/// The pseudonormals of a mesh: vertices summed once, edges summed when asked from the faces around them.
#[derive(Debug, Clone)]
pub(super) struct Pseudonormals {
    faces: Vec<[u32; 3]>,
    face_normals: Vec<DVec3>,
    vertex_normals: Vec<DVec3>,
    /// For half-edge `3 · face + corner` the next half-edge on the same edge, round and round; itself on a border.
    next_around_edge: Vec<u32>,
}

impl Pseudonormals {
    pub fn new(positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        let ((face_normals, vertex_normals), next_around_edge) = rayon::join(
            || face_and_vertex_normals(positions, faces),
            || link_half_edges(positions.len(), faces),
        );
        Self { faces: faces.to_vec(), face_normals, vertex_normals, next_around_edge }
    }

    /// The unit pseudonormal at a feature of a face; the face's own where a sum cancels.
    pub fn at(&self, face: u32, feature: Feature) -> DVec3 {
        let own = self.face_normals[face as usize];
        let sum = match feature {
            Feature::Face => return own,
            Feature::Corner(corner) => {
                self.vertex_normals[self.faces[face as usize][corner as usize] as usize]
            }
            Feature::Edge(corner) => {
                let start = 3 * face + u32::from(corner);
                let mut sum = own;
                let mut half_edge = self.next_around_edge[start as usize];
                while half_edge != start {
                    sum += self.face_normals[half_edge as usize / 3];
                    half_edge = self.next_around_edge[half_edge as usize];
                }
                sum
            }
        };
        sum.try_normalize().unwrap_or(own)
    }
}

fn face_and_vertex_normals(positions: &[DVec3], faces: &[[u32; 3]]) -> (Vec<DVec3>, Vec<DVec3>) {
    let mut face_normals = vec![DVec3::ZERO; faces.len()];
    let mut angles = vec![[0.0; 3]; faces.len()];
    let pieces = face_normals.par_chunks_mut(CHUNK).zip(angles.par_chunks_mut(CHUNK));
    pieces.zip(faces.par_chunks(CHUNK)).for_each(|((normals, angles), faces)| {
        for ((normal, angles), [a, b, c]) in normals.iter_mut().zip(angles).zip(faces) {
            let [a, b, c] = [positions[*a as usize], positions[*b as usize], positions[*c as usize]];
            *normal = (b - a).cross(c - a).normalize_or_zero();
            *angles = corner_angles([a, b, c]);
        }
    });
    let mut vertex_normals = vec![DVec3::ZERO; positions.len()];
    for ((face, normal), angles) in faces.iter().zip(&face_normals).zip(&angles) {
        for (vertex, angle) in face.iter().zip(angles) {
            vertex_normals[*vertex as usize] += *normal * *angle;
        }
    }
    (face_normals, vertex_normals)
}

/// Buckets half-edges by their lower vertex and ties those with the same higher vertex into rings.
fn link_half_edges(vertex_count: usize, faces: &[[u32; 3]]) -> Vec<u32> {
    let ends = |half_edge: u32| {
        let face = faces[half_edge as usize / 3];
        let corner = half_edge as usize % 3;
        let (from, to) = (face[corner], face[(corner + 1) % 3]);
        (from.min(to), from.max(to))
    };
    let half_edge_count = 3 * faces.len() as u32;
    let mut offsets = vec![0u32; vertex_count + 1];
    for half_edge in 0..half_edge_count {
        offsets[ends(half_edge).0 as usize + 1] += 1;
    }
    for vertex in 0..vertex_count {
        offsets[vertex + 1] += offsets[vertex];
    }
    let mut bucketed = vec![(0u32, 0u32); half_edge_count as usize];
    let mut next_free = offsets.clone();
    for half_edge in 0..half_edge_count {
        let (low, high) = ends(half_edge);
        bucketed[next_free[low as usize] as usize] = (high, half_edge);
        next_free[low as usize] += 1;
    }
    let mut next_around_edge: Vec<u32> = (0..half_edge_count).collect();
    for bucket in offsets.windows(2) {
        let bucket = &mut bucketed[bucket[0] as usize..bucket[1] as usize];
        bucket.sort_unstable();
        for ring in bucket.chunk_by(|first, second| first.0 == second.0) {
            for (place, (_, half_edge)) in ring.iter().enumerate() {
                next_around_edge[*half_edge as usize] = ring[(place + 1) % ring.len()].1;
            }
        }
    }
    next_around_edge
}
