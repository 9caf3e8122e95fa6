//! A small picture of a body inside an SVG document.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;

use crate::render::{Camera, Color, Layer, Paint, RenderError, Scene, render};

/// Width of a picture.
pub(super) const PANEL_WIDTH: usize = 150;
/// Its height.
pub(super) const PANEL_HEIGHT: usize = 260;

/// The SVG element of a body's picture whose upper left corner lies at `left`, `top`.
pub(super) fn picture(
    body: Vec<DVec3>,
    faces: &[[u32; 3]],
    paint: Paint,
    camera: &Camera,
    [left, top]: [usize; 2],
) -> Result<String, RenderError> {
    let scene = Scene {
        layers: vec![Layer::opaque(body, faces.to_vec(), paint)],
        background: Color::from_srgb(255, 255, 255),
        ..Scene::default()
    };
    let png = render(&scene, camera, 2 * PANEL_WIDTH, 2 * PANEL_HEIGHT)?.to_png()?;
    Ok(format!(
        "<image x=\"{left}\" y=\"{top}\" width=\"{PANEL_WIDTH}\" height=\"{PANEL_HEIGHT}\" href=\"data:image/png;base64,{}\"/>",
        STANDARD.encode(png)
    ))
}
