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

    /// Offers primitives to a collector, near ones first, until no other can be as near as its bound.
    pub fn collect<P: Packet>(&self, tree: Tree<'_, P>, collector: &mut impl Collector) {
        let mut cutoff = self.cutoff(collector.bound());
        let mut stack = [(0.0f32, 0u32); STACK];
        let mut waiting = 1;
        while waiting > 0 {
            waiting -= 1;
            let (distance_squared, code) = stack[waiting];
            if distance_squared > cutoff {
                continue;
            }
            match Child::of(code) {
                Child::Node(node) => {
                    waiting = self.push_children(&tree.nodes[node as usize], cutoff, &mut stack, waiting);
                }
                Child::Packet(packet) => {
                    let packet = packet as usize;
                    let bounds = tree.packets[packet].bounds(self.lanes, self.slack);
                    let mut untested = !bounds.cmpgt(Vec4::splat(cutoff)).bitmask() & 0xF;
                    let bounds = bounds.to_array();
                    while untested != 0 {
                        let lane = untested.trailing_zeros() as usize & (LANES - 1);
                        untested &= untested - 1;
                        if bounds[lane] > cutoff {
                            continue;
                        }
                        let primitive = tree.order[packet * LANES + lane];
                        let exact = P::distance_squared(self.point, &tree.primitives[primitive as usize]);
                        if collector.offer(exact, primitive) {
                            cutoff = self.cutoff(collector.bound());
                        }
                    }
                }
            }
        }
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

    /// The f32 squared distance beyond which nothing can be as near as `distance_squared`.
    #[inline(always)]
    fn cutoff(&self, distance_squared: f64) -> f32 {
        let reach = (distance_squared.sqrt() * self.units) as f32 + self.slack;
        reach * reach * (1.0 + ROUNDINGS * f32::EPSILON)
    }
}

/// What is searched: the tree, its packets and the exact primitives behind them.
pub(super) struct Tree<'a, P: Packet> {
    pub nodes: &'a [Node],
    /// The primitive of each lane of each packet.
    pub order: &'a [u32],
    pub packets: &'a [P],
    pub primitives: &'a [P::Primitive],
}

/// Keeps of the primitives that it is offered those that answer a question.
pub(super) trait Collector {
    /// The squared distance beyond which nothing is wanted.
    fn bound(&self) -> f64;
    /// Takes a primitive with its squared distance; true where that changed the bound.
    fn offer(&mut self, distance_squared: f64, primitive: u32) -> bool;
}

/// The nearest primitive so far; of equals the lowest, so that the answer does not hang on the order of search.
pub(super) struct Nearest {
    pub distance_squared: f64,
    pub primitive: Option<u32>,
}

impl Collector for Nearest {
    #[inline(always)]
    fn bound(&self) -> f64 {
        self.distance_squared
    }

    #[inline(always)]
    fn offer(&mut self, distance_squared: f64, primitive: u32) -> bool {
        let is_nearer = distance_squared < self.distance_squared
            || (distance_squared == self.distance_squared
                && self.primitive.is_none_or(|best| primitive < best));
        if is_nearer {
            *self = Self { distance_squared, primitive: Some(primitive) };
        }
        is_nearer
    }
}

/// The nearest few primitives, in ascending order.
pub(super) struct NearestFew<'a> {
    pub wanted: usize,
    pub found: &'a mut Vec<(f64, u32)>,
}

impl Collector for NearestFew<'_> {
    fn bound(&self) -> f64 {
        if self.found.len() < self.wanted {
            return f64::INFINITY;
        }
        self.found.last().map_or(f64::NEG_INFINITY, |(distance_squared, _)| *distance_squared)
    }

    fn offer(&mut self, distance_squared: f64, primitive: u32) -> bool {
        let entry = (distance_squared, primitive);
        let place = self.found.partition_point(|other| *other < entry);
        // The last packet repeats its last primitive to be full.
        if self.found.get(place) == Some(&entry) || place >= self.wanted {
            return false;
        }
        self.found.insert(place, entry);
        self.found.truncate(self.wanted);
        true
    }
}
