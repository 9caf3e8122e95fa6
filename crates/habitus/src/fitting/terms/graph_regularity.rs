//! What keeps the nodes of a deformation graph together.

use glam::DVec3;
use habitus_optimize::{Sink, Wanted};

use super::super::deformer::DeformedSurface;
use super::super::deformers::{GraphDeformer, NODE_PARAMETERS, NodeMotion};
use super::super::fit::Term;

/// Neighbours agree about where each of them goes: Σ ‖R_j (g_k − g_j) + g_j + t_j − (g_k + t_k)‖² over both
/// directions of each edge (Sumner et al. 2007, Eq. 8; E_smooth of Li et al. 2009). As nodes do not stretch, this is
/// what keeps lengths, too.
pub struct GraphRigidity<'a>(pub &'a GraphDeformer<'a>);

/// Neighbours turn alike: Σ ‖g_k − g_j‖² ‖R_j − R_k‖² over edges, in square metres; keeps bends wide.
pub struct GraphSmoothness<'a>(pub &'a GraphDeformer<'a>);

/// Columns 3 × 3, row by row, of the derivative of `R · arm` by a node's turn.
fn turn_jacobian(motion: &NodeMotion, turned_arm: DVec3) -> [DVec3; 3] {
    std::array::from_fn(|axis| motion.turn_derivative.col(axis).cross(turned_arm))
}

impl Term for GraphRigidity<'_> {
    fn name(&self) -> &'static str {
        "graph_rigidity"
    }

    fn add_to(&self, _: &dyn DeformedSurface, parameters: &[f64], weight: f64, sink: &mut dyn Sink) {
        let graph = self.0.graph();
        let motions = self.0.motions(parameters);
        let with_derivatives = sink.wanted() > Wanted::Value;
        for [a, b] in graph.edges() {
            for (j, k) in [(*a as usize, *b as usize), (*b as usize, *a as usize)] {
                let edge = graph.node(k) - graph.node(j);
                let turned = motions[j].rotation * edge;
                let residual = turned + motions[j].translation - edge - motions[k].translation;
                if !with_derivatives {
                    sink.add(weight, &residual.to_array(), &[], &[]);
                    continue;
                }
                let (first, other) = (j * NODE_PARAMETERS, k * NODE_PARAMETERS + 3);
                let columns: [usize; 9] =
                    std::array::from_fn(|c| if c < 6 { first + c } else { other + c - 6 });
                let derivatives = turn_jacobian(&motions[j], turned);
                let mut jacobian = [0.0; 27];
                for row in 0..3 {
                    for (column, derivative) in derivatives.iter().enumerate() {
                        jacobian[9 * row + column] = derivative[row];
                    }
                    jacobian[9 * row + 3 + row] = 1.0;
                    jacobian[9 * row + 6 + row] = -1.0;
                }
                sink.add(weight, &residual.to_array(), &columns, &jacobian);
            }
        }
    }
}

impl Term for GraphSmoothness<'_> {
    fn name(&self) -> &'static str {
        "graph_smoothness"
    }

    fn add_to(&self, _: &dyn DeformedSurface, parameters: &[f64], weight: f64, sink: &mut dyn Sink) {
        let graph = self.0.graph();
        let motions = self.0.motions(parameters);
        let with_derivatives = sink.wanted() > Wanted::Value;
        for [j, k] in graph.edges() {
            let (j, k) = (*j as usize, *k as usize);
            let length = graph.node(k).distance(graph.node(j));
            let columns: [usize; 6] = std::array::from_fn(|c| {
                if c < 3 { j * NODE_PARAMETERS + c } else { k * NODE_PARAMETERS + c - 3 }
            });
            for axis in 0..3 {
                let (one, other) = (motions[j].rotation.col(axis), motions[k].rotation.col(axis));
                let residual = (one - other) * length;
                if !with_derivatives {
                    sink.add(weight, &residual.to_array(), &[], &[]);
                    continue;
                }
                let derivatives = [turn_jacobian(&motions[j], one), turn_jacobian(&motions[k], other)];
                let mut jacobian = [0.0; 18];
                for row in 0..3 {
                    for column in 0..3 {
                        jacobian[6 * row + column] = derivatives[0][column][row] * length;
                        jacobian[6 * row + 3 + column] = -derivatives[1][column][row] * length;
                    }
                }
                sink.add(weight, &residual.to_array(), &columns, &jacobian);
            }
        }
    }
}
