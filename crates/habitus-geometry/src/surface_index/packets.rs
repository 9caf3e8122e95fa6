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
    pub fn gather(points: [DVec3; LANES]) -> Self {
        let lane = |axis: usize| Vec4::from_array(points.map(|point| point[axis] as f32));
        Self { x: lane(0), y: lane(1), z: lane(2) }
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
    pub fn new(triangles: [[DVec3; 3]; LANES]) -> Self {
        let corners = [0, 1, 2].map(|corner| Lanes::gather(triangles.map(|triangle| triangle[corner])));
        // The normal belongs to the rounded corners, or a sliver would be bounded against another plane than its own.
        let rounded = triangles.map(|triangle| triangle.map(|corner| corner.as_vec3().as_dvec3()));
        let normal = Lanes::gather(rounded.map(|[a, b, c]| (b - a).cross(c - a).normalize_or_zero()));
        let reach = Vec4::from_array(
            rounded.map(|[a, b, c]| a.distance(b).max(b.distance(c)).max(c.distance(a)) as f32),
        );
        Self { corners, normal, reach }
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
