//! The nearest-first descent that all closest-point questions share.

use glam::{DVec3, Vec4};

use super::packets::{LANES, Lanes, PointPacket, TrianglePacket};
use super::tree::{Child, Node, STACK};
use super::{ROUNDINGS, UnitFrame};
use crate::triangle::closest_on_triangle;

/// Primitives of which a packet bounds four.
pub(super) trait Packet: Copy {
    /// One primitive, exactly.
    type Primitive;
    /// Lower bounds on the squared distances to the four primitives, up to the slack.
    fn bounds(&self, point: Lanes, slack: f32) -> Vec4;
    /// The exact squared distance to one primitive.
    fn distance_squared(point: DVec3, primitive: &Self::Primitive) -> f64;
}

impl Packet for TrianglePacket {
    type Primitive = [DVec3; 3];

    #[inline(always)]
    fn bounds(&self, point: Lanes, slack: f32) -> Vec4 {
        self.distance_squared_bounds(point, slack)
    }

    #[inline]
    fn distance_squared(point: DVec3, corners: &[DVec3; 3]) -> f64 {
        closest_on_triangle(point, *corners).distance_squared
    }
}

impl Packet for PointPacket {
    type Primitive = DVec3;

    #[inline(always)]
    fn bounds(&self, point: Lanes, _slack: f32) -> Vec4 {
        self.distance_squared_bounds(point)
    }

    #[inline]
    fn distance_squared(point: DVec3, position: &DVec3) -> f64 {
        point.distance_squared(*position)
    }
}

/// A point in f64 and in f32 about the surface's centre, with the rounding that the latter allows.
pub(super) struct Query {
    point: DVec3,
    lanes: Lanes,
    slack: f32,
    /// Units of the frame in one metre.
    units: f64,
}

impl Query {
    pub fn new(point: DVec3, frame: &UnitFrame) -> Self {
        let in_frame = frame.enter(point);
        Self {
            point,
            lanes: Lanes::splat(in_frame),
            slack: UnitFrame::slack(in_frame),
            units: frame.metres.recip(),
        }
    }

    /// The nearest primitive no farther than `bound` (squared); of equals the lowest. A hint only makes it faster.
    pub fn nearest<P: Packet>(
        &self,
        nodes: &[Node],
        order: &[u32],
        packets: &[P],
        primitives: &[P::Primitive],
        bound: f64,
        hint: Option<u32>,
    ) -> Option<u32> {
        let mut best = Best { bound, primitive: hint.unwrap_or(u32::MAX), cutoff: 0.0 };
        if let Some(hint) = hint {
            best.bound = P::distance_squared(self.point, &primitives[hint as usize]);
        }
        best.cutoff = self.cutoff(best.bound);

        let mut stack = [(0.0f32, 0u32); STACK];
        let mut waiting = 1;
        while waiting > 0 {
            waiting -= 1;
            let (distance_squared, code) = stack[waiting];
            if distance_squared > best.cutoff {
                continue;
            }
            match Child::of(code) {
                Child::Node(node) => {
                    waiting = self.push_children(&nodes[node as usize], best.cutoff, &mut stack, waiting);
                }
                Child::Packet(packet) => {
                    let packet = packet as usize;
                    let bounds = packets[packet].bounds(self.lanes, self.slack);
                    self.test_lanes::<P>(bounds, &order[packet * LANES..], primitives, &mut best);
                }
            }
        }
        (best.primitive != u32::MAX).then_some(best.primitive)
    }

    /// Puts the children within reach on the stack, nearest on top.
    #[inline(always)]
    fn push_children(
        &self,
        node: &Node,
        cutoff: f32,
        stack: &mut [(f32, u32); STACK],
        mut waiting: usize,
    ) -> usize {
        let distances_squared = node.distances_squared(self.lanes);
        let (children, used) = node.children();
        // "Not beyond" rather than "within": a distance that is not a number must not hide a child.
        let mut within = !distances_squared.cmpgt(Vec4::splat(cutoff)).bitmask() & used;
        let distances_squared = distances_squared.to_array();
        let bottom = waiting;
        while within != 0 {
            let lane = within.trailing_zeros() as usize & (LANES - 1);
            within &= within - 1;
            let entry = (distances_squared[lane], children[lane]);
            let mut place = waiting;
            while place > bottom && stack[place - 1].0 < entry.0 {
                stack[place] = stack[place - 1];
                place -= 1;
            }
            stack[place] = entry;
            waiting += 1;
        }
        waiting
    }

    #[inline(always)]
    fn test_lanes<P: Packet>(
        &self,
        bounds: Vec4,
        order: &[u32],
        primitives: &[P::Primitive],
        best: &mut Best,
    ) {
        let mut untested = !bounds.cmpgt(Vec4::splat(best.cutoff)).bitmask() & 0xF;
        let bounds = bounds.to_array();
        while untested != 0 {
            let lane = untested.trailing_zeros() as usize & (LANES - 1);
            untested &= untested - 1;
            if bounds[lane] > best.cutoff {
                continue;
            }
            let primitive = order[lane];
            let distance_squared = P::distance_squared(self.point, &primitives[primitive as usize]);
            if distance_squared < best.bound || (distance_squared == best.bound && primitive < best.primitive)
            {
                best.bound = distance_squared;
                best.primitive = primitive;
                best.cutoff = self.cutoff(distance_squared);
            }
        }
    }

    /// The f32 squared distance beyond which nothing can be as near as `distance_squared`.
    #[inline(always)]
    fn cutoff(&self, distance_squared: f64) -> f32 {
        let reach = (distance_squared.sqrt() * self.units) as f32 + self.slack;
        reach * reach * (1.0 + ROUNDINGS * f32::EPSILON)
    }
}

/// The nearest primitive so far.
struct Best {
    bound: f64,
    primitive: u32,
    cutoff: f32,
}
