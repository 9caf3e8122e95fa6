//! The nearest-first descent that all closest-point questions share.

use glam::{DVec3, Vec4};

use super::packets::{FlatBoxes, LANES, Lanes, PointPacket, TrianglePacket};
use super::tree::{Node, Part, Waiting};
use super::{ROUNDINGS, UnitFrame};
use crate::triangle::closest_on_triangle;

/// Primitives of which a packet bounds four.
pub(super) trait Packet: Copy {
    /// One primitive, exactly.
    type Primitive;
    /// What bounds the packets of a group, if that pays.
    type Group;
    /// Lower bounds on the squared distances to the four packets of a group, up to the slack.
    fn group_bounds(group: &Self::Group, point: Lanes) -> Vec4;
    /// Lower bounds on the squared distances to the four primitives, up to the slack.
    fn bounds(&self, point: Lanes, slack: f32) -> Vec4;
    /// The exact squared distance to one primitive.
    fn distance_squared(point: DVec3, primitive: &Self::Primitive) -> f64;
}

impl Packet for TrianglePacket {
    type Primitive = [DVec3; 3];
    type Group = FlatBoxes;

    #[inline(always)]
    fn group_bounds(boxes: &FlatBoxes, point: Lanes) -> Vec4 {
        boxes.distances_squared(point)
    }

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
    /// Sixteen points are looked at sooner than four boxes.
    type Group = ();

    #[inline(always)]
    fn group_bounds(_group: &(), _point: Lanes) -> Vec4 {
        Vec4::ZERO
    }

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
        let mut waiting = Waiting::at_root();
        while let Some((distance_squared, code)) = waiting.pop() {
            if distance_squared > cutoff {
                continue;
            }
            match Part::of(code) {
                Part::Node(node) => {
                    let node = &tree.nodes[node as usize];
                    let (children, used) = node.children();
                    let distances_squared = node.distances_squared(self.lanes);
                    let lanes = not_beyond(distances_squared, cutoff) & used;
                    waiting.push_sorted(lanes, distances_squared.to_array(), children);
                }
                Part::Group(group) => {
                    let first = group * LANES as u32;
                    let used = (1 << (tree.packets.len() - first as usize).min(LANES)) - 1;
                    let bounds = P::group_bounds(&tree.groups[group as usize], self.lanes);
                    let packets = [0, 1, 2, 3].map(|lane| Part::Packet(first + lane).code());
                    waiting.push_sorted(not_beyond(bounds, cutoff) & used, bounds.to_array(), packets);
                }
                Part::Packet(packet) => {
                    let packet = packet as usize;
                    let bounds = tree.packets[packet].bounds(self.lanes, self.slack);
                    let mut lanes = not_beyond(bounds, cutoff);
                    let bounds = bounds.to_array();
                    while lanes != 0 {
                        let lane = lanes.trailing_zeros() as usize & (LANES - 1);
                        lanes &= lanes - 1;
                        if bounds[lane] > cutoff {
                            continue;
                        }
                        let primitive = tree.order[packet * LANES + lane];
                        if collector.has(primitive) {
                            continue;
                        }
                        let exact = P::distance_squared(self.point, &tree.primitives[primitive as usize]);
                        if collector.offer(exact, primitive) {
                            cutoff = self.cutoff(collector.bound());
                        }
                    }
                }
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

/// The lanes that are not beyond a distance; not "within", as one that is not a number must not hide anything.
#[inline(always)]
fn not_beyond(distances_squared: Vec4, cutoff: f32) -> u32 {
    !distances_squared.cmpgt(Vec4::splat(cutoff)).bitmask() & 0xF
}

/// What is searched: the tree, its packets and the exact primitives behind them.
pub(super) struct Tree<'a, P: Packet> {
    pub nodes: &'a [Node],
    /// The primitive of each lane of each packet.
    pub order: &'a [u32],
    pub groups: &'a [P::Group],
    pub packets: &'a [P],
    pub primitives: &'a [P::Primitive],
}

/// Keeps of the primitives that it is offered those that answer a question.
pub(super) trait Collector {
    /// The squared distance beyond which nothing is wanted.
    fn bound(&self) -> f64;
    /// True for a primitive that need not be offered again, where that is quickly known.
    fn has(&self, _primitive: u32) -> bool {
        false
    }
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
    fn has(&self, primitive: u32) -> bool {
        self.primitive == Some(primitive)
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
