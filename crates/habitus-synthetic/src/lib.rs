//! People, motions, simulated garments and captures of them, with exact truth.
//!
//! ```text
//! source body ─┬─ tailor ──▶ Garment ─ Cloth ─┐
//!              └─ Animation ─▶ Pose ──────────┴─ capture ─▶ one independent mesh per frame, with its truth
//! ```
//! Bodies come from outside the space that is fitted, garments are simulated, and every frame is meshed anew, so
//! that nothing of what a fit has to find is given away.

#![deny(missing_docs)]

pub mod animate;
pub mod benchmark;
pub mod capture;
mod carve;
pub mod cloth;
pub mod clothing_data;
pub mod depth_map;
mod error;
pub mod garment;
pub mod isosurface;
pub mod motion;
pub mod raw_scan;
pub mod refit;
pub mod remesh;
pub mod rest_body;
pub mod second_skin;
pub mod sequence;
mod sheet;
pub mod source_bodies;
pub mod truth;
mod view;

pub use error::SyntheticError;
