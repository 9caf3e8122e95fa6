//! Pictures of landmarks on a scan.

use glam::DVec3;
use habitus::artifacts::rigged_sequence::RiggedSequence;
use habitus::geometry::Surface;

use crate::captured_body::CapturedBody;
use crate::render::{
    Camera, Color, Dot, Image, Layer, Paint, Panel, RenderError, Scene, View, contact_sheet, render,
};

/// Share of light that the capture stops where it is seen face on.
const VEIL: f64 = 0.55;
/// Radius of a landmark in metres.
const RADIUS: f64 = 0.016;
const WIDTH: usize = 340;
const HEIGHT: usize = 560;

/// The scan, translucent, with its landmarks from the front, the left and behind: green where they are sure, red where
/// they are guesses.
///
/// # Errors
/// When a picture cannot be made.
pub fn landmark_sheet(
    title: &str,
    fit: &RiggedSequence,
    capture: Option<&Surface>,
) -> Result<Image, RenderError> {
    let body = CapturedBody::new(fit, 0, capture);
    let mut scene = Scene::default();
    let grey = Color::from_srgb(176, 186, 200);
    match &body.capture {
        Some(capture) if !capture.faces.is_empty() => scene.layers.push(Layer::translucent(
            capture.positions.clone(),
            capture.faces.clone(),
            Paint::Uniform(grey),
            VEIL,
        )),
        Some(capture) => {
            let step = capture.positions.len().div_ceil(6_000).max(1);
            let points = capture.positions.iter().step_by(step);
            scene.dots =
                points.map(|position| Dot { position: *position, color: grey, radius: 0.003 }).collect();
        }
        None => {
            let faces = fit.rig.faces.clone();
            scene.layers.push(Layer::translucent(body.vertices.clone(), faces, Paint::Uniform(grey), VEIL));
        }
    }
    let landmarks = fit.sequence.frames.iter().take(1).flat_map(|frame| &frame.landmarks);
    scene.dots.extend(landmarks.map(|landmark| Dot {
        position: landmark.position,
        color: confidence_color(landmark.confidence),
        radius: RADIUS,
    }));
    let front = fit.posed_skeleton(0).rotations[0] * DVec3::Z;
    let panels = [("front", 0.0), ("left", 90.0), ("back", 180.0)]
        .into_iter()
        .map(|(side, yaw)| {
            let view = View { front, up: DVec3::Y, ..View::from_degrees(yaw, 4.0) };
            let camera = Camera::framing(scene.bounds(), view, WIDTH as f64 / HEIGHT as f64);
            let image = render(&scene, &camera, WIDTH, HEIGHT)?;
            Ok(Panel { caption: format!("{title} {side}"), image })
        })
        .collect::<Result<Vec<Panel>, RenderError>>()?;
    contact_sheet(&panels, panels.len())
}

fn confidence_color(confidence: f64) -> Color {
    let share = confidence.clamp(0.0, 1.0);
    let level = |low: f64, high: f64| (low + (high - low) * share).round() as u8;
    Color::from_srgb(level(205.0, 20.0), level(40.0, 140.0), level(40.0, 90.0))
}
