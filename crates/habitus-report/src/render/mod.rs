//! Stills of meshes by a software rasteriser: no graphics card, no window, the same pixels on every machine.
//!
//! A [`Scene`] holds layers (meshes, opaque or translucent), curves and dots in metres; a [`Camera`] looks at it;
//! [`render`] gives an [`Image`]. Surfaces are resolved per pixel into a visibility buffer (nearest face of the
//! opaque layers, nearest face of each translucent layer) and shaded once, in linear light, at 2×2 samples a pixel.

mod camera;
mod color;
mod color_map;
mod contact_sheet;
mod font;
mod ground;
mod image;
mod marks;
mod rasterize;
mod scene;
mod shade;

use thiserror::Error;

pub use camera::{Bounds, Camera, Projection, View};
pub use color::Color;
pub use color_map::{ColorScale, diverging_color, sequential_color};
pub use contact_sheet::{Panel, contact_sheet};
pub use image::Image;
pub use rasterize::render;
pub use scene::{Curve, Dot, Layer, Lighting, Paint, Scene, Smoothness};

/// Why a picture could not be made.
#[derive(Debug, Error)]
pub enum RenderError {
    /// The picture would have no pixels, or too many.
    #[error("a picture of {width} × {height} pixels cannot be made: both sides must be 1 to {limit}")]
    Size {
        /// Asked width in pixels.
        width: usize,
        /// Asked height in pixels.
        height: usize,
        /// Largest side in pixels.
        limit: usize,
    },
    /// A face of a layer names a vertex that the layer does not have.
    #[error("layer {layer}: face {face} names vertex {vertex}, but the layer has {vertex_count} vertices")]
    FaceOutOfRange {
        /// Number of the layer in the scene.
        layer: usize,
        /// Number of the face in the layer.
        face: usize,
        /// The vertex that does not exist.
        vertex: u32,
        /// How many vertices the layer has.
        vertex_count: usize,
    },
    /// A layer has not one colour per vertex.
    #[error(
        "layer {layer}: {color_count} vertex colours for {vertex_count} vertices; give one colour a vertex"
    )]
    ColorCount {
        /// Number of the layer in the scene.
        layer: usize,
        /// How many colours were given.
        color_count: usize,
        /// How many vertices the layer has.
        vertex_count: usize,
    },
    /// The picture could not be written.
    #[error("cannot write the picture {path}: {source}")]
    Write {
        /// File that was to be written.
        path: std::path::PathBuf,
        /// What the system or the encoder said.
        source: std::io::Error,
    },
}
