//! Looks at a tracked motion again, from its end and from its start.
//!
//! Tracking knows the past alone. A foot that swings unseen inside a wide trouser leg can be lost there and found when it
//! stands; from that frame backwards it is often not lost. Deviation: P2 §4.5 tracks forwards only.

use std::collections::BTreeSet;

use glam::DVec3;
use habitus_optimize::Observer;
use rayon::prelude::*;

use super::captured_frame::FitFromInput;
use super::pose_solver::PoseSolver;
use super::track_pose::{Recent, TrackedFrame, usual_energy};
use super::{FitSequenceError, Stage, progress};

/// Poses whose joints are all nearer to each other than this, metres, are the same minimum of the energy.
const SAME_POSE: f64 = 0.03;

/// Rounds of both directions after which the motion is left as it is; two are usual.
const LARGEST_ROUND_COUNT: usize = 5;

impl Stage<'_> {
    /// Where the frames on one side of a frame expect its joints far from where they were tracked, tracks on from that side;
    /// keeps what explains the captures better and moves more evenly.
    pub(super) fn look_again(
        &self,
        identity: &[f64],
        fit_from_input: &FitFromInput,
        frames: &mut [TrackedFrame],
        observer: &mut dyn Observer,
    ) -> Result<(), FitSequenceError> {
        let forwards: Vec<usize> = (0..frames.len()).collect();
        let backwards: Vec<usize> = forwards.iter().rev().copied().collect();
        let mut motion = TrackedMotion {
            stage: self,
            solver: self.solver(identity)?,
            fit_from_input,
            usual_energy: usual_energy(frames),
            frames,
            rivals: Vec::new(),
        };
        // Where another way was looked for, with nothing changed nearby since.
        let mut settled = [BTreeSet::new(), BTreeSet::new()];
        for round in 0..LARGEST_ROUND_COUNT {
            let mut has_changed = false;
            for (direction, order) in [&backwards, &forwards].into_iter().enumerate() {
                let places: Vec<usize> =
                    (1..order.len()).filter(|place| settled[direction].insert(order[*place])).collect();
                let changed = motion.take_better_ways(order, &places)?;
                progress(observer, "second look", round + 1, LARGEST_ROUND_COUNT)?;
                has_changed |= !changed.is_empty();
                for settled in &mut settled {
                    settled.retain(|frame| changed.iter().all(|changed| frame.abs_diff(*changed) > 2));
                }
            }
            if !has_changed {
                break;
            }
        }
        motion.mark_rivals();
        Ok(())
    }
}

/// The frames as they are tracked by now, and what they are tracked with. Frames are gone through in an order, forwards
/// or backwards; places are positions in it.
struct TrackedMotion<'a> {
    stage: &'a Stage<'a>,
    solver: PoseSolver<'a>,
    fit_from_input: &'a FitFromInput,
    usual_energy: Option<f64>,
    frames: &'a mut [TrackedFrame],
    /// Frames as they were found and not kept.
    rivals: Vec<(usize, TrackedFrame)>,
}

impl TrackedMotion<'_> {
    /// Follows other ways from some places on and takes as much of each as helps; returns the frames that have changed.
    fn take_better_ways(
        &mut self,
        order: &[usize],
        places: &[usize],
    ) -> Result<BTreeSet<usize>, FitSequenceError> {
        let branches: Vec<_> = places.par_iter().map(|place| self.branch(order, *place)).collect();
        let mut changed = BTreeSet::new();
        for (place, branch) in places.iter().zip(branches) {
            let mut branch = branch?;
            let reach = place.saturating_sub(2)..(place + branch.len() + 2).min(order.len());
            if order[reach].iter().any(|frame| changed.contains(frame)) {
                branch = self.branch(order, *place)?;
            }
            let costs = (0..=branch.len()).map(|taken| self.cost(order, *place, &branch, taken));
            // The first of equals: nothing changes without a gain.
            let best = costs.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
            let taken = best.map_or(0, |(taken, _)| taken);
            for (step, (frame, found)) in order[*place..].iter().zip(branch).enumerate() {
                let mut other = found;
                if step < taken {
                    std::mem::swap(&mut self.frames[*frame], &mut other);
                    changed.insert(*frame);
                }
                self.rivals.push((*frame, other));
            }
        }
        Ok(changed)
    }

    /// Tracks on from the frames before a place, if they expect it elsewhere, until the motion as it is is met again.
    fn branch(&self, order: &[usize], first: usize) -> Result<Vec<TrackedFrame>, FitSequenceError> {
        let config = &self.stage.config.track;
        let mut branch: Vec<TrackedFrame> = Vec::new();
        for (place, frame) in order.iter().enumerate().skip(first) {
            let kept = &self.frames[*frame];
            let before: Vec<_> = (place.saturating_sub(2)..place)
                .map(|place| self.tracked_at(order, place, (first, &branch)))
                .collect();
            if kept.error.is_some() || !before.iter().all(|frame| frame.is_trusted()) {
                break;
            }
            let mut recent = Recent::of_frames(before.into_iter());
            let expected = recent.predict(self.stage.model.skeleton(), config.velocity);
            let is_expected = self.farthest_joint(&expected, &kept.pose) < config.second_look_distance;
            if branch.is_empty() && is_expected {
                break;
            }
            let Ok(capture) = self.stage.load(*frame, self.fit_from_input) else { break };
            let solution = self.stage.track_frame(&self.solver, &capture, &mut recent)?;
            if self.stage.is_suspicious(&solution, self.usual_energy)
                || self.farthest_joint(&solution.pose, &kept.pose) < SAME_POSE
            {
                break;
            }
            branch.push(TrackedFrame::found(solution, &capture, true));
        }
        Ok(branch)
    }

    /// What the motion costs from the place of a branch to its end if so many frames of it are taken: energies, and what
    /// the joint that changes its velocity most does in each frame.
    fn cost(&self, order: &[usize], first: usize, branch: &[TrackedFrame], taken: usize) -> f64 {
        let tracked_at = |place: usize| self.tracked_at(order, place, (first, &branch[..taken]));
        let end = first + branch.len();
        let energy: f64 = (first..end).map(|place| tracked_at(place).energy).sum();
        let joints = |place: usize| self.solver.coarse.posed(&tracked_at(place).pose).joints;
        let unevenness: f64 = (first.saturating_sub(1).max(1)..(end + 1).min(order.len().saturating_sub(1)))
            .map(|place| {
                let (before, here, after) = (joints(place - 1), joints(place), joints(place + 1));
                let change =
                    |joint: usize| (before[joint] + after[joint] - 2.0 * here[joint]).length_squared();
                (0..here.len()).map(change).fold(0.0, f64::max)
            })
            .sum();
        energy + self.stage.config.track.unevenness_weight * unevenness
    }

    /// Marks the frames that another pose explains almost as well.
    fn mark_rivals(&mut self) {
        let codes = &self.stage.config.codes;
        for (frame, rival) in std::mem::take(&mut self.rivals) {
            let kept = &self.frames[frame];
            let is_elsewhere = self.farthest_joint(&rival.pose, &kept.pose) > codes.rival_distance;
            if is_elsewhere && rival.energy < codes.rival_ratio * kept.energy {
                self.frames[frame].has_rival = true;
            }
        }
    }

    /// The frame at a place of the order, with a branch from its first place on instead of what is there.
    fn tracked_at<'b>(
        &'b self,
        order: &[usize],
        place: usize,
        (first, branch): (usize, &'b [TrackedFrame]),
    ) -> &'b TrackedFrame {
        let of_branch = place.checked_sub(first).and_then(|place| branch.get(place));
        of_branch.unwrap_or(&self.frames[order[place]])
    }

    /// Largest distance between the joints of two poses, metres.
    fn farthest_joint(&self, a: &[f64], b: &[f64]) -> f64 {
        let joints = |pose: &[f64]| -> Vec<DVec3> { self.solver.coarse.posed(pose).joints };
        joints(a).iter().zip(&joints(b)).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use habitus_geometry::{Surface, TriangleMesh};
    use habitus_optimize::Silent;

    use super::super::captured_frame::size_of;
    use super::super::config::{FitSequenceConfig, TrackConfig};
    use super::super::pose_solver::PosePrior;
    use super::*;
    use crate::artifacts::frames::FramesInMemory;
    use crate::body::{BodyModel, ROOT_LENGTH};

    #[test]
    fn a_frame_that_was_led_astray_is_found_from_the_frame_after_it_and_the_others_stay() {
        let model = BodyModel::default_space().expect("the embedded model");
        let rest = model.mean_vertices().to_vec();
        let axis_of = |name: &str| {
            let bone = model.skeleton().bones().iter().position(|bone| bone.name == name).expect("a bone");
            ROOT_LENGTH + model.skeleton().axes().iter().position(|axis| axis.bone == bone).expect("an axis")
        };
        // A leg that swings.
        let pose_at = |frame: usize| {
            let mut pose = vec![0.0; model.skeleton().pose_length()];
            pose[axis_of("left_thigh")] = 0.1 * frame as f64;
            pose[axis_of("left_shank")] = 0.2;
            pose
        };
        let capture_of = |pose: &[f64]| {
            let joints = model.joints(&rest);
            let vertices = model.pose_vertices(&rest, &model.skeleton().pose(&joints, pose));
            Surface::Mesh(TriangleMesh::new(vertices, model.faces().to_vec()).expect("a mesh"))
        };
        let surfaces: Vec<Surface> = (0..5).map(|frame| capture_of(&pose_at(frame))).collect();
        let fit_from_input = FitFromInput {
            scale: 1.0,
            rotation: DMat3::IDENTITY,
            translation: DVec3::ZERO,
            usual_size: size_of(&surfaces[0]),
        };
        let source = FramesInMemory { surfaces };
        let config = FitSequenceConfig { components: 1, ..FitSequenceConfig::default() };
        let stage = Stage::new(&source, &model, &config, &[]);
        let solver = stage.solver(&[0.0]).expect("a solver");
        let tracked = |frame: usize, pose: Vec<f64>| {
            let capture = stage.load(frame, &fit_from_input).expect("a capture");
            let solution = solver.polish(&capture, pose, &PosePrior::default(), 0).expect("a verdict");
            TrackedFrame::found(solution, &capture, true)
        };
        let mut frames: Vec<TrackedFrame> = (0..5).map(|frame| tracked(frame, pose_at(frame))).collect();
        let right = frames.clone();
        let mut astray = pose_at(2);
        astray[axis_of("left_shank")] += 0.5;
        frames[2] = tracked(2, astray);
        stage.look_again(&[0.0], &fit_from_input, &mut frames, &mut Silent).expect("a second look");
        for (frame, (found, right)) in frames.iter().zip(&right).enumerate() {
            if frame == 2 {
                let angle = found.pose[axis_of("left_shank")];
                assert!((angle - 0.2).abs() < 0.05, "the knee is bent by {angle}");
            } else {
                assert_eq!(found.pose, right.pose, "frame {frame} was right and has moved");
            }
        }
        assert!(TrackConfig::default().second_look_distance > SAME_POSE);
    }
}
