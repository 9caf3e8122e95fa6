//! A freely bent surface: each vertex has its own affine map (P1 §3.1).

use glam::{DMat3, DVec3};

use super::super::deformer::{DeformedSurface, Deformer, DerivativeColumns};

/// Parameters of one vertex: for each axis the three entries of that row of the linear part, then the offset.
pub const PARAMETERS_PER_VERTEX: usize = 12;

/// P1 §3.1's A_i, each about its own vertex: A_i(q) = q + B_i (q − p_i) / size + t_i.
///
/// All parameters are metres and zero is the identity. Expressed about a far-off origin, the linear part and the offset
/// of a vertex are nearly the same direction, and solvers crawl.
pub struct VertexAffines {
    rest: Vec<DVec3>,
    size: f64,
}

impl VertexAffines {
    /// Affine maps of the vertices `rest`; `size` is the surface's size in metres.
    pub fn new(rest: Vec<DVec3>, size: f64) -> Self {
        Self { rest, size }
    }

    /// The vertices that are bent, in metres.
    pub fn rest(&self) -> &[DVec3] {
        &self.rest
    }

    /// The surface's size in metres.
    pub fn size(&self) -> f64 {
        self.size
    }

    /// Where the offset of a vertex along an axis stands among the parameters.
    pub fn offset_index(vertex: usize, axis: usize) -> usize {
        PARAMETERS_PER_VERTEX * vertex + 4 * axis + 3
    }

    /// The linear part of a vertex's map.
    pub fn linear(&self, vertex: usize, parameters: &[f64]) -> DMat3 {
        let own = &parameters[PARAMETERS_PER_VERTEX * vertex..PARAMETERS_PER_VERTEX * (vertex + 1)];
        let rows: [DVec3; 3] = std::array::from_fn(|axis| DVec3::from_slice(&own[4 * axis..]));
        DMat3::IDENTITY + DMat3::from_cols(rows[0], rows[1], rows[2]).transpose() * (1.0 / self.size)
    }

    /// The bent vertices.
    pub fn vertices(&self, parameters: &[f64]) -> Vec<DVec3> {
        self.rest
            .iter()
            .enumerate()
            .map(|(vertex, rest)| {
                *rest + DVec3::from_array([0, 1, 2].map(|axis| parameters[Self::offset_index(vertex, axis)]))
            })
            .collect()
    }
}

impl Deformer for VertexAffines {
    fn parameter_count(&self) -> usize {
        PARAMETERS_PER_VERTEX * self.rest.len()
    }

    fn deform<'a>(&'a self, parameters: &'a [f64]) -> Box<dyn DeformedSurface + 'a> {
        Box::new(AffineSurface { vertices: self.vertices(parameters) })
    }
}

/// A vertex stands at its own map's centre, so that only its offset moves it.
struct AffineSurface {
    vertices: Vec<DVec3>,
}

impl DeformedSurface for AffineSurface {
    fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    fn vertex_derivatives(&self, vertex: usize, columns: &mut DerivativeColumns) {
        columns.extend((0..3).map(|axis| (VertexAffines::offset_index(vertex, axis), DVec3::AXES[axis])));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_parameters_are_the_identity_and_offsets_move_their_vertex() {
        let rest = vec![DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 0.0, 0.5)];
        let affines = VertexAffines::new(rest.clone(), 2.0);
        let mut parameters = vec![0.0; affines.parameter_count()];
        assert_eq!(affines.vertices(&parameters), rest);
        assert_eq!(affines.linear(1, &parameters), DMat3::IDENTITY);
        parameters[VertexAffines::offset_index(1, 2)] = 0.25;
        parameters[PARAMETERS_PER_VERTEX + 4 + 2] = 0.5;
        assert_eq!(affines.vertices(&parameters)[1], rest[1] + DVec3::Z * 0.25);
        // Row y, column z, over the size.
        assert_eq!(affines.linear(1, &parameters) * DVec3::Z, DVec3::new(0.0, 0.25, 1.0));
    }
}
