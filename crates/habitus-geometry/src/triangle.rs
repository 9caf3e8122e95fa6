//! The closest point of one triangle, exact in f64, with the feature on which it lies.

use glam::DVec3;

/// Where on a triangle a point lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Feature {
    /// Strictly inside.
    Face,
    /// On the edge from this corner to the next one.
    Edge(u8),
    /// On this corner.
    Corner(u8),
}

/// The closest point of a triangle, by its barycentric coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ClosestOnTriangle {
    pub position: DVec3,
    pub barycentric: [f64; 3],
    pub feature: Feature,
    pub distance_squared: f64,
}

/// The nearest of the three edges, or the foot on the plane where that lies inside. Slower than a walk through the
/// Voronoi regions of the corners, but right for slivers, whose regions drown in rounding.
pub(crate) fn closest_on_triangle(point: DVec3, [a, b, c]: [DVec3; 3]) -> ClosestOnTriangle {
    let (ab, bc, ca) = (b - a, c - b, a - c);
    let (ap, bp, cp) = (point - a, point - b, point - c);
    let normal = ab.cross(-ca);
    let (over_a, over_b, over_c) =
        (normal.dot(bc.cross(bp)), normal.dot(ca.cross(cp)), normal.dot(ab.cross(ap)));
    let whole = over_a + over_b + over_c;
    if over_a > 0.0 && over_b > 0.0 && over_c > 0.0 {
        let (v, w) = (over_b / whole, over_c / whole);
        return at(point, a + ab * v - ca * w, [1.0 - v - w, v, w], Feature::Face);
    }
    let (on_ab, on_bc, on_ca) = (share_along(ab, ap), share_along(bc, bp), share_along(ca, cp));
    let edges = [(0, a + ab * on_ab, on_ab), (1, b + bc * on_bc, on_bc), (2, c + ca * on_ca, on_ca)];
    let mut nearest = edges[0];
    for edge in &edges[1..] {
        if point.distance_squared(edge.1) < point.distance_squared(nearest.1) {
            nearest = *edge;
        }
    }
    let (edge, position, share) = nearest;
    let next = (edge + 1) % 3;
    let mut barycentric = [0.0; 3];
    barycentric[edge] = 1.0 - share;
    barycentric[next] = share;
    if share <= 0.0 {
        at(point, [a, b, c][edge], barycentric, Feature::Corner(edge as u8))
    } else if share >= 1.0 {
        at(point, [a, b, c][next], barycentric, Feature::Corner(next as u8))
    } else {
        at(point, position, barycentric, Feature::Edge(edge as u8))
    }
}

/// How far along an edge the foot of an offset from its start lies, from 0 to 1.
fn share_along(edge: DVec3, offset: DVec3) -> f64 {
    let length_squared = edge.length_squared();
    if length_squared > 0.0 { (edge.dot(offset) / length_squared).clamp(0.0, 1.0) } else { 0.0 }
}

fn at(point: DVec3, position: DVec3, barycentric: [f64; 3], feature: Feature) -> ClosestOnTriangle {
    ClosestOnTriangle { position, barycentric, feature, distance_squared: point.distance_squared(position) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [DVec3; 3] = [DVec3::ZERO, DVec3::new(2.0, 0.0, 0.0), DVec3::new(0.0, 2.0, 0.0)];

    #[test]
    fn every_region_gives_its_own_feature() {
        let cases = [
            (DVec3::new(0.5, 0.5, 3.0), Feature::Face, DVec3::new(0.5, 0.5, 0.0)),
            (DVec3::new(-1.0, -1.0, 1.0), Feature::Corner(0), DVec3::ZERO),
            (DVec3::new(4.0, -1.0, 0.0), Feature::Corner(1), CORNERS[1]),
            (DVec3::new(-1.0, 4.0, 0.0), Feature::Corner(2), CORNERS[2]),
            (DVec3::new(1.0, -3.0, 0.5), Feature::Edge(0), DVec3::X),
            (DVec3::new(3.0, 3.0, 0.0), Feature::Edge(1), DVec3::new(1.0, 1.0, 0.0)),
            (DVec3::new(-2.0, 1.0, 0.0), Feature::Edge(2), DVec3::Y),
        ];
        for (point, feature, position) in cases {
            let closest = closest_on_triangle(point, CORNERS);
            assert_eq!(closest.feature, feature);
            assert!(closest.position.distance(position) < 1e-15);
            let [u, v, w] = closest.barycentric;
            assert!((CORNERS[0] * u + CORNERS[1] * v + CORNERS[2] * w).distance(position) < 1e-15);
        }
    }
}
