//! One frame of a fit beside its capture: both in metres, y up, at the size of the body.

use glam::DVec3;
use habitus::artifacts::rigged_sequence::RiggedSequence;
use habitus::evaluation::clearance::clearance;
use habitus::geometry::Surface;

use crate::report::CaptureView;

/// A posed body and what was captured of it.
pub(crate) struct CapturedBody {
    /// Posed vertices.
    pub(crate) vertices: Vec<DVec3>,
    /// Clearance of each vertex in mm, negative outside, where the capture has an inside.
    pub(crate) clearance_mm: Option<Vec<f64>>,
    /// The capture, if there is one.
    pub(crate) capture: Option<CaptureView>,
}

impl CapturedBody {
    /// Poses the body of a frame and brings its capture, in the input's frame and unit, to it.
    pub(crate) fn new(fit: &RiggedSequence, frame: usize, surface: Option<&Surface>) -> Self {
        let input = &fit.sequence.input_frame;
        // A capture that was exported at another scale is shown, and measured against, at the size of the others.
        let scale = fit.sequence.frames[frame].capture_scale;
        let vertices = fit.posed_vertices(frame);
        let in_input: Vec<DVec3> = vertices.iter().map(|vertex| input.to_input(scale * *vertex)).collect();
        let to_mm = input.metres_per_unit / scale * 1000.0;
        let clearance = surface.and_then(|surface| clearance(&in_input, surface));
        let capture = surface.map(|surface| {
            let (positions, faces) = match surface {
                Surface::Mesh(mesh) => (mesh.positions(), mesh.faces()),
                Surface::Cloud(cloud) => (cloud.positions(), [].as_slice()),
            };
            let positions = positions.iter().map(|position| input.to_internal(*position) / scale).collect();
            CaptureView { positions, faces: faces.to_vec() }
        });
        let clearance_mm = clearance.map(|values| values.iter().map(|value| value * to_mm).collect());
        Self { vertices, clearance_mm, capture }
    }
}
