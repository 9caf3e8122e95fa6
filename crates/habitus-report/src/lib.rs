//! A run folder as one self-contained HTML file, and pictures of meshes.
//!
//! [`render`] is a small software rasteriser; [`report`] writes the page with the playable 3D view. Both know no
//! run: [`stills`], [`clothing_stills`] and [`run`] bring a finished fit and its captures to them. No fit is computed here.
#![deny(missing_docs)]

pub mod benchmark;
mod captured_body;
pub mod clothing;
pub mod clothing_stills;
pub mod dressed_report;
pub mod dressing_room;
pub mod landmark_stills;
pub mod render;
pub mod report;
pub mod review;
pub mod run;
pub mod shape_space;
pub mod stills;
