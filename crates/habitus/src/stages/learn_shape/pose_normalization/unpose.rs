//! Undoing the skinning: the base model's pose is fitted to a registration, and each vertex is moved back by the inverse of
//! its blended transform. What the model's identity space cannot express stays in the vertices.

use glam::{DMat3, DVec3};

use super::super::config::UnposeConfig;
use crate::body::{BodyModel, PosedSkeleton};
use crate::fitting::same_topology::SameTopologyFit;

/// The rest body of `vertices`, which were found to be in the pose of `fit`.
pub(super) fn unposed(
    base: &BodyModel,
    vertices: &[DVec3],
    fit: &SameTopologyFit,
    config: &UnposeConfig,
) -> Vec<DVec3> {
    let mut joints = base.surface().rest_joints(&fit.identity);
    let mut pose = fit.pose.clone();
    let mut rest = Vec::new();
    for round in 0..=config.joint_rounds {
        let posed = base.skeleton().pose(&joints, &pose);
        let transforms = rest_transforms(base, &posed, config.smallest_determinant);
        rest =
            vertices.iter().zip(&transforms).map(|(vertex, transform)| undone(transform, *vertex)).collect();
        if round < config.joint_rounds {
            let own = base.joints(&rest);
            // The root's posed joint stays where it is.
            let shift = joints[0] - own[0];
            for (parameter, value) in pose.iter_mut().zip(shift.to_array()) {
                *parameter += value;
            }
            joints = own;
        }
    }
    rest
}

/// For each vertex the inverse of its blended rotation and its blended translation (P3 Eq. 3).
pub(in super::super) fn rest_transforms(
    base: &BodyModel,
    posed: &PosedSkeleton,
    smallest_determinant: f64,
) -> Vec<(DMat3, DVec3)> {
    let skin = base.surface().skin();
    (0..base.vertex_count())
        .map(|vertex| {
            let (mut linear, mut translation, mut main) = (DMat3::ZERO, DVec3::ZERO, (0, 0.0));
            for (bone, weight) in skin.of(vertex) {
                linear += posed.rotations[bone] * weight;
                translation += posed.translations[bone] * weight;
                if weight > main.1 {
                    main = (bone, weight);
                }
            }
            if linear.determinant() >= smallest_determinant {
                return (linear.inverse(), translation);
            }
            (posed.rotations[main.0].transpose(), posed.translations[main.0])
        })
        .collect()
}

/// The rest place of a posed vertex.
pub(in super::super) fn undone((inverse, translation): &(DMat3, DVec3), vertex: DVec3) -> DVec3 {
    *inverse * (vertex - *translation)
}
