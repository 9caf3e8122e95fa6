//! The body under the clothes of a captured sequence (P2): one identity, a pose for each frame.
//!
//! Frames → frame of reference → start on the first frame (search, puppet or given landmarks) → identity of the first
//! frames → tracking → joint refinement → codes. Frames are read one at a time; only poses and codes grow with the
//! sequence. Everything inside happens in metres, y up, in coordinates centred on the first frame; results are moved back
//! at the end.

mod body_levels;
mod captured_frame;
mod choose_start;
mod clearances;
mod clothed_surface;
pub mod config;
mod frame_codes;
mod joint_refinement;
mod kept_captures;
mod limb_watch;
mod local_body;
mod orientation;
mod paper2016;
mod pose_solver;
mod puppet;
mod refine_identity;
mod second_look;
mod smooth_motion;
mod start_search;
mod track_pose;

use std::sync::Arc;

use glam::DVec3;
use habitus_geometry::MeshError;
use habitus_optimize::{Event, Flow, Observer, SolveError};
use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use self::body_levels::{BodyLevel, PreparedIdentity, RestBody};
use self::captured_frame::{CapturedFrame, FitFromInput};
pub use self::config::FitSequenceConfig;
use self::config::{CodeThresholds, Recipe, SurfaceConfig};
use self::frame_codes::{FrameQuality, is_temporal_jump, judge_frame};
use self::kept_captures::KeptCaptures;
use self::orientation::{Orientation, move_root};
use self::pose_solver::{GivenLandmark, PosePrior, PoseSolver};
pub use self::puppet::{PuppetFrame, follow_with_puppet};
use self::smooth_motion::smoothed;
use self::track_pose::TrackedFrame;
use crate::artifacts::codes::Code;
use crate::artifacts::fitted_sequence::{FittedFrame, FittedSequence, Landmark, StartReport};
use crate::artifacts::frames::{FrameError, FrameSource};
use crate::artifacts::journal::Journal;
use crate::body::{BodyModel, IdentityCoefficients};
use crate::fitting::correspondence::ClosestField;

/// Why a sequence cannot be fitted.
#[derive(Debug, Error)]
pub enum FitSequenceError {
    /// A frame cannot be read.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// No frame can be used.
    #[error("no frame of the sequence can be used; see the messages about its frames")]
    NoUsableFrame,
    /// A capture has almost nothing on it.
    #[error("{frame}: has only {found} usable triangles or points, a person needs at least {needed}")]
    TooLittleSurface {
        /// The frame.
        frame: String,
        /// What is there.
        found: usize,
        /// What is needed.
        needed: usize,
    },
    /// A capture's mesh is invalid after cleaning.
    #[error("{frame}: {source}")]
    UnusableFrame {
        /// The frame.
        frame: String,
        /// What is wrong.
        source: MeshError,
    },
    /// A landmark is given for a name that the model does not have.
    #[error("landmark '{name}' is unknown; the model has {known}")]
    UnknownLandmark {
        /// The name.
        name: String,
        /// The names it could be.
        known: String,
    },
    /// The start is to come from landmarks, and there are too few of them.
    #[error(
        "{frame}: has {found} given landmarks and a start from landmarks needs {needed}; give more with --landmarks, or \
         start with the search"
    )]
    TooFewLandmarks {
        /// The frame.
        frame: String,
        /// How many are given.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// A solver failed.
    #[error("the solver failed: {0}")]
    Solve(#[from] SolveError),
    /// The journal of finished frames cannot be written.
    #[error("the journal of finished frames cannot be written: {0}")]
    Journal(std::io::Error),
    /// The observer asked to stop.
    #[error("stopped on request; run again to continue from the frames that are finished")]
    Cancelled,
}

/// A landmark that the user gives for one frame, in the input's own coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UserLandmark {
    /// Name of the frame.
    pub frame: String,
    /// Name of the landmark in the model.
    pub landmark: String,
    /// Position in the input's coordinates.
    pub position: DVec3,
}

/// Fits one identity and a pose for each frame. Frames that were finished by an earlier, killed run are taken from the
/// journal. Progress is reported as stages `start`, `track`, `second look`, `refine`, `finish`.
pub fn fit_sequence(
    source: &dyn FrameSource,
    model: &BodyModel,
    config: &FitSequenceConfig,
    user_landmarks: &[UserLandmark],
    journal: &mut Journal,
    observer: &mut dyn Observer,
) -> Result<FittedSequence, FitSequenceError> {
    if let Some(unknown) =
        user_landmarks.iter().find(|given| !model.metadata().landmarks.contains(&given.landmark))
    {
        return Err(FitSequenceError::UnknownLandmark {
            name: unknown.landmark.clone(),
            known: model.metadata().landmarks.join(", "),
        });
    }
    progress(observer, "start", 0, 1)?;
    let stage = Stage::new(source, model, config, user_landmarks);
    let mut track = stage.track_or_resume(journal, observer)?;
    if config.recipe == Recipe::Paper2016 {
        paper2016::refit(&stage, &mut track, observer)?;
    } else {
        stage.refine(&mut track, observer)?;
    }
    stage.finish(track, observer)
}

fn progress(
    observer: &mut dyn Observer,
    stage: &'static str,
    done: usize,
    total: usize,
) -> Result<(), FitSequenceError> {
    match observer.on_event(&Event::Progress { stage, done, total }) {
        Flow::Continue => Ok(()),
        Flow::Stop => Err(FitSequenceError::Cancelled),
    }
}

/// What a run of the stage works with.
struct Stage<'a> {
    source: &'a dyn FrameSource,
    model: &'a BodyModel,
    config: &'a FitSequenceConfig,
    user_landmarks: &'a [UserLandmark],
    component_count: usize,
    captures: KeptCaptures,
    /// Few vertices, for the first rounds of tracking.
    coarse: BodyLevel,
    /// The surface energy of the joint refinement.
    refine_surface: SurfaceConfig,
    /// The surface energy of the final pass.
    final_surface: SurfaceConfig,
    /// Enough vertices to see the identity.
    medium: BodyLevel,
    full: BodyLevel,
}

/// What tracking found and refinement improves.
struct Track {
    orientation: Orientation,
    identity: Vec<f64>,
    covariance: DMatrix<f64>,
    /// The person at rest once local shapes have been refined; before that the identity says it all.
    body: Option<RestBody>,
    frames: Vec<TrackedFrame>,
    /// Energy of the second-best start over that of the best, over the trial frames.
    rival_ratio: f64,
    /// How the start was found.
    start: StartReport,
}

impl Track {
    /// Frames whose pose may vote on the identity.
    fn trusted(&self) -> Vec<usize> {
        (0..self.frames.len()).filter(|frame| self.frames[*frame].is_trusted()).collect()
    }
}

impl<'a> Stage<'a> {
    fn new(
        source: &'a dyn FrameSource,
        model: &'a BodyModel,
        config: &'a FitSequenceConfig,
        user_landmarks: &'a [UserLandmark],
    ) -> Self {
        let component_count = config.components.min(model.component_count());
        Self {
            source,
            model,
            config,
            user_landmarks,
            component_count,
            captures: KeptCaptures::new(config.frame.kept_primitives),
            refine_surface: SurfaceConfig {
                outside_weight: config.refine.outside_weight,
                bare_capture_weight: config.refine.bare_capture_weight,
                ..config.surface.clone()
            },
            final_surface: SurfaceConfig {
                outside_weight: config.refine.final_outside_weight,
                hand_outside_weight: config
                    .surface
                    .hand_outside_weight
                    .max(config.refine.final_outside_weight),
                outside_tolerance: config.refine.final_outside_tolerance,
                // Toes and crown have found their length; from here on the body is only brought inside.
                bare_capture_weight: 0.0,
                ..config.surface.clone()
            },
            coarse: BodyLevel::spread(model, config.track.coarse_vertex_count, component_count),
            medium: BodyLevel::spread(model, config.refine.vertex_count, component_count),
            full: BodyLevel::full(model, component_count),
        }
    }

    /// The capture of a frame, from memory if it is there.
    fn load(
        &self,
        frame: usize,
        fit_from_input: &FitFromInput,
    ) -> Result<Arc<CapturedFrame>, FitSequenceError> {
        self.captures.get_or_read(frame, fit_from_input, || self.read(frame, fit_from_input))
    }

    fn read(&self, frame: usize, fit_from_input: &FitFromInput) -> Result<CapturedFrame, FitSequenceError> {
        let name = self.source.name(frame);
        let surface = self.source.surface(frame)?;
        let identifier = (self.config.seed, &name[..]);
        let mut capture = CapturedFrame::prepare(surface, fit_from_input, &self.config.frame, identifier)?;
        let names = &self.model.metadata().landmarks;
        for given in self.user_landmarks.iter().filter(|given| given.frame == name) {
            if let Some(landmark) = names.iter().position(|name| *name == given.landmark) {
                let position = fit_from_input.rescaled(capture.capture_scale).apply(given.position);
                let vertex = self.model.landmark_vertices()[landmark];
                capture.landmarks.push(GivenLandmark { vertex, position });
            }
        }
        Ok(capture)
    }

    /// Solver for tracking and the first identity.
    fn solver(&self, identity: &[f64]) -> Result<PoseSolver<'_>, FitSequenceError> {
        let body = RestBody::of_space(self.model, identity);
        self.solver_of(&self.medium, &self.config.surface, &body)
    }

    /// Solver for a person who may be more than the space expresses.
    fn solver_of<'b>(
        &'b self,
        fine: &'b BodyLevel,
        surface: &'b SurfaceConfig,
        body: &RestBody,
    ) -> Result<PoseSolver<'b>, FitSequenceError> {
        let (lower, upper) = self.model.skeleton().pose_limits();
        Ok(PoseSolver {
            coarse: PreparedIdentity::of_body(self.model, &self.coarse, body),
            fine: PreparedIdentity::of_body(self.model, fine, body),
            surface,
            track: &self.config.track,
            codes: &self.config.codes,
            bounds: habitus_optimize::Bounds::new(lower, upper)?,
        })
    }

    /// Angles stay near those of the rest pose, where nothing else is said.
    fn rest_prior(&self, pose_length: usize) -> PosePrior {
        let angles = vec![(vec![0.0; pose_length], self.config.track.rest_stiffness)];
        PosePrior { angles, ..PosePrior::default() }
    }

    /// Angles stay near the mean of their neighbours in time, where cloth is silent.
    fn smoothness_prior(&self, poses: &[Vec<f64>], frame: usize) -> PosePrior {
        let mut prior = self.rest_prior(poses[frame].len());
        if frame > 0 && frame + 1 < poses.len() {
            let mean = poses[frame - 1].iter().zip(&poses[frame + 1]).map(|(a, b)| 0.5 * (a + b)).collect();
            prior.angles.push((mean, self.config.refine.smoothness));
        }
        prior
    }

    /// Last pose rounds with the final identity, codes, and the way back to the input's frame.
    fn finish(&self, track: Track, observer: &mut dyn Observer) -> Result<FittedSequence, FitSequenceError> {
        let body = track.body.clone().unwrap_or_else(|| RestBody::of_space(self.model, &track.identity));
        let solver = self.solver_of(&self.full, &self.final_surface, &body)?;
        let medium = self.solver_of(&self.medium, &self.final_surface, &body)?;
        let fit_from_input = track.orientation.fit_from_input;
        let found: Vec<Vec<f64>> = track.frames.iter().map(|frame| frame.pose.clone()).collect();
        let is_joined = |frame: usize| {
            [frame, frame + 1].iter().all(|frame| track.frames[*frame].is_trusted())
                && !is_temporal_jump(&found[frame + 1], &found[frame], &self.config.codes)
        };
        let motion = smoothed(&found, &is_joined, &self.config.refine);
        let mut smallest_clearance = vec![f64::INFINITY; self.full.vertices.len()];
        let mut frames = Vec::with_capacity(track.frames.len());
        const BATCH: usize = 8;
        for batch in (0..track.frames.len()).collect::<Vec<_>>().chunks(BATCH) {
            let finished: Vec<_> = batch
                .par_iter()
                .map(|frame| {
                    self.finish_frame(
                        [&medium, &solver],
                        &track.frames[*frame],
                        *frame,
                        &motion[*frame],
                        &fit_from_input,
                    )
                })
                .collect();
            for (frame, finished) in batch.iter().zip(finished) {
                let (pose, quality) = finished?;
                let (fitted, clearance) =
                    self.fitted_frame(&track, &solver, *frame, pose, quality, frames.last());
                if fitted.is_ok() {
                    for (smallest, clearance) in smallest_clearance.iter_mut().zip(&clearance) {
                        *smallest = smallest.min(*clearance);
                    }
                }
                frames.push(fitted);
            }
            progress(observer, "finish", frames.len(), track.frames.len())?;
        }
        if frames.iter().all(|frame| !frame.is_ok()) {
            smallest_clearance.fill(0.0);
        }
        let codes = self.sequence_codes(&track, &body.vertices, &frames);
        // Poses leave the fit's own coordinates for metres, y up, in the input's place.
        for frame in &mut frames {
            move_root(&mut frame.pose, solver.fine.joints[0], &track.orientation.internal_from_fit());
            for landmark in &mut frame.landmarks {
                landmark.position = track.orientation.internal_from_fit().apply(landmark.position);
            }
        }
        Ok(FittedSequence {
            input_frame: track.orientation.input_frame(),
            rest_vertices: body.vertices,
            rest_joints: body.joints,
            identity: track.identity,
            identity_covariance: track.covariance,
            start: Some(track.start),
            smallest_clearance,
            frames,
            codes,
        })
    }

    /// The final pose of a frame and the verdict on it.
    fn finish_frame(
        &self,
        solvers: [&PoseSolver<'_>; 2],
        tracked: &TrackedFrame,
        frame: usize,
        smoothed: &[f64],
        fit_from_input: &FitFromInput,
    ) -> Result<(Vec<f64>, Option<FrameQuality>), FitSequenceError> {
        let capture = match self.load(frame, fit_from_input) {
            Ok(capture) if tracked.error.is_none() => capture,
            _ => return Ok((tracked.pose.clone(), None)),
        };
        let (pose, quality) = if self.config.recipe == Recipe::Paper2016 {
            // The paper's energies do not promise a body inside; only a grossly wrong one counts as failed.
            let thresholds = CodeThresholds { outside_share_5mm: 1.0, ..self.config.codes.clone() };
            let pose = tracked.pose.clone();
            let quality = self.judge(solvers[1], &capture, (&pose, None), &thresholds);
            (pose, quality)
        } else {
            let motion = Some((smoothed.to_vec(), self.config.refine.smoothing_stiffness));
            let smooth = self.settle_pose(solvers, &capture, smoothed, motion)?;
            if smooth.1.codes.contains(&Code::BodyOutsideCapture) {
                // The person may have moved faster than the parabola: then the capture alone decides.
                let own = self.settle_pose(solvers, &capture, &tracked.pose, None)?;
                if own.1.outside_share_5mm < smooth.1.outside_share_5mm { own } else { smooth }
            } else {
                smooth
            }
        };
        Ok((pose, Some(quality)))
    }

    /// Pose rounds at medium resolution, one at full, and the verdict.
    fn settle_pose(
        &self,
        [medium, full]: [&PoseSolver<'_>; 2],
        capture: &CapturedFrame,
        start: &[f64],
        motion: Option<(Vec<f64>, [f64; 3])>,
    ) -> Result<(Vec<f64>, FrameQuality), FitSequenceError> {
        let landmarks = capture.landmarks.clone();
        let prior = PosePrior { motion, landmarks, ..self.rest_prior(start.len()) };
        let rounds = self.config.refine.final_rounds;
        let (pose, _) = medium.polish_found_pose(capture, start.to_vec(), &prior, rounds)?;
        let (pose, field) = full.polish_found_pose(capture, pose, &prior, 1)?;
        let quality = self.judge(full, capture, (&pose, field.as_ref()), &self.config.codes);
        Ok((pose, quality))
    }

    fn judge(
        &self,
        full: &PoseSolver<'_>,
        capture: &CapturedFrame,
        found: (&[f64], Option<&ClosestField>),
        thresholds: &CodeThresholds,
    ) -> FrameQuality {
        judge_frame(self.model, &full.fine, capture, found, &self.config.surface, thresholds)
    }

    fn fitted_frame(
        &self,
        track: &Track,
        solver: &PoseSolver<'_>,
        frame: usize,
        pose: Vec<f64>,
        quality: Option<FrameQuality>,
        before: Option<&FittedFrame>,
    ) -> (FittedFrame, Vec<f64>) {
        let name = self.source.name(frame);
        let Some(quality) = quality else {
            let landmarks = solver.landmarks_without_capture(self.model, &pose);
            let fitted = FittedFrame {
                name,
                pose,
                landmarks,
                codes: vec![Code::UnreadableFrame],
                inlier_share: 0.0,
                outside_share_5mm: 0.0,
                outside_mean: 0.0,
                clearance_percentiles: None,
                energy: 0.0,
                seconds: 0.0,
                capture_scale: 1.0,
            };
            return (fitted, Vec::new());
        };
        let mut codes = quality.codes;
        let capture_scale = track.frames[frame].capture_scale;
        if capture_scale != 1.0 {
            codes.push(Code::CaptureRescaled);
        }
        if before.is_some_and(|before| is_temporal_jump(&pose, &before.pose, &self.config.codes)) {
            codes.push(Code::TemporalJump);
        }
        if frame == 0 && track.rival_ratio < self.config.codes.rival_ratio {
            codes.push(Code::AmbiguousStart);
        }
        if track.frames[frame].has_rival {
            codes.push(Code::AmbiguousPose);
        }
        let fitted = FittedFrame {
            name,
            pose,
            landmarks: quality.landmarks,
            codes,
            inlier_share: quality.inlier_share,
            outside_share_5mm: quality.outside_share_5mm,
            outside_mean: quality.outside_mean,
            clearance_percentiles: percentiles(&quality.clearance),
            energy: quality.energy,
            seconds: 0.0,
            capture_scale,
        };
        (fitted, quality.clearance)
    }

    fn sequence_codes(&self, track: &Track, rest: &[DVec3], frames: &[FittedFrame]) -> Vec<Code> {
        let mut codes = Vec::new();
        let at_limit = |z: &f64| z.abs() >= IdentityCoefficients::LIMIT - 1e-6;
        if track.identity.iter().any(at_limit) {
            codes.push(Code::IdentityAtLimit);
        }
        let [low, high] = captured_frame::bounds_of(rest);
        let [shortest, tallest] = self.config.codes.stature;
        let failed = frames.iter().filter(|frame| !frame.is_ok()).count();
        if !(shortest..=tallest).contains(&(high.y - low.y)) || 2 * failed > frames.len() {
            codes.push(Code::NotAPerson);
        }
        if track.rival_ratio < self.config.codes.rival_ratio {
            codes.push(Code::AmbiguousStart);
        }
        if !track.orientation.is_certain {
            codes.push(Code::UncertainFrameOfReference);
        }
        codes
    }
}

/// 5, 25, 50, 75 and 95 % of the values.
fn percentiles(values: &[f64]) -> Option<[f64; 5]> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    Some([0.05, 0.25, 0.5, 0.75, 0.95].map(|share: f64| sorted[(share * last as f64).round() as usize]))
}

impl PoseSolver<'_> {
    /// Landmarks of a pose that no capture supports.
    fn landmarks_without_capture(&self, model: &BodyModel, pose: &[f64]) -> Vec<Landmark> {
        let (vertices, _) = self.fine.vertices_and_normals(&self.fine.posed(pose));
        model
            .landmark_vertices()
            .iter()
            .map(|vertex| Landmark { position: vertices[*vertex as usize], confidence: 0.0 })
            .collect()
    }
}
