//! A run folder as one self-contained HTML file, and pictures of meshes.
//!
//! [`render`] is a small software rasteriser for stills; [`report`] writes the page with the playable 3D view.
//! Both show what they are given: no fit, metric or measurement is computed here.
#![deny(missing_docs)]

pub mod render;
pub mod report;
pub mod run;
pub mod stills;
