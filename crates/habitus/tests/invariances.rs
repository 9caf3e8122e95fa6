//! Laws that hold whatever the numbers are: rigid motion, heading, up axis and unit, thread count, interruption.
#![allow(clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "a test may fail loudly")]

use std::cell::Cell;

use glam::{DMat3, DQuat, DVec3};
use habitus::artifacts::fitted_sequence::FittedSequence;
use habitus::artifacts::frames::FramesInMemory;
use habitus::artifacts::journal::Journal;
use habitus::artifacts::rigged_sequence::{Rig, RiggedSequence};
use habitus::body::{BodyModel, Pose};
use habitus::geometry::{Surface, TriangleMesh};
use habitus::optimize::{Event, Flow, Observer, Silent};
use habitus::stages::fit_sequence::{FitSequenceConfig, FitSequenceError, fit_sequence, follow_with_puppet};
use habitus_synthetic::sequence::{DressedSequence, DressedSequenceSettings};

mod dressed_person;
mod random;
use dressed_person::{captures, dressed, fit, largest_distance_mm, mean_distance_mm, model};
use random::Random;

fn random_pose(model: &BodyModel, random: &mut Random) -> Pose {
    let length = model.skeleton().pose_length();
    Pose::new(model.skeleton(), (0..length).map(|_| random.signed()).collect()).expect("of the right length")
}

fn random_identity(model: &BodyModel, random: &mut Random) -> Vec<f64> {
    (0..model.component_count()).map(|_| random.signed()).collect()
}

#[test]
fn moving_the_root_moves_the_whole_body_rigidly() {
    let model = model();
    let mut random = Random::new(1);
    for _ in 0..4 {
        let rest = model.rest_vertices(&random_identity(&model, &mut random));
        let joints = model.joints(&rest);
        let pose = random_pose(&model, &mut random);
        let turn = DQuat::from_scaled_axis(3.0 * random.direction());
        let shift = 2.0 * random.direction();
        let mut moved = pose.clone();
        let root = turn * (joints[0] + pose.translation()) + shift;
        moved.set_root(turn * pose.root_rotation(), root - joints[0]);
        let before = model.pose_vertices(&rest, &model.skeleton().pose(&joints, pose.parameters()));
        let after = model.pose_vertices(&rest, &model.skeleton().pose(&joints, moved.parameters()));
        let expected: Vec<DVec3> = before.iter().map(|vertex| turn * *vertex + shift).collect();
        assert!(largest_distance_mm(&after, &expected) < 1e-9);
    }
}

#[test]
fn the_blended_transform_undoes_posing() {
    let model = model();
    let surface = model.surface();
    let mut random = Random::new(2);
    for _ in 0..4 {
        let rest = model.rest_vertices(&random_identity(&model, &mut random));
        let pose = random_pose(&model, &mut random);
        let posed = model.skeleton().pose(&model.joints(&rest), pose.parameters());
        let unposed: Vec<DVec3> = model
            .pose_vertices(&rest, &posed)
            .into_iter()
            .enumerate()
            .map(|(vertex, position)| {
                let shift: DVec3 =
                    surface.skin().of(vertex).map(|(bone, weight)| posed.translations[bone] * weight).sum();
                surface.blended_rotation(vertex, &posed).inverse() * (position - shift)
            })
            .collect();
        assert!(largest_distance_mm(&unposed, &rest) < 1e-9);
    }
}

/// Four coarse frames of a person in a dress.
fn tiny(model: &BodyModel) -> DressedSequence {
    dressed(model, &DressedSequenceSettings::tiny())
}

fn on_threads(count: usize, source: &FramesInMemory, model: &BodyModel) -> FittedSequence {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("threads can be started");
    pool.install(|| fit(source, model, &FitSequenceConfig::default()).expect("it can be fitted"))
}

#[test]
fn one_and_two_threads_give_the_same_numbers() {
    let model = model();
    let source = captures(&tiny(&model));
    let (one, two) = (on_threads(1, &source, &model), on_threads(2, &source, &model));
    assert!(one == two, "differs by {} mm", mean_distance_mm(&one.rest_vertices, &two.rest_vertices));
}

#[test]
fn the_puppet_is_the_same_on_one_and_two_threads() {
    let model = model();
    let source = captures(&tiny(&model));
    let mut config = FitSequenceConfig::default();
    config.puppet.first_steps = 8;
    config.puppet.later_steps = 4;
    config.puppet.set_size = 10;
    config.puppet.first_particles = 40;
    let landmarks = |count: usize| {
        let pool =
            rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("threads can be started");
        let found = pool.install(|| follow_with_puppet(&source, &model, &config, &mut Silent));
        found.expect("a person").into_iter().map(|frame| frame.landmarks).collect::<Vec<_>>()
    };
    assert_eq!(landmarks(1), landmarks(2));
}

/// Stops at the first event of a stage that has done so much.
struct StopAt {
    stage: &'static str,
    done: usize,
}

impl Observer for StopAt {
    fn on_event(&mut self, event: &Event) -> Flow {
        match event {
            Event::Progress { stage, done, .. } if *stage == self.stage && *done >= self.done => Flow::Stop,
            _ => Flow::Continue,
        }
    }
}

/// Counts the frames that are tracked.
struct CountTracked<'a>(&'a Cell<usize>);

impl Observer for CountTracked<'_> {
    fn on_event(&mut self, event: &Event) -> Flow {
        if matches!(event, Event::Progress { stage: "track", .. }) {
            self.0.set(self.0.get() + 1);
        }
        Flow::Continue
    }
}

#[test]
fn an_interrupted_run_ends_with_the_numbers_of_one_that_was_not() {
    let model = model();
    let source = captures(&tiny(&model));
    let config = FitSequenceConfig::default();
    let whole = fit(&source, &model, &config).expect("it can be fitted");

    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("journal");
    let run = |observer: &mut dyn Observer| {
        let mut journal = Journal::open(&path, "key").expect("the journal opens");
        fit_sequence(&source, &model, &config, &[], &mut journal, observer)
    };
    for stop in [StopAt { stage: "track", done: 2 }, StopAt { stage: "refine", done: 1 }] {
        let mut stop = stop;
        assert!(matches!(run(&mut stop), Err(FitSequenceError::Cancelled)));
    }
    let tracked = Cell::new(0);
    let resumed = run(&mut CountTracked(&tracked)).expect("it can be continued");
    assert!(resumed == whole);
    assert_eq!(tracked.get(), 0, "all frames were finished before");

    // A kill leaves half a line; cut at several places, the run begins again from what is whole.
    let length = std::fs::metadata(&path).expect("it exists").len();
    for share in [0.95, 0.5, 0.1] {
        let cut = std::fs::File::options().write(true).open(&path).expect("it opens");
        cut.set_len((length as f64 * share) as u64).expect("it can be cut");
        let resumed = run(&mut Silent).expect("it can be continued");
        assert!(resumed == whole, "cut at {share}");
    }
}

/// Another way to give the same capture: turned about the vertical, laid on another up axis, in another unit.
#[derive(Clone, Copy, Debug)]
struct Presentation {
    yaw_deg: f64,
    up: DVec3,
    units_per_metre: f64,
}

impl Presentation {
    /// From metres, y up.
    fn rotation(&self) -> DMat3 {
        let lay = DQuat::from_rotation_arc(DVec3::Y, self.up);
        DMat3::from_quat(lay * DQuat::from_rotation_y(self.yaw_deg.to_radians()))
    }

    fn of(&self, source: &FramesInMemory) -> FramesInMemory {
        let rotation = self.rotation();
        let present = |surface: &Surface| {
            let Surface::Mesh(mesh) = surface else { panic!("captures are meshes") };
            let positions =
                mesh.positions().iter().map(|point| rotation * *point * self.units_per_metre).collect();
            Surface::Mesh(TriangleMesh::new(positions, mesh.faces().to_vec()).expect("still a mesh"))
        };
        FramesInMemory { surfaces: source.surfaces.iter().map(present).collect() }
    }

    /// Bodies of all frames, back in metres, y up, without the turn.
    fn bodies(&self, model: &BodyModel, fitted: &FittedSequence) -> Vec<DVec3> {
        let back = self.rotation().transpose();
        let rigged = RiggedSequence { sequence: fitted.clone(), rig: Rig::of(model) };
        let undo = |point: DVec3| back * fitted.input_frame.to_input(point) / self.units_per_metre;
        (0..fitted.frames.len()).flat_map(|frame| rigged.posed_vertices(frame)).map(undo).collect()
    }
}

/// Largest distances over presentations, millimetres.
#[derive(Debug, Default)]
struct Spread {
    rest_mean: f64,
    rest_largest: f64,
    posed_mean: f64,
    posed_largest: f64,
}

fn spread_over(presentations: &[Presentation]) -> Spread {
    let model = model();
    let source = captures(&tiny(&model));
    let config = FitSequenceConfig::default();
    let plain = Presentation { yaw_deg: 0.0, up: DVec3::Y, units_per_metre: 1.0 };
    let reference = fit(&source, &model, &config).expect("it can be fitted");
    let reference_bodies = plain.bodies(&model, &reference);
    let mut spread = Spread::default();
    for presentation in presentations {
        let fitted = fit(&presentation.of(&source), &model, &config).expect("it can be fitted");
        let (rest, posed) = (&fitted.rest_vertices, presentation.bodies(&model, &fitted));
        let rest_mean = mean_distance_mm(rest, &reference.rest_vertices);
        let posed_mean = mean_distance_mm(&posed, &reference_bodies);
        println!("{presentation:?}: rest {rest_mean:.4} mm, posed {posed_mean:.4} mm");
        spread = Spread {
            rest_mean: spread.rest_mean.max(rest_mean),
            rest_largest: spread.rest_largest.max(largest_distance_mm(rest, &reference.rest_vertices)),
            posed_mean: spread.posed_mean.max(posed_mean),
            posed_largest: spread.posed_largest.max(largest_distance_mm(&posed, &reference_bodies)),
        };
    }
    println!("{spread:?}");
    spread
}

/// The promise is two millimetres; a fit that turns captures to their own horizontal axes keeps it by far.
fn assert_same_body(spread: &Spread) {
    assert!(spread.rest_largest < 2.0, "{spread:?}");
    assert!(spread.posed_mean < 2.0, "{spread:?}");
}

#[test]
fn heading_up_axis_and_unit_do_not_change_the_body() {
    assert_same_body(&spread_over(&[
        Presentation { yaw_deg: 50.0, up: DVec3::Z, units_per_metre: 1000.0 },
        Presentation { yaw_deg: 170.0, up: DVec3::X, units_per_metre: 100.0 },
        Presentation { yaw_deg: 275.0, up: DVec3::Y, units_per_metre: 1.0 },
    ]));
}

#[test]
#[ignore = "slow: 108 fits, some minutes"]
fn no_heading_up_axis_or_unit_changes_the_body() {
    let mut presentations = Vec::new();
    for step in 0..12 {
        for up in [DVec3::X, DVec3::Y, DVec3::Z] {
            for units_per_metre in [1.0, 100.0, 1000.0] {
                presentations.push(Presentation { yaw_deg: 30.0 * f64::from(step), up, units_per_metre });
            }
        }
    }
    assert_same_body(&spread_over(&presentations));
}
