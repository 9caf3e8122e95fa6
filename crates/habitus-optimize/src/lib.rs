//! Objectives as residual blocks, and two solvers for them inside a box; knows no mesh and no body.
//!
//! An [`Objective`] adds weighted residual blocks to a [`Sink`]; each formula is therefore written once and serves the
//! value, the gradient of [`lbfgsb`] and the normal equations of [`gauss_newton`]. Every objective of the library passes
//! [`assert_derivatives_match`].
//!
//! ```
//! use habitus_optimize::{gauss_newton, Bounds, GaussNewtonSettings, Objective, Silent, Sink};
//!
//! /// (x − 3)², held below 2.
//! struct Distance;
//! impl Objective for Distance {
//!     fn parameter_count(&self) -> usize { 1 }
//!     fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
//!         sink.add(1.0, &[parameters[0] - 3.0], &[0], &[1.0]);
//!     }
//! }
//! let mut parameters = [0.0];
//! let bounds = Bounds::new(vec![-1.0], vec![2.0])?;
//! gauss_newton(&Distance, &mut parameters, &bounds, &GaussNewtonSettings::default(), &mut Silent)?;
//! assert_eq!(parameters, [2.0]);
//! # Ok::<(), habitus_optimize::SolveError>(())
//! ```
#![deny(missing_docs)]

mod bounds;
mod box_quadratic;
mod check;
mod chunks;
mod dense_cholesky;
mod error;
mod gauss_newton;
mod lbfgsb;
mod objective;
mod observer;
mod sink;
mod sparse_cholesky;
mod sparse_gauss_newton;
mod symmetric_eigen;
mod symmetric_matrix;
mod termination;

pub use bounds::Bounds;
pub use box_quadratic::{BoxStep, Position, minimize_box_quadratic};
pub use check::{Mismatch, assert_derivatives_match, assert_same_contributions, derivative_mismatch};
pub use chunks::map_chunks;
pub use error::SolveError;
pub use gauss_newton::{GaussNewtonSettings, gauss_newton};
pub use lbfgsb::{LbfgsbSettings, lbfgsb};
pub use objective::Objective;
pub use observer::{Event, Flow, Observer, Silent};
pub use sink::{Gradient, NormalEquations, Sink, ValueSum, Wanted};
pub use sparse_cholesky::{CholeskyFactor, SparseCholesky};
pub use sparse_gauss_newton::{SparseGaussNewtonSettings, SparseNormalEquations, sparse_gauss_newton};
pub use symmetric_eigen::symmetric_eigen;
pub use symmetric_matrix::SymmetricMatrix;
pub use termination::{SolveReport, StopReason, Tolerances};
