//! Laws of the identity's moments.

use super::*;

/// Σ w q qᵀ in the order of the moments.
fn moments(directions: &[DVec3]) -> [f64; 6] {
    let mut moments = ShapeMoments::new(1);
    for q in directions {
        moments.add(0, 2.0, 0.0, *q);
    }
    moments.second[0]
}

#[test]
fn factors_of_full_and_of_singular_moments_multiply_to_them() {
    let (a, b, c) = (DVec3::new(0.3, -0.7, 0.2), DVec3::new(0.1, 0.5, 0.9), DVec3::new(-0.4, 0.2, 0.1));
    let along_axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| vec![axis]);
    let nearly_flat = vec![a, a + DVec3::new(1e-9, 0.0, 1e-9)];
    let all =
        [vec![a], vec![a, b], vec![a, b, c], nearly_flat, vec![DVec3::new(1e-12, 0.6, -0.8)], Vec::new()];
    for directions in all.into_iter().chain(along_axes) {
        let m = moments(&directions);
        let [l00, l10, l11, l20, l21, l22] = lower_factor(&m);
        let product = [
            l00 * l00,
            l00 * l10,
            l00 * l20,
            l10 * l10 + l11 * l11,
            l10 * l20 + l11 * l21,
            l20 * l20 + l21 * l21 + l22 * l22,
        ];
        // A pivot below 1e-14 of the trace counts as zero.
        let slack = 1e-13 * (m[0] + m[3] + m[5]);
        for (found, expected) in product.iter().zip(&m) {
            assert!((found - expected).abs() <= slack, "{directions:?}: {product:?} for {m:?}");
        }
    }
}

#[test]
fn moments_of_two_parts_merge_to_those_of_the_whole() {
    let (a, b) = (DVec3::new(0.3, -0.7, 0.2), DVec3::new(0.1, 0.5, 0.9));
    let (mut whole, mut one, mut other) = (ShapeMoments::new(2), ShapeMoments::new(2), ShapeMoments::new(2));
    whole.add(0, 1.0, 0.5, a);
    whole.add(1, 2.0, -0.5, b);
    one.add(0, 1.0, 0.5, a);
    other.add(1, 2.0, -0.5, b);
    one.merge(&other);
    assert_eq!((one.second, one.first), (whole.second, whole.first));
}
