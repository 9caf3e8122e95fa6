//! Joint refinement of identity and poses over evenly spread frames: first in the space, then with local shapes beside it.

use habitus_optimize::{Event, Observer};

use super::captured_frame::LimbSearch;
use super::clearances::Clearances;
use super::kept_captures::KeptCaptures;
use super::local_body::LocalBody;
use super::refine_identity::{Contact, refine_pass, spread};
use super::{FitSequenceError, Stage, Track, progress};

/// What the passes hand on to one another.
struct Refinement<'a> {
    /// Frames that take part.
    frames: Vec<usize>,
    /// Poses of all frames as they were tracked.
    tracked: Vec<Vec<f64>>,
    /// Poses of all frames as they are now.
    poses: Vec<Vec<f64>>,
    /// What the last pass saw between skin and cloth.
    clearances: Option<Clearances>,
    captures: KeptCaptures<'a>,
}

impl Stage<'_> {
    /// Refines the identity and the poses of the trusted frames (see `refine_identity`).
    pub(super) fn refine(
        &self,
        track: &mut Track,
        observer: &mut dyn Observer,
    ) -> Result<(), FitSequenceError> {
        let frames = spread(&track.trusted(), self.config.refine.frame_limit);
        if frames.is_empty() {
            return Ok(());
        }
        let tracked: Vec<Vec<f64>> = track.frames.iter().map(|frame| frame.pose.clone()).collect();
        let captures = KeptCaptures::new(self, track.orientation.fit_from_input, LimbSearch::Unneeded);
        let poses = tracked.clone();
        let mut state = Refinement { frames, tracked, poses, clearances: None, captures };
        let outside_share = self.refine_in_space(track, &mut state, observer)?;
        // Whom the space does not get inside is no person of it: local shapes must not hide that.
        if outside_share <= self.config.refine.local_outside_share {
            self.refine_local_shapes(track, &mut state, observer)?;
        }
        for frame in state.frames {
            track.frames[frame].pose = std::mem::take(&mut state.poses[frame]);
        }
        Ok(())
    }

    /// The passes in the space; returns the share of vertices more than 5 mm outside in the last of them.
    fn refine_in_space(
        &self,
        track: &mut Track,
        state: &mut Refinement<'_>,
        observer: &mut dyn Observer,
    ) -> Result<f64, FitSequenceError> {
        let config = &self.config.refine;
        let mut outside_share = 0.0;
        for pass in 0..config.passes {
            progress(observer, "refine", pass, config.passes + config.local_passes + 1)?;
            let solver = self.solver_at(&self.medium, &self.refine_surface, &track.identity)?;
            let load = |frame: usize| state.captures.load(frame).ok();
            let prior = |frame: usize| self.smoothness_prior(&state.tracked, frame);
            let contact = Contact {
                earlier: state.clearances.as_ref(),
                scale: config.contact_scale(pass, config.passes),
                posture: None,
            };
            let step =
                refine_pass(&solver, &state.frames, &load, &mut state.poses, &prior, &contact, config)?;
            track.identity = step.coefficients;
            track.covariance = step.covariance;
            state.clearances = Some(step.clearances);
            outside_share = step.outside_share_5mm;
            let (index, energy) = (pass, step.energy);
            observer.on_event(&Event::Round { name: "refine", index, count: config.passes, energy });
        }
        Ok(outside_share)
    }

    /// The last passes: local shapes are free, too, at the scale of contact that the space has come to.
    fn refine_local_shapes(
        &self,
        track: &mut Track,
        state: &mut Refinement<'_>,
        observer: &mut dyn Observer,
    ) -> Result<(), FitSequenceError> {
        let config = &self.config.refine;
        if config.local_passes == 0 {
            return Ok(());
        }
        let local = LocalBody::new(self.model, &self.medium, track.identity.len(), config);
        let mut body = local.rest_body(&track.identity);
        for pass in 0..config.local_passes {
            progress(observer, "refine", config.passes + pass, config.passes + config.local_passes + 1)?;
            let solver = self.solver_of(&local.level, &self.refine_surface, &body)?;
            let load = |frame: usize| state.captures.load(frame).ok();
            let prior = |frame: usize| self.smoothness_prior(&state.tracked, frame);
            let contact = Contact {
                earlier: state.clearances.as_ref(),
                scale: config.contact_scale[1],
                posture: Some(&local.posture),
            };
            let step =
                refine_pass(&solver, &state.frames, &load, &mut state.poses, &prior, &contact, config)?;
            body = local.rest_body(&step.coefficients);
            // What the space's coefficients may be, whatever the local shapes are.
            let own = track.identity.len();
            track.covariance = step.covariance.view((0, 0), (own, own)).into_owned();
            state.clearances = Some(step.clearances);
            let (index, energy) = (pass, step.energy);
            observer.on_event(&Event::Round {
                name: "refine local shapes",
                index,
                count: config.local_passes,
                energy,
            });
        }
        track.identity = body.coefficients[..track.identity.len()].to_vec();
        track.body = Some(body);
        Ok(())
    }
}
