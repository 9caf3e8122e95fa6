//! Keeps the body inside the clothing.

use habitus_optimize::Sink;

use super::super::correspondence::Correspondence;
use super::super::deformer::{DeformedSurface, VertexResidual};
use super::super::fit::Term;
use super::closest_points::{DistanceForm, add_scaled, residuals};

/// P2 Eq. 8 without its regularisation: Σ δ_out δ_NN ‖s_i − NN(s_i)‖². Which vertices are outside is frozen
/// with the correspondences; the regularisation is [`super::StayNear`].
pub struct InsideClothing {
    residuals: Vec<VertexResidual>,
}

impl InsideClothing {
    /// Freezes the correspondences of the vertices that are outside.
    pub fn new(correspondences: &[Correspondence], form: DistanceForm) -> Self {
        Self { residuals: residuals(correspondences.iter().filter(|pair| pair.is_outside), form) }
    }

    /// The frozen residuals.
    pub fn residuals(&self) -> &[VertexResidual] {
        &self.residuals
    }
}

impl Term for InsideClothing {
    fn name(&self) -> &'static str {
        "inside_clothing"
    }

    fn add_to(&self, surface: &dyn DeformedSurface, _: &[f64], weight: f64, sink: &mut dyn Sink) {
        add_scaled(surface, &self.residuals, weight, sink);
    }
}
