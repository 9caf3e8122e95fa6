//! From a fit and its captures to the report: a body in a known skin of cloth, in millimetres and z up.
#![expect(clippy::expect_used, reason = "test helpers stand outside test functions")]

use glam::{DMat3, DQuat, DVec3};
use habitus::artifacts::codes::Code;
use habitus::artifacts::fitted_sequence::{FittedFrame, FittedSequence, InputFrame};
use habitus::artifacts::frames::{FrameError, FrameSource};
use habitus::artifacts::measurements::{Measurement, Quantity};
use habitus::artifacts::rigged_sequence::{Rig, RiggedSequence};
use habitus::body::BodyModel;
use habitus::geometry::{Surface, TriangleMesh, vertex_normals};
use habitus_report::render::{ColorScale, View};
use habitus_report::report::{ReportOptions, page};
use habitus_report::run::{FinishedRun, report_of_run};
use habitus_report::stills::{FrameStill, StillContent};

/// Distance from skin to cloth in metres.
const CLOTH: f64 = 0.02;

/// Captures in memory; the last one cannot be read.
struct Captures(Vec<Surface>);

impl FrameSource for Captures {
    fn len(&self) -> usize {
        self.0.len() + 1
    }

    fn name(&self, frame: usize) -> String {
        format!("capture_{frame}.ply")
    }

    fn surface(&self, frame: usize) -> Result<Surface, FrameError> {
        self.0.get(frame).cloned().ok_or(FrameError::Empty { path: self.name(frame).into() })
    }
}

fn fitted_frame(name: String, pose: Vec<f64>, codes: Vec<Code>, capture_scale: f64) -> FittedFrame {
    FittedFrame {
        name,
        pose,
        landmarks: Vec::new(),
        codes,
        inlier_share: 0.9,
        outside_share_5mm: 0.01,
        outside_mean: 0.0002,
        clearance_percentiles: None,
        energy: 1e-5,
        capture_scale,
        seconds: 0.02,
    }
}

/// Three good frames, of which the second was captured at twice its size, and one that cannot be read.
fn made_up_fit() -> (RiggedSequence, Captures) {
    let model = BodyModel::default_space().expect("the embedded model");
    let rest = model.rest_vertices(&[0.7, -0.4]);
    let input_frame = InputFrame {
        metres_per_unit: 0.001,
        internal_from_input: DMat3::from_rotation_x(-std::f64::consts::FRAC_PI_2),
        report: vec!["millimetres".into(), "z up".into()],
    };
    let frames = (0..4).map(|frame| {
        let mut pose = model.skeleton().rest_pose();
        pose.set_root(
            DQuat::from_rotation_y(0.4 * f64::from(frame)),
            DVec3::new(0.1 * f64::from(frame), 0.0, 0.0),
        );
        let codes = if frame == 3 { vec![Code::UnreadableFrame] } else { Vec::new() };
        let capture_scale = if frame == 1 { 2.0 } else { 1.0 };
        fitted_frame(format!("capture_{frame}.ply"), pose.parameters().to_vec(), codes, capture_scale)
    });
    let sequence = FittedSequence {
        input_frame,
        identity: vec![0.7, -0.4],
        identity_covariance: nalgebra::DMatrix::from_diagonal_element(2, 2, 0.04),
        rest_joints: model.joints(&rest),
        rest_vertices: rest,
        start: None,
        smallest_clearance: Vec::new(),
        frames: frames.collect(),
        codes: Vec::new(),
    };
    let fit = RiggedSequence { sequence, rig: Rig::of(&model) };
    let captures = (0..3).map(|frame| {
        let body = fit.posed_vertices(frame);
        let normals = vertex_normals(&body, &fit.rig.faces);
        let scale = fit.sequence.frames[frame].capture_scale;
        let to_input = |point: DVec3| fit.sequence.input_frame.to_input(scale * point);
        let cloth =
            body.iter().zip(&normals).map(|(vertex, normal)| to_input(*vertex + CLOTH * *normal)).collect();
        Surface::Mesh(TriangleMesh::new(cloth, fit.rig.faces.clone()).expect("mesh"))
    });
    let captures = Captures(captures.collect());
    (fit, captures)
}

#[test]
fn stills_show_body_capture_and_clearance_of_one_view() {
    let (fit, captures) = made_up_fit();
    let surface = captures.surface(1).expect("capture");
    let still = FrameStill::new(&fit, 1, Some(&surface), ColorScale::CLEARANCE);
    let view = View::from_degrees(30.0, 5.0);
    let picture = |content| still.draw(content, view, 120, 200).expect("picture");
    let background = picture(StillContent::Body).pixel(2, 2).expect("corner");
    let covered = |content| picture(content).pixels().iter().filter(|pixel| **pixel != background).count();
    let [body, capture] = [StillContent::Body, StillContent::Capture].map(covered);
    // Cloth 20 mm off the skin covers more of the picture, and with the same camera just so much more.
    assert!(capture > body && capture < 2 * body, "{body} {capture}");
    assert!(picture(StillContent::Clearance) != picture(StillContent::Body));
    let without = FrameStill::new(&fit, 3, None, ColorScale::CLEARANCE);
    assert!(without.draw(StillContent::Overlay, view, 60, 100).is_ok());
    let sheet = still.sheet("frame 2", view, 300, 500).expect("sheet");
    if let Some(folder) = option_env!("HABITUS_TEST_PICTURES") {
        sheet.save_png(&std::path::Path::new(folder).join("still.png")).expect("written");
    }
}

#[test]
fn a_run_in_millimetres_and_z_up_is_reported_in_metres_and_y_up() {
    let (fit, captures) = made_up_fit();
    let measurements = [Measurement {
        name: "stature".into(),
        quantity: Quantity::Length,
        value: 1.7543,
        plus_minus: Some(0.0042),
        curve: vec![DVec3::ZERO, DVec3::Y],
        definition: "Floor to crown.".into(),
    }];
    let run = FinishedRun {
        title: "Run".into(),
        subtitle: String::new(),
        version: "1".into(),
        fit: &fit,
        captures: &captures,
        measurements: &measurements,
        timings: Vec::new(),
        provenance: String::new(),
        accuracy: None,
        frames_per_second: 25.0,
    };
    let options = ReportOptions::default();
    let data = report_of_run(&run, &options);
    for (frame, summary) in data.frames.iter().take(3).enumerate() {
        let median = summary.clearance_mm.expect("known").p50;
        // Cloth grown along vertex normals is a little nearer than its offset where faces bend.
        assert!((median - 1000.0 * CLOTH).abs() < 1.0, "frame {frame}: {median}");
    }
    let last = &data.frames[3];
    assert!(!last.is_ok && last.clearance_mm.is_none() && last.outside_share.is_none());
    let model = data.model.as_ref().expect("model");
    for view in &model.frames[..3] {
        let body = fit.posed_vertices(view.frame);
        let top = |points: &[DVec3]| points.iter().map(|point| point.y).fold(f64::MIN, f64::max);
        assert!(
            (top(&view.capture.positions) - top(&body) - CLOTH).abs() < 0.003,
            "capture and body stand together"
        );
        let joint = model.body.joints[8];
        let posed = fit.posed_skeleton(view.frame).joints[8];
        assert!(view.posed_from_rest[8].transform_point3(joint).distance(posed) < 1e-12);
    }
    assert_eq!((model.frames.len(), model.frames[3].capture.positions.len()), (4, 0));
    assert_eq!(data.headlines[0].value, "1754");
    assert_eq!(data.measurements[0].name, "Stature");
    assert!((data.identity[0].plus_minus.expect("known") - 0.2).abs() < 1e-12);
    assert_eq!(data.code_meanings.len(), 1);
    let html = page(&data, &options).expect("page");
    assert!(html.len() < options.size_limit && html.contains("millimetres; z up"));
}
