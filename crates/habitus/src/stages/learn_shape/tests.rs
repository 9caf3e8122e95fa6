use glam::DQuat;
use habitus_optimize::Silent;

use super::*;
use crate::body::fixture;
use crate::statistics::RandomStream;

fn origin() -> SpaceOrigin {
    SpaceOrigin { name: "learnt".into(), license: "test".into(), provenance: ().into() }
}

/// People of the figure's own space, in scanner frames of their own.
fn people(model: &BodyModel, count: usize, angle: f64) -> Vec<(Vec<f64>, Registration)> {
    let mut stream = RandomStream::named(5, "people");
    let (lower, upper) = model.skeleton().pose_limits();
    (0..count)
        .map(|index| {
            let identity: Vec<f64> = (0..model.component_count()).map(|_| stream.normal()).collect();
            let mut pose = model.skeleton().rest_pose();
            for (k, value) in pose.parameters_mut().iter_mut().enumerate().skip(6) {
                *value = (angle * stream.normal()).clamp(lower[k], upper[k]);
            }
            let turn = DQuat::from_scaled_axis(DVec3::new(stream.normal(), stream.normal(), stream.normal()));
            pose.set_root(turn, DVec3::new(stream.normal(), 1.0, 2.0));
            let joints = model.surface().rest_joints(&identity);
            let posed = model.skeleton().pose(&joints, pose.parameters());
            let vertices = model.pose_vertices(&model.rest_vertices(&identity), &posed);
            (identity, Registration { name: format!("person_{index}"), vertices })
        })
        .collect()
}

fn config(pose_normalization: PoseNormalization) -> LearnShapeConfig {
    let mut config = LearnShapeConfig { pose_normalization, ..LearnShapeConfig::default() };
    config.space.components = 6;
    config
}

/// Largest distance of the rest bodies of these people to the learnt space, in metres, after rigid alignment.
fn largest_misfit(base: &BodyModel, learnt: &BodyModel, people: &[(Vec<f64>, Registration)]) -> f64 {
    let space = learnt.identity_space().expect("is consistent");
    let mean = learnt.mean_vertices();
    let misfits = people.iter().map(|(identity, _)| {
        let mut rest: Vec<f64> = base.rest_vertices(identity).iter().flat_map(|v| v.to_array()).collect();
        crate::statistics::align_to(&mut rest, mean);
        let found = space.project(&rest);
        rest.iter().zip(&found).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
    });
    misfits.fold(0.0, f64::max)
}

#[test]
fn people_who_stand_alike_give_their_space_back() {
    let base = fixture::model();
    let people = people(&base, 24, 0.0);
    let registrations: Vec<Registration> = people.iter().map(|(_, r)| r.clone()).collect();
    let learn =
        |method| learn_shape(&registrations, &base, &config(method), origin(), &mut Silent).expect("learns");
    let learnt = learn(PoseNormalization::None);
    assert_eq!(learnt.model.component_count(), 6);
    assert_eq!(learnt.model.faces(), base.faces());
    // Alignment bends the linear family a little: turns of whole bodies are of second order in the identity.
    assert!(largest_misfit(&base, &learnt.model, &people) < 2e-3);
}

#[test]
fn unposing_brings_people_in_different_poses_back_to_their_space() {
    let base = fixture::model();
    let people = people(&base, 24, 0.12);
    let registrations: Vec<Registration> = people.iter().map(|(_, r)| r.clone()).collect();
    let misfit = |method| {
        let learnt =
            learn_shape(&registrations, &base, &config(method), origin(), &mut Silent).expect("learns");
        largest_misfit(&base, &learnt.model, &people)
    };
    let (plain, unposed) = (misfit(PoseNormalization::None), misfit(PoseNormalization::Unpose));
    assert!(unposed < 5e-3 && unposed < 0.2 * plain, "{unposed} and {plain}");
}

#[test]
fn results_do_not_depend_on_threads_or_on_the_scanner_frame() {
    let base = fixture::model();
    let people = people(&base, 8, 0.1);
    let registrations: Vec<Registration> = people.iter().map(|(_, r)| r.clone()).collect();
    let learn = |registrations: &[Registration], threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let config = config(PoseNormalization::SkeletonLaplacian);
        pool.install(|| {
            learn_shape(registrations, &base, &config, origin(), &mut Silent).expect("learns").space
        })
    };
    let first = learn(&registrations, 1);
    assert_eq!(first, learn(&registrations, 3));
    let turn = DQuat::from_rotation_x(1.0);
    let turned: Vec<Registration> = registrations
        .iter()
        .map(|r| {
            let vertices = r.vertices.iter().map(|v| turn * *v + DVec3::new(3.0, -1.0, 0.5)).collect();
            Registration { name: r.name.clone(), vertices }
        })
        .collect();
    let again = learn(&turned, 2);
    for (left, right) in first.standard_deviations().iter().zip(again.standard_deviations()) {
        // The pose fits end within their tolerances, not at one bit pattern.
        assert!((left - right).abs() < 1e-5 * first.standard_deviations()[0], "{left} {right}");
    }
}

#[test]
fn unusable_registrations_are_refused_by_name() {
    let base = fixture::model();
    let mut registrations: Vec<Registration> = people(&base, 3, 0.0).into_iter().map(|(_, r)| r).collect();
    registrations[1].vertices.pop();
    let learn = |registrations: &[Registration]| {
        learn_shape(registrations, &base, &LearnShapeConfig::default(), origin(), &mut Silent)
            .expect_err("is refused")
            .to_string()
    };
    let message = learn(&registrations);
    assert!(message.contains("person_1") && message.contains("--base"), "{message}");
    assert!(learn(&registrations[..2]).contains("2 usable"));
}
