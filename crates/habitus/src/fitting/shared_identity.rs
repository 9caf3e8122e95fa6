//! Several fits of one body: the identity is shared, each has a pose of its own (P1 §6, P2 §4.5).

use habitus_optimize::{
    Bounds, GaussNewtonSettings, Objective, Silent, Sink, SolveError, Wanted, gauss_newton,
};
use nalgebra::DMatrix;

use super::deformers::{BodyParameters, FreeParameters};
use super::fit::Fit;
use super::gaps::ScanPoints;
use super::model_fit::{ModelFitter, ModelState};
use super::terms::{ClosestPoints, DistanceForm, StayNear};
use crate::body::{IdentityCoefficients, ROOT_LENGTH};

/// Parameters: the identity, then the pose of each fit. Every fit deforms a body by identity and pose together.
pub struct SharedIdentity<'a> {
    fits: Vec<Fit<'a>>,
    identity_count: usize,
    pose_length: usize,
}

impl<'a> SharedIdentity<'a> {
    /// Joins fits that have `identity_count` parameters of identity first and their pose after them.
    pub fn new(fits: Vec<Fit<'a>>, identity_count: usize) -> Self {
        let pose_length = fits.first().map_or(0, |fit| fit.parameter_count() - identity_count);
        assert!(fits.iter().all(|fit| fit.parameter_count() == identity_count + pose_length), "alike fits");
        Self { fits, identity_count, pose_length }
    }
}

impl Objective for SharedIdentity<'_> {
    fn parameter_count(&self) -> usize {
        self.identity_count + self.fits.len() * self.pose_length
    }

    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
        for (index, fit) in self.fits.iter().enumerate() {
            let first = self.identity_count + index * self.pose_length;
            let own =
                [&parameters[..self.identity_count], &parameters[first..first + self.pose_length]].concat();
            let places = (0..self.identity_count).chain(first..first + self.pose_length).collect();
            fit.add_to(&own, &mut Placed { sink, places });
        }
    }
}

/// Gives the columns of one fit their places among all parameters.
struct Placed<'a> {
    sink: &'a mut dyn Sink,
    places: Vec<usize>,
}

impl Placed<'_> {
    fn placed(&self, columns: &[usize]) -> Vec<usize> {
        columns.iter().map(|column| self.places[*column]).collect()
    }
}

impl Sink for Placed<'_> {
    fn wanted(&self) -> Wanted {
        self.sink.wanted()
    }

    fn begin_part(&mut self, name: &'static str) {
        self.sink.begin_part(name);
    }

    fn add(&mut self, weight: f64, residual: &[f64], columns: &[usize], jacobian: &[f64]) {
        let columns = self.placed(columns);
        self.sink.add(weight, residual, &columns, jacobian);
    }

    fn add_assembled(
        &mut self,
        value: f64,
        columns: &[usize],
        half_gradient: &[f64],
        normal_matrix: Option<&DMatrix<f64>>,
    ) {
        let columns = self.placed(columns);
        self.sink.add_assembled(value, &columns, half_gradient, normal_matrix);
    }
}

impl ModelFitter<'_> {
    /// All rounds of one level for several scans of one person: one identity, a pose for each scan. The first state's
    /// identity is where it starts.
    pub fn fit_level_together(
        &self,
        level: usize,
        states: &mut [ModelState],
        scans: &[ScanPoints<'_>],
    ) -> Result<(), SolveError> {
        let mut hints = vec![Vec::new(); scans.len()];
        for round in 0..self.config.levels[level].rounds {
            self.round_together([level, round], states, scans, &mut hints)?;
        }
        Ok(())
    }

    fn round_together(
        &self,
        [level, round]: [usize; 2],
        states: &mut [ModelState],
        scans: &[ScanPoints<'_>],
        hints: &mut [Vec<u32>],
    ) -> Result<(), SolveError> {
        let rounds = &self.config.levels[level];
        let level = &self.levels[level];
        let terms: Vec<ClosestPoints> = states
            .iter()
            .zip(scans)
            .zip(hints)
            .map(|((state, scan), hints)| {
                let vertices = self.vertices(state);
                let pairs = self.gather(level, rounds, round, &vertices, scan, hints);
                ClosestPoints::new(&pairs, DistanceForm::Plane)
            })
            .collect();
        let components = level.surface.component_count();
        let skeleton = level.surface.skeleton();
        let count = level.vertices.len() as f64;
        let variance = (self.config.residual_mm / 1000.0).powi(2) * count / self.config.independent_residuals;
        let spread = self.config.angle_spread_deg.to_radians();
        // The population speaks once, however many scans there are.
        let mut stiffness = vec![variance / states.len().max(1) as f64; components];
        stiffness.extend(vec![0.0; ROOT_LENGTH]);
        stiffness.extend(vec![variance / (spread * spread); skeleton.axes().len()]);
        let prior = StayNear::new(0, &vec![0.0; stiffness.len()], &stiffness);
        let deformer = BodyParameters::new(&level.surface, FreeParameters::IdentityAndPose);
        let fits = terms.iter().map(|term| Fit::new(&deformer).with(1.0, &prior).with(1.0, term)).collect();
        let shared = SharedIdentity::new(fits, components);
        let mut parameters = states.first().map_or_else(Vec::new, |state| state.identity.clone());
        parameters.resize(components, 0.0);
        let limit = IdentityCoefficients::LIMIT;
        let (mut lower, mut upper) = (vec![-limit; components], vec![limit; components]);
        let (low, high) = skeleton.pose_limits();
        for state in states.iter() {
            parameters.extend(&state.pose);
            lower.extend(&low);
            upper.extend(&high);
        }
        let settings = GaussNewtonSettings { max_iterations: 1, ..GaussNewtonSettings::default() };
        gauss_newton(&shared, &mut parameters, &Bounds::new(lower, upper)?, &settings, &mut Silent)?;
        let (identity, poses) = parameters.split_at(components);
        for (state, pose) in states.iter_mut().zip(poses.chunks_exact(low.len())) {
            state.identity = identity.to_vec();
            state.pose = pose.to_vec();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use habitus_optimize::assert_derivatives_match;

    use super::*;
    use crate::body::fixture;
    use crate::fitting::deformers::{BodyParameters, FreeParameters};
    use crate::fitting::terms::{LandmarkPull, LandmarkTargets};

    #[test]
    fn derivatives_of_two_poses_of_one_identity_match_differences() {
        let model = fixture::model_with_segments(6);
        let pull = |vertex: u32| LandmarkPull {
            vertex,
            target: DVec3::new(0.1 * f64::from(vertex), 0.5, -0.2),
            confidence: 0.5,
        };
        let terms: Vec<LandmarkTargets> =
            [[3, 40], [11, 90]].map(|vertices| LandmarkTargets::new(&vertices.map(pull))).into();
        let deformer = BodyParameters::new(model.surface(), FreeParameters::IdentityAndPose);
        let fits = terms.iter().map(|term| Fit::new(&deformer).with(1.0, term)).collect();
        let shared = SharedIdentity::new(fits, model.component_count());
        let parameters: Vec<f64> =
            (0..shared.parameter_count()).map(|k| 0.2 * (1.7 * k as f64).sin()).collect();
        assert_derivatives_match(&shared, &parameters);
    }
}
