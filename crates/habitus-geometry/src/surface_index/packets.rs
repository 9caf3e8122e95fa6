//! Four triangles or points side by side in f32, for lower bounds that spare the exact f64 test.
//!
//! A bound may be too low, never too high by more than the query's slack: every rounding below is relative to
//! lengths no larger than the surface's radius plus the query's distance from its centre.

use glam::{DVec3, Vec4};

/// How many primitives one packet holds.
pub(super) const LANES: usize = 4;

/// Three coordinates of four points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lanes {
    pub x: Vec4,
    pub y: Vec4,
    pub z: Vec4,
}

impl Lanes {
    #[inline(always)]
    pub fn gather([a, b, c, d]: [DVec3; LANES]) -> Self {
        Self {
            x: Vec4::new(a.x as f32, b.x as f32, c.x as f32, d.x as f32),
            y: Vec4::new(a.y as f32, b.y as f32, c.y as f32, d.y as f32),
            z: Vec4::new(a.z as f32, b.z as f32, c.z as f32, d.z as f32),
        }
    }

    pub fn splat(point: DVec3) -> Self {
        Self::gather([point; LANES])
    }

    #[inline(always)]
    pub fn minus(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }

    #[inline(always)]
    pub fn dot(self, other: Self) -> Vec4 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    #[inline(always)]
    fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    /// Squared distance from the tip of `self` to the segment from the origin to the tip of `edge`.
    #[inline(always)]
    fn distance_squared_to_segment(self, edge: Self) -> Vec4 {
        // The floor keeps an edge without length from dividing nothing by nothing.
        let along = self.dot(edge) / edge.dot(edge).max(Vec4::splat(f32::MIN_POSITIVE));
        let along = along.max(Vec4::ZERO).min(Vec4::ONE);
        let rest =
            Self { x: self.x - edge.x * along, y: self.y - edge.y * along, z: self.z - edge.z * along };
        rest.dot(rest)
    }
}

/// Four triangles about the surface's centre, with their unit normals and longest edges.
#[derive(Debug, Clone, Copy)]
pub(super) struct TrianglePacket {
    pub corners: [Lanes; 3],
    normal: Lanes,
    reach: Vec4,
}

impl TrianglePacket {
    pub fn new([t, u, v, w]: &[[DVec3; 3]; LANES]) -> Self {
        let corner = |corner: usize| Lanes::gather([t[corner], u[corner], v[corner], w[corner]]);
        let [t, u, v, w] =
            [normal_and_reach(t), normal_and_reach(u), normal_and_reach(v), normal_and_reach(w)];
        Self {
            corners: [corner(0), corner(1), corner(2)],
            normal: Lanes::gather([t.0, u.0, v.0, w.0]),
            reach: Vec4::new(t.1, u.1, v.1, w.1),
        }
    }

    /// Lower bounds on the squared distances, up to the slack: to the three edges, and to the plane where the
    /// point may lie over the face.
    #[inline(always)]
    pub fn distance_squared_bounds(&self, point: Lanes, slack: f32) -> Vec4 {
        let [a, b, c] = self.corners;
        let (ab, bc, ca) = (b.minus(a), c.minus(b), a.minus(c));
        let (from_a, from_b, from_c) = (point.minus(a), point.minus(b), point.minus(c));
        let to_edges = from_a
            .distance_squared_to_segment(ab)
            .min(from_b.distance_squared_to_segment(bc))
            .min(from_c.distance_squared_to_segment(ca));
        let height = self.normal.dot(from_a);
        let inwards = self
            .normal
            .dot(ab.cross(from_a))
            .min(self.normal.dot(bc.cross(from_b)))
            .min(self.normal.dot(ca.cross(from_c)));
        let may_be_over_face = inwards.cmpge(self.reach * -slack);
        Vec4::select(may_be_over_face, to_edges.min(height * height), to_edges)
    }
}

/// The unit normal of a triangle and its longest edge. They belong to the corners as they are rounded for the packet, or a
/// sliver would be bounded against another plane than its own.
#[inline(always)]
fn normal_and_reach(triangle: &[DVec3; 3]) -> (DVec3, f32) {
    let rounded = |corner: usize| triangle[corner].as_vec3().as_dvec3();
    let (a, b, c) = (rounded(0), rounded(1), rounded(2));
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
    (normal, longest.sqrt() as f32)
}

/// Four points about the surface's centre.
#[derive(Debug, Clone, Copy)]
pub(super) struct PointPacket {
    pub points: Lanes,
}

impl PointPacket {
    #[inline(always)]
    pub fn distance_squared_bounds(&self, point: Lanes) -> Vec4 {
        let offset = point.minus(self.points);
        offset.dot(offset)
    }
}

/// Four boxes, each turned to lie flat on the triangles of one packet. A box along the axes stands out of a slanted
/// surface by half its width, which is why so many of them are near a point that is near the surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct FlatBoxes {
    axes: [Lanes; 3],
    /// The boxes' centres and half-widths along their own axes.
    centre: Lanes,
    half: Lanes,
}

impl FlatBoxes {
    /// Boxes around the triangles of four packets, given about the surface's centre.
    pub fn around(packets: &[[[DVec3; 3]; LANES]; LANES]) -> Self {
        let [a, b, c, d] = packets;
        let [a, b, c, d] = [FlatBox::around(a), FlatBox::around(b), FlatBox::around(c), FlatBox::around(d)];
        let axis = |axis: usize| Lanes::gather([a.axes[axis], b.axes[axis], c.axes[axis], d.axes[axis]]);
        Self {
            axes: [axis(0), axis(1), axis(2)],
            centre: Lanes::gather([a.centre, b.centre, c.centre, d.centre]),
            half: Lanes::gather([a.half, b.half, c.half, d.half]),
        }
    }

    /// Squared distances to the four boxes.
    #[inline(always)]
    pub fn distances_squared(&self, point: Lanes) -> Vec4 {
        let outside =
            |axis: Lanes, centre: Vec4, half: Vec4| ((axis.dot(point) - centre).abs() - half).max(Vec4::ZERO);
        let outside = Lanes {
            x: outside(self.axes[0], self.centre.x, self.half.x),
            y: outside(self.axes[1], self.centre.y, self.half.y),
            z: outside(self.axes[2], self.centre.z, self.half.z),
        };
        outside.dot(outside)
    }

    /// Where a ray enters and leaves the four boxes after these grew by the slack.
    #[inline(always)]
    pub fn slab_interval(&self, origin: Lanes, direction: Lanes, slack: f32) -> (Vec4, Vec4) {
        let slab = |axis: Lanes, centre: Vec4, half: Vec4| {
            let from = axis.dot(origin) - centre;
            let along = axis.dot(direction);
            // A direction in the box's own plane would divide by nothing.
            let flattest = Vec4::splat(1e-18);
            let inverse = Vec4::select(along.abs().cmplt(flattest), flattest, along).recip();
            let grown = half + slack;
            let (first, second) = ((-grown - from) * inverse, (grown - from) * inverse);
            (first.min(second), first.max(second))
        };
        let x = slab(self.axes[0], self.centre.x, self.half.x);
        let y = slab(self.axes[1], self.centre.y, self.half.y);
        let z = slab(self.axes[2], self.centre.z, self.half.z);
        (x.0.max(y.0).max(z.0), x.1.min(y.1).min(z.1))
    }
}

#[derive(Clone, Copy)]
struct FlatBox {
    axes: [DVec3; 3],
    centre: DVec3,
    half: DVec3,
}

impl FlatBox {
    #[inline(always)]
    fn around(triangles: &[[DVec3; 3]; LANES]) -> Self {
        let mut area_vector = DVec3::ZERO;
        for [a, b, c] in triangles {
            area_vector += (*b - *a).cross(*c - *a);
        }
        let up = area_vector.try_normalize().unwrap_or(DVec3::Z);
        let [a, b, _] = triangles[0];
        let along = (b - a).reject_from_normalized(up).try_normalize().unwrap_or(up.any_orthonormal_vector());
        // Rounded first, so that the extents belong to the axes that the search will use.
        let rounded = |axis: DVec3| axis.as_vec3().as_dvec3();
        let axes = [rounded(along), rounded(up.cross(along)), rounded(up)];
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corners in triangles {
            for corner in corners {
                let on_axes = DVec3::new(axes[0].dot(*corner), axes[1].dot(*corner), axes[2].dot(*corner));
                low = low.min(on_axes);
                high = high.max(on_axes);
            }
        }
        Self { axes, centre: (low + high) * 0.5, half: (high - low) * 0.5 }
    }
}
