//! Exact closest points, signs and ray hits on a mesh or an oriented point cloud.
//!
//! A four-wide tree of f32 boxes leads to groups of four packets of four primitives; f32 only rules out, every answer is
//! computed in f64 from the primitive itself.

mod closest;
mod packets;
mod pseudonormals;
mod ray;
mod tree;

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::TriangleMesh;
use closest::{Collector, Nearest, NearestFew, Packet, Query, Tree};
use packets::{FlatBoxes, LANES, Lanes, PointPacket, TrianglePacket};
use pseudonormals::Pseudonormals;
use tree::{Bounds, GROUP, Node, nodes_over, packet_order};

pub use ray::RayHit;

/// How many roundings of f32, relative to the largest length involved, a bound may be wrong by; generous, as
/// sixteen of them are 2 µm on a body.
const ROUNDINGS: f32 = 16.0;
/// Groups of primitives per parallel piece of the build.
const GROUPS_PER_PIECE: usize = 128;
/// Queries per parallel piece of [`SurfaceIndex::closest_many`].
const QUERY_CHUNK: usize = 256;

/// A point on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// The point, in metres.
    pub position: DVec3,
    /// The face, or the point's index in a cloud; of several that are equally near, the lowest.
    pub face: u32,
    /// The weights of the face's corners; `[1, 0, 0]` in a cloud.
    pub barycentric: [f64; 3],
    /// The unit pseudonormal: the face's own inside it, the edge's or vertex's on those; the given normal in a cloud.
    pub normal: DVec3,
    /// The squared distance to the point asked about.
    pub distance_squared: f64,
}

/// A search tree over the triangles of a mesh or the points of an oriented cloud.
#[derive(Debug, Clone)]
pub struct SurfaceIndex {
    frame: UnitFrame,
    nodes: Vec<Node>,
    /// The primitives in packet order, padded with the last one.
    order: Vec<u32>,
    primitives: Primitives,
}

/// What the tree is over.
#[derive(Debug, Clone)]
enum Primitives {
    Triangles {
        groups: Vec<FlatBoxes>,
        packets: Vec<TrianglePacket>,
        corners: Vec<[DVec3; 3]>,
        pseudonormals: Pseudonormals,
    },
    Points {
        groups: Vec<()>,
        packets: Vec<PointPacket>,
        positions: Vec<DVec3>,
        normals: Vec<DVec3>,
    },
}

impl SurfaceIndex {
    /// Indexes the triangles of a mesh.
    pub fn of_mesh(mesh: &TriangleMesh) -> Self {
        let positions = mesh.positions();
        let frame = UnitFrame::around(positions);
        let at = |vertex: u32| positions[vertex as usize];
        let corners: Vec<[DVec3; 3]> =
            mesh.faces().iter().map(|[a, b, c]| [at(*a), at(*b), at(*c)]).collect();
        let ((order, groups, packets, nodes), pseudonormals) = rayon::join(
            || {
                let centres = corners.iter().map(|[a, b, c]| frame.enter((*a + *b + *c) / 3.0));
                let order = padded(packet_order(centres));
                let packed = |indices: &[u32]| {
                    lanes_of(indices, |index| {
                        let [a, b, c] = corners[index as usize];
                        [frame.enter(a), frame.enter(b), frame.enter(c)]
                    })
                };
                let packets: Vec<TrianglePacket> = order
                    .par_chunks(LANES)
                    .with_min_len(LANES * GROUPS_PER_PIECE)
                    .map(|indices| TrianglePacket::new(&packed(indices)))
                    .collect();
                // A group that is not full repeats its last packet.
                let packet_of = |group: &[u32], packet: usize| {
                    let first = LANES * packet.min(group.len() / LANES - 1);
                    packed(&group[first..first + LANES])
                };
                let groups: Vec<FlatBoxes> = order
                    .par_chunks(GROUP)
                    .with_min_len(GROUPS_PER_PIECE)
                    .map(|group| FlatBoxes::around(&std::array::from_fn(|packet| packet_of(group, packet))))
                    .collect();
                let bounds: Vec<Bounds> = packets
                    .chunks(LANES)
                    .map(|group| Bounds::around(group.iter().flat_map(|packet| &packet.corners)))
                    .collect();
                let nodes = nodes_over(&bounds);
                (order, groups, packets, nodes)
            },
            || Pseudonormals::new(positions, mesh.faces()),
        );
        let primitives = Primitives::Triangles { groups, packets, corners, pseudonormals };
        Self { frame, nodes, order, primitives }
    }

    /// Indexes the points of a cloud, of which there must be one or more, with one unit normal each.
    ///
    /// # Panics
    /// If there are no points, or not as many normals as points.
    pub fn of_cloud(positions: &[DVec3], normals: &[DVec3]) -> Self {
        assert!(!positions.is_empty(), "a cloud needs a point to be searched");
        assert_eq!(positions.len(), normals.len(), "each point of the cloud needs its normal");
        let frame = UnitFrame::around(positions);
        let order = padded(packet_order(positions.iter().map(|position| frame.enter(*position))));
        let packets: Vec<PointPacket> = order
            .chunks(LANES)
            .map(|indices| PointPacket {
                points: Lanes::gather(lanes_of(indices, |index| frame.enter(positions[index as usize]))),
            })
            .collect();
        let bounds: Vec<Bounds> = packets
            .chunks(LANES)
            .map(|group| Bounds::around(group.iter().map(|packet| &packet.points)))
            .collect();
        let (positions, normals) = (positions.to_vec(), normals.to_vec());
        let primitives = Primitives::Points { groups: vec![(); bounds.len()], packets, positions, normals };
        Self { frame, nodes: nodes_over(&bounds), order, primitives }
    }

    /// How many faces or points are indexed.
    pub fn primitive_count(&self) -> usize {
        match &self.primitives {
            Primitives::Triangles { corners, .. } => corners.len(),
            Primitives::Points { positions, .. } => positions.len(),
        }
    }

    /// The closest point of the surface to a finite point.
    pub fn closest(&self, point: DVec3) -> SurfacePoint {
        // Beyond every finite distance face 0 stands in, so that there always is an answer.
        self.find_closest(point, f64::INFINITY, None).unwrap_or_else(|| self.on_primitive(point, 0))
    }

    /// The closest point of the surface, if it is no farther than `radius` metres.
    pub fn closest_within(&self, point: DVec3, radius: f64) -> Option<SurfacePoint> {
        self.find_closest(point, radius * radius, None)
    }

    /// The same answer as [`SurfaceIndex::closest`], found faster where `hint_face` is near the answer.
    pub fn closest_warm(&self, point: DVec3, hint_face: u32) -> SurfacePoint {
        if hint_face as usize >= self.primitive_count() {
            return self.closest(point);
        }
        self.find_closest(point, f64::INFINITY, Some(hint_face))
            .unwrap_or_else(|| self.on_primitive(point, hint_face))
    }

    /// The closest points of many points, in parallel; `hints` are faces as for [`SurfaceIndex::closest_warm`], one per point.
    /// Without them a point's answer is the hint for the next one: neighbours in a list mostly are neighbours in space.
    ///
    /// # Panics
    /// If there are hints, but not one per point.
    pub fn closest_many(&self, points: &[DVec3], hints: Option<&[u32]>, closest: &mut Vec<SurfacePoint>) {
        if let Some(hints) = hints {
            assert_eq!(hints.len(), points.len(), "each point needs its hint");
        }
        points
            .par_iter()
            .with_min_len(QUERY_CHUNK)
            .enumerate()
            .map_init(
                || None,
                |last: &mut Option<u32>, (place, point)| {
                    let found = match hints.map(|hints| hints[place]).or(*last) {
                        Some(hint) => self.closest_warm(*point, hint),
                        None => self.closest(*point),
                    };
                    *last = Some(found.face);
                    found
                },
            )
            .collect_into_vec(closest);
    }

    /// The distance to the surface in metres, negative inside (behind the closest point's pseudonormal).
    pub fn signed_distance(&self, point: DVec3) -> f64 {
        let closest = self.closest(point);
        let distance = closest.distance_squared.sqrt();
        if (point - closest.position).dot(closest.normal) < 0.0 { -distance } else { distance }
    }

    /// The nearest `count` points of a cloud (or faces of a mesh) with their squared distances, nearest first.
    pub fn nearest_few(&self, point: DVec3, count: usize, found: &mut Vec<(f64, u32)>) {
        found.clear();
        if count > 0 {
            self.collect(point, &mut NearestFew { wanted: count, found });
        }
    }

    fn find_closest(&self, point: DVec3, bound: f64, hint: Option<u32>) -> Option<SurfacePoint> {
        let distance_squared = hint.map_or(bound, |hint| self.distance_squared_to(point, hint));
        let mut nearest = Nearest { distance_squared, primitive: hint };
        self.collect(point, &mut nearest);
        nearest.primitive.map(|primitive| self.on_primitive(point, primitive))
    }

    fn collect(&self, point: DVec3, collector: &mut impl Collector) {
        let query = Query::new(point, &self.frame);
        let (nodes, order) = (self.nodes.as_slice(), self.order.as_slice());
        match &self.primitives {
            Primitives::Triangles { groups, packets, corners, .. } => {
                query.collect(Tree { nodes, order, groups, packets, primitives: corners }, collector);
            }
            Primitives::Points { groups, packets, positions, .. } => {
                query.collect(Tree { nodes, order, groups, packets, primitives: positions }, collector);
            }
        }
    }

    fn distance_squared_to(&self, point: DVec3, primitive: u32) -> f64 {
        match &self.primitives {
            Primitives::Triangles { corners, .. } => {
                TrianglePacket::distance_squared(point, &corners[primitive as usize])
            }
            Primitives::Points { positions, .. } => point.distance_squared(positions[primitive as usize]),
        }
    }

    /// The closest point of one given face or cloud point.
    fn on_primitive(&self, point: DVec3, primitive: u32) -> SurfacePoint {
        match &self.primitives {
            Primitives::Triangles { corners, pseudonormals, .. } => {
                let closest = crate::triangle::closest_on_triangle(point, corners[primitive as usize]);
                SurfacePoint {
                    position: closest.position,
                    face: primitive,
                    barycentric: closest.barycentric,
                    normal: pseudonormals.at(primitive, closest.feature),
                    distance_squared: closest.distance_squared,
                }
            }
            Primitives::Points { positions, normals, .. } => SurfacePoint {
                position: positions[primitive as usize],
                face: primitive,
                barycentric: [1.0, 0.0, 0.0],
                normal: normals[primitive as usize],
                distance_squared: point.distance_squared(positions[primitive as usize]),
            },
        }
    }
}

/// The frame of everything in f32: the surface's box is centred and its largest half-width is 1, so that roundings
/// are known beforehand and no scale can overflow.
#[derive(Debug, Clone, Copy)]
struct UnitFrame {
    centre: DVec3,
    /// Metres in one unit of the frame.
    metres: f64,
}

impl UnitFrame {
    fn around(positions: &[DVec3]) -> Self {
        let low = positions.iter().fold(DVec3::INFINITY, |low, position| low.min(*position));
        let high = positions.iter().fold(DVec3::NEG_INFINITY, |high, position| high.max(*position));
        let radius = (high * 0.5 - low * 0.5).max_element();
        Self { centre: low * 0.5 + high * 0.5, metres: if radius.is_normal() { radius } else { 1.0 } }
    }

    fn enter(&self, point: DVec3) -> DVec3 {
        (point - self.centre) / self.metres
    }

    /// What f32 may be wrong by, in units of the frame, about this point of it.
    fn slack(point: DVec3) -> f32 {
        ROUNDINGS * f32::EPSILON * (1.0 + point.abs().max_element() as f32)
    }
}

fn padded(mut order: Vec<u32>) -> Vec<u32> {
    while !order.len().is_multiple_of(LANES) {
        order.push(order[order.len() - 1]);
    }
    order
}

#[inline(always)]
fn lanes_of<T: Copy>(indices: &[u32], primitive: impl Fn(u32) -> T) -> [T; LANES] {
    [primitive(indices[0]), primitive(indices[1]), primitive(indices[2]), primitive(indices[3])]
}
