//! A number at each vertex as colours on a body, from the front and from the back (P1 Fig. 1b, 2b and 6).

use std::fmt::Write;

use glam::DVec3;

use super::picture::{PANEL_HEIGHT, PANEL_WIDTH, picture};
use crate::render::{Camera, Color, Paint, RenderError, View, sequential_color};
use crate::report::{escaped, number};

const LABEL: usize = 22;
const LEGEND: usize = 44;
/// Steps of the colour bar.
const STEPS: usize = 48;

/// One body of the figure.
pub struct HeatMap<'a> {
    /// What it shows.
    pub name: String,
    /// Vertices, metres.
    pub vertices: &'a [DVec3],
    /// Faces.
    pub faces: &'a [[u32; 3]],
    /// A value for each vertex, millimetres; one that is no number is grey.
    pub values_mm: &'a [f64],
}

/// A figure with two views of each body and one scale for all, from 0 to `most_mm`.
///
/// # Errors
/// When a picture cannot be made.
pub fn heat_map_figure(maps: &[HeatMap<'_>], most_mm: f64) -> Result<String, RenderError> {
    let (width, height) = (2 * PANEL_WIDTH * maps.len().max(1), PANEL_HEIGHT + LABEL + LEGEND);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"values on the body\" font-family=\"system-ui,sans-serif\" font-size=\"12\" fill=\"#30343c\"><rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>"
    );
    for (place, map) in maps.iter().enumerate() {
        let left = 2 * PANEL_WIDTH * place;
        let _ = write!(
            out,
            "<text x=\"{}\" y=\"16\" font-weight=\"600\">{}</text>",
            left + 6,
            escaped(&map.name)
        );
        let colors: Vec<Color> = map.values_mm.iter().map(|value| color(*value, most_mm)).collect();
        for (side, yaw) in [15.0, 195.0].into_iter().enumerate() {
            let view = View::from_degrees(yaw, 4.0).orthographic();
            let camera = Camera::framing_points(map.vertices, view, PANEL_WIDTH as f64 / PANEL_HEIGHT as f64);
            let at = [left + side * PANEL_WIDTH, LABEL];
            let paint = Paint::PerVertex(colors.clone());
            out.push_str(&picture(map.vertices.to_vec(), map.faces, paint, &camera, at)?);
        }
    }
    add_legend(&mut out, most_mm, [LABEL + PANEL_HEIGHT + 8, width]);
    out.push_str("</svg>\n");
    Ok(out)
}

fn color(value_mm: f64, most_mm: f64) -> Color {
    if value_mm.is_finite() {
        sequential_color(value_mm / most_mm.max(1e-9))
    } else {
        Color::from_srgb(150, 150, 150)
    }
}

fn add_legend(out: &mut String, most_mm: f64, [top, width]: [usize; 2]) {
    let (left, length) = (40.0, width as f64 - 80.0);
    let step = length / STEPS as f64;
    for k in 0..STEPS {
        let [r, g, b] = sequential_color((k as f64 + 0.5) / STEPS as f64).to_srgb();
        let _ = write!(
            out,
            "<rect x=\"{:.1}\" y=\"{top}\" width=\"{:.1}\" height=\"10\" fill=\"rgb({r},{g},{b})\"/>",
            left + k as f64 * step,
            step + 0.5
        );
    }
    for share in [0.0, 0.5, 1.0] {
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{} mm</text>",
            left + share * length,
            top + 24,
            number(share * most_mm, 1)
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_body_is_seen_from_two_sides_beside_one_scale() {
        let vertices = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let values_mm = [0.0, 1.0, f64::NAN, 9.0];
        let map = |name: &str| HeatMap {
            name: name.into(),
            vertices: &vertices,
            faces: &faces,
            values_mm: &values_mm,
        };
        let svg = heat_map_figure(&[map("a < b"), map("c")], 4.0).expect("is drawn");
        assert_eq!(svg.matches("<image").count(), 4);
        assert!(svg.contains("a &lt; b") && svg.contains("4.0 mm") && svg.contains("2.0 mm"));
    }
}
