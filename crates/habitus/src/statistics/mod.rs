//! Linear statistics of stacked vectors: principal components of bodies and of clothes.
//!
//! A [`SampleMatrix`] holds samples, a [`LinearSpace`] is what is learnt from them (P1 Eq. 1): a mean, an orthonormal
//! basis and a standard deviation for each component. Knows no body and no mesh.
//!
//! Regressors from rows to rows stand beside it: a network, kernel ridge, nearest neighbour.

mod centred;
mod directions;
mod gram;
pub mod kernel_mixture;
pub mod kernel_ridge;
mod linear_space;
mod linear_space_file;
pub mod nearest_neighbours;
pub mod network;
mod procrustes;
mod random_stream;
mod sample_matrix;
pub mod standardization;

pub use gram::{GramMatrix, GramPrecision};
pub use linear_space::{LinearSpace, LinearSpaceError, LinearSpaceSettings};
pub use procrustes::{ProcrustesSettings, SizeRule, align_samples, align_to};
pub use random_stream::RandomStream;
pub use sample_matrix::SampleMatrix;
