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

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn pair(vertex: u32, is_outside: bool) -> Correspondence {
        let signed_distance = if is_outside { 0.01 } else { -0.01 };
        Correspondence {
            vertex,
            target: DVec3::ZERO,
            normal: DVec3::X,
            is_outside,
            signed_distance,
            weight: 0.5,
        }
    }

    #[test]
    fn only_vertices_outside_are_pulled() {
        let pairs = [pair(0, true), pair(1, false), pair(2, true)];
        let plane = InsideClothing::new(&pairs, DistanceForm::Plane);
        let vertices: Vec<u32> = plane.residuals().iter().map(|residual| residual.vertex).collect();
        assert_eq!(vertices, [0, 2]);
        assert!(plane.residuals().iter().all(|residual| residual.weight == 0.5));
        let point = InsideClothing::new(&pairs, DistanceForm::Point);
        assert_eq!(point.residuals().len(), 6, "a point distance has three axes");
    }

    #[test]
    fn a_point_distance_is_the_squared_length_and_a_plane_distance_its_share_along_the_normal() {
        let position = DVec3::new(0.3, 0.4, 1.2);
        let energy = |form| -> f64 {
            let term = InsideClothing::new(&[pair(0, true)], form);
            term.residuals().iter().map(|residual| residual.value(position).powi(2)).sum()
        };
        assert!((energy(DistanceForm::Point) - 1.69).abs() < 1e-12);
        assert!((energy(DistanceForm::Plane) - 0.09).abs() < 1e-12);
    }
}
