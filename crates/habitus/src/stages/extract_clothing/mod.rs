//! P3 §3.1: the clothing as a layer of offsets over the fitted body.
//!
//! ```text
//! aligned surfaces ─┬─ a few frames ──rays──▶ sparse pairs ──diffusion──▶ association ──completion─┐
//! fitted body ──────┘                                                                              ▼
//!                    every frame ──unpose (Eq. 3)──▶ subtract the anchor on the body (Eq. 4)──▶ ClothingLayer
//! ```

mod alignment;
mod blend_spreading;
mod completion;
pub mod config;
mod fuzzy_association;
mod offsets;
mod sparse_association;
#[cfg(test)]
mod tests;

use glam::DVec3;
use habitus_geometry::{Geodesics, Surface, Topology, TriangleMesh};
use habitus_optimize::{Event, Flow, Observer, SolveError};
use rayon::prelude::*;
use thiserror::Error;

pub use alignment::{AlignedFrame, AlignedSequence, ClothingTemplate, align_clothing};
pub use config::{
    AlignmentConfig, AssociationConfig, BlockedRays, DetailConfig, ExtractClothingConfig, SpreadingConfig,
};

use crate::artifacts::clothing_layer::{
    AlignmentQuality, AssociationOrigin, ClothingAssociation, ClothingFrame, ClothingLayer,
};
use crate::artifacts::frames::FrameSource;
use crate::artifacts::rigged_sequence::{FrameRate, RiggedSequence};
use blend_spreading::{clearances, spread_bones};
use completion::complete;
use fuzzy_association::diffuse;
use offsets::{FrameOffsets, Unposing};
use sparse_association::SparsePairs;

/// Frames that are read and unposed side by side before the observer hears of them.
const FRAMES_AT_ONCE: usize = 16;

/// Why a clothing layer cannot be extracted.
#[derive(Debug, Error)]
pub enum ExtractClothingError {
    /// The fit and the surfaces are not of the same frames.
    #[error("the fit has {fitted} frames and there are {given} surfaces; give the captures that were fitted")]
    OtherFrames {
        /// Frames of the fit.
        fitted: usize,
        /// Surfaces.
        given: usize,
    },
    /// No frame has both a trusted body and a surface.
    #[error("no frame can be used: {first_reason}; look at the codes in the report of the fit")]
    NoUsableFrame {
        /// Why the first frame was left out.
        first_reason: String,
    },
    /// A setting cannot be used.
    #[error("extract_clothing.{setting} is {value}: {needed}")]
    Setting {
        /// The setting.
        setting: &'static str,
        /// Its value.
        value: String,
        /// What it must be.
        needed: &'static str,
    },
    /// No ray from the body meets the surface.
    #[error(
        "no ray from the body meets the clothing within {reach} m; is the surface that of these captures?"
    )]
    NoPair {
        /// Longest ray in metres.
        reach: f64,
    },
    /// The other layer's surface has other vertices.
    #[error("the surfaces have {found} vertices, the layer that they are to be like has {needed}")]
    OtherTemplate {
        /// Vertices of the surfaces.
        found: usize,
        /// Vertices of the other layer.
        needed: usize,
    },
    /// The equations of a frame, or of the bone weights, cannot be solved.
    #[error(
        "the equations of the clothing cannot be solved ({0}); look for vertices that are not finite or far away"
    )]
    Solve(#[from] SolveError),
    /// The observer asked to stop.
    #[error("stopped after {done} frames")]
    Stopped {
        /// Frames done.
        done: usize,
    },
}

/// A frame that is not in the layer, and why.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LeftOutFrame {
    /// The frame's name.
    pub name: String,
    /// The reason, for a person.
    pub reason: String,
}

/// A layer and what is known about how it came about.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtractedClothing {
    /// The layer.
    pub layer: ClothingLayer,
    /// Clothing vertices with a pair of their own.
    pub paired_vertices: usize,
    /// Largest share of clothing vertices in a frame whose blended transform was nearly singular.
    pub limited_share: f64,
    /// Largest distance between a clothing vertex and its reconstruction from the layer, in metres.
    pub round_trip: f64,
    /// Frames that could not be used.
    pub left_out: Vec<LeftOutFrame>,
}

impl ExtractedClothing {
    /// Puts the reasons of an earlier step in the place of those that follow from them.
    pub fn name_reasons(&mut self, earlier: &[LeftOutFrame]) {
        for frame in &mut self.left_out {
            if let Some(known) = earlier.iter().find(|known| known.name == frame.name) {
                frame.reason.clone_from(&known.reason);
            }
        }
    }
}

/// Where the dressed surfaces of a sequence come from.
#[derive(Clone, Copy)]
pub enum DressedSurfaces<'a> {
    /// Captures of one connectivity, in the input's own coordinates, one for each fitted frame.
    Captured(&'a dyn FrameSource),
    /// Surfaces that were brought into one connectivity.
    Aligned(&'a AlignedSequence),
}

/// Extracts the layer. With `like`, the surfaces hang on the body as those of another layer do, so that both can be
/// learnt from together.
pub fn extract_clothing(
    fit: &RiggedSequence,
    surfaces: DressedSurfaces<'_>,
    like: Option<&ClothingAssociation>,
    frame_rate: FrameRate,
    config: &ExtractClothingConfig,
    observer: &mut dyn Observer,
) -> Result<ExtractedClothing, ExtractClothingError> {
    check(&config.association)?;
    let frame_count = fit.sequence.frames.len();
    if let DressedSurfaces::Captured(source) = surfaces
        && source.len() != frame_count
    {
        return Err(ExtractClothingError::OtherFrames { fitted: frame_count, given: source.len() });
    }
    let mut stage = Stage { fit, surfaces, template: None };
    let (first, mut left_out) = stage.find_template()?;
    progress(observer, "associate", 0, 1, 0)?;
    let (association, paired_vertices) = match like {
        None => stage.associate(first, &config.association)?,
        Some(like) => (stage.check_likeness(like)?, 0),
    };
    progress(observer, "associate", 1, 1, 0)?;

    let unposing = Unposing::new(fit, &association);
    let (mut frames, mut offsets, mut limited, mut round_trip) = (Vec::new(), Vec::new(), 0, 0.0_f64);
    let remaining: Vec<usize> = (first..frame_count).collect();
    for chunk in remaining.chunks(FRAMES_AT_ONCE) {
        let done: Vec<Result<FrameOffsets, String>> = chunk
            .par_iter()
            .map(|frame| Ok(unposing.offsets(*frame, stage.surface(*frame)?.positions())))
            .collect();
        for (frame, result) in chunk.iter().zip(done) {
            match result {
                Ok(result) => {
                    limited = limited.max(result.limited);
                    round_trip = round_trip.max(result.round_trip);
                    offsets.extend(result.values);
                    frames.push(stage.clothing_frame(*frame));
                }
                Err(reason) => left_out.push(LeftOutFrame { name: stage.name(*frame), reason }),
            }
        }
        progress(observer, "offsets", frames.len() + left_out.len(), frame_count, frames.len())?;
    }
    let limited_share = limited as f64 / association.clothing_vertex_count() as f64;
    let sequence = &fit.sequence;
    let layer = ClothingLayer {
        input_frame: sequence.input_frame.clone(),
        rig: fit.rig.clone(),
        identity: sequence.identity.clone(),
        rest_vertices: sequence.rest_vertices.clone(),
        rest_joints: sequence.rest_joints.clone(),
        association,
        clothing_faces: stage.template.map(|template| template.into_parts().1).unwrap_or_default(),
        frame_rate,
        frames,
        offsets,
    };
    Ok(ExtractedClothing { layer, paired_vertices, limited_share, round_trip, left_out })
}

fn check(config: &AssociationConfig) -> Result<(), ExtractClothingError> {
    let fail = |setting, value: String, needed| Err(ExtractClothingError::Setting { setting, value, needed });
    if config.body_vertices_per_clothing_vertex == 0 {
        return fail("association.body_vertices_per_clothing_vertex", "0".into(), "must be 1 or more");
    }
    if config.frames == 0 {
        return fail("association.frames", "0".into(), "must be 1 or more");
    }
    let stretch = config.smallest_stretch;
    if !(stretch > 0.0 && stretch < 1.0) {
        return fail("association.smallest_stretch", stretch.to_string(), "must lie between 0 and 1");
    }
    let lengths = [
        ("association.ray_length", config.ray_length),
        ("association.diffusion_radius", config.diffusion_radius),
        ("association.diffusion_reach", config.diffusion_reach),
    ];
    for (setting, length) in lengths {
        if !(length > 0.0 && length.is_finite()) {
            return fail(setting, length.to_string(), "must be a positive length in metres");
        }
    }
    let spreading = &config.spreading;
    for (setting, value) in [
        ("association.spreading.width_per_clearance", spreading.width_per_clearance),
        ("association.spreading.tight_clearance", spreading.tight_clearance),
    ] {
        if !(value >= 0.0 && value.is_finite()) {
            return fail(setting, value.to_string(), "must be 0 or more");
        }
    }
    let share = spreading.smallest_share;
    if !(0.0..=1.0).contains(&share) {
        return fail("association.spreading.smallest_share", share.to_string(), "must lie between 0 and 1");
    }
    Ok(())
}

fn progress(
    observer: &mut dyn Observer,
    stage: &'static str,
    done: usize,
    total: usize,
    frames_done: usize,
) -> Result<(), ExtractClothingError> {
    match observer.on_event(&Event::Progress { stage, done, total }) {
        Flow::Continue => Ok(()),
        Flow::Stop => Err(ExtractClothingError::Stopped { done: frames_done }),
    }
}

/// A dressed surface and the fitted frame that it belongs to, in metres, y up.
struct Observed {
    frame: usize,
    clothing: TriangleMesh,
}

struct Stage<'a> {
    fit: &'a RiggedSequence,
    surfaces: DressedSurfaces<'a>,
    /// The first usable surface: all others must have its faces.
    template: Option<TriangleMesh>,
}

impl Stage<'_> {
    fn name(&self, frame: usize) -> String {
        self.fit.sequence.frames[frame].name.clone()
    }

    /// Takes the first usable surface as the template; returns its frame and those that were not usable before it.
    fn find_template(&mut self) -> Result<(usize, Vec<LeftOutFrame>), ExtractClothingError> {
        let mut left_out = Vec::new();
        for frame in 0..self.fit.sequence.frames.len() {
            match self.surface(frame) {
                Ok(surface) => {
                    self.template = Some(surface);
                    return Ok((frame, left_out));
                }
                Err(reason) => left_out.push(LeftOutFrame { name: self.name(frame), reason }),
            }
        }
        let first_reason =
            left_out.first().map_or_else(|| "there is none".into(), |frame| frame.reason.clone());
        Err(ExtractClothingError::NoUsableFrame { first_reason })
    }

    /// The dressed surface of a frame in metres, y up, at the scale of the body; or why it cannot be used.
    fn surface(&self, frame: usize) -> Result<TriangleMesh, String> {
        let fitted = &self.fit.sequence.frames[frame];
        if let Some(code) = fitted.codes.iter().find(|code| code.is_failure()) {
            return Err(format!("its body is not to be trusted ({code})"));
        }
        let source = match self.surfaces {
            DressedSurfaces::Captured(source) => source,
            DressedSurfaces::Aligned(sequence) => return sequence.surface(frame),
        };
        let mesh = match source.surface(frame) {
            Ok(Surface::Mesh(mesh)) => mesh,
            Ok(Surface::Cloud(_)) => return Err("it is a point cloud; a mesh is needed".into()),
            Err(error) => return Err(error.to_string()),
        };
        if let Some(template) = &self.template
            && (template.faces() != mesh.faces() || template.positions().len() != mesh.positions().len())
        {
            return Err("its vertices or faces are not those of the first frame".into());
        }
        let input_frame = &self.fit.sequence.input_frame;
        let internal: Vec<DVec3> =
            mesh.positions().iter().map(|p| input_frame.to_internal(*p) / fitted.capture_scale).collect();
        mesh.with_positions(internal).map_err(|error| error.to_string())
    }

    /// The association from a few frames, and how many clothing vertices have a pair of their own.
    fn associate(
        &self,
        first: usize,
        config: &AssociationConfig,
    ) -> Result<(ClothingAssociation, usize), ExtractClothingError> {
        let frames = spread(first, self.fit.sequence.frames.len(), config.frames);
        let observed: Vec<Observed> = frames
            .into_iter()
            .filter_map(|frame| Some(Observed { frame, clothing: self.surface(frame).ok()? }))
            .collect();
        associate_frames(self.fit, &observed, config)
    }

    fn check_likeness(
        &self,
        like: &ClothingAssociation,
    ) -> Result<ClothingAssociation, ExtractClothingError> {
        let found = self.template.as_ref().map_or(0, |template| template.positions().len());
        let needed = like.clothing_vertex_count();
        if found == needed {
            Ok(like.clone())
        } else {
            Err(ExtractClothingError::OtherTemplate { found, needed })
        }
    }

    fn clothing_frame(&self, frame: usize) -> ClothingFrame {
        let fitted = &self.fit.sequence.frames[frame];
        let mut codes = fitted.codes.clone();
        let mut quality = AlignmentQuality::default();
        if let DressedSurfaces::Aligned(sequence) = self.surfaces
            && let Some(aligned) = sequence.frame(frame)
        {
            codes.extend(&aligned.codes);
            quality = aligned.quality;
        }
        ClothingFrame {
            name: fitted.name.clone(),
            capture_index: frame,
            pose: fitted.pose.clone(),
            codes,
            quality,
        }
    }
}

/// What the vertices of a surface hang on, from one or several frames; also how many have a pair of their own.
///
/// Deviation: P3 §3.1 takes the first frame alone.
fn associate_frames(
    fit: &RiggedSequence,
    observed: &[Observed],
    config: &AssociationConfig,
) -> Result<(ClothingAssociation, usize), ExtractClothingError> {
    let no_pair = || ExtractClothingError::NoPair { reach: config.ray_length };
    let template = &observed.first().ok_or_else(no_pair)?.clothing;
    let topology = Topology::of_mesh(template);
    let mut pairs = SparsePairs::new(template.positions().len());
    let mut bodies = Vec::new();
    for seen in observed {
        if let Ok(body) = TriangleMesh::new(fit.posed_vertices(seen.frame), fit.rig.faces.clone()) {
            pairs.add_frame(&body, &seen.clothing, &topology, config);
            bodies.push((body, &seen.clothing));
        }
    }
    let frames: Vec<(&TriangleMesh, &TriangleMesh)> =
        bodies.iter().map(|(body, clothing)| (body, *clothing)).collect();
    let pairs = pairs.lasting(&frames, config.largest_parting);
    let (Some((body, _)), false) = (bodies.first(), pairs.is_empty()) else { return Err(no_pair()) };
    // Geodesics of the rest body and of the first surface: the same for all frames, up to stretch.
    let clothing = Geodesics::new(template.positions(), template.faces());
    let rest = Geodesics::new(&fit.sequence.rest_vertices, &fit.rig.faces);
    let mut slots = diffuse(&pairs, &clothing, &rest, config);
    let slot_count = config.body_vertices_per_clothing_vertex;
    let completed = complete(&mut slots, &topology, template, body, slot_count, config.completion_rounds);
    let mut association = ClothingAssociation {
        body_vertices_per_clothing_vertex: slot_count,
        body_vertices: Vec::with_capacity(slots.len() * slot_count),
        weights: Vec::with_capacity(slots.len() * slot_count),
        origins: completed
            .iter()
            .map(|completed| match completed {
                true => AssociationOrigin::Completed,
                false => AssociationOrigin::Diffused,
            })
            .collect(),
        smallest_stretch: config.smallest_stretch,
        spread_skin: None,
    };
    for entries in &slots {
        let first = entries.first().map_or(0, |(vertex, _)| *vertex);
        for slot in 0..slot_count {
            let (vertex, weight) = entries.get(slot).copied().unwrap_or((first, 0.0));
            association.body_vertices.push(vertex);
            association.weights.push(weight);
        }
    }
    association.spread_skin = spread_bones(
        &association.skin_of_body_vertices(&fit.rig),
        fit.rig.skeleton.bones().len(),
        template,
        &clearances(&frames),
        &config.spreading,
    )?;
    Ok((association, pairs.len()))
}

/// Up to `count` frames of `first..end`, evenly spread, the first among them.
fn spread(first: usize, end: usize, count: usize) -> Vec<usize> {
    let available = end - first;
    let count = count.min(available);
    (0..count).map(|k| first + k * available / count).collect()
}
