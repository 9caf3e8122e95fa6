//! The first components of a space as bodies at −3σ and +3σ (P1 Fig. 4).

use std::fmt::Write;

use glam::DVec3;
use habitus::body::BodyModel;

use super::picture::{PANEL_HEIGHT, PANEL_WIDTH, picture};
use crate::render::{Camera, Color, Paint, RenderError, View};
use crate::report::escaped;

const LABEL: usize = 22;
/// How many standard deviations from the mean the bodies are. P1 Fig. 4: 3.
const DEVIATIONS: f64 = 3.0;

/// A figure with a row for each model and two bodies for each of the first components.
///
/// # Errors
/// When a picture cannot be made.
pub fn modes_figure(models: &[(String, &BodyModel)], components: usize) -> Result<String, RenderError> {
    let columns = 2 * components;
    let (width, height) = (columns * PANEL_WIDTH, models.len() * (PANEL_HEIGHT + 2 * LABEL));
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"components at ±3 standard deviations\" font-family=\"system-ui,sans-serif\" font-size=\"13\" fill=\"#30343c\"><rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>"
    );
    for (row, (name, model)) in models.iter().enumerate() {
        let top = row * (PANEL_HEIGHT + 2 * LABEL);
        let _ = write!(out, "<text x=\"6\" y=\"{}\" font-weight=\"600\">{}</text>", top + 16, escaped(name));
        // One camera for the row, so that sizes can be compared.
        let bodies: Vec<(usize, f64, Vec<DVec3>)> = (0..components.min(model.component_count()))
            .flat_map(|component| {
                [-DEVIATIONS, DEVIATIONS].map(|deviation| {
                    let mut identity = vec![0.0; component + 1];
                    identity[component] = deviation;
                    (component, deviation, model.rest_vertices(&identity))
                })
            })
            .collect();
        let all: Vec<DVec3> = bodies.iter().flat_map(|(_, _, body)| body.iter().copied()).collect();
        let camera = Camera::framing_points(
            &all,
            View::from_degrees(20.0, 4.0).orthographic(),
            PANEL_WIDTH as f64 / PANEL_HEIGHT as f64,
        );
        for (place, (component, deviation, body)) in bodies.into_iter().enumerate() {
            let paint = Paint::Uniform(Color::from_srgb(176, 184, 196));
            let at = [place * PANEL_WIDTH, top + LABEL];
            out.push_str(&picture(body, model.faces(), paint, &camera, at)?);
            let _ = write!(
                out,
                "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{} {}3σ</text>",
                place * PANEL_WIDTH + PANEL_WIDTH / 2,
                top + LABEL + PANEL_HEIGHT + 15,
                component + 1,
                if deviation < 0.0 { '−' } else { '+' },
            );
        }
    }
    out.push_str("</svg>\n");
    Ok(out)
}
