//! Keeps the affine maps of neighbouring vertices alike.

use glam::DVec3;
use habitus_optimize::{Sink, Wanted};

use super::super::deformer::DeformedSurface;
use super::super::deformers::{PARAMETERS_PER_VERTEX, VertexAffines};
use super::super::fit::Term;

/// Where the difference of two affine maps is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AffineMetric {
    /// At the middle of the edge, the linear parts over the surface's size: the same for every origin and unit.
    AtEdge,
    /// P1 Eq. 5 as printed, ‖A_i − A_j‖_F² of 4 × 4 matrices over absolute coordinates; `unit` is the length in metres
    /// in which coordinates count (0.001 for millimetres). It depends on where the origin is.
    Printed {
        /// Metres in one unit.
        unit: f64,
    },
}

/// P1 Eq. 5: Σ ‖A_i − A_j‖_F² over the edges, in square metres: ‖A_i(c) − A_j(c)‖² + r² ‖M_i − M_j‖² with the linear
/// parts M, the point c and the length r of the metric.
pub struct SmoothAffines<'a> {
    affines: &'a VertexAffines,
    edges: &'a [[u32; 2]],
    metric: AffineMetric,
}

impl<'a> SmoothAffines<'a> {
    /// Takes the edges of the surface.
    pub fn new(affines: &'a VertexAffines, edges: &'a [[u32; 2]], metric: AffineMetric) -> Self {
        Self { affines, edges, metric }
    }

    /// The rows of one edge and one axis over the parameters (b_i, t_i, b_j, t_j) of that axis, each four; and the
    /// constant of the last row is zero, because equal maps differ nowhere.
    pub fn rows(&self, edge: [u32; 2]) -> [[f64; 8]; 4] {
        let [first, second] = edge.map(|vertex| self.affines.rest()[vertex as usize]);
        let size = self.affines.size();
        let (centre, radius) = match self.metric {
            AffineMetric::AtEdge => ((first + second) * 0.5, size),
            AffineMetric::Printed { unit } => (DVec3::ZERO, unit),
        };
        let mut rows = [[0.0; 8]; 4];
        for (k, row) in rows.iter_mut().take(3).enumerate() {
            row[k] = radius / size;
            row[4 + k] = -radius / size;
        }
        let (lever, other_lever) = ((centre - first) / size, (centre - second) / size);
        rows[3] = [lever.x, lever.y, lever.z, 1.0, -other_lever.x, -other_lever.y, -other_lever.z, -1.0];
        rows
    }

    /// The edges.
    pub fn edges(&self) -> &[[u32; 2]] {
        self.edges
    }
}

impl Term for SmoothAffines<'_> {
    fn name(&self) -> &'static str {
        "smooth_affines"
    }

    fn add_to(&self, _: &dyn DeformedSurface, parameters: &[f64], weight: f64, sink: &mut dyn Sink) {
        let with_derivatives = sink.wanted() > Wanted::Value;
        for edge in self.edges {
            let rows = self.rows(*edge);
            for axis in 0..3 {
                let columns: [usize; 8] =
                    std::array::from_fn(|k| PARAMETERS_PER_VERTEX * edge[k / 4] as usize + 4 * axis + k % 4);
                let residual =
                    rows.map(|row| row.iter().zip(columns).map(|(entry, k)| entry * parameters[k]).sum());
                if with_derivatives {
                    sink.add(weight, &residual, &columns, rows.as_flattened());
                } else {
                    sink.add(weight, &residual, &[], &[]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use habitus_optimize::ValueSum;

    use super::*;
    use crate::fitting::Fit;

    fn energy(affines: &VertexAffines, metric: AffineMetric, parameters: &[f64]) -> f64 {
        let term = SmoothAffines::new(affines, &[[0, 1]], metric);
        ValueSum::of(&Fit::new(affines).with(1.0, &term), parameters).value
    }

    #[test]
    fn the_printed_metric_is_the_frobenius_norm_of_the_difference_of_matrices() {
        let rest = vec![DVec3::new(0.3, 1.2, -0.1), DVec3::new(0.32, 1.19, -0.11)];
        let affines = VertexAffines::new(rest.clone(), 1.7);
        let parameters: Vec<f64> = (0..24).map(|k| (f64::from(k) * 1.3).sin() * 0.1).collect();
        // A_i(q) = M q + d over millimetres, with d = p_i + t − M p_i.
        let vertices = affines.vertices(&parameters);
        let matrix = |vertex: usize| -> (DMat3, DVec3) {
            let linear = affines.linear(vertex, &parameters);
            (linear, (vertices[vertex] - linear * rest[vertex]) * 1000.0)
        };
        let ((first, first_offset), (second, second_offset)) = (matrix(0), matrix(1));
        let difference = first - second;
        let frobenius: f64 = difference.to_cols_array().iter().map(|entry| entry * entry).sum::<f64>()
            + (first_offset - second_offset).length_squared();
        let found = energy(&affines, AffineMetric::Printed { unit: 0.001 }, &parameters) * 1e6;
        assert!((found - frobenius).abs() < 1e-9 * frobenius, "{found} {frobenius}");
    }

    #[test]
    fn equal_maps_cost_nothing_and_no_origin_is_special_at_the_edge() {
        let at = |origin: DVec3| VertexAffines::new(vec![origin, origin + DVec3::new(0.02, 0.01, 0.0)], 1.7);
        let (here, there) = (at(DVec3::ZERO), at(DVec3::new(5.0, -3.0, 1.0)));
        // One and the same map A(q) = q + B q / size, as each vertex's parameters say it.
        let linear = [0.1, -0.2, 0.05, 0.3, 0.1, 0.0, -0.1, 0.2, 0.15];
        let mut parameters = vec![0.0; 24];
        for vertex in 0..2 {
            for axis in 0..3 {
                let row = &linear[3 * axis..3 * axis + 3];
                let start = PARAMETERS_PER_VERTEX * vertex + 4 * axis;
                parameters[start..start + 3].copy_from_slice(row);
                parameters[start + 3] = DVec3::from_slice(row).dot(here.rest()[vertex]) / here.size();
            }
        }
        assert!(energy(&here, AffineMetric::AtEdge, &parameters) < 1e-28);
        parameters[3] += 0.01;
        let difference = energy(&here, AffineMetric::AtEdge, &parameters)
            - energy(&there, AffineMetric::AtEdge, &parameters);
        assert!(difference.abs() < 1e-15);
        assert!((energy(&here, AffineMetric::AtEdge, &parameters) - 1e-4).abs() < 1e-12);
    }
}
