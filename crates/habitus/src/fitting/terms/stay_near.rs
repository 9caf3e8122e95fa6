//! Keeps parameters near given values.

use habitus_optimize::Sink;

use super::super::deformer::DeformedSurface;
use super::super::fit::Term;

/// Σ stiffness_k (x_k − target_k)²: P2 Eq. 8's ω_r ‖β − β₀‖², population priors, temporal predictions.
pub struct StayNear {
    pulls: Vec<(usize, f64, f64)>,
}

impl StayNear {
    /// Pulls parameter `first + k` to `targets[k]` with `stiffness[k]`.
    pub fn new(first: usize, targets: &[f64], stiffness: &[f64]) -> Self {
        let pulls = targets.iter().zip(stiffness).enumerate().map(|(k, (t, s))| (first + k, *t, *s));
        Self { pulls: pulls.filter(|(_, _, stiffness)| *stiffness > 0.0).collect() }
    }
}

impl Term for StayNear {
    fn name(&self) -> &'static str {
        "stay_near"
    }

    fn add_to(&self, _: &dyn DeformedSurface, parameters: &[f64], weight: f64, sink: &mut dyn Sink) {
        for (parameter, target, stiffness) in &self.pulls {
            sink.add(weight * stiffness, &[parameters[*parameter] - target], &[*parameter], &[1.0]);
        }
    }
}
