//! Starts on the first frame, estimates a first identity, and tracks the pose through the sequence (P2 §4.5).

use std::sync::mpsc::sync_channel;

use habitus_optimize::Observer;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::captured_frame::CapturedFrame;
use super::orientation::{Orientation, candidates};
use super::pose_solver::{AnglePrior, PoseSolution, PoseSolver};
use super::start_search::{Start, StartSearch};
use super::{FitSequenceError, Stage, Track, progress};
use crate::artifacts::journal::Journal;

/// A frame that tracking has been through.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct TrackedFrame {
    pub pose: Vec<f64>,
    pub energy: f64,
    pub inlier_share: f64,
    /// Why the frame could not be read.
    pub error: Option<String>,
    /// Whether the pose explains the frame well enough to vote on the identity.
    pub explains: bool,
}

impl TrackedFrame {
    pub fn is_trusted(&self) -> bool {
        self.error.is_none() && self.explains
    }
}

/// What the journal holds: first the start, then the frames.
#[derive(Serialize, Deserialize)]
enum Entry {
    Started { orientation: Box<Orientation>, identity: Vec<f64>, first_frame: usize, pose: Vec<f64>, rival_ratio: f64 },
    Tracked(TrackedFrame),
}

/// A started sequence.
struct Started {
    orientation: Orientation,
    identity: Vec<f64>,
    first_frame: usize,
    pose: Vec<f64>,
    rival_ratio: f64,
}

/// A frame whose energy exceeds the running median by this factor is searched afresh.
const SUSPICIOUS_RATIO: f64 = 2.5;

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
                Entry::Started { orientation, identity, first_frame, pose, rival_ratio } => {
                    let orientation = *orientation;
                    resumed = Some(Started { orientation, identity, first_frame, pose, rival_ratio });
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
                };
                journal.append(&entry).map_err(FitSequenceError::Journal)?;
                started
            }
        };
        progress(observer, "start", 1, 1)?;
        self.track(&started, &mut frames, journal, observer)?;
        let width = started.identity.len();
        Ok(Track {
            orientation: started.orientation,
            identity: started.identity,
            covariance: DMatrix::identity(width, width),
            frames,
            rival_ratio: started.rival_ratio,
        })
    }

    /// The best start over orientations and rivals, and the identity of the first frames.
    fn start(&self) -> Result<Started, FitSequenceError> {
        let search = StartSearch::new(self.model, &self.config.start);
        let (first_frame, best) = self.first_starts(&search)?;
        let smallest = best.iter().map(|(_, start)| start.energy).fold(f64::INFINITY, f64::min);
        let rivals: Vec<(Orientation, Start)> = best
            .into_iter()
            .filter(|(_, start)| start.energy <= self.config.start.rival_ratio * smallest)
            .collect();
        let mut tried = Vec::new();
        for (orientation, start) in rivals {
            let energy = self.try_start(&orientation, &start, first_frame)?;
            tried.push((energy, orientation, start));
        }
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        let rival_ratio = match &tried[..] {
            [best, second, ..] => second.0 / best.0.max(f64::MIN_POSITIVE),
            _ => self.config.start.rival_ratio,
        };
        let Some((_, orientation, start)) = tried.into_iter().next() else {
            return Err(FitSequenceError::NoUsableFrame);
        };
        let mut identity = start.identity;
        identity.resize(self.component_count, 0.0);
        let mut track = Track {
            orientation,
            covariance: DMatrix::identity(self.component_count, self.component_count),
            identity,
            frames: Vec::new(),
            rival_ratio,
        };
        self.initial_identity(&mut track, first_frame, &start.pose)?;
        let pose = track.frames[0].pose.clone();
        Ok(Started { orientation: track.orientation, identity: track.identity, first_frame, pose, rival_ratio })
    }

    /// Searches the first frame that can be used, in every orientation that is possible.
    fn first_starts(
        &self,
        search: &StartSearch<'_>,
    ) -> Result<(usize, Vec<(Orientation, Start)>), FitSequenceError> {
        let orientations = candidates(self.source, self.config)?;
        let mut first_error = None;
        for frame in 0..self.source.len() {
            let mut starts = Vec::new();
            for orientation in &orientations {
                match self.load(frame, &orientation.fit_from_input) {
                    Ok(capture) => {
                        let found = search.search(&capture, None, &[]);
                        starts.extend(found.into_iter().map(|start| (orientation.clone(), start)));
                    }
                    Err(error) => {
                        first_error.get_or_insert(error);
                        break;
                    }
                }
            }
            if !starts.is_empty() {
                return Ok((frame, starts));
            }
        }
        Err(first_error.unwrap_or(FitSequenceError::NoUsableFrame))
    }

    /// Mean energy of a start tracked through the trial frames.
    fn try_start(
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
        let mut poses: Vec<Vec<f64>> = vec![start.pose.clone()];
        for frame in first_frame..last {
            let Ok(capture) = self.load(frame, &orientation.fit_from_input) else { continue };
            let solution = self.track_frame(&solver, &capture, &poses)?;
            sum += solution.energy;
            count += 1;
            poses.push(solution.pose);
        }
        Ok(sum / f64::from(count.max(1)))
    }

    /// P2 §4.5, initial identity: tracks the first frames and refines over some of them.
    fn initial_identity(
        &self,
        track: &mut Track,
        first_frame: usize,
        pose: &[f64],
    ) -> Result<(), FitSequenceError> {
        let config = &self.config.refine;
        let fit_from_input = track.orientation.fit_from_input;
        let last = (first_frame + config.initial_frames).min(self.source.len());
        let solver = self.solver(&track.identity)?;
        let mut poses: Vec<Vec<f64>> = vec![pose.to_vec()];
        let mut usable = Vec::new();
        for frame in first_frame..last {
            let Ok(capture) = self.load(frame, &fit_from_input) else {
                poses.push(poses[poses.len() - 1].clone());
                continue;
            };
            let solution = self.track_frame(&solver, &capture, &poses)?;
            usable.push(poses.len());
            poses.push(solution.pose);
        }
        // poses[k + 1] belongs to frame first_frame + k; position 0 is the start itself.
        let frames = super::refine_identity::spread(&usable, INITIAL_SPREAD);
        let tracked = poses.clone();
        let mut clearance: Option<Vec<f64>> = None;
        for _ in 0..config.initial_passes {
            let solver = self.solver(&track.identity)?;
            let load = |position: usize| self.load(first_frame + position - 1, &fit_from_input).ok();
            let prior = |position: usize| self.smoothness_prior(&tracked, position);
            let step = super::refine_identity::refine_pass(
                &solver,
                &frames,
                &load,
                &mut poses,
                &prior,
                clearance.as_deref(),
                config,
            )?;
            track.identity = step.identity;
            track.covariance = step.covariance;
            clearance = Some(step.smallest_clearance);
        }
        let first = poses[usable.first().copied().unwrap_or(0)].clone();
        track.frames = vec![TrackedFrame {
            pose: first,
            energy: 0.0,
            inlier_share: 1.0,
            error: None,
            explains: true,
        }];
        Ok(())
    }

    /// Fits one frame from the prediction of the poses before it.
    fn track_frame(
        &self,
        solver: &PoseSolver<'_>,
        capture: &CapturedFrame,
        poses: &[Vec<f64>],
    ) -> Result<PoseSolution, FitSequenceError> {
        let config = &self.config.track;
        let last = &poses[poses.len() - 1];
        let before = poses.len().checked_sub(2).map(|k| &poses[k][..]);
        let predicted = PoseSolver::predict(self.model.skeleton(), last, before, config.velocity);
        let prior = AnglePrior {
            pulls: vec![
                (predicted.clone(), config.prediction_stiffness),
                (vec![0.0; predicted.len()], config.rest_stiffness),
            ],
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
        capture: Result<CapturedFrame, FitSequenceError>,
    ) -> Result<TrackedFrame, FitSequenceError> {
        let mut poses: Vec<Vec<f64>> =
            frames.iter().rev().take(2).rev().map(|frame| frame.pose.clone()).collect();
        if frames.len() <= started.first_frame {
            poses = vec![started.pose.clone()];
        }
        let capture = match capture {
            Ok(capture) => capture,
            Err(error) => {
                return Ok(TrackedFrame {
                    pose: poses[poses.len() - 1].clone(),
                    energy: 0.0,
                    inlier_share: 0.0,
                    error: Some(error.to_string()),
                    explains: false,
                });
            }
        };
        let mut solution = self.track_frame(solver, &capture, &poses)?;
        let usual = median_energy(frames);
        if self.is_suspicious(&solution, usual) {
            solution = self.restart(solver, search, &capture, &poses, solution)?;
        }
        let explains = !self.is_suspicious(&solution, usual);
        Ok(TrackedFrame {
            explains,
            pose: solution.pose,
            energy: solution.energy,
            inlier_share: solution.inlier_share,
            error: None,
        })
    }

    fn is_suspicious(&self, solution: &PoseSolution, usual: Option<f64>) -> bool {
        solution.inlier_share < self.config.codes.inlier_share
            || usual.is_some_and(|usual| solution.energy > SUSPICIOUS_RATIO * usual)
    }

    /// Searches a frame afresh with the identity known; keeps whatever explains it best.
    fn restart(
        &self,
        solver: &PoseSolver<'_>,
        search: &StartSearch<'_>,
        capture: &CapturedFrame,
        poses: &[Vec<f64>],
        current: PoseSolution,
    ) -> Result<PoseSolution, FitSequenceError> {
        let hints = vec![current.pose.clone(), poses[poses.len() - 1].clone()];
        let mut best = current;
        for start in search.search(capture, Some(&solver.fine.identity), &hints).into_iter().take(3) {
            let prior =
                AnglePrior { pulls: vec![(vec![0.0; start.pose.len()], self.config.track.rest_stiffness)] };
            let solution = solver.solve(capture, &start.pose, &prior)?;
            if solution.energy < best.energy {
                best = solution;
            }
        }
        Ok(best)
    }
}

/// Initial frames over which the first identity is refined: neighbours in time say the same again.
const INITIAL_SPREAD: usize = 8;
/// Frames whose median energy is what is usual.
const USUAL_FRAMES: usize = 15;

fn median_energy(frames: &[TrackedFrame]) -> Option<f64> {
    let mut energies: Vec<f64> =
        frames.iter().rev().filter(|frame| frame.is_trusted()).take(USUAL_FRAMES).map(|f| f.energy).collect();
    if energies.len() < 3 {
        return None;
    }
    energies.sort_by(f64::total_cmp);
    Some(energies[energies.len() / 2])
}
