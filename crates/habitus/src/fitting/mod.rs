//! Bending a surface onto a capture: one loop with exchangeable terms.
//!
//! A [`Deformer`] turns parameters into vertices, a [`Term`] is one energy of the bent surface, a [`Fit`]
//! is one deformer with weighted terms and therefore an objective for both solvers. Correspondences are
//! frozen inside a solve, so that every term is smooth and its derivatives can be checked.

pub mod correspondence;
mod deformer;
pub mod deformers;
mod fit;
pub mod gaps;
pub mod local_shapes;
pub mod model_fit;
pub mod retarget;
pub mod same_topology;
pub mod schedule;
pub mod shared_identity;
pub mod standing_start;
pub mod terms;

pub use deformer::{DeformedSurface, Deformer, DerivativeColumns, VertexResidual};
pub use fit::{Fit, Term};
