//! Ways to bend a surface.

pub mod body_assembly;
mod body_parameters;

pub use body_parameters::{BodyParameters, FreeParameters};
