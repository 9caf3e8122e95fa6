//! Ways to bend a surface.

pub mod body_assembly;
mod body_parameters;
mod deformation_graph;
mod vertex_affines;

pub use body_parameters::{BodyParameters, FreeParameters};
pub use deformation_graph::{DeformationGraph, GraphDeformer, NODE_PARAMETERS, NodeMotion};
pub use vertex_affines::{PARAMETERS_PER_VERTEX, VertexAffines};
