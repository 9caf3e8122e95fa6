//! What clothing must leave: the inside of a posed body.
//!
//! Skinning lets parts of a body overlap: calf and thigh of a bent knee, an upper arm and the trunk. Flesh would yield there, skin
//! would meet skin, and clothing would be held in between. So a point is *inside* where the body's surface winds around it once;
//! where it winds around it twice or more, two parts overlap and the point is *pinched* between them. The way out of the inside leads
//! to the nearest surface, whether what lies behind it is air or another part: one rule for both, and neighbours stay neighbours.
//! A nearest way to the air alone would tear the clothing in a closed crease apart, to all sides of the limb.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, SurfacePoint, TriangleMesh, vertex_normals};
use rayon::prelude::*;

/// How far in front of the surface it is seen what lies there, metres: well above roundings, well below anything that is seen.
const IN_FRONT: f64 = 1e-5;
/// Cosine between the way to an edge and its normal above which a point is in front of it without doubt.
const CLEARLY_IN_FRONT: f64 = 0.7;
/// Points per parallel piece.
const CHUNK: usize = 256;

/// Where a point is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// In the air.
    Outside,
    /// In the body.
    Inside,
    /// Where parts of the body overlap.
    Pinched,
}

/// The nearest surface of the body, seen from a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exit {
    /// Where the point is.
    pub place: Place,
    /// Nearest point of the surface.
    pub position: DVec3,
    /// From the inside towards what lies beyond.
    pub normal: DVec3,
    /// Distance in metres, not negative.
    pub distance: f64,
    /// Face of the body that the nearest point lies on: the hint for the next search.
    pub face: u32,
}

impl Exit {
    /// How deep the point is inside, metres; not positive if it is not.
    pub fn depth(&self) -> f64 {
        if self.place == Place::Inside { self.distance } else { -self.distance }
    }
}

/// A posed body, ready for questions.
pub(super) struct Obstacle {
    index: SurfaceIndex,
    /// For each face what lies in front of it.
    front: Vec<Front>,
}

/// What lies in front of a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Front {
    Air,
    /// Another part of the body.
    Body,
    /// Air in front of some corners, another part in front of others.
    Both,
}

impl Obstacle {
    /// Finds which faces of a closed body lie inside another of its parts.
    pub fn new(body: &TriangleMesh) -> Self {
        let index = SurfaceIndex::of_mesh(body);
        let normals = vertex_normals(body.positions(), body.faces());
        let is_buried: Vec<bool> = body
            .positions()
            .par_iter()
            .with_min_len(CHUNK)
            .zip(&normals)
            .map(|(position, normal)| {
                let in_front = *position + *normal * IN_FRONT;
                // Most of the skin sees no other skin, and one ray tells.
                index.ray_hit(in_front, *normal, f64::INFINITY).is_some()
                    && index.winding_number(in_front) > 0
            })
            .collect();
        let front = |face: &[u32; 3]| match face.iter().filter(|vertex| is_buried[**vertex as usize]).count()
        {
            0 => Front::Air,
            3 => Front::Body,
            _ => Front::Both,
        };
        let front = body.faces().iter().map(front).collect();
        Self { index, front }
    }

    /// Where a point is, and the nearest surface, sought first near a face.
    pub fn exit(&self, point: DVec3, hint: u32) -> Exit {
        let closest = self.index.closest_warm(point, hint);
        let distance = closest.distance_squared.sqrt();
        let height = (point - closest.position).dot(closest.normal);
        let is_buried = self.is_buried(&closest);
        // Where skinning turns a crease inside out, the normals of its edges and vertices do not tell the side.
        let is_on_edge = closest.barycentric.contains(&0.0);
        let is_doubtful = self.front[closest.face as usize] == Front::Both
            || (is_on_edge && height < CLEARLY_IN_FRONT * distance);
        let windings = if is_doubtful {
            self.index.winding_number(point)
        } else {
            i32::from(height < 0.0) + i32::from(is_buried)
        };
        let place = match windings {
            ..=0 => Place::Outside,
            1 => Place::Inside,
            2.. => Place::Pinched,
        };
        let normal = if is_buried { -closest.normal } else { closest.normal };
        Exit { place, position: closest.position, normal, distance, face: closest.face }
    }

    /// How far it is from a point inside to the surface in a direction, metres.
    pub fn way(&self, point: DVec3, direction: DVec3) -> Option<f64> {
        self.index.ray_hit(point, direction, f64::INFINITY).map(|hit| hit.distance)
    }

    fn is_buried(&self, point: &SurfacePoint) -> bool {
        match self.front[point.face as usize] {
            Front::Air => false,
            Front::Body => true,
            Front::Both => self.index.winding_number(point.position + point.normal * IN_FRONT) > 0,
        }
    }

    /// [`Obstacle::exit`] of many points, in parallel.
    pub fn exits_into(&self, points: &[DVec3], hints: &[u32], exits: &mut Vec<Exit>) {
        points
            .par_iter()
            .with_min_len(CHUNK)
            .zip(hints)
            .map(|(point, hint)| self.exit(*point, *hint))
            .collect_into_vec(exits);
    }
}
