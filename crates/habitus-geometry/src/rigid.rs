//! Rotation and translation, and the best such motion between two point sets.

use glam::{DMat3, DVec3};
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// A rotation followed by a translation: `target = rotation · source + translation`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RigidTransform {
    /// A proper rotation (determinant +1).
    pub rotation: DMat3,
    /// The translation in metres, after the rotation.
    pub translation: DVec3,
}

impl RigidTransform {
    /// The transform that moves nothing.
    pub const IDENTITY: Self = Self { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };

    /// The moved point.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// The transform that undoes this one.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// The transform that applies `first` and then `self`.
    pub fn compose(&self, first: &Self) -> Self {
        Self { rotation: self.rotation * first.rotation, translation: self.apply(first.translation) }
    }
}

/// The rigid motion of `source` onto `target` with the least sum of squares (Arun et al. 1987, with Umeyama's sign);
/// `None` without three points that leave the rotation determined.
pub fn procrustes(source: &[DVec3], target: &[DVec3]) -> Option<RigidTransform> {
    if source.len() != target.len() || source.len() < 3 {
        return None;
    }
    let (source_mean, target_mean) = (mean(source), mean(target));
    let mut covariance = Matrix3::<f64>::zeros();
    for (from, to) in source.iter().zip(target) {
        let (from, to) = ((*from - source_mean).to_array(), (*to - target_mean).to_array());
        for (row, to) in to.iter().enumerate() {
            for (column, from) in from.iter().enumerate() {
                covariance[(row, column)] += to * from;
            }
        }
    }
    let rotation = rotation_of(&covariance)?;
    Some(RigidTransform { rotation, translation: target_mean - rotation * source_mean })
}

/// The rotation that turns source directions best onto target directions, from `Σ target · sourceᵀ` (Umeyama 1991); `None`
/// if it leaves a turn free.
pub fn best_rotation(covariance: &DMat3) -> Option<DMat3> {
    rotation_of(&Matrix3::from_column_slice(&covariance.to_cols_array()))
}

fn rotation_of(covariance: &Matrix3<f64>) -> Option<DMat3> {
    if !covariance.iter().all(|value| value.is_finite()) {
        return None;
    }
    let svd = covariance.try_svd(true, true, f64::EPSILON, 0)?;
    let (mut u, v_transposed) = (svd.u?, svd.v_t?);
    // The singular values come unordered; on a line or in a point the second largest is nothing and the turn about it free.
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| svd.singular_values[j].total_cmp(&svd.singular_values[i]));
    if svd.singular_values[order[1]] <= 1e-12 * svd.singular_values[order[0]] {
        return None;
    }
    if (u * v_transposed).determinant() < 0.0 {
        u.column_mut(order[2]).neg_mut();
    }
    Some(DMat3::from_cols_slice((u * v_transposed).as_slice()))
}

fn mean(points: &[DVec3]) -> DVec3 {
    points.iter().sum::<DVec3>() / points.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn motion() -> RigidTransform {
        RigidTransform {
            rotation: DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -2.1, 1.4)),
            translation: DVec3::new(0.2, -5.0, 3.0),
        }
    }

    fn points() -> Vec<DVec3> {
        (0..20)
            .map(|i| DVec3::new((i as f64).sin(), (i as f64 * 1.7).cos(), (i as f64 * 0.3).sin()))
            .collect()
    }

    #[test]
    fn a_known_motion_is_recovered() {
        let moved: Vec<_> = points().iter().map(|p| motion().apply(*p)).collect();
        let found = procrustes(&points(), &moved).unwrap();
        for point in points() {
            assert!(found.apply(point).distance(motion().apply(point)) < 1e-12);
        }
    }

    #[test]
    fn planar_points_and_mirrored_points_give_a_proper_rotation() {
        let flat: Vec<_> = points().iter().map(|p| DVec3::new(p.x, p.y, 0.0)).collect();
        let moved: Vec<_> = flat.iter().map(|p| motion().apply(*p)).collect();
        let found = procrustes(&flat, &moved).unwrap();
        assert!((found.rotation.determinant() - 1.0).abs() < 1e-12);
        assert!(found.apply(flat[3]).distance(moved[3]) < 1e-12);
        let mirrored: Vec<_> = points().iter().map(|p| *p * DVec3::new(-1.0, 1.0, 1.0)).collect();
        assert!((procrustes(&points(), &mirrored).unwrap().rotation.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn points_that_leave_the_rotation_free_are_refused() {
        assert!(procrustes(&points()[..2], &points()[..2]).is_none());
        assert!(procrustes(&[DVec3::ONE; 5], &[DVec3::ONE; 5]).is_none());
        let line: Vec<_> = (0..9).map(|i| DVec3::X * i as f64).collect();
        assert!(procrustes(&line, &line).is_none());
        assert!(procrustes(&[DVec3::NAN; 5], &[DVec3::ONE; 5]).is_none());
    }

    #[test]
    fn inverse_and_composition_cancel() {
        let nothing = motion().compose(&motion().inverse());
        assert!((nothing.rotation - DMat3::IDENTITY).abs_diff_eq(DMat3::ZERO, 1e-14));
        assert!(nothing.translation.length() < 1e-14);
    }
}
