//! A made-up run for tests: the capsule person walks in loose clothes; every part of the page has something to show.

use std::f64::consts::TAU;

use glam::DVec3;
use habitus_report::report::{
    BodyCurve, BodyView, CaptureView, CodeMeaning, FrameSummary, FrameView, Headline, IdentityCoefficient,
    LandmarkView, MeasurementRow, ModelView, Percentiles, ReportData, Timing, TruthRow,
};

use crate::capsule_person::{CapsuleMesh, JOINTS, PARENTS, capsule_person, posed, walking_bones};

/// The run with this many frames; `sides` sets how fine its meshes are.
pub fn made_up_run(frame_count: usize, sides: u32) -> ReportData {
    let body = capsule_person(0.0, sides);
    let capture = dressed(sides + 4);
    ReportData {
        title: "Walk in a loose coat".into(),
        subtitle: "Body under clothing from a made-up capsule person".into(),
        version: "0.1.0".into(),
        units: "metres, y up (as given)".into(),
        headlines: headlines(frame_count),
        frames: (0..frame_count).map(|frame| summary(frame, frame_count)).collect(),
        sequence_codes: vec!["identity_at_limit".into()],
        code_meanings: ["temporal_jump", "too_few_inliers", "identity_at_limit"]
            .map(|code| CodeMeaning {
                code: code.into(),
                meaning: format!("What {} means.", code.replace('_', " ")),
            })
            .to_vec(),
        identity: (0..40)
            .map(|i| IdentityCoefficient {
                value: 3.0 * (f64::from(i) * 1.7).sin() / (1.0 + 0.15 * f64::from(i)),
                plus_minus: Some(0.1 + 0.02 * f64::from(i)),
            })
            .collect(),
        measurements: measurements(),
        timings: [("Read captures", 0.42), ("Start poses", 0.31), ("Track", 1.9), ("Refine identity", 0.85)]
            .map(|(stage, seconds)| Timing { stage: stage.into(), seconds })
            .to_vec(),
        provenance: "model      default adult space, 100 components\nseed       7\nsettings   default recipe"
            .into(),
        truth: [("Rest-pose vertex distance, mean", 6.2, "mm"), ("Joints, mean", 9.8, "mm")]
            .map(|(metric, value, unit)| TruthRow { metric: metric.into(), value, unit: unit.into() })
            .to_vec(),
        frames_per_second: 24.0,
        model: Some(ModelView {
            body: BodyView {
                rest_vertices: body.positions.clone(),
                faces: body.faces.clone(),
                skin_bones: body.bones.iter().map(|bone| [*bone, 0, 0, 0]).collect(),
                skin_weights: vec![[1.0, 0.0, 0.0, 0.0]; body.positions.len()],
                joints: JOINTS.map(DVec3::from_array).to_vec(),
                parents: PARENTS.iter().enumerate().map(|(i, p)| (i > 0).then_some(*p)).collect(),
            },
            frames: (0..frame_count).map(|frame| view(frame, frame_count, &body, &capture)).collect(),
        }),
    }
}

/// The person grown by cloth, wider below the waist.
fn dressed(sides: u32) -> CapsuleMesh {
    let mut capture = capsule_person(0.025, sides);
    for position in &mut capture.positions {
        let flare =
            0.12 * ((1.15 - position.y) / 0.5).clamp(0.0, 1.0) * f64::from(u8::from(position.y > 0.45));
        position.x *= 1.0 + flare;
        position.z *= 1.0 + 4.0 * flare;
    }
    capture
}

fn phase(frame: usize, frame_count: usize) -> f64 {
    TAU * frame as f64 / frame_count.max(2) as f64
}

fn view(frame: usize, frame_count: usize, body: &CapsuleMesh, capture: &CapsuleMesh) -> FrameView {
    let bones = walking_bones(phase(frame, frame_count));
    let clearance = |p: &DVec3| 25.0 + 70.0 * (1.1 - p.y).max(0.0) * (3.0 * p.x + frame as f64 * 0.3).sin();
    let landmark = |(bone, name): (usize, &str)| LandmarkView {
        name: name.into(),
        position: bones[bone].transform_point3(DVec3::from_array(JOINTS[bone])),
        confidence: 0.9,
    };
    FrameView {
        frame,
        posed_from_rest: bones.to_vec(),
        capture: CaptureView { positions: posed(capture, &bones), faces: capture.faces.clone() },
        clearance_mm: body.positions.iter().map(|p| clearance(p) as f32).collect(),
        landmarks: [(8, "forehead"), (2, "left_knee"), (5, "right_knee"), (11, "left_wrist")]
            .map(landmark)
            .to_vec(),
    }
}

fn summary(frame: usize, frame_count: usize) -> FrameSummary {
    let wave = phase(frame, frame_count);
    let codes = match frame % 9 {
        4 => vec!["temporal_jump".to_owned()],
        7 if frame > 9 => vec!["too_few_inliers".to_owned(), "temporal_jump".to_owned()],
        _ => Vec::new(),
    };
    let middle = 24.0 + 6.0 * wave.sin();
    FrameSummary {
        name: format!("coat_walk_{frame:04}.ply"),
        is_ok: !codes.contains(&"too_few_inliers".to_owned()),
        codes,
        seconds: 0.041 + 0.01 * (5.0 * wave).sin().abs(),
        energies: vec![
            ("closest points".into(), 1.3e-4 + 4e-5 * (3.0 * wave).cos()),
            ("inside clothing".into(), 2e-5 + 1e-5 * (2.0 * wave).sin()),
        ],
        clearance_mm: Some(Percentiles {
            p5: middle - 27.0,
            p25: middle - 12.0,
            p50: middle,
            p75: middle + 16.0,
            p95: middle + 44.0 + 8.0 * (2.0 * wave).cos(),
        }),
        outside_share: Some(0.021 + 0.012 * (2.0 * wave).sin()),
        inlier_share: Some(0.82 + 0.05 * wave.cos()),
    }
}

fn headlines(frame_count: usize) -> Vec<Headline> {
    let tile = |label: &str, value: String, unit: &str, note: &str| Headline {
        label: label.into(),
        value,
        unit: unit.into(),
        note: note.into(),
    };
    vec![
        tile("Stature", "1,772".into(), "mm", "± 6 mm"),
        tile("Chest girth", "984".into(), "mm", "± 11 mm"),
        tile("Frames", frame_count.to_string(), "", "24 a second"),
        tile("Time a frame", "46".into(), "ms", "median"),
        tile("Body outside", "2.1".into(), "%", "of vertices, mean"),
    ]
}

fn measurements() -> Vec<MeasurementRow> {
    let ring = |height: f64, side: f64, depth: f64| BodyCurve {
        points: (0..48)
            .map(|k| {
                let (sin, cos) = (TAU * f64::from(k) / 48.0).sin_cos();
                DVec3::new(side * cos, height, depth * sin)
            })
            .collect(),
        is_closed: true,
    };
    let row = |name: &str, value, plus_minus, definition: &str, curve| MeasurementRow {
        name: name.into(),
        value,
        unit: "mm".into(),
        plus_minus: Some(plus_minus),
        definition: definition.into(),
        curve,
    };
    vec![
        row("Stature", 1772.4, 6.0, "Floor to the top of the head, standing upright.", None),
        row(
            "Chest girth",
            984.2,
            11.2,
            "Horizontal, at the fullest part of the chest.",
            Some(ring(1.26, 0.157, 0.157)),
        ),
        row(
            "Hip girth",
            1011.8,
            9.4,
            "Horizontal, at the widest part of the seat.",
            Some(ring(0.96, 0.2, 0.132)),
        ),
        row(
            "Head girth",
            571.3,
            3.1,
            "Above the brows, around the back of the head.",
            Some(ring(1.62, 0.092, 0.1)),
        ),
        row("Inside leg", 812.5, 7.7, "Crotch to floor.", None),
    ]
}
