//! Pulls vertices to their closest points on the capture.

use habitus_optimize::Sink;

use super::super::correspondence::Correspondence;
use super::super::deformer::{DeformedSurface, VertexResidual};
use super::super::fit::Term;

/// How the distance to a closest point counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DistanceForm {
    /// To the point itself, as P1 Eq. 4 and P2 Eq. 7 print it.
    Point,
    /// To the tangent plane there: lets the surface slide and converges faster.
    Plane,
}

/// P1 Eq. 4, P2 Eq. 7: Σ δ_NN w ‖s_i − NN(s_i)‖² over frozen correspondences with weights w.
pub struct ClosestPoints {
    residuals: Vec<VertexResidual>,
}

impl ClosestPoints {
    /// Freezes correspondences; each counts with its own weight.
    pub fn new(correspondences: &[Correspondence], form: DistanceForm) -> Self {
        Self { residuals: residuals(correspondences.iter(), form) }
    }

    /// The frozen residuals.
    pub fn residuals(&self) -> &[VertexResidual] {
        &self.residuals
    }
}

impl Term for ClosestPoints {
    fn name(&self) -> &'static str {
        "closest_points"
    }

    fn add_to(&self, surface: &dyn DeformedSurface, _: &[f64], weight: f64, sink: &mut dyn Sink) {
        add_scaled(surface, &self.residuals, weight, sink);
    }
}

/// Residuals of frozen correspondences; a point distance is three of them, one for each axis.
pub(super) fn residuals<'a>(
    correspondences: impl Iterator<Item = &'a Correspondence>,
    form: DistanceForm,
) -> Vec<VertexResidual> {
    let mut residuals = Vec::new();
    for pair in correspondences {
        let residual = |direction| VertexResidual {
            vertex: pair.vertex,
            direction,
            target: pair.target,
            weight: pair.weight,
        };
        match form {
            DistanceForm::Point => residuals.extend(glam::DVec3::AXES.map(residual)),
            DistanceForm::Plane => residuals.push(residual(pair.normal)),
        }
    }
    residuals
}

pub(super) fn add_scaled(
    surface: &dyn DeformedSurface,
    residuals: &[VertexResidual],
    weight: f64,
    sink: &mut dyn Sink,
) {
    if weight == 1.0 {
        surface.add_vertex_residuals(residuals, sink);
        return;
    }
    let scaled: Vec<VertexResidual> =
        residuals.iter().map(|r| VertexResidual { weight: r.weight * weight, ..*r }).collect();
    surface.add_vertex_residuals(&scaled, sink);
}
