//! Ends of limbs in the capture that no body covers, and poses that reach for them.
//!
//! Between the legs of a stride wide trousers close to one surface. A leg inside may swing through unseen, and tracking
//! leaves it behind; then the foot comes out in front of the hem, where no body is.

use glam::DVec3;
use habitus_geometry::PointGrid;

use super::body_levels::BodyLevel;
use super::captured_frame::CapturedFrame;
use super::choose_start::Started;
use super::config::{CodeThresholds, SurfaceConfig};
use super::pose_solver::{GivenLandmark, PosePrior, PoseSolution, PoseSolver};
use super::track_pose::{Recent, TrackedFrame, usual_energy};
use super::{FitSequenceError, Stage};

/// Samples this near to one another belong together, metres.
const LINK: f64 = 0.06;
/// Tips, the largest first, and ends of limbs, the nearest first, that are brought together.
const TRIED: [usize; 2] = [2, 2];
/// A pose that reaches for a tip must have this share of the other's energy at most: one that is as good as the other in one
/// frame and a little worse in the next would leave the limb flickering between both.
const CLEARLY_LESS: f64 = 0.95;

/// A connected group of samples that looks like the end of a limb and has no body near it.
struct UncoveredTip {
    middle: DVec3,
    /// Share of all samples.
    share: f64,
}

/// The tips without a body, the largest first.
fn uncovered_tips(
    frame: &CapturedFrame,
    vertices: &[DVec3],
    surface: &SurfaceConfig,
    codes: &CodeThresholds,
) -> Vec<UncoveredTip> {
    let grid = PointGrid::new(vertices);
    let sole = frame.bounds[0].y + surface.sole_height;
    let mut left: Vec<DVec3> = frame
        .samples
        .iter()
        .filter(|sample| sample.is_limb_like || sample.position.y < sole)
        .map(|sample| sample.position)
        .filter(|position| !grid.has_within(*position, codes.tip_distance))
        .collect();
    let mut tips = Vec::new();
    while let Some(seed) = left.pop() {
        let group = take_connected(seed, &mut left);
        let share = group.len() as f64 / frame.samples.len().max(1) as f64;
        if share >= codes.uncovered_tip_share {
            tips.push(UncoveredTip { middle: group.iter().sum::<DVec3>() / group.len() as f64, share });
        }
    }
    tips.sort_by(|a, b| b.share.total_cmp(&a.share));
    tips
}

/// Takes all points out of `left` that are linked to `seed`, by others if need be.
fn take_connected(seed: DVec3, left: &mut Vec<DVec3>) -> Vec<DVec3> {
    let mut group = vec![seed];
    let mut next = 0;
    while next < group.len() {
        let from = group[next];
        group.extend(left.extract_if(.., |other| from.distance(*other) < LINK));
        next += 1;
    }
    group
}

impl Stage<'_> {
    /// Poses that bring an end of a limb to where the capture has one and the body has none; the one that explains the
    /// frame best, or the given one.
    pub(super) fn reclaim_limbs(
        &self,
        solver: &PoseSolver<'_>,
        capture: &CapturedFrame,
        found: PoseSolution,
    ) -> Result<PoseSolution, FitSequenceError> {
        let body = &solver.coarse;
        let (vertices, _) = body.vertices_and_normals(&body.posed(&found.pose));
        let tips = uncovered_tips(capture, &vertices, solver.surface, &self.config.codes);
        let mut best = found;
        for tip in tips.into_iter().take(TRIED[0]) {
            for vertex in self.ends_near(tip.middle, body.level, &vertices) {
                let reached = self.reach_for(solver, capture, &best.pose, vertex, tip.middle)?;
                if reached.energy < CLEARLY_LESS * best.energy && reached.is_better_than(&best) {
                    best = reached;
                }
            }
        }
        Ok(best)
    }

    /// The landmark vertices of the model at ends of limbs (toes and heels), the nearest to a point first.
    fn ends_near(&self, point: DVec3, level: &BodyLevel, vertices: &[DVec3]) -> Vec<u32> {
        let bones = self.model.skeleton().bones();
        let is_end = |bone: u8| bones.iter().all(|other| other.parent != Some(usize::from(bone)));
        let mut ends: Vec<(f64, u32)> = self
            .model
            .landmark_vertices()
            .iter()
            .filter_map(|vertex| {
                let slot = level.vertices.binary_search(vertex).ok()?;
                is_end(level.main_bones[slot]).then(|| (vertices[slot].distance(point), *vertex))
            })
            .collect();
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        ends.into_iter().take(TRIED[1]).map(|(_, vertex)| vertex).collect()
    }

    /// Draws a vertex of the model to a point, then lets it go.
    fn reach_for(
        &self,
        solver: &PoseSolver<'_>,
        capture: &CapturedFrame,
        pose: &[f64],
        vertex: u32,
        point: DVec3,
    ) -> Result<PoseSolution, FitSequenceError> {
        let free = PosePrior { landmarks: capture.landmarks.clone(), ..self.rest_prior(pose.len()) };
        let mut drawn = free.clone();
        drawn.landmarks.push(GivenLandmark { vertex, position: point });
        let drawn = solver.solve(capture, pose, &drawn)?;
        solver.solve(capture, &drawn.pose, &free)
    }

    /// Goes back in time from each frame in which a limb was found again: it was lost for a while before, and coming from the
    /// other side tracking may hold it. Frames keep the pose that explains them better.
    pub(super) fn track_back(
        &self,
        started: &Started,
        frames: &mut [TrackedFrame],
    ) -> Result<(), FitSequenceError> {
        let solver = self.solver(&started.identity)?;
        let usual = usual_energy(frames);
        let mut is_going_back = false;
        for frame in (started.first_frame..frames.len().saturating_sub(1)).rev() {
            let later = &frames[frame + 1];
            let is_wanted = later.is_trusted() && (is_going_back || later.is_found_again);
            is_going_back = false;
            if !is_wanted {
                continue;
            }
            let Ok(capture) = self.load(frame, &started.orientation.fit_from_input) else { continue };
            let mut recent = Recent::of_frames_after(frames, frame);
            let solution = self.track_frame(&solver, &capture, &mut recent)?;
            let tracked = &mut frames[frame];
            if solution.energy < tracked.energy && !solution.has_lost_a_limb {
                is_going_back = true;
                tracked.explains = !self.is_suspicious(&solution, usual);
                tracked.pose = solution.pose;
                tracked.energy = solution.energy;
                tracked.inlier_share = solution.inlier_share;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connected_points_are_taken_through_others_and_the_rest_stays() {
        let chain = |start: f64| (0..5).map(move |k| DVec3::X * (start + 0.9 * LINK * f64::from(k)));
        let mut left: Vec<DVec3> = chain(0.0).chain(chain(1.0)).collect();
        let seed = left.remove(2);
        let mut taken = take_connected(seed, &mut left);
        taken.sort_by(|a, b| a.x.total_cmp(&b.x));
        assert_eq!(taken, chain(0.0).collect::<Vec<_>>());
        assert_eq!(left, chain(1.0).collect::<Vec<_>>());
    }
}
