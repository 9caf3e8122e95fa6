//! The body model: the numbers of a statistical body and what is known about its vertices.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::file::{self, ModelFileError};
use super::skeleton::{PosedSkeleton, Skeleton};
use super::surface::BodySurface;

/// Which part of the body a vertex belongs to, as far as clothing is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PartLabel {
    /// Usually covered by clothes.
    Covered,
    /// Head, with face and hair.
    Head,
    /// A hand.
    Hand,
    /// A foot.
    Foot,
}

impl PartLabel {
    /// Head, hands and feet are usually bare or tightly covered.
    pub fn is_bare(self) -> bool {
        self != Self::Covered
    }
}

/// Where a model comes from and what its vertices are called.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelMetadata {
    /// Short name of the model.
    pub name: String,
    /// Licence of the model's data.
    pub license: String,
    /// How the model was made: free text or a table.
    pub provenance: serde_json::Value,
    /// Names of the bones.
    pub bones: Vec<String>,
    /// Names of the rotation axes.
    pub axes: Vec<String>,
    /// Names of the landmarks.
    pub landmarks: Vec<String>,
    /// Named vertices that measurements refer to.
    pub measurement_vertices: BTreeMap<String, u32>,
}

/// A statistical body with its skeleton (P1 §2, P2 §3).
#[derive(Clone, Debug)]
pub struct BodyModel {
    pub(super) metadata: ModelMetadata,
    pub(super) surface: BodySurface,
    pub(super) standard_deviations: Vec<f64>,
    pub(super) faces: Vec<[u32; 3]>,
    pub(super) joint_regressor: Vec<Vec<(u32, f64)>>,
    pub(super) landmark_vertices: Vec<u32>,
    pub(super) mirror_vertices: Vec<u32>,
    pub(super) part_labels: Vec<PartLabel>,
}

impl BodyModel {
    /// The default space that ships inside the library; its data is CC0.
    pub fn default_space() -> Result<Self, ModelFileError> {
        let bytes = include_bytes!("../../assets/default_space.npz").to_vec();
        file::read(bytes, Path::new("default_space.npz (embedded)"))
    }

    /// Reads a model file; broken, newer and foreign files are refused by name.
    pub fn load(path: &Path) -> Result<Self, ModelFileError> {
        let bytes = std::fs::read(path)
            .map_err(|source| ModelFileError::Unreadable { path: path.to_path_buf(), source })?;
        file::read(bytes, path)
    }

    /// Writes the model file, first under a temporary name.
    pub fn save(&self, path: &Path) -> Result<(), ModelFileError> {
        file::write(self, path)
    }

    /// Name, licence, provenance and names of parts.
    pub fn metadata(&self) -> &ModelMetadata {
        &self.metadata
    }

    /// The moving surface with all vertices.
    pub fn surface(&self) -> &BodySurface {
        &self.surface
    }

    /// Bones, axes and limits.
    pub fn skeleton(&self) -> &Skeleton {
        &self.surface.skeleton
    }

    /// Triangles, counter-clockwise from outside.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.surface.vertex_count()
    }

    /// Number of identity components.
    pub fn component_count(&self) -> usize {
        self.surface.component_count()
    }

    /// Standard deviation of each component in metres of the stacked vertex vector.
    pub fn standard_deviations(&self) -> &[f64] {
        &self.standard_deviations
    }

    /// Vertices of the mean body in metres.
    pub fn mean_vertices(&self) -> &[DVec3] {
        self.surface.mean_vertices()
    }

    /// Rest vertices of an identity in metres (P2 Eq. 1).
    pub fn rest_vertices(&self, identity: &[f64]) -> Vec<DVec3> {
        self.surface.rest_vertices(identity)
    }

    /// Joints of any rest body in this topology, in metres; it need not lie in the space.
    pub fn joints(&self, rest_vertices: &[DVec3]) -> Vec<DVec3> {
        self.joint_regressor
            .iter()
            .map(|row| row.iter().map(|(vertex, value)| rest_vertices[*vertex as usize] * *value).sum())
            .collect()
    }

    /// Linear blend skinning of any rest body in this topology, in metres (P2 Eq. 2).
    pub fn pose_vertices(&self, rest_vertices: &[DVec3], posed: &PosedSkeleton) -> Vec<DVec3> {
        self.surface.skin_vertices(rest_vertices, posed)
    }

    /// The landmark vertices, named by `metadata().landmarks`.
    pub fn landmark_vertices(&self) -> &[u32] {
        &self.landmark_vertices
    }

    /// The left–right mirror image of each vertex.
    pub fn mirror_vertices(&self) -> &[u32] {
        &self.mirror_vertices
    }

    /// The clothing part of each vertex.
    pub fn part_labels(&self) -> &[PartLabel] {
        &self.part_labels
    }

    /// A vertex that measurements refer to by name.
    pub fn measurement_vertex(&self, name: &str) -> Option<usize> {
        self.metadata.measurement_vertices.get(name).map(|vertex| *vertex as usize)
    }

    /// The bone with the largest weight on each vertex.
    pub fn dominant_bones(&self) -> Vec<usize> {
        (0..self.vertex_count())
            .map(|vertex| {
                self.surface
                    .skin
                    .of(vertex)
                    .fold(
                        (0, 0.0),
                        |best, (bone, weight)| if weight > best.1 { (bone, weight) } else { best },
                    )
                    .0
            })
            .collect()
    }
}
