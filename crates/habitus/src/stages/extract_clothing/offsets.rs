//! Unposing the clothing and subtracting the body (P3 Eq. 1, 3 and 4).

use glam::DVec3;

use crate::artifacts::clothing_layer::ClothingAssociation;
use crate::artifacts::rigged_sequence::RiggedSequence;
use crate::body::{BlendedSkin, Carrier};

/// What does not change from frame to frame.
pub(super) struct Unposing<'a> {
    fit: &'a RiggedSequence,
    skin: BlendedSkin,
    anchors: Vec<DVec3>,
    smallest_stretch: f64,
}

/// The offsets of one frame.
pub(super) struct FrameOffsets {
    /// x, y, z of each clothing vertex in turn, in metres in rest space.
    pub values: Vec<f32>,
    /// Largest distance between a clothing vertex and its reconstruction from the rounded offsets, in metres.
    pub round_trip: f64,
    /// Clothing vertices whose blended transform had to be limited.
    pub limited: usize,
}

impl<'a> Unposing<'a> {
    pub fn new(fit: &'a RiggedSequence, association: &ClothingAssociation) -> Self {
        Self {
            fit,
            skin: association.blended_skin(&fit.rig),
            anchors: association.anchors(&fit.sequence.rest_vertices),
            smallest_stretch: association.smallest_stretch,
        }
    }

    /// The transforms of a fitted frame (P3 Eq. 3).
    pub fn carriers(&self, frame: usize) -> Vec<Carrier> {
        self.skin.carriers(&self.anchors, &self.fit.posed_skeleton(frame), self.smallest_stretch)
    }

    /// P3 Eq. 4, as the weighted mean over the body vertices of each clothing vertex: the unposed body (Eq. 1) is the
    /// rest body of the identity, as the poses are those of the model.
    pub fn offsets(&self, frame: usize, clothing: &[DVec3]) -> FrameOffsets {
        let carriers = self.carriers(frame);
        let mut values = Vec::with_capacity(3 * clothing.len());
        let mut round_trip = 0.0_f64;
        for (carrier, vertex) in carriers.iter().zip(clothing) {
            let offset = carrier.unpose(*vertex).as_vec3();
            round_trip = round_trip.max(carrier.pose(offset.as_dvec3()).distance(*vertex));
            values.extend(offset.to_array());
        }
        FrameOffsets {
            values,
            round_trip,
            limited: carriers.iter().filter(|carrier| carrier.is_limited).count(),
        }
    }
}
