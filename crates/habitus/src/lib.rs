//! Bodies from scans, bodies under clothes, and the clothes over them.
//!
//! ```text
//! Frames ──fit_sequence──▶ FittedSequence ──measure──▶ Measurements
//!              ▲
//!          BodyModel (the default space is embedded; others load from a file)
//! ```
//! Read in this order: [`body`] (the statistical body), [`fitting`] (one loop with exchangeable terms),
//! [`stages`] (recipes), [`pipeline`] (run folders). Lengths are metres and angles radians throughout;
//! files are converted at the border.

pub use habitus_geometry as geometry;
pub use habitus_optimize as optimize;

pub mod artifacts;
pub mod body;
pub mod evaluation;
pub mod fitting;
pub mod pipeline;
pub mod stages;
pub mod statistics;
