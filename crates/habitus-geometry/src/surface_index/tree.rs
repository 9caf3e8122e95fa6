//! A four-wide tree of f32 boxes over groups of four packets of four primitives.
//!
//! Splits are at the median group, so the shape of the tree follows from the count alone: building is one
//! parallel reordering, the traversal stack is bounded, and no input can make the tree degenerate.

use glam::{DVec3, Vec4};

use super::packets::{LANES, Lanes};

/// Enough for a branch of the largest tree: fourteen levels and a group with three waiting parts each.
const STACK: usize = 64;
/// Below this many primitives a second thread costs more than it brings.
const PARALLEL_FROM: usize = 4096;
/// How many primitives one group holds.
pub(super) const GROUP: usize = LANES * LANES;
/// Marks a child that is a group of packets, or one packet, instead of a node.
const GROUP_MARK: u32 = 1 << 31;
const PACKET_MARK: u32 = 1 << 30;

/// Four boxes with what they hold.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    low: Lanes,
    high: Lanes,
    children: [u32; LANES],
    used: u32,
}

/// What waits to be searched.
#[derive(Debug, Clone, Copy)]
pub(super) enum Part {
    /// A node.
    Node(u32),
    /// Four packets.
    Group(u32),
    /// Four primitives.
    Packet(u32),
}

impl Part {
    /// The part in 32 bits, as the stack keeps it.
    #[inline(always)]
    pub fn code(self) -> u32 {
        match self {
            Self::Node(node) => node,
            Self::Group(group) => group | GROUP_MARK,
            Self::Packet(packet) => packet | PACKET_MARK,
        }
    }

    #[inline(always)]
    pub fn of(code: u32) -> Self {
        if code & GROUP_MARK != 0 {
            Self::Group(code & !GROUP_MARK)
        } else if code & PACKET_MARK != 0 {
            Self::Packet(code & !PACKET_MARK)
        } else {
            Self::Node(code)
        }
    }
}

/// The parts that wait, the nearest of those last added on top.
pub(super) struct Waiting {
    entries: [(f32, u32); STACK],
    count: usize,
}

impl Waiting {
    /// With the root alone.
    pub fn at_root() -> Self {
        Self { entries: [(0.0, Part::Node(0).code()); STACK], count: 1 }
    }

    #[inline(always)]
    pub fn pop(&mut self) -> Option<(f32, u32)> {
        self.count = self.count.checked_sub(1)?;
        Some(self.entries[self.count])
    }

    /// Adds the parts in these lanes, sorted so that the nearest comes out first.
    #[inline(always)]
    pub fn push_sorted(&mut self, mut lanes: u32, distances: [f32; LANES], codes: [u32; LANES]) {
        let bottom = self.count;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize & (LANES - 1);
            lanes &= lanes - 1;
            let mut place = self.count;
            while place > bottom && self.entries[place - 1].0 < distances[lane] {
                self.entries[place] = self.entries[place - 1];
                place -= 1;
            }
            self.entries[place] = (distances[lane], codes[lane]);
            self.count += 1;
        }
    }
}

impl Node {
    /// Squared distances to the four boxes.
    #[inline(always)]
    pub fn distances_squared(&self, point: Lanes) -> Vec4 {
        let (below, above) = (self.low.minus(point), point.minus(self.high));
        let outside = Lanes {
            x: below.x.max(above.x).max(Vec4::ZERO),
            y: below.y.max(above.y).max(Vec4::ZERO),
            z: below.z.max(above.z).max(Vec4::ZERO),
        };
        outside.dot(outside)
    }

    /// Where a ray enters and leaves the four boxes after these grew by the slack.
    #[inline(always)]
    pub fn slab_interval(&self, origin: Lanes, inverse_direction: Lanes, slack: f32) -> (Vec4, Vec4) {
        let slack = Vec4::splat(slack);
        let axis = |low: Vec4, high: Vec4, origin: Vec4, inverse: Vec4| {
            let (first, second) = ((low - slack - origin) * inverse, (high + slack - origin) * inverse);
            (first.min(second), first.max(second))
        };
        let x = axis(self.low.x, self.high.x, origin.x, inverse_direction.x);
        let y = axis(self.low.y, self.high.y, origin.y, inverse_direction.y);
        let z = axis(self.low.z, self.high.z, origin.z, inverse_direction.z);
        (x.0.max(y.0).max(z.0), x.1.min(y.1).min(z.1))
    }

    /// The children by lane, and the lanes in use as bits.
    #[inline(always)]
    pub fn children(&self) -> ([u32; LANES], u32) {
        (self.children, self.used)
    }
}

/// A box in f32.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub low: [f32; 3],
    pub high: [f32; 3],
}

impl Bounds {
    fn joined(self, other: Self) -> Self {
        let mut joined = self;
        for axis in 0..3 {
            joined.low[axis] = self.low[axis].min(other.low[axis]);
            joined.high[axis] = self.high[axis].max(other.high[axis]);
        }
        joined
    }

    /// The box around points that lie four by four in lanes.
    #[inline(always)]
    pub fn around<'a>(points: impl Iterator<Item = &'a Lanes>) -> Self {
        let (mut low, mut high) = ([Vec4::INFINITY; 3], [Vec4::NEG_INFINITY; 3]);
        for four in points {
            for (axis, coordinates) in [four.x, four.y, four.z].into_iter().enumerate() {
                low[axis] = low[axis].min(coordinates);
                high[axis] = high[axis].max(coordinates);
            }
        }
        Self { low: low.map(Vec4::min_element), high: high.map(Vec4::max_element) }
    }
}

/// A primitive while it is being sorted: its centre and its index.
#[derive(Debug, Clone, Copy)]
struct Centre {
    /// In steps of 2⁻³⁰ units of the frame, as integers are compared sooner.
    position: [i32; 3],
    index: u32,
}

impl Centre {
    /// What decides the order along an axis. Equal centres are told apart by index, so that the order never hangs on the
    /// thread count.
    #[inline(always)]
    fn key(&self, axis: usize) -> i64 {
        i64::from(self.position[axis]) << 32 | i64::from(self.index)
    }
}

/// The order of primitives in which each run of four is one packet and each run of sixteen one group.
pub(super) fn packet_order(centres: impl Iterator<Item = DVec3>) -> Vec<u32> {
    const STEPS: f64 = (1 << 30) as f64;
    let mut centres: Vec<Centre> = centres
        .enumerate()
        .map(|(index, centre)| Centre {
            position: (centre * STEPS).as_ivec3().to_array(),
            index: index as u32,
        })
        .collect();
    split(&mut centres);
    centres.iter().map(|centre| centre.index).collect()
}

/// The larger half, which decides the split of primitives and of nodes alike.
fn left_half(count: usize) -> usize {
    count.div_ceil(2)
}

fn split(centres: &mut [Centre]) {
    if centres.len() <= LANES {
        return;
    }
    let axis = widest_axis(centres);
    let unit = if centres.len() > GROUP { GROUP } else { LANES };
    let middle = left_half(centres.len().div_ceil(unit)) * unit;
    centres.select_nth_unstable_by_key(middle, |centre| centre.key(axis));
    let (left, right) = centres.split_at_mut(middle);
    if left.len() >= PARALLEL_FROM {
        rayon::join(|| split(left), || split(right));
    } else {
        split(left);
        split(right);
    }
}

fn widest_axis(centres: &[Centre]) -> usize {
    let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
    for centre in centres {
        for axis in 0..3 {
            low[axis] = low[axis].min(centre.position[axis]);
            high[axis] = high[axis].max(centre.position[axis]);
        }
    }
    let width = |axis: usize| i64::from(high[axis]) - i64::from(low[axis]);
    (0..3).fold(0, |widest, axis| if width(axis) > width(widest) { axis } else { widest })
}

/// The nodes over groups with these boxes, parents first; node 0 is the root.
pub(super) fn nodes_over(groups: &[Bounds]) -> Vec<Node> {
    let mut nodes = Vec::with_capacity(groups.len() / 2 + 1);
    add_node(&mut nodes, groups, 0);
    nodes
}

fn add_node(nodes: &mut Vec<Node>, groups: &[Bounds], first_group: usize) -> (u32, Bounds) {
    let place = nodes.len();
    let empty = Lanes::splat(DVec3::ZERO);
    nodes.push(Node { low: empty, high: empty, children: [0; LANES], used: 0 });
    let mut ranges = [(0, 0); LANES];
    let half = left_half(groups.len());
    let (quarter, last_quarter) = (left_half(half), half + left_half(groups.len() - half));
    for (range, ends) in ranges.iter_mut().zip([
        (0, quarter),
        (quarter, half),
        (half, last_quarter),
        (last_quarter, groups.len()),
    ]) {
        *range = ends;
    }
    let (mut low, mut high) = ([[0.0f32; LANES]; 3], [[0.0f32; LANES]; 3]);
    let (mut children, mut used) = ([0; LANES], 0);
    let mut whole: Option<Bounds> = None;
    for (lane, (start, end)) in ranges.into_iter().filter(|(start, end)| start < end).enumerate() {
        let (child, bounds) = if end - start == 1 {
            (Part::Group((first_group + start) as u32).code(), groups[start])
        } else {
            add_node(nodes, &groups[start..end], first_group + start)
        };
        children[lane] = child;
        used |= 1 << lane;
        for axis in 0..3 {
            low[axis][lane] = bounds.low[axis];
            high[axis][lane] = bounds.high[axis];
        }
        whole = Some(whole.map_or(bounds, |whole| whole.joined(bounds)));
    }
    let lanes = |axes: [[f32; LANES]; 3]| {
        let [x, y, z] = axes.map(Vec4::from_array);
        Lanes { x, y, z }
    };
    nodes[place] = Node { low: lanes(low), high: lanes(high), children, used };
    (place as u32, whole.unwrap_or(groups[0]))
}
