//! Cloth that every vertex ties to the skin: the tight suits of P2 §6.1.

use glam::DVec3;

use crate::cloth::Anchor;
use crate::garment::{Drive, Garment};
use crate::rest_body::RestBody;

/// The body's own covered triangles, lifted off the skin.
pub(crate) fn second_skin(body: &RestBody, thickness: f64) -> Garment {
    let is_covered = |face: &&[u32; 3]| face.iter().all(|&vertex| !body.is_bare(vertex));
    let body_faces: Vec<[u32; 3]> = body.faces().iter().filter(is_covered).copied().collect();
    let mut anchors = Vec::new();
    let mut cloth_vertex = vec![u32::MAX; body.positions().len()];
    let mut faces = body_faces.clone();
    for (face_index, face) in body.faces().iter().enumerate() {
        if !is_covered(&face) {
            continue;
        }
        for (corner, &vertex) in face.iter().enumerate() {
            if cloth_vertex[vertex as usize] == u32::MAX {
                cloth_vertex[vertex as usize] = anchors.len() as u32;
                let barycentric = std::array::from_fn(|slot| if slot == corner { 1.0 } else { 0.0 });
                let vertex = anchors.len() as u32;
                anchors.push(Anchor {
                    vertex,
                    face: face_index as u32,
                    barycentric,
                    height: thickness,
                    compliance: 0.0,
                });
            }
        }
    }
    for vertex in faces.iter_mut().flatten() {
        *vertex = cloth_vertex[*vertex as usize];
    }
    let positions = follow_skin(&anchors, body.positions(), body.faces());
    Garment { name: "suit", positions, faces, anchors, drive: Drive::FollowsSkin, layer: 0 }
}

/// Positions of anchored vertices on a body in any pose.
pub fn follow_skin(anchors: &[Anchor], body_positions: &[DVec3], body_faces: &[[u32; 3]]) -> Vec<DVec3> {
    let normals = habitus::geometry::vertex_normals(body_positions, body_faces);
    anchors
        .iter()
        .map(|anchor| {
            let corners = body_faces[anchor.face as usize].map(|vertex| vertex as usize);
            let blend = |values: &[DVec3]| -> DVec3 {
                corners.iter().zip(anchor.barycentric).map(|(&vertex, share)| values[vertex] * share).sum()
            };
            blend(body_positions) + blend(&normals).normalize_or_zero() * anchor.height
        })
        .collect()
}
