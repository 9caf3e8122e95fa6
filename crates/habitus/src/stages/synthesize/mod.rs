//! New dressed sequences: another body, motion, fabric or size (P3 §5).
//!
//! ```text
//! model + motion + controls ──▶ coefficients ──▶ offsets ┐
//! layer ────────────────────────────────────▶ offsets ───┴─▶ pose over the body (Eq. 3, 4) ──push_out──▶ clothing
//! ```

pub mod config;
mod obstacle;
mod push_out;
#[cfg(test)]
mod tests;

use glam::DVec3;
use habitus_geometry::MeshError;
use habitus_optimize::{Event, Flow, Observer};
use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use config::SynthesizeConfig;
pub use push_out::{PushOut, body_mesh};

use crate::artifacts::clothing_layer::{ClothingLayer, pose_offsets};
use crate::artifacts::clothing_model::ClothingModel;
use crate::artifacts::fitted_sequence::{FittedFrame, FittedSequence};
use crate::artifacts::journal::Journal;
use crate::artifacts::motion_clip::MotionClip;
use crate::artifacts::rigged_sequence::{FrameRate, RiggedSequence};
use crate::artifacts::synthesized_sequence::{Penetration, SynthesizedSequence};
use crate::body::BodyModel;

/// Frames between two events of progress.
const FRAMES_PER_EVENT: usize = 8;

/// Why nothing can be synthesized.
#[derive(Debug, Error)]
pub enum SynthesizeError {
    /// The model or layer belongs to another body model.
    #[error(
        "the clothes were learnt on the body model '{needed}', not on '{found}'; give that one with --model"
    )]
    OtherBody {
        /// Body model of the clothes.
        needed: String,
        /// Body model that was given.
        found: String,
    },
    /// A motion without frames or of another skeleton.
    #[error(
        "the motion '{name}' has {frames} frames of {length} numbers; needed are frames of {needed} numbers"
    )]
    Motion {
        /// Its name.
        name: String,
        /// Frames.
        frames: usize,
        /// Numbers of its first pose.
        length: usize,
        /// Numbers of this skeleton's poses.
        needed: usize,
    },
    /// As many controls as the model has are needed.
    #[error("{found} controls were given, the model has {needed}")]
    Controls {
        /// Controls given.
        found: usize,
        /// Controls needed.
        needed: usize,
    },
    /// A posed body is no mesh.
    #[error("frame {frame}: the body is no usable mesh ({source})")]
    Body {
        /// The frame.
        frame: usize,
        /// What is wrong.
        source: MeshError,
    },
    /// The observer asked to stop.
    #[error("synthesis was stopped")]
    Stopped,
}

/// A motion to dress.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Its name, for messages.
    pub name: String,
    /// Poses in metres and radians, y up.
    pub poses: Vec<Vec<f64>>,
    /// Poses per second.
    pub frame_rate: FrameRate,
}

impl Motion {
    /// The motion of a layer.
    pub fn of_layer(layer: &ClothingLayer) -> Self {
        let poses = layer.frames.iter().map(|frame| frame.pose.clone()).collect();
        Self { name: "layer".into(), poses, frame_rate: layer.frame_rate }
    }

    /// The motion of a sequence that a model was learnt from; none if there is no such sequence.
    pub fn of_model(model: &ClothingModel, sequence: &str) -> Option<Self> {
        let (name, poses) = model.motions.iter().find(|(name, _)| name == sequence)?;
        Some(Self { name: name.clone(), poses: poses.clone(), frame_rate: model.frame_rate() })
    }

    /// A motion clip.
    pub fn of_clip(clip: &MotionClip) -> Self {
        let poses = clip.poses.iter().map(|pose| pose.parameters().to_vec()).collect();
        Self { name: clip.name.clone(), poses, frame_rate: clip.frame_rate }
    }

    /// The motion of a fit.
    pub fn of_fit(fit: &RiggedSequence, frame_rate: FrameRate) -> Self {
        let poses = fit.sequence.frames.iter().map(|frame| frame.pose.clone()).collect();
        Self { name: "fit".into(), poses, frame_rate }
    }
}

/// P3 §5.1, change of body: the same clothes over another identity of the body model. What the body has beyond the space,
/// as after a fit with local shapes, it keeps.
pub fn change_body(
    dressed: &ClothingLayer,
    model: &BodyModel,
    identity: &[f64],
) -> Result<ClothingLayer, SynthesizeError> {
    if model.metadata().name != dressed.rig.model_name || model.vertex_count() != dressed.rest_vertices.len()
    {
        let (needed, found) = (dressed.rig.model_name.clone(), model.metadata().name.clone());
        return Err(SynthesizeError::OtherBody { needed, found });
    }
    let mut changed = dressed.clone();
    changed.identity = identity.to_vec();
    let [before, after] = [&dressed.identity[..], identity].map(|identity| model.rest_vertices(identity));
    for (vertex, (before, after)) in changed.rest_vertices.iter_mut().zip(before.iter().zip(&after)) {
        *vertex += *after - *before;
    }
    changed.rest_joints = model.joints(&changed.rest_vertices);
    Ok(changed)
}

/// P3 §5.1: the offsets of a layer over its body, frame by frame.
///
/// The journal keeps frames that were pushed out, so that a killed run goes on where it stopped.
pub fn replay_layer(
    layer: &ClothingLayer,
    config: &SynthesizeConfig,
    journal: &mut Journal,
    observer: &mut dyn Observer,
) -> Result<SynthesizedSequence, SynthesizeError> {
    let motion = Motion::of_layer(layer);
    let coefficients = DMatrix::zeros(motion.poses.len(), 0);
    dress(layer, &motion, coefficients, config, journal, observer, |frame| {
        layer.frame_offsets(frame).to_vec()
    })
}

/// P3 §5: clothing of a model in a motion; `dressed` is the model's own person or [`change_body`] of it.
///
/// The journal keeps frames that were pushed out, so that a killed run goes on where it stopped.
pub fn synthesize(
    model: &ClothingModel,
    dressed: &ClothingLayer,
    motion: &Motion,
    controls: &[f64],
    config: &SynthesizeConfig,
    journal: &mut Journal,
    observer: &mut dyn Observer,
) -> Result<SynthesizedSequence, SynthesizeError> {
    let needed = dressed.rig.skeleton.pose_length();
    if motion.poses.is_empty() || motion.poses.iter().any(|pose| pose.len() != needed) {
        return Err(SynthesizeError::Motion {
            name: motion.name.clone(),
            frames: motion.poses.len(),
            length: motion.poses.first().map_or(0, Vec::len),
            needed,
        });
    }
    if controls.len() != model.controls.len() {
        return Err(SynthesizeError::Controls { found: controls.len(), needed: model.controls.len() });
    }
    let poses: Vec<&[f64]> = motion.poses.iter().map(Vec::as_slice).collect();
    let times: Vec<f64> = (0..poses.len()).map(|frame| motion.frame_rate.time_of(frame)).collect();
    let coefficients = model.coefficients(&poses, &times, controls);
    let rows: Vec<Vec<f64>> = coefficients.row_iter().map(|row| row.iter().copied().collect()).collect();
    dress(dressed, motion, coefficients, config, journal, observer, |frame| model.offsets(&rows[frame]))
}

/// A frame of clothing that was posed and pushed out.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct DressedFrame {
    /// Vertices in metres. In f32, so that a journal holds exactly what is used.
    clothing: Vec<[f32; 3]>,
    /// Before and after the push-out; none if there was none.
    inside: Option<(Penetration, Penetration)>,
}

/// Poses offsets over the body and pushes the clothing out of it.
fn dress(
    dressed: &ClothingLayer,
    motion: &Motion,
    coefficients: DMatrix<f64>,
    config: &SynthesizeConfig,
    journal: &mut Journal,
    observer: &mut dyn Observer,
    offsets: impl Fn(usize) -> Vec<f32> + Sync,
) -> Result<SynthesizedSequence, SynthesizeError> {
    let skin = dressed.association.blended_skin(&dressed.rig);
    let anchors = dressed.association.anchors(&dressed.rest_vertices);
    let push_out = PushOut::new(anchors.len(), &dressed.clothing_faces, &config.push_out);
    let body = rigged(dressed, motion);
    let is_pushed = config.push_out.rounds > 0;
    let frame_of = |frame: usize, hints: &mut Vec<u32>| {
        let carriers =
            skin.carriers(&anchors, &body.posed_skeleton(frame), dressed.association.smallest_stretch);
        let mut clothing = pose_offsets(&carriers, &offsets(frame));
        let mut inside = None;
        if is_pushed {
            let surface = body_mesh(body.posed_vertices(frame), &body.rig.faces)
                .map_err(|source| SynthesizeError::Body { frame, source })?;
            inside = Some(push_out.apply(&mut clothing, &surface, hints));
        }
        let clothing = clothing.iter().map(|vertex| vertex.as_vec3().to_array()).collect();
        Ok(DressedFrame { clothing, inside })
    };
    let count = motion.poses.len();
    let starts: Vec<usize> = (0..count).step_by(FRAMES_PER_EVENT).collect();
    let end_of = |start: usize| count.min(start + FRAMES_PER_EVENT);
    // Whole runs of frames alone: what comes after depends on their hints.
    let mut runs: Vec<Vec<DressedFrame>> = if is_pushed { journal.finished() } else { Vec::new() };
    let is_whole = |(run, start): &(&Vec<DressedFrame>, &usize)| {
        run.len() == end_of(**start) - **start
            && run.iter().all(|frame| frame.clothing.len() == anchors.len() && frame.inside.is_some())
    };
    runs.truncate(runs.iter().zip(&starts).take_while(is_whole).count());
    for block in starts[runs.len()..].chunks(rayon::current_num_threads().max(1)) {
        // Each run of frames keeps its own hints: where frames are split does not depend on the number of threads.
        let done: Vec<Result<Vec<_>, SynthesizeError>> = block
            .par_iter()
            .map(|start| {
                let mut hints = Vec::new();
                (*start..end_of(*start)).map(|frame| frame_of(frame, &mut hints)).collect()
            })
            .collect();
        for run in done {
            let run = run?;
            // What takes no time is not worth keeping; a journal that cannot be written costs a repetition, not the result.
            if is_pushed {
                let _ = journal.append(&run);
            }
            runs.push(run);
        }
        let done = runs.iter().map(Vec::len).sum();
        let progress = Event::Progress { stage: "synthesize", done, total: count };
        if observer.on_event(&progress) == Flow::Stop {
            return Err(SynthesizeError::Stopped);
        }
    }
    let in_metres = |vertices: Vec<[f32; 3]>| -> Vec<DVec3> {
        vertices.into_iter().map(|place| DVec3::from_array(place.map(f64::from))).collect()
    };
    let frames = runs.into_iter().flatten().map(|frame| (in_metres(frame.clothing), frame.inside));
    let (clothing, inside): (Vec<_>, Vec<_>) = frames.unzip();
    let (before, after) = inside.into_iter().flatten().unzip();
    Ok(SynthesizedSequence {
        body,
        frame_rate: motion.frame_rate,
        clothing_faces: dressed.clothing_faces.clone(),
        clothing,
        coefficients,
        before,
        after,
    })
}

/// The body of a dressed person in a motion.
fn rigged(dressed: &ClothingLayer, motion: &Motion) -> RiggedSequence {
    let frames = motion.poses.iter().enumerate().map(|(index, pose)| FittedFrame {
        name: format!("{}_{index:06}", motion.name),
        pose: pose.clone(),
        landmarks: Vec::new(),
        codes: Vec::new(),
        inlier_share: 1.0,
        outside_share_5mm: 0.0,
        outside_mean: 0.0,
        clearance_percentiles: None,
        energy: 0.0,
        capture_scale: 1.0,
        seconds: 0.0,
    });
    let component_count = dressed.identity.len();
    let sequence = FittedSequence {
        input_frame: dressed.input_frame.clone(),
        identity: dressed.identity.clone(),
        identity_covariance: DMatrix::zeros(component_count, component_count),
        rest_vertices: dressed.rest_vertices.clone(),
        rest_joints: dressed.rest_joints.clone(),
        start: None,
        smallest_clearance: vec![0.0; dressed.rest_vertices.len()],
        frames: frames.collect(),
        codes: Vec::new(),
    };
    RiggedSequence { sequence, rig: dressed.rig.clone() }
}
