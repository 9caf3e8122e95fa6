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

/// Ericson, Real-Time Collision Detection, §5.1.5: the Voronoi regions of the corners, then the edges, then the face.
pub(crate) fn closest_on_triangle(point: DVec3, [a, b, c]: [DVec3; 3]) -> ClosestOnTriangle {
    let (ab, ac, ap) = (b - a, c - a, point - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return at(point, a, [1.0, 0.0, 0.0], Feature::Corner(0));
    }
    let bp = point - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return at(point, b, [0.0, 1.0, 0.0], Feature::Corner(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = ratio(d1, d1 - d3);
        return at(point, a + ab * t, [1.0 - t, t, 0.0], Feature::Edge(0));
    }
    let cp = point - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return at(point, c, [0.0, 0.0, 1.0], Feature::Corner(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = ratio(d2, d2 - d6);
        return at(point, a + ac * t, [1.0 - t, 0.0, t], Feature::Edge(2));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let t = ratio(d4 - d3, (d4 - d3) + (d5 - d6));
        return at(point, b + (c - b) * t, [0.0, 1.0 - t, t], Feature::Edge(1));
    }
    let denominator = 1.0 / (va + vb + vc);
    let (v, w) = (vb * denominator, vc * denominator);
    at(point, a + ab * v + ac * w, [1.0 - v - w, v, w], Feature::Face)
}

fn at(point: DVec3, position: DVec3, barycentric: [f64; 3], feature: Feature) -> ClosestOnTriangle {
    ClosestOnTriangle { position, barycentric, feature, distance_squared: point.distance_squared(position) }
}

/// `part / whole`, and 0 on an edge without length.
fn ratio(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { part / whole } else { 0.0 }
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
