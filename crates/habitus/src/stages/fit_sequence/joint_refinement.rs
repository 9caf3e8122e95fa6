//! Joint refinement of identity and poses over evenly spread frames: first in the space, then with local shapes beside it.

use habitus_optimize::{Event, Observer};
use nalgebra::DMatrix;

use super::body_levels::{BodyLevel, RestBody};
use super::captured_frame::FitFromInput;
use super::clearances::Clearances;
use super::local_body::LocalBody;
use super::refine_identity::{Contact, IdentityStep, refine_pass, spread};
use super::{FitSequenceError, Stage, Track, progress};

/// What the passes hand on to one another.
struct Refinement {
    /// Frames that take part.
    frames: Vec<usize>,
    /// Poses of all frames as they were tracked.
    tracked: Vec<Vec<f64>>,
    /// Poses of all frames as they are now.
    poses: Vec<Vec<f64>>,
    /// What the last pass saw between skin and cloth.
    clearances: Option<Clearances>,
    fit_from_input: FitFromInput,
}

/// What one pass fits.
struct Pass<'a> {
    name: &'static str,
    /// Position among all passes.
    index: usize,
    /// Vertices and the components that move them.
    level: &'a BodyLevel,
    body: &'a RestBody,
    /// Geman–McClure scale of the attraction to the cloth, in metres.
    scale: f64,
    /// Functions of the coefficients that are posture (see `Contact`).
    posture: Option<&'a DMatrix<f64>>,
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
        self.captures.prefer(&frames);
        let poses = tracked.clone();
        let fit_from_input = track.orientation.fit_from_input;
        let mut state = Refinement { frames, tracked, poses, clearances: None, fit_from_input };
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
        state: &mut Refinement,
        observer: &mut dyn Observer,
    ) -> Result<f64, FitSequenceError> {
        let config = &self.config.refine;
        let mut outside_share = 0.0;
        for index in 0..config.passes {
            let body = RestBody::of_space(self.model, &track.identity);
            let (scale, posture) = (config.contact_scale(index, config.passes), None);
            let pass = Pass { name: "refine", index, level: &self.medium, body: &body, scale, posture };
            let step = self.pass(&pass, state, observer)?;
            track.identity = step.coefficients;
            track.covariance = step.covariance;
            outside_share = step.outside_share_5mm;
        }
        Ok(outside_share)
    }

    /// The last passes: local shapes are free, too, at the scale of contact that the space has come to.
    fn refine_local_shapes(
        &self,
        track: &mut Track,
        state: &mut Refinement,
        observer: &mut dyn Observer,
    ) -> Result<(), FitSequenceError> {
        let config = &self.config.refine;
        if config.local_passes == 0 {
            return Ok(());
        }
        let own = track.identity.len();
        let local = LocalBody::new(self.model, &self.medium, own, config);
        let mut body = local.rest_body(&track.identity);
        for index in config.passes..config.passes + config.local_passes {
            let (scale, posture) = (config.contact_scale[1], Some(&local.posture));
            let name = "refine local shapes";
            let pass = Pass { name, index, level: &local.level, body: &body, scale, posture };
            let step = self.pass(&pass, state, observer)?;
            body = local.rest_body(&step.coefficients);
            // What the space's coefficients may be, whatever the local shapes are.
            track.covariance = step.covariance.view((0, 0), (own, own)).into_owned();
        }
        track.identity = body.coefficients[..own].to_vec();
        track.body = Some(body);
        Ok(())
    }

    /// Polishes the poses for a body and steps its coefficients.
    fn pass(
        &self,
        pass: &Pass<'_>,
        state: &mut Refinement,
        observer: &mut dyn Observer,
    ) -> Result<IdentityStep, FitSequenceError> {
        let config = &self.config.refine;
        let count = config.passes + config.local_passes;
        // The final pass over all frames comes after these.
        progress(observer, "refine", pass.index, count + 1)?;
        let solver = self.solver_of(pass.level, &self.refine_surface, pass.body)?;
        let load = |frame: usize| self.load(frame, &state.fit_from_input).ok();
        let prior = |frame: usize| self.smoothness_prior(&state.tracked, frame);
        let contact =
            Contact { earlier: state.clearances.as_ref(), scale: pass.scale, posture: pass.posture };
        let (step, clearances) =
            refine_pass(&solver, &state.frames, &load, &mut state.poses, &prior, &contact, config)?;
        state.clearances = Some(clearances);
        let (name, index, energy) = (pass.name, pass.index, step.energy);
        observer.on_event(&Event::Round { name, index, count, energy });
        Ok(step)
    }
}
