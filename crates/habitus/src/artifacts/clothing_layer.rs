//! The result of `extract_clothing`: how the dressed surface hangs on the body, and its offsets in each frame (P3 §3.1).
//!
//! ```text
//! anchor(i)  = Σ_k weight(i, k) · rest_vertex(body_vertex(i, k))
//! offset(i)  = unposed clothing vertex − anchor(i)                    P3 Eq. 3 and 4, in rest space
//! clothing(i) = carrier(i, pose) · offset(i)                          see body::BlendedSkin
//! ```
//! Deviation: P3 stacks one offset for each of the n_f body vertices of a clothing vertex. Over one body they differ by constants, so
//! the weighted mean holds all of them, at 3 · n_v numbers a frame, and principal components are the same.

mod file;
#[cfg(test)]
mod tests;

use glam::DVec3;

pub use file::{LayerFileError, read_layer, write_layer};
pub(in crate::artifacts) use file::{add_layer, read_arrays};

use super::codes::Code;
use super::fitted_sequence::InputFrame;
use super::rigged_sequence::{FrameRate, Rig};
use crate::body::{BlendedSkin, Carrier, PosedSkeleton};

/// How a clothing vertex came to its body vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AssociationOrigin {
    /// The diffusion reached it (P3 Eq. 2).
    Diffused,
    /// No pair was near; it follows its neighbours on the clothing.
    Completed,
}

/// For each clothing vertex the body vertices that it hangs on (P3 §3.1, fuzzy dense association).
#[derive(Clone, Debug, PartialEq)]
pub struct ClothingAssociation {
    /// P3's n_f: slots of each clothing vertex.
    pub body_vertices_per_clothing_vertex: usize,
    /// Body vertices, `n_f` for each clothing vertex, the heaviest first; unused slots repeat the first.
    pub body_vertices: Vec<u32>,
    /// P3's ω, in the same order: not negative, the sum of a clothing vertex is one, unused slots are zero.
    pub weights: Vec<f64>,
    /// How each clothing vertex came to its body vertices.
    pub origins: Vec<AssociationOrigin>,
    /// Smallest stretch of the blended transforms; see [`BlendedSkin::carriers_into`].
    pub smallest_stretch: f64,
    /// Bone weights that were evened out where the cloth stands off the body; without it those of the body vertices,
    /// Σ ω w (P3 Eq. 3). Not negative, the sum of a clothing vertex is one.
    pub spread_skin: Option<BlendedSkin>,
}

impl ClothingAssociation {
    /// Number of clothing vertices.
    pub fn clothing_vertex_count(&self) -> usize {
        self.origins.len()
    }

    /// The body vertices of a clothing vertex with their weights, the heaviest first.
    pub fn of(&self, clothing_vertex: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let slots = self.body_vertices_per_clothing_vertex;
        let range = clothing_vertex * slots..(clothing_vertex + 1) * slots;
        self.body_vertices[range.clone()]
            .iter()
            .zip(&self.weights[range])
            .filter(|(_, weight)| **weight > 0.0)
            .map(|(vertex, weight)| (*vertex as usize, *weight))
    }

    /// The point of the rest body that each clothing vertex hangs on: Σ ω v, in metres.
    pub fn anchors(&self, rest_vertices: &[DVec3]) -> Vec<DVec3> {
        let anchor = |vertex| self.of(vertex).map(|(body, weight)| rest_vertices[body] * weight).sum();
        (0..self.clothing_vertex_count()).map(anchor).collect()
    }

    /// Bone weights of the clothing vertices.
    pub fn blended_skin(&self, rig: &Rig) -> BlendedSkin {
        self.spread_skin.clone().unwrap_or_else(|| self.skin_of_body_vertices(rig))
    }

    /// Bone weights of the body vertices that the clothing vertices hang on: Σ ω w (P3 Eq. 3).
    pub fn skin_of_body_vertices(&self, rig: &Rig) -> BlendedSkin {
        let slots = self.body_vertices_per_clothing_vertex;
        BlendedSkin::new(&rig.skin, slots, &self.body_vertices, &self.weights)
    }
}

/// How well the aligned surface lies on its capture, in metres; zero where it is the capture itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AlignmentQuality {
    /// Mean distance from the aligned surface to the capture.
    pub mean_to_capture: f64,
    /// Mean distance from the capture to the aligned surface.
    pub mean_from_capture: f64,
    /// Share of faces that are turned over against their surroundings.
    pub folded_share: f64,
    /// Mean of |length / length in the template − 1| over the edges.
    pub mean_edge_strain: f64,
}

/// One frame of a clothing layer.
#[derive(Clone, Debug, PartialEq)]
pub struct ClothingFrame {
    /// The frame's name: its file name.
    pub name: String,
    /// Its place in the captured sequence, counted from 0: frames that could not be used are left out of a layer, so
    /// its time is that of this place and not of its row.
    pub capture_index: usize,
    /// Pose parameters of the body in metres and radians, y up.
    pub pose: Vec<f64>,
    /// Codes that fired while the body was fitted or the surface aligned.
    pub codes: Vec<Code>,
    /// How well the surface was aligned.
    pub quality: AlignmentQuality,
}

/// Offsets of the dressed surface from the body under it, frame by frame, in metres, y up.
#[derive(Clone, Debug, PartialEq)]
pub struct ClothingLayer {
    /// How the captures' coordinates relate to metres, y up.
    pub input_frame: InputFrame,
    /// What moves the body.
    pub rig: Rig,
    /// Identity coefficients of the body in standard deviations.
    pub identity: Vec<f64>,
    /// Rest vertices of the body in metres.
    pub rest_vertices: Vec<DVec3>,
    /// Rest joints of the body in metres.
    pub rest_joints: Vec<DVec3>,
    /// What each clothing vertex hangs on.
    pub association: ClothingAssociation,
    /// Triangles of the dressed surface, counter-clockwise from outside.
    pub clothing_faces: Vec<[u32; 3]>,
    /// Captured frames per second.
    pub frame_rate: FrameRate,
    /// The frames in order.
    pub frames: Vec<ClothingFrame>,
    /// `offsets[(frame · clothing_vertex_count + vertex) · 3 + axis]`, in metres in rest space. In f32: 0.00003 mm at
    /// most for an offset of half a metre.
    pub offsets: Vec<f32>,
}

impl ClothingLayer {
    /// Number of clothing vertices.
    pub fn clothing_vertex_count(&self) -> usize {
        self.association.clothing_vertex_count()
    }

    /// The offsets of a frame: x, y, z of each clothing vertex in turn.
    pub fn frame_offsets(&self, frame: usize) -> &[f32] {
        let width = 3 * self.clothing_vertex_count();
        &self.offsets[frame * width..(frame + 1) * width]
    }

    /// Seconds from the first captured frame to this frame.
    pub fn time_of(&self, frame: usize) -> f64 {
        self.frame_rate.time_of(self.frames[frame].capture_index)
    }

    /// The skeleton in a frame's pose, metres, y up.
    pub fn posed_skeleton(&self, frame: usize) -> PosedSkeleton {
        self.rig.skeleton.pose(&self.rest_joints, &self.frames[frame].pose)
    }

    /// The dressed surface of a frame, metres, y up.
    pub fn clothing_vertices(&self, frame: usize) -> Vec<DVec3> {
        let carriers = self.association.blended_skin(&self.rig).carriers(
            &self.association.anchors(&self.rest_vertices),
            &self.posed_skeleton(frame),
            self.association.smallest_stretch,
        );
        pose_offsets(&carriers, self.frame_offsets(frame))
    }
}

/// The posed clothing of stacked offsets (x, y, z of each vertex in turn), metres.
pub fn pose_offsets(carriers: &[Carrier], offsets: &[f32]) -> Vec<DVec3> {
    carriers
        .iter()
        .zip(offsets.as_chunks::<3>().0)
        .map(|(carrier, offset)| carrier.pose(DVec3::from_array(offset.map(f64::from))))
        .collect()
}
