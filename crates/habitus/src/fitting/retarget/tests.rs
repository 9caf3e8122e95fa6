use glam::{DQuat, DVec3};
use habitus_optimize::assert_derivatives_match;

use super::*;
use crate::artifacts::motion_files::CapturedJoint;
use crate::body::ROOT_LENGTH;

/// A motion of the default body: it marches, turns and jumps, with bent elbows.
fn clip(model: &BodyModel) -> MotionClip {
    let index = |name: &str| {
        let axes = model.skeleton().axes();
        ROOT_LENGTH + axes.iter().position(|axis| axis.name == name).unwrap()
    };
    let body = RetargetBody::new(model, &model.rest_vertices(&[])).unwrap();
    let poses = (0..40).map(|frame| {
        let time = f64::from(frame) / 30.0;
        let step = (time * 6.0).sin();
        let mut pose = model.skeleton().rest_pose();
        let jump = (0.25 - (time - 1.0).powi(2) * 4.0).max(0.0);
        pose.set_root(
            DQuat::from_rotation_y(2.5 + 2.0 * time) * DQuat::from_rotation_x(0.1),
            DVec3::new(time, 0.0, 0.5 * time),
        );
        for (side, swing) in [("left", step), ("right", -step)] {
            let parameters = pose.parameters_mut();
            let (hip, knee) = (0.5 + 0.5 * swing, 0.8 + 0.4 * swing);
            parameters[index(&format!("{side}_hip_flexion"))] = hip;
            parameters[index(&format!("{side}_knee_flexion"))] = knee;
            // Level soles, as on a floor.
            parameters[index(&format!("{side}_ankle_flexion"))] = knee - hip + 0.1;
            parameters[index(&format!("{side}_shoulder_elevation"))] = -0.4 - 0.3 * swing;
            parameters[index(&format!("{side}_shoulder_swing"))] = 0.3;
            parameters[index(&format!("{side}_elbow_flexion"))] = 0.9;
        }
        pose.parameters_mut()[index("thorax_twist")] = 0.2 * step;
        let height = body.soles.lowest(&body, &pose);
        pose.parameters_mut()[1] += jump - height;
        pose
    });
    MotionClip { name: "march".into(), frame_rate: FrameRate::new(30.0).unwrap(), poses: poses.collect() }
}

/// Joints of the posed bones, with the toes and the ends of the hands, as a file would give them.
fn capture(clip: &MotionClip, body: &RetargetBody<'_>, unit: f64, turn: DQuat) -> JointMotion {
    let bones = body.model.skeleton().bones();
    let mut joints: Vec<CapturedJoint> =
        bones.iter().map(|bone| CapturedJoint { name: bone.name.clone(), parent: bone.parent }).collect();
    let ends: Vec<(usize, DVec3)> = ["left_foot", "right_foot", "left_hand", "right_hand", "head"]
        .iter()
        .map(|name| {
            let bone = bones.iter().position(|bone| bone.name == *name).unwrap();
            joints.push(CapturedJoint { name: format!("{name}_end"), parent: Some(bone) });
            (bone, body.limbs.end_of(bone))
        })
        .collect();
    let positions = clip.poses.iter().map(|pose| {
        let posed = body.model.skeleton().pose(&body.joints, pose.parameters());
        let ends = ends.iter().map(|(bone, rest)| posed.rotations[*bone] * *rest + posed.translations[*bone]);
        posed.joints.iter().copied().chain(ends).map(|place| turn * place * unit).collect()
    });
    JointMotion {
        name: clip.name.clone(),
        joints,
        frame_rate: clip.frame_rate,
        positions: positions.collect(),
    }
}

#[test]
fn directions_pass_the_derivative_check() {
    let model = BodyModel::default_space().unwrap();
    let body = RetargetBody::new(&model, &model.rest_vertices(&[])).unwrap();
    let clip = clip(&model);
    let captured = CapturedBody::of(&capture(&clip, &body, 1.0, DQuat::IDENTITY)).unwrap();
    let settings = RetargetSettings { rest: 0.1, smoothness: 0.2, ..RetargetSettings::default() };
    let floor = Floor::of(&captured, clip.frame_rate, &settings);
    let directions = body.limbs.directions(&captured, &floor, &settings);
    let fit = DirectionFit::new(&body, &directions[7], &clip.poses[3], &settings);
    assert_derivatives_match(&fit, clip.poses[20].parameters());
}

#[test]
fn a_motion_of_our_own_body_comes_back() {
    let model = BodyModel::default_space().unwrap();
    let body = RetargetBody::new(&model, &model.rest_vertices(&[])).unwrap();
    let clip = clip(&model);
    // Centimetres, z up, as some files are.
    let turn = DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
    let found = retarget(&capture(&clip, &body, 100.0, turn), &body, &RetargetSettings::default()).unwrap();
    let skeleton = model.skeleton();
    let limits = skeleton.pose_limits();
    let mut worst: f64 = 0.0;
    for (found, truth) in found.poses.iter().zip(&clip.poses) {
        let [a, b] = [found, truth].map(|pose| skeleton.pose(&body.joints, pose.parameters()));
        // The clip starts above the origin.
        let shift = b.joints[0] - a.joints[0];
        worst = a.joints.iter().zip(&b.joints).map(|(a, b)| (*a + shift).distance(*b)).fold(worst, f64::max);
        assert!(shift.y.abs() < 0.02, "the height is off by {} m", shift.y);
        let inside = found.parameters().iter().zip(limits.0.iter().zip(&limits.1));
        assert!(inside.into_iter().all(|(value, (low, high))| low <= value && value <= high));
    }
    // The pulls to rest and to the frame before cost some; a slip in an axis costs decimetres.
    assert!(worst < 0.03, "a joint is {worst} m off");
}

#[test]
fn another_body_takes_steps_as_long_as_its_legs() {
    let model = BodyModel::default_space().unwrap();
    let small = model.rest_vertices(&[]);
    let tall: Vec<DVec3> = small.iter().map(|place| *place * 1.2).collect();
    let [from, to] = [&small, &tall].map(|rest| RetargetBody::new(&model, rest).unwrap());
    let clip = clip(&model);
    let carried = carry_over(&clip, &from, &to);
    for (a, b) in clip.poses.iter().zip(&carried.poses) {
        assert_eq!(a.parameters()[ROOT_LENGTH..], b.parameters()[ROOT_LENGTH..]);
        let heights = [from.soles.lowest(&from, a), to.soles.lowest(&to, b)];
        assert!((heights[0] * 1.2 - heights[1]).abs() < 1e-9);
    }
    let way = |clip: &MotionClip| clip.poses[39].translation() - clip.poses[0].translation();
    let (short, long) = (way(&clip), way(&carried));
    assert!((long.x / short.x - 1.2).abs() < 1e-6 && (long.z / short.z - 1.2).abs() < 1e-6);
}
