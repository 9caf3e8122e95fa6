//! Estimates a first identity and tracks the pose through the sequence (P2 §4.5).

use std::sync::Arc;
use std::sync::mpsc::sync_channel;

use glam::DVec3;
use habitus_optimize::Observer;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::captured_frame::CapturedFrame;
use super::choose_start::Started;
use super::orientation::Orientation;
use super::pose_solver::{PosePrior, PoseSolution, PoseSolver};
use super::refine_identity::Contact;
use super::start_search::{Start, StartSearch};
use super::{FitSequenceError, Stage, Track, progress};
use crate::artifacts::fitted_sequence::StartReport;
use crate::artifacts::journal::Journal;
use crate::body::Skeleton;

/// A frame that tracking has been through.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct TrackedFrame {
    pub pose: Vec<f64>,
    pub energy: f64,
    pub inlier_share: f64,
    /// Middle of the capture in metres, in the fit's coordinates.
    pub middle: DVec3,
    /// How much larger the capture is than the rest of the sequence; 1 unless it jumps.
    pub capture_scale: f64,
    /// Why the frame could not be read.
    pub error: Option<String>,
    /// Whether the pose explains the frame well enough to vote on the identity.
    pub explains: bool,
    /// Whether another pose explains it almost as well.
    #[serde(default)]
    pub has_rival: bool,
}

impl TrackedFrame {
    /// A frame without a pose of its own.
    fn lost(pose: &[f64], error: Option<String>) -> Self {
        Self {
            pose: pose.to_vec(),
            energy: 0.0,
            inlier_share: 0.0,
            middle: DVec3::ZERO,
            capture_scale: 1.0,
            error,
            explains: false,
            has_rival: false,
        }
    }

    pub fn found(solution: PoseSolution, capture: &CapturedFrame, explains: bool) -> Self {
        Self {
            pose: solution.pose,
            energy: solution.energy,
            inlier_share: solution.inlier_share,
            middle: capture.middle,
            capture_scale: capture.capture_scale,
            error: None,
            explains,
            has_rival: false,
        }
    }

    pub fn is_trusted(&self) -> bool {
        self.error.is_none() && self.explains
    }
}

/// What the journal holds: first the start, then the frames.
#[derive(Serialize, Deserialize)]
enum Entry {
    Started {
        orientation: Box<Orientation>,
        identity: Vec<f64>,
        first_frame: usize,
        pose: Vec<f64>,
        rival_ratio: f64,
        report: StartReport,
    },
    Tracked(TrackedFrame),
}

/// A frame whose energy exceeds what is usual by this factor is searched afresh.
const SUSPICIOUS_RATIO: f64 = 1.8;

impl Stage<'_> {
    /// Tracks all frames, continuing after those that the journal holds.
    pub(super) fn track_or_resume(
        &self,
        journal: &mut Journal,
        observer: &mut dyn Observer,
    ) -> Result<Track, FitSequenceError> {
        let mut frames = Vec::new();
        let mut resumed = None;
        for entry in journal.finished::<Entry>() {
            match entry {
                Entry::Started { orientation, identity, first_frame, pose, rival_ratio, report } => {
                    let orientation = *orientation;
                    resumed = Some(Started { orientation, identity, first_frame, pose, rival_ratio, report });
                }
                Entry::Tracked(frame) => frames.push(frame),
            }
        }
        let started = match resumed {
            Some(started) => started,
            None => {
                let started = self.start()?;
                let entry = Entry::Started {
                    orientation: Box::new(started.orientation.clone()),
                    identity: started.identity.clone(),
                    first_frame: started.first_frame,
                    pose: started.pose.clone(),
                    rival_ratio: started.rival_ratio,
                    report: started.report.clone(),
                };
                journal.append(&entry).map_err(FitSequenceError::Journal)?;
                started
            }
        };
        progress(observer, "start", 1, 1)?;
        self.track(&started, &mut frames, journal, observer)?;
        let fit_from_input = &started.orientation.fit_from_input;
        self.look_again(&started.identity, fit_from_input, &mut frames, observer)?;
        let width = started.identity.len();
        Ok(Track {
            orientation: started.orientation,
            identity: started.identity,
            covariance: DMatrix::identity(width, width),
            body: None,
            frames,
            rival_ratio: started.rival_ratio,
            start: started.report,
        })
    }

    /// Mean energy of a start tracked through the trial frames.
    pub(super) fn try_start(
        &self,
        orientation: &Orientation,
        start: &Start,
        first_frame: usize,
    ) -> Result<f64, FitSequenceError> {
        let mut identity = start.identity.clone();
        identity.resize(self.component_count, 0.0);
        let solver = self.solver(&identity)?;
        let last = (first_frame + self.config.start.trial_frames).min(self.source.len());
        let (mut sum, mut count) = (0.0, 0);
        let mut recent = Recent::of_start(&start.pose);
        for frame in first_frame..last {
            let Ok(capture) = self.load(frame, &orientation.fit_from_input) else { continue };
            let solution = self.track_frame(&solver, &capture, &mut recent)?;
            sum += solution.energy;
            count += 1;
            recent.push(solution.pose);
        }
        Ok(sum / f64::from(count.max(1)))
    }

    /// P2 §4.5, initial identity: tracks the first frames and refines over some of them.
    pub(super) fn initial_identity(
        &self,
        track: &mut Track,
        first_frame: usize,
        pose: &[f64],
    ) -> Result<(), FitSequenceError> {
        let config = &self.config.refine;
        let last = (first_frame + config.initial_frames).min(self.source.len());
        let solver = self.solver(&track.identity)?;
        let mut recent = Recent::of_start(pose);
        let mut poses: Vec<Vec<f64>> = vec![pose.to_vec()];
        let mut energies = Vec::new();
        let fit_from_input = track.orientation.fit_from_input;
        for frame in first_frame..last {
            if let Ok(capture) = self.load(frame, &fit_from_input) {
                let solution = self.track_frame(&solver, &capture, &mut recent)?;
                energies.push((poses.len(), solution.energy));
                recent.push(solution.pose);
            }
            poses.push(recent.last().to_vec());
        }
        // A frame that fits far worse than the best has gone astray and must not shape the identity.
        let smallest = energies.iter().map(|(_, energy)| *energy).fold(f64::INFINITY, f64::min);
        let usable: Vec<usize> = energies
            .iter()
            .filter(|(_, energy)| *energy <= SUSPICIOUS_RATIO * smallest)
            .map(|(position, _)| *position)
            .collect();
        // poses[k + 1] belongs to frame first_frame + k; position 0 is the start itself.
        let frames = super::refine_identity::spread(&usable, INITIAL_SPREAD);
        let tracked = poses.clone();
        let mut clearances = None;
        for pass in 0..config.initial_passes {
            let solver = self.solver(&track.identity)?;
            let load = |position: usize| self.load(first_frame + position - 1, &fit_from_input).ok();
            let prior = |position: usize| self.smoothness_prior(&tracked, position);
            let (step, seen) = super::refine_identity::refine_pass(
                &solver,
                &frames,
                &load,
                &mut poses,
                &prior,
                &Contact {
                    earlier: clearances.as_ref(),
                    scale: config.contact_scale(pass, config.initial_passes),
                    posture: None,
                },
                config,
            )?;
            track.identity = step.coefficients;
            track.covariance = step.covariance;
            clearances = Some(seen);
        }
        let first = poses[usable.first().copied().unwrap_or(0)].clone();
        track.frames = vec![TrackedFrame { pose: first, explains: true, ..TrackedFrame::lost(&[], None) }];
        Ok(())
    }

    /// Fits one frame from the prediction of the poses before it.
    pub(super) fn track_frame(
        &self,
        solver: &PoseSolver<'_>,
        capture: &CapturedFrame,
        recent: &mut Recent,
    ) -> Result<PoseSolution, FitSequenceError> {
        let config = &self.config.track;
        recent.follow(capture);
        let predicted = recent.predict(self.model.skeleton(), config.velocity);
        let prior = PosePrior {
            angles: vec![
                (predicted.clone(), config.prediction_stiffness),
                (vec![0.0; predicted.len()], config.rest_stiffness),
            ],
            landmarks: capture.landmarks.clone(),
            ..PosePrior::default()
        };
        solver.solve(capture, &predicted, &prior)
    }

    fn track(
        &self,
        started: &Started,
        frames: &mut Vec<TrackedFrame>,
        journal: &mut Journal,
        observer: &mut dyn Observer,
    ) -> Result<(), FitSequenceError> {
        let solver = self.solver(&started.identity)?;
        let search = StartSearch::new(self.model, &self.config.start);
        let total = self.source.len();
        let first = frames.len();
        let fit_from_input = started.orientation.fit_from_input;
        std::thread::scope(|scope| {
            // One frame is read and indexed while the one before it is fitted.
            let (sender, receiver) = sync_channel(1);
            scope.spawn(move || {
                for frame in first..total {
                    if sender.send(self.load(frame, &fit_from_input)).is_err() {
                        return;
                    }
                }
            });
            for (frame, capture) in (first..total).zip(receiver) {
                let tracked = self.tracked_frame(&solver, &search, started, frames, capture)?;
                journal.append(&Entry::Tracked(tracked.clone())).map_err(FitSequenceError::Journal)?;
                frames.push(tracked);
                progress(observer, "track", frame + 1, total)?;
            }
            Ok(())
        })
    }

    fn tracked_frame(
        &self,
        solver: &PoseSolver<'_>,
        search: &StartSearch<'_>,
        started: &Started,
        frames: &[TrackedFrame],
        capture: Result<Arc<CapturedFrame>, FitSequenceError>,
    ) -> Result<TrackedFrame, FitSequenceError> {
        let mut recent = if frames.len() > started.first_frame {
            Recent::of_frames(frames.iter())
        } else {
            Recent::of_start(&started.pose)
        };
        let capture = match capture {
            Ok(capture) => capture,
            Err(error) => {
                return Ok(TrackedFrame::lost(recent.last(), Some(error.to_string())));
            }
        };
        let mut solution = self.track_frame(solver, &capture, &mut recent)?;
        let usual = usual_energy(frames);
        if self.is_suspicious(&solution, usual) {
            solution = self.restart(solver, search, &capture, recent.last(), solution)?;
        }
        let explains = !self.is_suspicious(&solution, usual);
        Ok(TrackedFrame::found(solution, &capture, explains))
    }

    pub(super) fn is_suspicious(&self, solution: &PoseSolution, usual: Option<f64>) -> bool {
        solution.inlier_share < self.config.codes.inlier_share
            || solution.has_lost_a_limb
            || usual.is_some_and(|usual| solution.energy > SUSPICIOUS_RATIO * usual)
    }

    /// Searches a frame afresh with the identity known; keeps whatever explains it best.
    fn restart(
        &self,
        solver: &PoseSolver<'_>,
        search: &StartSearch<'_>,
        capture: &CapturedFrame,
        last: &[f64],
        current: PoseSolution,
    ) -> Result<PoseSolution, FitSequenceError> {
        let hints = vec![current.pose.clone(), last.to_vec()];
        let mut best = current;
        for start in search
            .search(std::slice::from_ref(capture), Some(&solver.fine.coefficients), &hints)
            .into_iter()
            .take(3)
        {
            let prior =
                PosePrior { landmarks: capture.landmarks.clone(), ..self.rest_prior(start.pose.len()) };
            let solution = solver.solve(capture, &start.pose, &prior)?;
            if solution.is_better_than(&best) {
                best = solution;
            }
        }
        Ok(best)
    }
}

/// A capture whose middle jumps further than this between frames has been moved as a whole, as happens when frames of
/// one sequence were exported in different coordinates; no person moves so far.
const TELEPORT: f64 = 0.4;

/// The last poses, from which the next is predicted.
pub(super) struct Recent {
    poses: Vec<Vec<f64>>,
    middle: Option<DVec3>,
}

impl Recent {
    fn of_start(pose: &[f64]) -> Self {
        Self { poses: vec![pose.to_vec()], middle: None }
    }

    /// Of frames in the order in which they are gone through; the last two count.
    pub fn of_frames<'a>(frames: impl DoubleEndedIterator<Item = &'a TrackedFrame> + Clone) -> Self {
        let middle = frames.clone().rev().find(|frame| frame.error.is_none()).map(|frame| frame.middle);
        let mut poses: Vec<_> = frames.rev().take(2).map(|frame| frame.pose.clone()).collect();
        poses.reverse();
        Self { poses, middle }
    }

    /// Where the next pose is expected.
    pub fn predict(&self, skeleton: &Skeleton, velocity: f64) -> Vec<f64> {
        let before = self.poses.len().checked_sub(2).map(|k| &self.poses[k][..]);
        PoseSolver::predict(skeleton, self.last(), before, velocity)
    }

    fn last(&self) -> &[f64] {
        &self.poses[self.poses.len() - 1]
    }

    /// Moves the poses along with a capture that has been moved as a whole.
    fn follow(&mut self, capture: &CapturedFrame) {
        let moved = capture.middle - self.middle.unwrap_or(capture.middle);
        if moved.length() > TELEPORT {
            for pose in &mut self.poses {
                for (value, shift) in pose.iter_mut().zip(moved.to_array()) {
                    *value += shift;
                }
            }
        }
        self.middle = Some(capture.middle);
    }

    fn push(&mut self, pose: Vec<f64>) {
        if self.poses.len() == 2 {
            self.poses.remove(0);
        }
        self.poses.push(pose);
    }
}

/// Initial frames over which the first identity is refined: neighbours in time say the same again.
const INITIAL_SPREAD: usize = 8;

/// The lower quartile over all trusted frames: a run of frames that drift off together must not become what is usual.
pub(super) fn usual_energy(frames: &[TrackedFrame]) -> Option<f64> {
    let mut energies: Vec<f64> =
        frames.iter().filter(|frame| frame.is_trusted()).map(|frame| frame.energy).collect();
    energies.sort_by(f64::total_cmp);
    energies.get(energies.len() / 4).copied()
}
