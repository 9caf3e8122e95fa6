//! Errors on the mean body (P2 Fig. 6, right) and bodies inside their captures (P2 Fig. 7).

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::DVec3;
use habitus::artifacts::rigged_sequence::RiggedSequence;
use habitus::evaluation::sequence_metrics::mean_rest_errors_mm;
use habitus::geometry::Surface;

use super::{MeanBody, Variant, styles};
use crate::render::{
    Camera, Color, ColorScale, Layer, Paint, RenderError, Scene, View, render, sequential_color,
};
use crate::report::escaped;
use crate::shape_space::Figure;
use crate::stills::{FrameStill, StillContent};

const PANEL_WIDTH: usize = 130;
const PANEL_HEIGHT: usize = 250;
const LABEL: usize = 20;
/// Error that gets the brightest colour, mm.
const BRIGHTEST_MM: f64 = 40.0;
const LEGEND_HEIGHT: usize = 34;
/// A sheet is at least so wide: one picture alone is not blown up.
const FEWEST_COLUMNS: usize = 4;

/// A picture with a place in a sheet.
struct Tile {
    column: usize,
    row: usize,
    caption: String,
    png: Vec<u8>,
}

/// Pictures in rows and columns with their captions, as one SVG.
fn sheet(title: &str, tiles: &[Tile], extra_height: usize) -> String {
    let columns = tiles.iter().map(|tile| tile.column + 1).fold(FEWEST_COLUMNS, usize::max);
    let rows = tiles.iter().map(|tile| tile.row + 1).max().unwrap_or(1);
    let (width, height) = (columns * PANEL_WIDTH, rows * (PANEL_HEIGHT + LABEL) + LABEL + extra_height);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{0}\" font-family=\"system-ui,sans-serif\" font-size=\"10\" fill=\"#30343c\"><rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/><text x=\"6\" y=\"15\" font-size=\"12\" font-weight=\"600\">{0}</text>",
        escaped(title)
    );
    for tile in tiles {
        let (left, top) = (tile.column * PANEL_WIDTH, LABEL + tile.row * (PANEL_HEIGHT + LABEL));
        let _ = write!(
            out,
            "<image x=\"{left}\" y=\"{top}\" width=\"{PANEL_WIDTH}\" height=\"{PANEL_HEIGHT}\" href=\"data:image/png;base64,{}\"/><text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            STANDARD.encode(&tile.png),
            left + PANEL_WIDTH / 2,
            top + PANEL_HEIGHT + 13,
            escaped(&tile.caption),
        );
    }
    out
}

/// Mean error of each vertex on the mean body, from the front and from behind, for each style and variant.
pub(super) fn shape_map(variants: &[Variant<'_>], body: MeanBody<'_>) -> Result<Figure, RenderError> {
    let mut tiles = Vec::new();
    for (row, variant) in variants.iter().enumerate() {
        for (place, style) in styles(variant).iter().enumerate() {
            let errors = mean_rest_errors_mm(&variant.of(|errors| errors.label.style == *style));
            for (side, yaw) in [0.0, 180.0].into_iter().enumerate() {
                let caption = if side == 0 { format!("{style}, {}", variant.name) } else { String::new() };
                tiles.push(Tile { column: 2 * place + side, row, caption, png: map(body, &errors, yaw)? });
            }
        }
    }
    let mut svg = sheet("Mean shape error on the mean body", &tiles, LEGEND_HEIGHT);
    let rows = variants.len().max(1);
    add_legend(&mut svg, LABEL + rows * (PANEL_HEIGHT + LABEL) + 8);
    svg.push_str("</svg>\n");
    Ok(Figure {
        name: "shape_map".into(),
        caption: format!(
            "Mean vertex error in the rest pose against the true bodies, from 0 (dark) to {BRIGHTEST_MM} mm and more \
             (bright), from the front and from behind (P2 Fig. 6, right)."
        ),
        svg,
    })
}

fn map(body: MeanBody<'_>, errors_mm: &[f64], yaw: f64) -> Result<Vec<u8>, RenderError> {
    let colors = errors_mm.iter().map(|error| sequential_color(error / BRIGHTEST_MM)).collect();
    let scene = Scene {
        layers: vec![Layer::opaque(body.vertices.to_vec(), body.faces.to_vec(), Paint::PerVertex(colors))],
        background: Color::from_srgb(255, 255, 255),
        ..Scene::default()
    };
    let camera = Camera::framing_points(
        body.vertices,
        View::from_degrees(yaw, 4.0).orthographic(),
        PANEL_WIDTH as f64 / PANEL_HEIGHT as f64,
    );
    render(&scene, &camera, 2 * PANEL_WIDTH, 2 * PANEL_HEIGHT)?.to_png()
}

fn add_legend(out: &mut String, top: usize) {
    const STEPS: usize = 40;
    const WIDTH: f64 = 200.0;
    for step in 0..STEPS {
        let [red, green, blue] = sequential_color(step as f64 / (STEPS - 1) as f64).to_srgb();
        let _ = write!(
            out,
            "<rect x=\"{:.1}\" y=\"{top}\" width=\"{:.1}\" height=\"8\" fill=\"#{red:02x}{green:02x}{blue:02x}\"/>",
            8.0 + WIDTH * step as f64 / STEPS as f64,
            WIDTH / STEPS as f64 + 0.3
        );
    }
    let _ = write!(
        out,
        "<text x=\"8\" y=\"{0}\">0</text><text x=\"{1}\" y=\"{0}\" text-anchor=\"end\">{BRIGHTEST_MM} mm</text>",
        top + 20,
        8.0 + WIDTH
    );
}

/// One frame of a fit and its capture, in the input's frame.
pub struct Overlay<'a> {
    /// The fit.
    pub fit: &'a RiggedSequence,
    /// Number of the frame.
    pub frame: usize,
    /// The capture, if it can be read.
    pub capture: Option<Surface>,
    /// What to write below.
    pub caption: String,
}

/// Overlays in a row; `name` is the figure's file.
///
/// # Errors
/// When a picture cannot be made.
pub fn overlays_figure(
    name: &str,
    title: &str,
    caption: &str,
    overlays: &[Overlay<'_>],
) -> Result<Figure, RenderError> {
    const COLUMNS: usize = 6;
    let mut tiles = Vec::new();
    for (place, overlay) in overlays.iter().enumerate() {
        let still =
            FrameStill::new(overlay.fit, overlay.frame, overlay.capture.as_ref(), ColorScale::CLEARANCE);
        let front = overlay.fit.posed_skeleton(overlay.frame).rotations[0] * DVec3::Z;
        let view = View { front, up: DVec3::Y, ..View::from_degrees(30.0, 4.0) };
        let image = still.draw(StillContent::Overlay, view, 2 * PANEL_WIDTH, 2 * PANEL_HEIGHT)?;
        tiles.push(Tile {
            column: place % COLUMNS,
            row: place / COLUMNS,
            caption: overlay.caption.clone(),
            png: image.to_png()?,
        });
    }
    let mut svg = sheet(title, &tiles, 0);
    svg.push_str("</svg>\n");
    Ok(Figure { name: name.into(), caption: caption.into(), svg })
}
