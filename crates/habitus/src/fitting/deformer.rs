//! Parameters to vertices, and the derivatives of vertices.

use glam::DVec3;
use habitus_optimize::{Sink, Wanted};

/// One scalar residual of a bent surface: `weight · (direction · (vertex − target))²`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexResidual {
    /// The vertex.
    pub vertex: u32,
    /// Direction in which the distance counts; its length scales the residual.
    pub direction: DVec3,
    /// Where the vertex should be, in metres.
    pub target: DVec3,
    /// Weight of the square.
    pub weight: f64,
}

impl VertexResidual {
    /// The residual of a vertex at `position`, in metres.
    pub fn value(&self, position: DVec3) -> f64 {
        self.direction.dot(position - self.target)
    }
}

/// Derivatives of one vertex: `columns[k] = (parameter, d position / d parameter)`.
pub type DerivativeColumns = Vec<(usize, DVec3)>;

/// Parameters to vertex positions.
pub trait Deformer {
    /// Number of parameters.
    fn parameter_count(&self) -> usize;

    /// The surface at these parameters, computed once and seen by all terms.
    fn deform<'a>(&'a self, parameters: &'a [f64]) -> Box<dyn DeformedSurface + 'a>;
}

/// A surface at fixed parameters.
pub trait DeformedSurface {
    /// Vertex positions in metres.
    fn vertices(&self) -> &[DVec3];

    /// Appends the derivatives of one vertex.
    fn vertex_derivatives(&self, vertex: usize, columns: &mut DerivativeColumns);

    /// Adds weighted squares of vertex residuals. This plain form is the oracle of batched forms.
    fn add_vertex_residuals(&self, residuals: &[VertexResidual], sink: &mut dyn Sink) {
        let with_derivatives = sink.wanted() > Wanted::Value;
        let mut derivatives = DerivativeColumns::new();
        let (mut columns, mut jacobian) = (Vec::new(), Vec::new());
        for residual in residuals {
            derivatives.clear();
            if with_derivatives {
                self.vertex_derivatives(residual.vertex as usize, &mut derivatives);
            }
            columns.clear();
            jacobian.clear();
            for (parameter, derivative) in &derivatives {
                columns.push(*parameter);
                jacobian.push(residual.direction.dot(*derivative));
            }
            let value = residual.value(self.vertices()[residual.vertex as usize]);
            sink.add(residual.weight, &[value], &columns, &jacobian);
        }
    }
}
