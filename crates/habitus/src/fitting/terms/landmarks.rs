//! Pulls landmark vertices to landmark positions.

use glam::DVec3;
use habitus_optimize::Sink;

use super::super::deformer::{DeformedSurface, VertexResidual};
use super::super::fit::Term;
use super::closest_points::add_scaled;

/// Where one landmark vertex should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkPull {
    /// Vertex of the surface that is fitted.
    pub vertex: u32,
    /// Position in metres.
    pub target: DVec3,
    /// Confidence between 0 and 1, used as the weight.
    pub confidence: f64,
}

/// P2 Eq. 6 (P1 Eq. 6): Σ ‖s_i − l_i‖², each landmark weighted by its confidence.
pub struct LandmarkTargets {
    residuals: Vec<VertexResidual>,
}

impl LandmarkTargets {
    /// Takes the pulls.
    pub fn new(pulls: &[LandmarkPull]) -> Self {
        let residuals = pulls
            .iter()
            .flat_map(|pull| {
                DVec3::AXES.map(|direction| VertexResidual {
                    vertex: pull.vertex,
                    direction,
                    target: pull.target,
                    weight: pull.confidence,
                })
            })
            .collect();
        Self { residuals }
    }

    /// The frozen residuals.
    pub fn residuals(&self) -> &[VertexResidual] {
        &self.residuals
    }
}

impl Term for LandmarkTargets {
    fn name(&self) -> &'static str {
        "landmarks"
    }

    fn add_to(&self, surface: &dyn DeformedSurface, _: &[f64], weight: f64, sink: &mut dyn Sink) {
        add_scaled(surface, &self.residuals, weight, sink);
    }
}
