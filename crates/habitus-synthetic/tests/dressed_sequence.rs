//! Laws of a whole dressed sequence on the default body space.

#![allow(clippy::unwrap_used, reason = "a failed step is a failed test")]

use glam::DVec3;
use habitus::body::BodyModel;
use habitus::geometry::{SurfaceIndex, TriangleMesh, area_weighted_points};
use habitus_synthetic::animate::Animation;
use habitus_synthetic::capture::CaptureSettings;
use habitus_synthetic::garment::Outfit;
use habitus_synthetic::motion::Motion;
use habitus_synthetic::rest_body::RestBody;
use habitus_synthetic::sequence::{DressedSequence, DressedSequenceSettings, generate};
use habitus_synthetic::source_bodies::{source_body, source_body_names};
use habitus_synthetic::truth::{DressedTruth, capture_file, write_sequence};

fn model() -> BodyModel {
    BodyModel::default_space().unwrap()
}

fn tiny(outfit: Outfit, motion: Motion) -> DressedSequence {
    let settings = DressedSequenceSettings { outfit, motion, ..DressedSequenceSettings::tiny() };
    generate(&model(), &settings, &mut |_, _| ()).unwrap()
}

/// Share of points that lie further than `depth` metres outside a closed mesh.
fn share_outside(points: &[DVec3], mesh: &TriangleMesh, depth: f64) -> f64 {
    let index = SurfaceIndex::of_mesh(mesh);
    points.iter().filter(|&&point| index.signed_distance(point) > depth).count() as f64 / points.len() as f64
}

#[test]
fn the_true_body_lies_inside_its_capture() {
    for (outfit, motion) in [
        (Outfit::Dress, Motion::WalkAndTurn),
        (Outfit::ShirtAndTrousers, Motion::TurnOnSpot),
        (Outfit::Tight, Motion::KneePulls),
    ] {
        let settings = DressedSequenceSettings {
            outfit,
            motion,
            frame_count: 2,
            capture: CaptureSettings::default(),
            ..DressedSequenceSettings::tiny()
        };
        let sequence = generate(&model(), &settings, &mut |_, _| ()).unwrap();
        for frame in &sequence.frames {
            let body = TriangleMesh::new(frame.scene.body_vertices.clone(), sequence.faces.clone()).unwrap();
            let points: Vec<DVec3> =
                area_weighted_points(&body, 10_000, 1).into_iter().map(|(point, _)| point).collect();
            let share = share_outside(&points, &frame.capture, 0.005);
            assert!(share <= 0.01, "{outfit:?}: {share} of the skin is outside");
        }
    }
}

#[test]
fn motions_have_no_jumps() {
    let model = model();
    let body = RestBody::new(&model, source_body(&model, 0).unwrap()).unwrap();
    for motion in [Motion::Walk, Motion::WalkAndTurn, Motion::TurnOnSpot, Motion::KneePulls] {
        let mut animation = Animation::new(&model, &body, motion, 0.0);
        let poses: Vec<_> = (0..90).map(|frame| animation.next_pose(f64::from(frame) / 30.0, 1.0)).collect();
        for (frame, pair) in poses.windows(2).enumerate() {
            // Root rotation vectors may wrap at a half turn; the angles after them may not.
            let change = pair[0].parameters()[6..].iter().zip(&pair[1].parameters()[6..]);
            let largest = change.map(|(before, after)| (after - before).abs()).fold(0.0, f64::max);
            // The knee of a swinging leg turns by about 9 degrees in a frame.
            assert!(largest < 0.3, "{motion:?} jumps by {largest} rad after frame {frame}");
            let way = pair[0].translation().distance(pair[1].translation());
            assert!(way < 0.12, "{motion:?} jumps by {way} m after frame {frame}");
        }
    }
}

#[test]
fn simulated_cloth_stays_out_of_the_body() {
    let sequence = tiny(Outfit::Dress, Motion::WalkAndTurn);
    for frame in &sequence.frames {
        let body = TriangleMesh::new(frame.scene.body_vertices.clone(), sequence.faces.clone()).unwrap();
        let index = SurfaceIndex::of_mesh(&body);
        let dress = &frame.scene.garment_positions[0];
        let inside = dress.iter().filter(|&&position| index.signed_distance(position) < -0.002).count();
        // Cloth in an armpit is squeezed between two skins.
        assert!(
            inside * 100 <= dress.len(),
            "frame {}: {inside} of {} in the body",
            frame.index,
            dress.len()
        );
    }
}

#[test]
fn a_dress_is_loose_and_a_suit_is_not() {
    let clearance = |outfit: Outfit| {
        let sequence = tiny(outfit, Motion::Walk);
        let frame = &sequence.frames[0];
        let body = TriangleMesh::new(frame.scene.body_vertices.clone(), sequence.faces.clone()).unwrap();
        let index = SurfaceIndex::of_mesh(&body);
        let cloth = &frame.scene.garment_positions[0];
        cloth.iter().map(|&position| index.signed_distance(position)).sum::<f64>() / cloth.len() as f64
    };
    assert!(clearance(Outfit::Dress) > 0.03);
    let suit = clearance(Outfit::Tight);
    assert!((0.001..0.005).contains(&suit), "{suit}");
}

#[test]
fn a_standing_foot_stays_where_it_is() {
    let settings = DressedSequenceSettings {
        outfit: Outfit::Tight,
        motion: Motion::Walk,
        frame_count: 33,
        ..DressedSequenceSettings::tiny()
    };
    let model = model();
    let mut performance = habitus_synthetic::sequence::Performance::new(
        &model,
        source_body(&model, settings.source_body).unwrap(),
        &settings,
    )
    .unwrap();
    let scenes: Vec<_> = (0..settings.frame_count).map(|_| performance.next_scene().unwrap()).collect();
    let (mut slides, mut heights) = (Vec::new(), Vec::new());
    for pair in scenes.windows(2) {
        let lowest = |scene: &habitus_synthetic::sequence::Scene| {
            (0..scene.body_vertices.len())
                .min_by(|&a, &b| scene.body_vertices[a].y.total_cmp(&scene.body_vertices[b].y))
                .unwrap()
        };
        let vertex = lowest(&pair[1]);
        let way = pair[1].body_vertices[vertex] - pair[0].body_vertices[vertex];
        slides.push(way.x.hypot(way.z));
        heights.push(pair[1].body_vertices[vertex].y.abs());
    }
    slides.sort_by(f64::total_cmp);
    heights.sort_by(f64::total_cmp);
    // A foot is one bone: as it lifts off, the toes that would bend dip below the floor.
    assert!(heights[heights.len() / 2] < 0.01 && heights[heights.len() - 1] < 0.05, "{heights:?}");
    // A sole rolls from heel to toe, so it moves by a few millimetres a frame; walking moves the body by 40.
    assert!(slides[slides.len() / 2] < 0.006, "median slide {}", slides[slides.len() / 2]);
    let walked = scenes[32].joints[0].distance(scenes[0].joints[0]);
    assert!((0.8..1.8).contains(&walked), "one gait cycle covers two steps: {walked} m");
}

#[test]
fn a_sequence_is_the_same_on_one_thread_and_two() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let settings = DressedSequenceSettings { frame_count: 2, ..DressedSequenceSettings::tiny() };
            let sequence = generate(&model(), &settings, &mut |_, _| ()).unwrap();
            sequence.frames.into_iter().map(|frame| frame.capture.into_parts()).collect::<Vec<_>>()
        })
    };
    assert!(on(1) == on(2));
}

#[test]
fn source_bodies_are_not_in_the_space() {
    let model = model();
    let count = source_body_names().unwrap().len();
    assert!(count >= 10);
    let vertices = source_body(&model, count - 1).unwrap();
    let stature = vertices.iter().map(|vertex| vertex.y).fold(f64::NEG_INFINITY, f64::max)
        - vertices.iter().map(|vertex| vertex.y).fold(f64::INFINITY, f64::min);
    assert!((1.3..2.2).contains(&stature), "{stature}");
    assert!(source_body(&model, count).is_err());
}

#[test]
fn a_written_sequence_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let settings =
        DressedSequenceSettings { frame_count: 2, outfit: Outfit::Tight, ..DressedSequenceSettings::tiny() };
    let mut heard = Vec::new();
    let written =
        write_sequence(&model(), &settings, folder.path(), &mut |done, total| heard.push((done, total)))
            .unwrap();
    assert_eq!(heard, [(1, 2), (2, 2)]);
    for frame in 0..2 {
        let mesh = habitus::geometry::io::read_mesh(&folder.path().join(capture_file(frame))).unwrap();
        assert!(mesh.faces().len() > 1000);
    }
    let read = DressedTruth::read(folder.path()).unwrap();
    assert_eq!((read.settings, read.faces, read.poses), (written.settings, written.faces, written.poses));
    for (read, written) in read.posed_vertices.iter().flatten().zip(written.posed_vertices.iter().flatten()) {
        assert!(read.distance(*written) < 1e-6, "stored in single precision");
    }
}

#[test]
fn settings_that_make_no_sense_are_refused_by_name() {
    let mut settings = DressedSequenceSettings::tiny();
    settings.capture.voxel_mm = 0.0;
    let error = generate(&model(), &settings, &mut |_, _| ()).unwrap_err();
    assert!(error.to_string().contains("voxel_mm"), "{error}");
}
