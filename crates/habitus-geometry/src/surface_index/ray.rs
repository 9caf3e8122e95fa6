//! The first hit of a ray.

use glam::{DVec3, Vec4};

use super::packets::{LANES, Lanes};
use super::tree::{Part, Waiting};
use super::{Primitives, SurfaceIndex, UnitFrame};

/// Stands for 1/0 in the slab test: large, but a product with it stays a number.
const STEEPEST: f64 = 1e18;
/// Relative widening of a ray's interval in a box, for the roundings of f32.
const WIDENING: f32 = 1e-5;

/// A unit direction along which no edge of a modelled mesh lies.
const GENERAL_DIRECTION: DVec3 =
    DVec3::new(0.801_783_725_737_273_2, 0.267_261_241_912_424_4, 0.534_522_483_824_848_8);
/// How far behind a hit the next one is sought, in sizes of the mesh: faces that share an edge are met once.
const PAST_A_HIT: f64 = 1e-9;

/// Where a ray meets a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayHit {
    /// The face; of several hit at the same distance, the lowest.
    pub face: u32,
    /// The distance from the ray's origin in metres.
    pub distance: f64,
    /// The weights of the face's corners.
    pub barycentric: [f64; 3],
}

impl SurfaceIndex {
    /// The first face, from either side, that a ray meets within `max_distance` metres; the direction may have any
    /// length but zero. A ray through an edge shared by two faces cannot slip between them. Clouds are never hit.
    pub fn ray_hit(&self, origin: DVec3, direction: DVec3, max_distance: f64) -> Option<RayHit> {
        let Primitives::Triangles { corners, groups, .. } = &self.primitives else { return None };
        let direction = direction.try_normalize()?;
        let in_frame = self.frame.enter(origin);
        let slack = UnitFrame::slack(in_frame);
        let lanes = Lanes::splat(in_frame);
        let limit_at = |reach: f64| (reach / self.frame.metres) as f32 * (1.0 + WIDENING) + slack;
        let along = Lanes::splat(direction);
        let inverse = Lanes::splat(direction.map(|value| {
            if value.abs() < 1.0 / STEEPEST { STEEPEST.copysign(value) } else { value.recip() }
        }));

        let mut hit: Option<RayHit> = None;
        let mut reach = max_distance;
        let mut limit = limit_at(reach);
        let mut waiting = Waiting::at_root();
        while let Some((entry, code)) = waiting.pop() {
            if entry > limit {
                continue;
            }
            let met = |(enter, leave): (Vec4, Vec4)| {
                let enter = enter.max(Vec4::ZERO);
                let missed = enter.cmpgt(leave * (1.0 + WIDENING)) | enter.cmpgt(Vec4::splat(limit));
                (!missed.bitmask(), enter.to_array())
            };
            match Part::of(code) {
                Part::Node(node) => {
                    let node = &self.nodes[node as usize];
                    let (children, used) = node.children();
                    let (lanes, enter) = met(node.slab_interval(lanes, inverse, slack));
                    waiting.push_sorted(lanes & used, enter, children);
                }
                Part::Group(group) => {
                    let first = group * LANES as u32;
                    let used = (1 << (self.order.len() / LANES - first as usize).min(LANES)) - 1;
                    let (lanes, enter) = met(groups[group as usize].slab_interval(lanes, along, slack));
                    let packets = [0, 1, 2, 3].map(|lane| Part::Packet(first + lane).code());
                    waiting.push_sorted(lanes & used, enter, packets);
                }
                Part::Packet(packet) => {
                    for &face in &self.order[packet as usize * LANES..][..LANES] {
                        let Some((distance, barycentric)) = meet(origin, direction, corners[face as usize])
                        else {
                            continue;
                        };
                        let is_nearer =
                            distance < reach || (distance == reach && hit.is_none_or(|hit| face < hit.face));
                        if is_nearer {
                            reach = distance;
                            limit = limit_at(reach);
                            hit = Some(RayHit { face, distance, barycentric });
                        }
                    }
                }
            }
        }
        hit
    }

    /// How many times a closed mesh winds around a point: 0 outside, 1 inside, more where its parts overlap. Counted along one ray,
    /// on which faces seen from behind count for and faces seen from the front against.
    pub fn winding_number(&self, point: DVec3) -> i32 {
        let Primitives::Triangles { corners, .. } = &self.primitives else { return 0 };
        let mut origin = point;
        let mut winding = 0;
        while let Some(hit) = self.ray_hit(origin, GENERAL_DIRECTION, f64::INFINITY) {
            let [a, b, c] = corners[hit.face as usize];
            winding += if (b - a).cross(c - a).dot(GENERAL_DIRECTION) > 0.0 { 1 } else { -1 };
            origin += GENERAL_DIRECTION * (hit.distance + self.frame.metres * PAST_A_HIT);
        }
        winding
    }
}

/// Distance and barycentric coordinates where a ray meets a triangle. The three volumes change sign exactly with
/// the direction of their edge, which is what closes the gap between neighbours.
fn meet(origin: DVec3, direction: DVec3, corners: [DVec3; 3]) -> Option<(f64, [f64; 3])> {
    let [a, b, c] = corners.map(|corner| corner - origin);
    let (u, v, w) = (direction.dot(c.cross(b)), direction.dot(a.cross(c)), direction.dot(b.cross(a)));
    let is_inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
    let volume = u + v + w;
    if !is_inside || volume == 0.0 {
        return None;
    }
    let barycentric = [u / volume, v / volume, w / volume];
    let distance = (a * barycentric[0] + b * barycentric[1] + c * barycentric[2]).dot(direction);
    (distance >= 0.0).then_some((distance, barycentric))
}
