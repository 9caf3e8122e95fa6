//! A template prepared once for many scans.

use glam::DVec3;
use habitus_geometry::Topology;
use habitus_optimize::{SparseCholesky, SymmetricMatrix};

use super::RegisterError;
use super::config::{RegisterConfig, RegisterRecipe};
use crate::artifacts::template_mesh::TemplateMesh;
use crate::body::{BodyModel, PartLabel};
use crate::fitting::model_fit::ModelFitter;

/// What is brought onto the scans.
#[derive(Clone, Copy, Debug)]
pub enum Template<'a> {
    /// A statistical body.
    Model(&'a BodyModel),
    /// A mesh with landmarks.
    Mesh(&'a TemplateMesh),
}

impl Template<'_> {
    /// Its name.
    pub fn name(&self) -> &str {
        match self {
            Self::Model(model) => &model.metadata().name,
            Self::Mesh(template) => &template.name,
        }
    }

    /// Names and vertices of its landmarks; those of a model are its landmarks and measurement vertices.
    pub fn landmarks(&self) -> Vec<(String, u32)> {
        match self {
            Self::Model(model) => {
                let metadata = model.metadata();
                let own = metadata.landmarks.iter().cloned().zip(model.landmark_vertices().iter().copied());
                let mut all: Vec<(String, u32)> = own.collect();
                for (name, vertex) in &metadata.measurement_vertices {
                    if !all.iter().any(|(known, _)| known == name) {
                        all.push((name.clone(), *vertex));
                    }
                }
                all
            }
            Self::Mesh(template) => template.landmarks.clone(),
        }
    }
}

/// A template with all that does not depend on the scan.
pub struct PreparedTemplate<'a> {
    pub(super) template: Template<'a>,
    pub(super) config: &'a RegisterConfig,
    pub(super) fitter: Option<ModelFitter<'a>>,
    /// Vertices at rest, metres for a model.
    pub(super) rest: Vec<DVec3>,
    pub(super) faces: Vec<[u32; 3]>,
    pub(super) edges: Vec<[u32; 2]>,
    pub(super) face_neighbours: Vec<[u32; 3]>,
    pub(super) parts: Vec<PartLabel>,
    pub(super) landmarks: Vec<(String, u32)>,
    pub(super) displacement_matrix: SymmetricMatrix,
    pub(super) displacement_cholesky: SparseCholesky,
    pub(super) affine: Option<(SymmetricMatrix, SparseCholesky)>,
}

/// No face lies across this side.
pub(super) const NO_FACE: u32 = u32::MAX;

impl<'a> PreparedTemplate<'a> {
    /// Analyses the template; `landmarks` replaces its own table.
    pub fn new(
        template: Template<'a>,
        landmarks: Option<Vec<(String, u32)>>,
        config: &'a RegisterConfig,
    ) -> Result<Self, RegisterError> {
        let (rest, faces, parts) = match template {
            Template::Model(model) => {
                (model.mean_vertices().to_vec(), model.faces().to_vec(), model.part_labels().to_vec())
            }
            Template::Mesh(template) => {
                let mesh = &template.mesh;
                let parts = vec![PartLabel::Covered; mesh.positions().len()];
                (mesh.positions().to_vec(), mesh.faces().to_vec(), parts)
            }
        };
        let landmarks = landmarks.unwrap_or_else(|| template.landmarks());
        let topology = Topology::new(rest.len(), &faces);
        let edges = topology.edges().to_vec();
        let places = edges.iter().map(|[a, b]| (*a as usize, *b as usize));
        let displacement_matrix = SymmetricMatrix::with_places(rest.len(), places);
        let displacement_cholesky = SparseCholesky::analyse(&displacement_matrix)?;
        let needs_affines = config.recipe == RegisterRecipe::Paper || matches!(template, Template::Mesh(_));
        let affine = if needs_affines { Some(super::affines::analyse(rest.len(), &edges)?) } else { None };
        let fitter = match template {
            Template::Model(model) => {
                let vertices: Vec<u32> = landmarks.iter().map(|(_, vertex)| *vertex).collect();
                Some(ModelFitter::new(model, &config.model, &vertices))
            }
            Template::Mesh(_) => None,
        };
        let face_neighbours = face_neighbours(&topology, &faces);
        Ok(Self {
            template,
            config,
            fitter,
            rest,
            faces,
            edges,
            face_neighbours,
            parts,
            landmarks,
            displacement_matrix,
            displacement_cholesky,
            affine,
        })
    }

    /// Names and vertices of the landmarks.
    pub fn landmarks(&self) -> &[(String, u32)] {
        &self.landmarks
    }
}

/// The faces across the three sides of each face.
fn face_neighbours(topology: &Topology, faces: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let mut neighbours = vec![[NO_FACE; 3]; faces.len()];
    for edge in 0..topology.edges().len() {
        if let [first, second] = *topology.edge_faces(edge) {
            for (own, other) in [(first, second), (second, first)] {
                if let Some(slot) = neighbours[own as usize].iter_mut().find(|slot| **slot == NO_FACE) {
                    *slot = other;
                }
            }
        }
    }
    neighbours
}

/// Faces that lie folded over: against the mean of the faces around them, where on the template they do not.
pub(super) fn folded_faces(
    faces: &[[u32; 3]],
    neighbours: &[[u32; 3]],
    template: &[DVec3],
    vertices: &[DVec3],
) -> Vec<usize> {
    let normals = habitus_geometry::face_normals(vertices, faces);
    let rest_normals = habitus_geometry::face_normals(template, faces);
    let is_folded = |normals: &[DVec3], face: usize| {
        let around: DVec3 = neighbours[face]
            .iter()
            .filter(|other| **other != NO_FACE)
            .map(|other| normals[*other as usize])
            .sum();
        normals[face].dot(around) < 0.0
    };
    (0..faces.len()).filter(|face| is_folded(&normals, *face) && !is_folded(&rest_normals, *face)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_that_is_turned_over_is_found() {
        // A fan of six around a vertex.
        let mut template = vec![DVec3::ZERO];
        template.extend((0..6).map(|k| {
            let angle = f64::from(k) * std::f64::consts::TAU / 6.0;
            DVec3::new(angle.cos(), angle.sin(), 0.0)
        }));
        let faces: Vec<[u32; 3]> = (0..6).map(|k| [0, 1 + k, 1 + (k + 1) % 6]).collect();
        let topology = Topology::new(7, &faces);
        let neighbours = face_neighbours(&topology, &faces);
        assert!(folded_faces(&faces, &neighbours, &template, &template).is_empty());
        let mut vertices = template.clone();
        // The middle beyond one side turns that face over.
        vertices[0] = DVec3::new(0.0, 1.2, 0.0);
        let folded = folded_faces(&faces, &neighbours, &template, &vertices);
        assert_eq!(folded, [1]);
    }
}
