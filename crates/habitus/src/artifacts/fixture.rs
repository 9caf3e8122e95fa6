//! A made-up fitted sequence of the figure of tubes, in millimetres, z up: for tests of files and exports.

use std::f64::consts::FRAC_PI_2;

use glam::{DMat3, DVec3};
use nalgebra::DMatrix;

use super::clothing_layer::{
    AlignmentQuality, AssociationOrigin, ClothingAssociation, ClothingFrame, ClothingLayer,
};
use super::codes::Code;
use super::fitted_sequence::{FittedFrame, FittedSequence, InputFrame, Landmark};
use super::rigged_sequence::{FrameRate, Rig, RiggedSequence};
use crate::body::fixture;

/// A figure that turns through more than half a circle while all its joints bend.
pub(crate) fn rigged_sequence(frame_count: usize) -> RiggedSequence {
    let model = fixture::model();
    let identity = vec![0.7, -1.1, 0.4, 0.0, 1.9, -0.2];
    let rest_vertices = model.rest_vertices(&identity);
    let rest_joints = model.joints(&rest_vertices);
    let input_frame = InputFrame {
        metres_per_unit: 0.001,
        internal_from_input: DMat3::from_rotation_y(0.4) * DMat3::from_rotation_x(-FRAC_PI_2),
        report: vec!["millimetres, z up".into()],
    };
    let frames = (0..frame_count)
        .map(|frame| {
            let time = frame as f64;
            let mut pose: Vec<f64> = (0..30).map(|k| 0.6 * (0.3 * time + 1.7 * f64::from(k)).sin()).collect();
            pose[3..6].copy_from_slice(&[0.0, 0.25 * time, 0.1]);
            let skeleton = model.skeleton().pose(&rest_joints, &pose);
            let posed = model.pose_vertices(&rest_vertices, &skeleton);
            FittedFrame {
                name: format!("take, {frame:04}.ply"),
                pose,
                landmarks: model
                    .landmark_vertices()
                    .iter()
                    .map(|vertex| Landmark { position: posed[*vertex as usize], confidence: 0.75 })
                    .collect(),
                codes: if frame == 1 { vec![Code::TooFewInliers, Code::TemporalJump] } else { Vec::new() },
                inlier_share: 0.9,
                outside_share_5mm: 0.01,
                outside_mean: 2e-4,
                clearance_percentiles: (frame > 0).then_some([-0.002, 0.004, 0.01, 0.02, 0.05]),
                energy: 3e-5,
                capture_scale: if frame == 2 { 1.5 } else { 1.0 },
                seconds: 0.02,
            }
        })
        .collect();
    let vertex_count = rest_vertices.len();
    let covariance = DMatrix::from_fn(6, 6, |row, column| if row == column { 0.04 } else { 0.001 });
    RiggedSequence {
        sequence: FittedSequence {
            input_frame,
            identity,
            identity_covariance: covariance,
            rest_vertices,
            rest_joints,
            start: None,
            smallest_clearance: (0..vertex_count).map(|vertex| 1e-4 * vertex as f64 - 0.002).collect(),
            frames,
            codes: vec![Code::UncertainFrameOfReference],
        },
        rig: Rig::of(&model),
    }
}

/// A second skin two centimetres over the figure that swells by up to a centimetre as the first joint bends, and hangs
/// `width` farther out everywhere; poses of a calm motion.
pub(crate) fn moving_layer(frame_count: usize, width: f64) -> ClothingLayer {
    let fit = rigged_sequence(0);
    let body = &fit.sequence.rest_vertices;
    let normals = habitus_geometry::vertex_normals(body, &fit.rig.faces);
    let next = |vertex: usize| (vertex + 1) % body.len();
    let vertex_count = body.len();
    let association = ClothingAssociation {
        body_vertices_per_clothing_vertex: 2,
        body_vertices: (0..vertex_count).flat_map(|vertex| [vertex as u32, next(vertex) as u32]).collect(),
        weights: [0.75, 0.25].repeat(vertex_count),
        origins: vec![AssociationOrigin::Diffused; vertex_count],
        smallest_stretch: 0.2,
        spread_skin: None,
    };
    let pose = |frame: usize| -> Vec<f64> {
        // Two rhythms move all joints, each at its own phase: no pose comes twice, but its like does.
        let (fast, slow) = (0.31 * frame as f64, 0.057 * frame as f64);
        let angle = |k: usize| 0.25 * (fast + k as f64).sin() + 0.1 * (slow + 2.0 * k as f64).cos();
        let mut pose: Vec<f64> = (0..30).map(angle).collect();
        pose[..6].iter_mut().for_each(|value| *value *= 0.3);
        pose
    };
    let anchors = association.anchors(body);
    let mut offsets = Vec::new();
    let mut frames = Vec::new();
    for frame in 0..frame_count {
        let pose = pose(frame);
        let swelling = 0.02 + width + 0.02 * pose[6];
        for ((vertex, normal), anchor) in body.iter().zip(&normals).zip(&anchors) {
            let outwards = normal.try_normalize().unwrap_or(DVec3::Y) * swelling;
            offsets.extend((*vertex + outwards - *anchor).as_vec3().to_array());
        }
        frames.push(ClothingFrame {
            name: format!("frame_{frame:04}"),
            capture_index: frame,
            pose,
            codes: Vec::new(),
            quality: AlignmentQuality::default(),
        });
    }
    ClothingLayer {
        input_frame: fit.sequence.input_frame.clone(),
        identity: fit.sequence.identity.clone(),
        rest_vertices: body.clone(),
        rest_joints: fit.sequence.rest_joints.clone(),
        clothing_faces: fit.rig.faces.clone(),
        association,
        frame_rate: FrameRate::new(30.0).unwrap(),
        frames,
        offsets,
        rig: fit.rig,
    }
}

/// Largest distance between corresponding points.
pub(crate) fn largest_distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}
