//! Stills of a fit: one frame, seen the way that papers and data sheets show it.

use glam::DVec3;
use habitus::artifacts::rigged_sequence::RiggedSequence;
use habitus::geometry::Surface;

use crate::captured_body::CapturedBody;
use crate::render::{
    Camera, Color, ColorScale, Dot, Image, Layer, Paint, Panel, RenderError, Scene, View, contact_sheet,
    render,
};
use crate::report::CaptureView;

/// What a still shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StillContent {
    /// The capture, translucent, with the body inside.
    Overlay,
    /// The capture alone.
    Capture,
    /// The body alone.
    Body,
    /// The body with its clearance to the capture as a heat map.
    Clearance,
}

impl StillContent {
    /// All contents in the order in which a sheet shows them.
    pub const ALL: [Self; 4] = [Self::Capture, Self::Overlay, Self::Body, Self::Clearance];

    /// The name for captions.
    pub fn name(self) -> &'static str {
        match self {
            Self::Overlay => "overlay",
            Self::Capture => "capture",
            Self::Body => "body",
            Self::Clearance => "clearance",
        }
    }
}

/// Share of light that the capture of an overlay stops where it is seen face on.
const VEIL: f64 = 0.3;
/// Radius of a cloud's point in metres.
const POINT_RADIUS: f64 = 0.003;
/// Points of a cloud that are drawn at most.
const POINT_LIMIT: usize = 6_000;

/// One frame of a fit in metres, y up, ready to be drawn from any side.
pub struct FrameStill {
    frame: CapturedBody,
    faces: Vec<[u32; 3]>,
    scale: ColorScale,
}

impl FrameStill {
    /// Takes a frame of a fit and its capture, in the input's frame, if it can be read.
    pub fn new(fit: &RiggedSequence, frame: usize, capture: Option<&Surface>, scale: ColorScale) -> Self {
        Self { frame: CapturedBody::new(fit, frame, capture), faces: fit.rig.faces.clone(), scale }
    }

    /// Draws the frame; all contents of one view have the same camera, so that pictures can be compared.
    ///
    /// # Errors
    /// When the size is unusable.
    pub fn draw(
        &self,
        content: StillContent,
        view: View,
        width: usize,
        height: usize,
    ) -> Result<Image, RenderError> {
        let capture_points = self.frame.capture.iter().flat_map(|capture| &capture.positions);
        let points: Vec<DVec3> = self.frame.vertices.iter().chain(capture_points).copied().collect();
        let camera = Camera::framing_points(&points, view, width as f64 / height.max(1) as f64);
        let lowest =
            points.iter().map(|point| point.y).filter(|y| y.is_finite()).fold(f64::INFINITY, f64::min);
        let mut scene = self.scene(content);
        scene.ground_height = lowest.is_finite().then_some(lowest);
        render(&scene, &camera, width, height)
    }

    /// The picture of each content beside the others, with captions that begin with `title`.
    ///
    /// # Errors
    /// When the size is unusable.
    pub fn sheet(&self, title: &str, view: View, width: usize, height: usize) -> Result<Image, RenderError> {
        let panel = |content: StillContent| {
            let mut image = self.draw(content, view, width, height)?;
            if content == StillContent::Clearance {
                let legend = self.scale.legend(width.min(240), 30)?;
                image.paste(&legend, 0, height.saturating_sub(30));
            }
            Ok(Panel { caption: format!("{title} {}", content.name()), image })
        };
        let panels: Vec<Panel> =
            StillContent::ALL.into_iter().map(panel).collect::<Result<_, RenderError>>()?;
        contact_sheet(&panels, panels.len())
    }

    fn scene(&self, content: StillContent) -> Scene {
        let mut scene = Scene::default();
        let skin = Paint::Uniform(Color::from_srgb(230, 184, 154));
        match (content, &self.frame.clearance_mm) {
            (StillContent::Capture, _) => {}
            (StillContent::Clearance, Some(values)) => {
                let colors = values.iter().map(|value| self.scale.color(*value)).collect();
                scene.layers.push(Layer::opaque(
                    self.frame.vertices.clone(),
                    self.faces.clone(),
                    Paint::PerVertex(colors),
                ));
            }
            _ => scene.layers.push(Layer::opaque(self.frame.vertices.clone(), self.faces.clone(), skin)),
        }
        if let (StillContent::Capture | StillContent::Overlay, Some(capture)) = (content, &self.frame.capture)
        {
            let color = Color::from_srgb(128, 152, 184);
            let CaptureView { positions, faces } = capture;
            if faces.is_empty() {
                let step = positions.len().div_ceil(POINT_LIMIT).max(1);
                let drawn = positions.iter().step_by(step);
                scene.dots =
                    drawn.map(|position| Dot { position: *position, color, radius: POINT_RADIUS }).collect();
            } else if content == StillContent::Overlay {
                let paint = Paint::Uniform(color);
                scene.layers.push(Layer::translucent(positions.clone(), faces.clone(), paint, VEIL));
            } else {
                scene.layers.push(Layer::opaque(positions.clone(), faces.clone(), Paint::Uniform(color)));
            }
        }
        scene
    }
}
