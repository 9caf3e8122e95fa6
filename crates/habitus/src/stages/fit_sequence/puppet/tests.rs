use glam::DMat3;
use habitus_geometry::{Surface, TriangleMesh};

use super::super::captured_frame::{FitFromInput, size_of};
use super::super::config::{FrameConfig, StartConfig};
use super::super::start_search::StartSearch;
use super::stitching::{seam_to_child, seam_to_parent};
use super::*;
use crate::body::{BodyModel, ROOT_LENGTH};

fn model() -> BodyModel {
    BodyModel::default_space().expect("the embedded model")
}

/// Fewer steps than in earnest: laws hold for any number of them.
fn quick() -> PuppetConfig {
    PuppetConfig { first_steps: 12, set_size: 10, learning_bodies: 60, ..PuppetConfig::default() }
}

fn learnt(model: &BodyModel, config: &PuppetConfig) -> (Puppet, Vec<Vec<f64>>) {
    let start = StartConfig::default();
    let poses = StartSearch::new(model, &start).clusters().to_vec();
    (Puppet::learn(model, &poses, config, 1), poses)
}

/// A capture that is a body, grown along its normals by `ease` metres where it is covered.
fn capture(model: &BodyModel, identity: &[f64], pose: &[f64], ease: f64) -> CapturedFrame {
    let rest = model.rest_vertices(identity);
    let posed = model.skeleton().pose(&model.joints(&rest), pose);
    let skin = model.pose_vertices(&rest, &posed);
    let normals = habitus_geometry::vertex_normals(&skin, model.faces());
    let dressed = skin
        .iter()
        .zip(&normals)
        .zip(model.part_labels())
        .map(|((vertex, normal), part)| *vertex + *normal * if part.is_bare() { 0.0 } else { ease })
        .collect();
    let mesh = TriangleMesh::new(dressed, model.faces().to_vec()).expect("a mesh");
    let fit_from_input = FitFromInput {
        scale: 1.0,
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        usual_size: size_of(&Surface::Mesh(mesh.clone())),
    };
    let surface = Surface::Mesh(mesh);
    let frame = FrameConfig::default();
    CapturedFrame::prepare(surface, &fit_from_input, &frame, (1, "body")).expect("a frame")
}

/// One arm forward, a knee bent, turned by 2 rad.
fn bent_pose(model: &BodyModel) -> Vec<f64> {
    let skeleton = model.skeleton();
    let mut pose = vec![0.0; skeleton.pose_length()];
    pose[4] = 2.0;
    for (axis, of) in skeleton.axes().iter().enumerate() {
        let wanted = match &of.name[..] {
            "left_elbow_flexion" => 0.8,
            "right_knee_flexion" => 0.6,
            "right_hip_flexion" => 0.5,
            _ => 0.0,
        };
        pose[ROOT_LENGTH + axis] = f64::clamp(wanted, of.limits[0], of.limits[1]);
    }
    pose
}

fn stitching_cost(puppet: &Puppet, states: &[PartState]) -> f64 {
    (1..puppet.parts.len())
        .map(|part| {
            let (stitch, parent) =
                (puppet.stitches[part].as_ref().expect("a stitch"), puppet.parts[part].layout.parent);
            let parent = parent.expect("a parent");
            let child = &puppet.parts[part];
            let own = seam_to_parent(child, &child.points(&states[part]), &states[part].rotation);
            let points = puppet.parts[parent].points(&states[parent]);
            stitch.cost(&own, &seam_to_child(child, &points, &states[parent].rotation), 0.0)
        })
        .sum()
}

#[test]
fn real_bodies_cost_little_to_stitch_and_torn_or_overturned_ones_much() {
    let model = model();
    let (puppet, poses) = learnt(&model, &quick());
    assert_eq!(puppet.parts.len(), model.skeleton().bones().len());
    let identity = [1.2, -0.8, 0.9, -1.1, 0.4];
    let whole = puppet.states_of(&identity, &poses[7]);
    let real = stitching_cost(&puppet, &whole);
    // Six units for each stitch are what its four independent distances, of three axes each, cost on average.
    assert!(real < 2.0 * 6.0 * (puppet.parts.len() - 1) as f64, "{real}");
    for part in 1..puppet.parts.len() {
        let mut torn = whole.clone();
        torn[part].joint.x += 0.1;
        assert!(stitching_cost(&puppet, &torn) > real + 15.0, "part {part} tears for nothing");
    }
    let bone = |name: &str| model.skeleton().bones().iter().position(|bone| bone.name == name);
    let shank = bone("left_shank").expect("a shank");
    let mut backwards = whole.clone();
    let turn = DMat3::from_axis_angle(whole[shank].rotation * DVec3::X, std::f64::consts::PI);
    backwards[shank].rotation = turn * backwards[shank].rotation;
    assert!(stitching_cost(&puppet, &backwards) > real + 15.0);
}

#[test]
fn parts_follow_the_body_that_they_are_taken_from() {
    let model = model();
    let (puppet, _) = learnt(&model, &quick());
    let (identity, pose) = ([0.8, -0.7, 0.5], bent_pose(&model));
    let rest = model.rest_vertices(&identity);
    let posed = model.skeleton().pose(&model.joints(&rest), &pose);
    let skin = model.pose_vertices(&rest, &posed);
    let mut errors = Vec::new();
    for (part, state) in puppet.parts.iter().zip(puppet.states_of(&identity, &pose)) {
        let points = part.points(&state);
        errors.extend(points.iter().zip(&part.layout.vertices).map(|(p, v)| p.distance(skin[*v as usize])));
    }
    // Four components of shape and five of bending leave a few millimetres.
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean < 0.006, "{mean}");
}

#[test]
fn a_known_pose_is_found_without_landmarks() {
    let model = model();
    let config = PuppetConfig::default();
    let (puppet, poses) = learnt(&model, &config);
    let (identity, pose) = (vec![0.8, -0.7, 0.5], bent_pose(&model));
    let frame = capture(&model, &identity, &pose, 0.0);
    let fit = puppet.fit(&frame, &Beginning::Anew { poses: &poses }, 60, &config, 1);
    let rest = model.rest_vertices(&identity);
    let skin = model.pose_vertices(&rest, &model.skeleton().pose(&model.joints(&rest), &pose));
    let found = &fit.bodies[0].landmarks;
    let errors: Vec<f64> = model
        .landmark_vertices()
        .iter()
        .zip(found)
        .map(|(vertex, landmark)| landmark.position.distance(skin[*vertex as usize]))
        .collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    // The puppet starts a fit; it need not be as exact as one. Front for back or left for right would be above 0.3 m.
    assert!(mean < 0.1, "{errors:?}");
    assert!(found.iter().all(|landmark| (0.0..=1.0).contains(&landmark.confidence)));
}

#[test]
fn more_particles_never_make_a_worse_body_and_the_same_seed_makes_the_same() {
    let model = model();
    let config = quick();
    let (puppet, poses) = learnt(&model, &config);
    let frame = capture(&model, &[0.5], &bent_pose(&model), 0.0);
    let fit = |count: usize| puppet.fit(&frame, &Beginning::Anew { poses: &poses }, count, &config, 3);
    let energies: Vec<f64> = [10, 20, 40].map(|count| fit(count).bodies[0].energy).to_vec();
    // Sets are nested, and the best body of all is exact.
    assert!(energies[1] <= energies[0] && energies[2] <= energies[1], "{energies:?}");
    let (one, two) = (fit(20), fit(20));
    assert_eq!(one.bodies[0].energy.to_bits(), two.bodies[0].energy.to_bits());
    assert_eq!(one.particles, two.particles);
}

#[test]
fn wide_clothing_does_not_drag_the_parts_out_of_the_models_range() {
    let model = model();
    let config = quick();
    let (puppet, poses) = learnt(&model, &config);
    let frame = capture(&model, &[], &bent_pose(&model), 0.06);
    for count in [10, 80] {
        let fit = puppet.fit(&frame, &Beginning::Anew { poses: &poses }, count, &config, 1);
        let body = &fit.bodies[0];
        // Real bodies have one by construction; cloth six centimetres off the skin must not look like a giant.
        assert!(body.shape_deviation() < 1.5, "{count}: {}", body.shape_deviation());
        let limit = config.coefficient_limit;
        assert!(body.states.iter().all(|state| state.coefficients.iter().all(|c| c.abs() <= limit)));
    }
}

#[test]
fn a_later_frame_is_found_from_the_one_before() {
    let model = model();
    let config = PuppetConfig { later_particles: 10, later_steps: 12, ..quick() };
    let (puppet, poses) = learnt(&model, &config);
    let pose = bent_pose(&model);
    let states = puppet.states_of(&[], &pose);
    let known: Vec<Vec<PartState>> = states.iter().map(|state| vec![*state]).collect();
    let mut moved = pose.clone();
    moved[0] += 0.5;
    let frame = capture(&model, &[], &moved, 0.0);
    let beginning = Beginning::From { particles: &known, moved: DVec3::new(0.5, 0.0, 0.0) };
    let fit = puppet.fit(&frame, &beginning, 10, &config, 1);
    for (state, before) in fit.bodies[0].states.iter().zip(&states) {
        // What the population prior and the capture trade off against each other moves a joint by a few centimetres.
        assert!(state.joint.distance(before.joint + DVec3::X * 0.5) < 0.08);
    }
    assert!(!poses.is_empty());
}
