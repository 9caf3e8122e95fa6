//! The S-SCAPE body model (P1 §2, P2 §3): a linear identity space, moved by linear blend skinning.
//!
//! `posed = skinning(rest(identity), posed_from_rest(pose, joints(identity)))`. The joints follow the
//! shape through a sparse regressor, so that long and short bodies bend in their own places.

mod blended_skin;
pub(crate) mod file;
#[cfg(test)]
pub(crate) mod fixture;
mod identity_space;
mod model;
mod motion_features;
mod skeleton;
mod surface;

pub use blended_skin::{BlendedSkin, Carrier};
pub use file::ModelFileError;
pub use identity_space::SpaceOrigin;
pub use model::{BodyModel, ModelMetadata, PartLabel};
pub use motion_features::{Feature, FeatureKind, FeatureSet};
pub(crate) use skeleton::left_jacobian;
pub use skeleton::{
    Axis, BONE_COUNT, Bone, POSE_LENGTH, Pose, PosedSkeleton, ROOT_LENGTH, Skeleton, SkeletonError, Twist,
    rotation_vector,
};
pub use surface::{BodySurface, IdentityCoefficients, JointMap, SkinWeights};
