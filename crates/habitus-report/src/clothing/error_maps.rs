//! Where on the clothing a prediction is wrong, as P3 Fig. 7 shows it, from 0 to 50 mm.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use habitus::evaluation::clothing_metrics::ClothingErrorMap;
use habitus::evaluation::layer_reconstruction::mean;

use crate::render::{Camera, Color, Layer, Paint, RenderError, Scene, View, render, sequential_color};
use crate::report::escaped;

/// Error that gets the brightest colour, mm.
const MOST_MM: f64 = 50.0;
const PANEL_WIDTH: usize = 150;
const PANEL_HEIGHT: usize = 270;
const LABEL: usize = 18;
const LEGEND: usize = 40;
/// Pairs of pictures in a row.
const PAIRS_PER_ROW: usize = 4;

/// All sequences in rows, a picture for each method; the number is the mean over the surface.
///
/// # Errors
/// When a picture cannot be made.
pub fn error_maps_figure(maps: &[ClothingErrorMap]) -> Result<String, RenderError> {
    let methods = maps.iter().map(|map| map.errors_mm.len()).max().unwrap_or(0).max(1);
    let columns = PAIRS_PER_ROW.min(maps.len().max(1));
    let (cell_width, cell_height) = (methods * PANEL_WIDTH, PANEL_HEIGHT + 2 * LABEL);
    let (width, height) = (columns * cell_width, maps.len().div_ceil(columns) * cell_height + LEGEND);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"error maps\" font-family=\"system-ui,sans-serif\" font-size=\"12\" fill=\"#30343c\"><rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>"
    );
    for (index, map) in maps.iter().enumerate() {
        let (left, top) = (index % columns * cell_width, index / columns * cell_height);
        let title = escaped(&map.sequence);
        let _ = write!(out, "<text x=\"{}\" y=\"{}\" font-weight=\"600\">{title}</text>", left + 6, top + 13);
        let camera = Camera::framing_points(
            &map.vertices,
            View::from_degrees(20.0, 4.0).orthographic(),
            PANEL_WIDTH as f64 / PANEL_HEIGHT as f64,
        );
        for (place, (method, errors)) in map.errors_mm.iter().enumerate() {
            let colors = errors.iter().map(|error| sequential_color(error / MOST_MM)).collect();
            let skin = Paint::Uniform(Color::from_srgb(214, 206, 198));
            let scene = Scene {
                layers: vec![
                    Layer::opaque(map.body.clone(), map.body_faces.clone(), skin),
                    Layer::opaque(map.vertices.clone(), map.faces.clone(), Paint::PerVertex(colors)),
                ],
                background: Color::from_srgb(255, 255, 255),
                ..Scene::default()
            };
            let png = render(&scene, &camera, PANEL_WIDTH, PANEL_HEIGHT)?.to_png()?;
            let x = left + place * PANEL_WIDTH;
            let _ = write!(
                out,
                "<image x=\"{x}\" y=\"{}\" width=\"{PANEL_WIDTH}\" height=\"{PANEL_HEIGHT}\" href=\"data:image/png;base64,{}\"/><text x=\"{}\" y=\"{}\" text-anchor=\"middle\" font-size=\"10.5\">{} {:.1} mm</text>",
                top + LABEL,
                STANDARD.encode(png),
                x + PANEL_WIDTH / 2,
                top + LABEL + PANEL_HEIGHT + 12,
                escaped(&method.replace('_', " ")),
                mean(errors)
            );
        }
    }
    add_legend(&mut out, height - LEGEND + 8);
    out.push_str("</svg>\n");
    Ok(out)
}

fn add_legend(out: &mut String, top: usize) {
    const STEPS: usize = 50;
    for step in 0..STEPS {
        let [red, green, blue] = sequential_color(step as f64 / (STEPS - 1) as f64).to_srgb();
        let x = 10 + 4 * step;
        let _ = write!(
            out,
            "<rect x=\"{x}\" y=\"{top}\" width=\"5\" height=\"10\" fill=\"rgb({red},{green},{blue})\"/>"
        );
    }
    let _ = write!(
        out,
        "<text x=\"10\" y=\"{0}\">0</text><text x=\"{1}\" y=\"{0}\" text-anchor=\"end\">{MOST_MM:.0} mm</text>",
        top + 23,
        10 + 4 * STEPS
    );
}
