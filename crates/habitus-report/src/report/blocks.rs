//! Binary blocks of the 3D view: little endian, each part padded to four bytes, written as base64.
//!
//! Body: rest positions f32×3, skin weights u8×4, skin bones u8×4, faces u16×3 (u32×3 above 65,536 vertices).
//! Frame: bone transforms f32×12 (rows of 3×4), clearance i8 in mm, capture positions u16×3 in its box, capture faces.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use serde::Serialize;

use super::{BodyView, CaptureView, FrameView, MeasurementRow};

/// A binary block and the JSON that says what is in it.
pub(crate) struct Block<Head> {
    pub(crate) head: Head,
    pub(crate) base64: String,
}

/// What the page must know of the body's block.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct BodyHead {
    vertex_count: usize,
    face_count: usize,
    joints: Vec<[f32; 3]>,
    parents: Vec<Option<usize>>,
    curves: Vec<CurveHead>,
}

/// A curve on the body: corners at rest, and the vertex that carries each.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct CurveHead {
    row: usize,
    points: Vec<[f32; 3]>,
    carriers: Vec<usize>,
    is_closed: bool,
}

/// What the page must know of a frame's block.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct FrameHead {
    frame: usize,
    has_clearance: bool,
    capture_vertex_count: usize,
    capture_face_count: usize,
    capture_low: [f32; 3],
    capture_size: [f32; 3],
    landmarks: Vec<(String, [f32; 3], f32)>,
}

/// Little-endian numbers, each part padded to four bytes.
#[derive(Default)]
pub(crate) struct Bytes(pub(crate) Vec<u8>);

impl Bytes {
    pub(crate) fn floats(&mut self, values: impl IntoIterator<Item = f32>) {
        self.0.extend(values.into_iter().flat_map(f32::to_le_bytes));
    }

    pub(crate) fn small(&mut self, values: impl IntoIterator<Item = u8>) {
        self.0.extend(values);
        self.0.resize(self.0.len().next_multiple_of(4), 0);
    }

    pub(crate) fn indices(&mut self, faces: &[[u32; 3]], vertex_count: usize) {
        let numbers = faces.iter().flatten();
        if vertex_count <= 1 << 16 {
            self.small(numbers.flat_map(|number| (*number as u16).to_le_bytes()));
        } else {
            self.small(numbers.flat_map(|number| number.to_le_bytes()));
        }
    }

    fn base64(&self) -> String {
        STANDARD.encode(&self.0)
    }
}

/// The body's block, with the measurement curves bound to their nearest vertices.
pub(crate) fn body_block(body: &BodyView, measurements: &[MeasurementRow]) -> Block<BodyHead> {
    let mut bytes = Bytes::default();
    bytes.floats(body.rest_vertices.iter().flat_map(|vertex| vertex.as_vec3().to_array()));
    bytes.small(
        body.skin_weights.iter().flatten().map(|weight| (weight.clamp(0.0, 1.0) * 255.0).round() as u8),
    );
    bytes.small(body.skin_bones.iter().flatten().copied());
    bytes.indices(&body.faces, body.rest_vertices.len());
    let curves = measurements.iter().enumerate().filter_map(|(row, measurement)| {
        let curve = measurement.curve.as_ref()?;
        Some(CurveHead {
            row,
            points: curve.points.iter().map(|point| point.as_vec3().to_array()).collect(),
            carriers: curve.points.iter().map(|point| nearest(&body.rest_vertices, *point)).collect(),
            is_closed: curve.is_closed,
        })
    });
    let head = BodyHead {
        vertex_count: body.rest_vertices.len(),
        face_count: body.faces.len(),
        joints: body.joints.iter().map(|joint| joint.as_vec3().to_array()).collect(),
        parents: body.parents.clone(),
        curves: curves.collect(),
    };
    Block { head, base64: bytes.base64() }
}

fn nearest(vertices: &[DVec3], point: DVec3) -> usize {
    let distances = vertices.iter().map(|vertex| vertex.distance_squared(point)).enumerate();
    distances.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(number, _)| number)
}

/// A frame's block with its capture as given (already small enough).
pub(crate) fn frame_block(view: &FrameView, capture: &CaptureView) -> Block<FrameHead> {
    let mut bytes = Bytes::default();
    for transform in &view.posed_from_rest {
        let (m, t) = (transform.matrix3, transform.translation);
        let rows = [
            [m.x_axis.x, m.y_axis.x, m.z_axis.x, t.x],
            [m.x_axis.y, m.y_axis.y, m.z_axis.y, t.y],
            [m.x_axis.z, m.y_axis.z, m.z_axis.z, t.z],
        ];
        bytes.floats(rows.into_iter().flatten().map(|value| value as f32));
    }
    let as_byte = |mm: &f32| if mm.is_finite() { mm.round().clamp(-127.0, 127.0) as i8 } else { i8::MIN };
    bytes.small(view.clearance_mm.iter().map(|mm| as_byte(mm).cast_unsigned()));
    let (low, high) =
        capture.positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), position| {
            (low.min(*position), high.max(*position))
        });
    let (low, size) =
        if capture.positions.is_empty() { (DVec3::ZERO, DVec3::ONE) } else { (low, high - low) };
    let size = size.max(DVec3::splat(1e-6));
    bytes.small(capture.positions.iter().flat_map(|position| {
        let share = ((*position - low) / size * 65_535.0).round().to_array();
        share.into_iter().flat_map(|value| (value as u16).to_le_bytes())
    }));
    bytes.indices(&capture.faces, capture.positions.len());
    let landmarks = view.landmarks.iter();
    let head = FrameHead {
        frame: view.frame,
        has_clearance: !view.clearance_mm.is_empty(),
        capture_vertex_count: capture.positions.len(),
        capture_face_count: capture.faces.len(),
        capture_low: low.as_vec3().to_array(),
        capture_size: size.as_vec3().to_array(),
        landmarks: landmarks
            .map(|l| (l.name.clone(), l.position.as_vec3().to_array(), l.confidence as f32))
            .collect(),
    };
    Block { head, base64: bytes.base64() }
}
