//! Settings of `learn_shape`. Lengths are metres.

use serde::{Deserialize, Serialize};

use crate::fitting::same_topology::SameTopologySettings;
use crate::statistics::{LinearSpaceSettings, ProcrustesSettings};

/// How differences of pose are taken out of the registrations (P1 §3.4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseNormalization {
    /// Not at all.
    None,
    /// The mean body takes on the localized Laplacian coordinates of each registration (P1 §3.4, WSX).
    LocalLaplacian,
    /// A skeleton brings each registration into the mean pose and Laplacian coordinates keep its surface (P1 §3.4, NH).
    SkeletonLaplacian,
    /// The base model's pose is fitted and its skinning is undone.
    #[default]
    Unpose,
}

impl PoseNormalization {
    /// All, in the order of tables.
    pub const ALL: [Self; 4] = [Self::None, Self::LocalLaplacian, Self::SkeletonLaplacian, Self::Unpose];

    /// The name in settings and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::LocalLaplacian => "local_laplacian",
            Self::SkeletonLaplacian => "skeleton_laplacian",
            Self::Unpose => "unpose",
        }
    }
}

/// How vertices count in the components.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VertexWeighting {
    /// All the same, as P1: dense regions such as hands and face count more.
    #[default]
    Uniform,
    /// By the area that a vertex stands for on the mean body.
    Area,
}

/// Settings of the whole stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnShapeConfig {
    /// How differences of pose are taken out.
    pub pose_normalization: PoseNormalization,
    /// How vertices count.
    pub weighting: VertexWeighting,
    /// How registrations are aligned.
    pub alignment: ProcrustesSettings,
    /// How the components are computed.
    pub space: LinearSpaceSettings,
    /// How the base model is laid on a registration.
    pub pose_fit: SameTopologySettings,
    /// Settings of `local_laplacian`.
    pub local_laplacian: LocalLaplacianConfig,
    /// Settings of `skeleton_laplacian`.
    pub skeleton_laplacian: SkeletonLaplacianConfig,
    /// Settings of `unpose`.
    pub unpose: UnposeConfig,
}

/// Settings of the normalization by localized Laplacian coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalLaplacianConfig {
    /// Times that the local frames are taken anew from the surface that was found. More lets the shape converge and lets
    /// the pose drift back.
    pub rounds: usize,
    /// Pull of each vertex to the mean body, over the pull of its Laplacian coordinates: it holds the pose.
    pub anchor: f64,
}

impl Default for LocalLaplacianConfig {
    fn default() -> Self {
        Self { rounds: 4, anchor: 1e-5 }
    }
}

/// Settings of the normalization by a skeleton and Laplacian coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SkeletonLaplacianConfig {
    /// Pull of a vertex that hangs on one bone alone to where that bone brings it.
    pub rigid_anchor: f64,
    /// The same for a vertex between bones; in between it falls with the fourth power of the largest skin weight.
    pub joint_anchor: f64,
}

impl Default for SkeletonLaplacianConfig {
    fn default() -> Self {
        Self { rigid_anchor: 0.1, joint_anchor: 1e-4 }
    }
}

/// Settings of the normalization that undoes the skinning.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UnposeConfig {
    /// Times that the joints are taken from the rest body that was found.
    pub joint_rounds: usize,
    /// Determinant of a blended rotation below which it is not undone but replaced by the rotation of the vertex' main bone.
    pub smallest_determinant: f64,
}

impl Default for UnposeConfig {
    fn default() -> Self {
        Self { joint_rounds: 2, smallest_determinant: 0.2 }
    }
}
