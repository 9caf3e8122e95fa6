//! Laws of the skeleton: identity at rest, rigid roots, twists that are the derivatives.

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec3};

use super::{Axis, Bone, Pose, Skeleton, SkeletonError, left_jacobian, rotation_vector};
use crate::body::fixture;

/// A pose with every parameter away from zero.
fn bent_pose(length: usize) -> Vec<f64> {
    (0..length).map(|k| 0.7 * (1.3 * k as f64 + 0.4).sin()).collect()
}

#[test]
fn the_rest_pose_moves_nothing() {
    let model = fixture::model();
    let rest = model.rest_vertices(&[0.4, -1.0]);
    let posed = model.skeleton().pose(&model.joints(&rest), model.skeleton().rest_pose().parameters());
    for (vertex, moved) in rest.iter().zip(model.pose_vertices(&rest, &posed)) {
        assert!(vertex.distance(moved) < 1e-14);
    }
}

#[test]
fn the_root_moves_the_body_rigidly_about_the_pelvis_joint() {
    let model = fixture::model();
    let skeleton = model.skeleton();
    let rest = model.rest_vertices(&[]);
    let joints = model.joints(&rest);
    let mut pose = Pose::new(skeleton, bent_pose(skeleton.pose_length())).unwrap();
    pose.set_root(DQuat::IDENTITY, DVec3::ZERO);
    let still = model.pose_vertices(&rest, &skeleton.pose(&joints, pose.parameters()));
    let (rotation, translation) =
        (DQuat::from_scaled_axis(DVec3::new(0.3, -2.0, 0.9)), DVec3::new(1.0, -0.2, 3.0));
    pose.set_root(rotation, translation);
    let moved = model.pose_vertices(&rest, &skeleton.pose(&joints, pose.parameters()));
    for (before, after) in still.iter().zip(&moved) {
        let expected = rotation * (*before - joints[0]) + joints[0] + translation;
        assert!(expected.distance(*after) < 1e-12);
    }
}

#[test]
fn each_bone_keeps_its_length_in_any_pose() {
    let model = fixture::model();
    let skeleton = model.skeleton();
    let joints = model.joints(model.mean_vertices());
    let posed = skeleton.pose(&joints, &bent_pose(skeleton.pose_length()));
    for (index, bone) in skeleton.bones().iter().enumerate().skip(1) {
        let parent = bone.parent.unwrap();
        let before = joints[index].distance(joints[parent]);
        assert!((posed.joints[index].distance(posed.joints[parent]) - before).abs() < 1e-12);
        let carried = posed.rotations[index] * joints[index] + posed.translations[index];
        assert!(carried.distance(posed.joints[index]) < 1e-12);
    }
}

#[test]
fn twists_are_the_derivatives_of_rigid_points_for_every_parameter() {
    let model = fixture::model();
    let skeleton = model.skeleton();
    let joints = model.joints(model.mean_vertices());
    let step = 1e-5;
    for (start, scale) in [(0.0, 1.0), (1.0, 0.2), (2.0, 0.0)] {
        let pose: Vec<f64> =
            bent_pose(skeleton.pose_length()).iter().map(|value| scale * (value + start)).collect();
        let posed = skeleton.pose(&joints, &pose);
        for parameter in 0..pose.len() {
            let at = |delta: f64| {
                let mut changed = pose.clone();
                changed[parameter] += delta;
                skeleton.pose(&joints, &changed)
            };
            let (ahead, behind) = (at(step), at(-step));
            for (bone, joint) in joints.iter().enumerate() {
                let point = *joint + DVec3::new(0.1, -0.2, 0.15);
                let place = |skeleton: &super::PosedSkeleton| {
                    skeleton.rotations[bone] * point + skeleton.translations[bone]
                };
                let difference = (place(&ahead) - place(&behind)) / (2.0 * step);
                let is_moved = skeleton.chain(bone).contains(&parameter);
                let expected = if is_moved { posed.twists[parameter].at(place(&posed)) } else { DVec3::ZERO };
                assert!(
                    difference.distance(expected) < 1e-6,
                    "bone {bone}, parameter {parameter}: {difference} against {expected}"
                );
            }
        }
    }
}

#[test]
fn the_left_jacobian_is_right_at_zero_near_zero_and_near_pi() {
    let direction = DVec3::new(0.48, -0.6, 0.64);
    for angle in [0.0, 1e-9, 1e-5, 0.99e-4, 1.01e-4, 1e-2, 1.0, PI - 1e-6, PI, PI + 1e-3, 5.0] {
        let r = direction * angle;
        let jacobian = left_jacobian(r);
        let inverse = DQuat::from_scaled_axis(r).inverse();
        let step = 1e-5;
        for (column, axis) in DVec3::AXES.into_iter().enumerate() {
            // exp(r + h e) exp(r)⁻¹ = exp(h J e) to second order, which the central difference cancels.
            let turned = |h: f64| rotation_vector(DQuat::from_scaled_axis(r + axis * h) * inverse);
            let difference = (turned(step) - turned(-step)) / (2.0 * step);
            assert!(difference.distance(jacobian.col(column)) < 1e-8, "angle {angle}, column {column}");
        }
    }
}

#[test]
fn rotation_vectors_are_the_shortest_and_survive_a_round_trip() {
    for r in [DVec3::ZERO, DVec3::X * 1e-9, DVec3::new(0.1, 0.2, -0.3), DVec3::new(-1.0, 2.0, 2.0)] {
        let back = rotation_vector(DQuat::from_scaled_axis(r));
        assert!(back.distance(r) < 1e-12, "{r} became {back}");
    }
    let long = DVec3::Y * (PI + 0.5);
    assert!(rotation_vector(DQuat::from_scaled_axis(long)).distance(DVec3::Y * (0.5 - PI)) < 1e-12);
}

#[test]
fn axes_of_one_bone_turn_in_their_order() {
    let model = fixture::model();
    let skeleton = model.skeleton();
    let joints = model.joints(model.mean_vertices());
    let mut pose = skeleton.rest_pose();
    pose.parameters_mut()[6..9].copy_from_slice(&[0.3, -0.4, 0.5]);
    let posed = skeleton.pose(&joints, pose.parameters());
    let axes = &skeleton.axes()[..3];
    let expected = DMat3::from_axis_angle(axes[0].direction, 0.3)
        * DMat3::from_axis_angle(axes[1].direction, -0.4)
        * DMat3::from_axis_angle(axes[2].direction, 0.5);
    assert!((posed.rotations[1] - expected).abs_diff_eq(DMat3::ZERO, 1e-14));
}

#[test]
fn a_skeleton_with_children_before_parents_is_refused() {
    let bone = |name: &str, parent| Bone { name: name.into(), parent };
    let refused = Skeleton::new(vec![bone("root", None), bone("arm", Some(1))], Vec::new());
    assert_eq!(refused, Err(SkeletonError::ParentOrder { bone: 1, parent: 1 }));
    let rootless = Skeleton::new(vec![bone("root", Some(0))], Vec::new());
    assert_eq!(rootless, Err(SkeletonError::ParentOrder { bone: 0, parent: 0 }));
    let two_roots = Skeleton::new(vec![bone("root", None), bone("other", None)], Vec::new());
    assert_eq!(two_roots, Err(SkeletonError::ParentOrder { bone: 1, parent: -1 }));
    assert_eq!(Skeleton::new(Vec::new(), Vec::new()), Err(SkeletonError::NoRoot));
}

#[test]
fn unusable_axes_are_refused() {
    let bones = || {
        let bone = |name: &str, parent| Bone { name: name.into(), parent };
        vec![bone("root", None), bone("arm", Some(0)), bone("hand", Some(1))]
    };
    let axis = |bone, direction, limits| Axis { name: "axis".into(), bone, direction, limits };
    let good = || axis(1, DVec3::X * 3.0, [-1.0, 1.0]);
    assert!((Skeleton::new(bones(), vec![good()]).unwrap().axes()[0].direction - DVec3::X).length() < 1e-15);
    for (bad, place) in [
        (vec![axis(0, DVec3::X, [-1.0, 1.0])], 0),
        (vec![axis(3, DVec3::X, [-1.0, 1.0])], 0),
        (vec![axis(1, DVec3::ZERO, [-1.0, 1.0])], 0),
        (vec![axis(1, DVec3::NAN, [-1.0, 1.0])], 0),
        (vec![good(), axis(1, DVec3::X, [1.0, 1.0])], 1),
        (vec![good(), axis(1, DVec3::X, [f64::NAN, 1.0])], 1),
        (vec![axis(2, DVec3::X, [-1.0, 1.0]), good()], 1),
    ] {
        match Skeleton::new(bones(), bad) {
            Err(SkeletonError::BadAxis { axis, .. }) => assert_eq!(axis, place),
            other => panic!("should be refused: {other:?}"),
        }
    }
}

#[test]
fn a_pose_of_another_length_is_refused() {
    let model = fixture::model();
    assert!(Pose::new(model.skeleton(), vec![0.0; 29]).is_none());
    assert!(Pose::new(model.skeleton(), vec![0.0; 30]).is_some());
    let (lower, upper) = model.skeleton().pose_limits();
    assert!(lower.len() == 30 && upper.len() == 30);
    assert!(lower[..6].iter().all(|limit| *limit == f64::NEG_INFINITY) && upper[6] == 2.5);
}
