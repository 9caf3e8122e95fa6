//! What a picture shows: meshes, curves and dots, in metres.

use glam::DVec3;

use super::{Bounds, Camera, Color, View};

/// The colour of a layer.
#[derive(Debug, Clone)]
pub enum Paint {
    /// One colour everywhere.
    Uniform(Color),
    /// One colour a vertex, interpolated over faces.
    PerVertex(Vec<Color>),
}

/// How normals vary over a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Smoothness {
    /// Vertex normals are interpolated: a smooth surface.
    Smooth,
    /// One normal a face: the triangles can be seen.
    Faceted,
}

/// A mesh of the scene.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Vertex positions in metres.
    pub positions: Vec<DVec3>,
    /// Triangles as vertex numbers, outward counter-clockwise.
    pub faces: Vec<[u32; 3]>,
    /// Colour.
    pub paint: Paint,
    /// Share of light that the surface stops where it is seen face on, 0–1; 1 is opaque.
    pub opacity: f64,
    /// Same where it is seen edge on; above `opacity`, the outline of a translucent layer stays visible.
    pub edge_opacity: f64,
    /// How normals vary.
    pub smoothness: Smoothness,
}

impl Layer {
    /// An opaque, smooth layer.
    pub fn opaque(positions: Vec<DVec3>, faces: Vec<[u32; 3]>, paint: Paint) -> Self {
        Self { positions, faces, paint, opacity: 1.0, edge_opacity: 1.0, smoothness: Smoothness::Smooth }
    }

    /// A translucent, smooth layer whose outline stays visible.
    pub fn translucent(positions: Vec<DVec3>, faces: Vec<[u32; 3]>, paint: Paint, opacity: f64) -> Self {
        let edge_opacity = (opacity + 0.55).min(0.95).max(opacity);
        Self { positions, faces, paint, opacity, edge_opacity, smoothness: Smoothness::Smooth }
    }

    pub(crate) fn is_opaque(&self) -> bool {
        self.opacity >= 1.0
    }
}

/// A curve in space, drawn as a round tube: a girth on the body, a path.
#[derive(Debug, Clone)]
pub struct Curve {
    /// Corners in metres.
    pub points: Vec<DVec3>,
    /// Whether the last corner is joined to the first.
    pub is_closed: bool,
    /// Colour.
    pub color: Color,
    /// Radius of the tube in metres.
    pub radius: f64,
}

/// A dot in space, drawn as a ball: a landmark, a joint.
#[derive(Debug, Clone, Copy)]
pub struct Dot {
    /// Centre in metres.
    pub position: DVec3,
    /// Colour.
    pub color: Color,
    /// Radius in metres.
    pub radius: f64,
}

/// How surfaces are lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lighting {
    /// A soft key light and a fill light that stand beside the camera, and a bright sky.
    Studio,
    /// Plain colours without shading or edge opacity, for exact comparisons.
    Unlit,
}

/// Everything that a picture shows.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Meshes, in any order.
    pub layers: Vec<Layer>,
    /// Curves.
    pub curves: Vec<Curve>,
    /// Dots.
    pub dots: Vec<Dot>,
    /// Colour behind everything.
    pub background: Color,
    /// How surfaces are lit.
    pub lighting: Lighting,
    /// Height in metres, along the camera's up direction, of a floor that catches a soft shadow.
    pub ground_height: Option<f64>,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            layers: Vec::new(),
            curves: Vec::new(),
            dots: Vec::new(),
            background: Color::from_srgb(244, 245, 247),
            lighting: Lighting::Studio,
            ground_height: None,
        }
    }
}

impl Scene {
    /// The camera of a view that just sees everything in a picture of this width/height ratio.
    pub fn camera(&self, view: View, aspect: f64) -> Camera {
        Camera::framing_points(&self.points().collect::<Vec<_>>(), view, aspect)
    }

    /// The box around all finite vertices, curve corners and dots; a unit box when there is nothing.
    pub fn bounds(&self) -> Bounds {
        Bounds::around(self.points())
    }

    fn points(&self) -> impl Iterator<Item = DVec3> + '_ {
        let layers = self.layers.iter().flat_map(|layer| layer.positions.iter().copied());
        let curves = self.curves.iter().flat_map(|curve| curve.points.iter().copied());
        let dots = self.dots.iter().map(|dot| dot.position);
        layers.chain(curves).chain(dots)
    }
}
