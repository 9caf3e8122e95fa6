//! What hangs on what, as P3 Fig. 1 shows it: clothing in the colours of its body vertices, and one vertex with more and
//! more of them.

use glam::DVec3;
use habitus::artifacts::clothing_layer::ClothingLayer;

use crate::render::{
    Bounds, Camera, Color, Dot, Image, Layer, Paint, Panel, RenderError, Scene, View, contact_sheet, render,
};

/// Numbers of body vertices that the sheet shows, P3 Fig. 1; the layer's own is the last.
const COUNTS: [usize; 3] = [1, 3, 9];
/// Share of light that the clothing stops over the body of one vertex.
const VEIL: f64 = 0.12;
/// Radius of the dot on the clothing vertex, metres.
const DOT_RADIUS: f64 = 0.012;

/// Clothing and body in the colours of the association, then the body vertices of one clothing vertex for n_f of 1, 3, 9
/// and the layer's own. The vertex shown is the one that most bones share.
///
/// # Errors
/// When the size is unusable.
pub fn association_sheet(
    layer: &ClothingLayer,
    frame: usize,
    width: usize,
    height: usize,
) -> Result<Image, RenderError> {
    let sheet = AssociationSheet::new(layer, frame, width as f64 / height.max(1) as f64);
    let colors = place_colors(&layer.rest_vertices);
    let clothing_colors = (0..layer.clothing_vertex_count())
        .map(|vertex| {
            let heaviest = layer.association.of(vertex).next();
            heaviest.map_or(Color::from_srgb(128, 128, 128), |(body, _)| colors[body])
        })
        .collect();
    let own = layer.association.body_vertices_per_clothing_vertex;
    let mut counts: Vec<usize> = COUNTS.into_iter().filter(|count| *count < own).collect();
    counts.push(own);
    let mut scenes = vec![
        ("clothing".to_string(), sheet.scene(None, Some(Paint::PerVertex(clothing_colors)), None)),
        ("body".to_string(), sheet.scene(Some(Paint::PerVertex(colors)), None, None)),
    ];
    let shown = most_shared_vertex(layer);
    for count in counts {
        let paint = Paint::PerVertex(weight_colors(layer, shown, count));
        let veil = Paint::Uniform(Color::from_srgb(128, 152, 184));
        scenes.push((format!("n_f = {count}"), sheet.scene(Some(paint), Some(veil), Some(shown))));
    }
    let count = scenes.len();
    let panels: Vec<Panel> = scenes
        .into_iter()
        .map(|(caption, scene)| Ok(Panel { caption, image: render(&scene, &sheet.camera, width, height)? }))
        .collect::<Result<_, RenderError>>()?;
    contact_sheet(&panels, count)
}

struct AssociationSheet<'a> {
    layer: &'a ClothingLayer,
    clothing: Vec<DVec3>,
    body: Vec<DVec3>,
    camera: Camera,
}

impl<'a> AssociationSheet<'a> {
    fn new(layer: &'a ClothingLayer, frame: usize, aspect: f64) -> Self {
        let posed = layer.posed_skeleton(frame);
        let mut body = Vec::new();
        layer.rig.skin.apply_into(&layer.rest_vertices, &posed, &mut body);
        let clothing = layer.clothing_vertices(frame);
        // The person faces the camera, whatever the heading.
        let front = posed.rotations.first().map_or(DVec3::Z, |rotation| *rotation * DVec3::Z);
        let front = DVec3::new(front.x, 0.0, front.z).try_normalize().unwrap_or(DVec3::Z);
        let view = View { front, ..View::from_degrees(20.0, 5.0) };
        let camera = Camera::framing_points(&clothing, view, aspect);
        Self { layer, clothing, body, camera }
    }

    fn scene(&self, body: Option<Paint>, clothing: Option<Paint>, dot: Option<usize>) -> Scene {
        let mut scene = Scene::default();
        let is_veiled = body.is_some();
        if let Some(paint) = body {
            scene.layers.push(Layer::opaque(self.body.clone(), self.layer.rig.faces.clone(), paint));
        }
        if let Some(paint) = clothing {
            let (positions, faces) = (self.clothing.clone(), self.layer.clothing_faces.clone());
            scene.layers.push(match is_veiled {
                true => Layer::translucent(positions, faces, paint, VEIL),
                false => Layer::opaque(positions, faces, paint),
            });
        }
        scene.dots.extend(dot.map(|vertex| Dot {
            position: self.clothing[vertex],
            color: Color::from_srgb(214, 69, 65),
            radius: DOT_RADIUS,
        }));
        scene
    }
}

/// A colour for each place of the body: neighbours look alike, left and right, front and back do not.
fn place_colors(rest_vertices: &[DVec3]) -> Vec<Color> {
    let bounds = Bounds::around(rest_vertices.iter().copied());
    let size = (bounds.high - bounds.low).max(DVec3::splat(1e-9));
    let color = |position: &DVec3| {
        let place = (*position - bounds.low) / size;
        let stripes = 0.5 + 0.5 * (place.y * 40.0).sin();
        let part = |share: f64| (40.0 + 200.0 * share.clamp(0.0, 1.0)) as u8;
        Color::from_srgb(part(place.x), part(0.25 + 0.5 * stripes * place.y), part(1.0 - place.z))
    };
    rest_vertices.iter().map(color).collect()
}

/// Blue by weight over a light body, P3 Fig. 1 right; the heaviest vertex is full blue.
fn weight_colors(layer: &ClothingLayer, vertex: usize, count: usize) -> Vec<Color> {
    let mut colors = vec![Color::from_srgb(235, 228, 222); layer.rest_vertices.len()];
    let strongest = layer.association.of(vertex).next().map_or(1.0, |(_, weight)| weight);
    for (body, weight) in layer.association.of(vertex).take(count) {
        let share = (0.25 + 0.75 * weight / strongest) as f32;
        colors[body] = colors[body].mix(Color::from_srgb(20, 60, 200), share);
    }
    colors
}

/// The clothing vertex whose bones share it most evenly.
fn most_shared_vertex(layer: &ClothingLayer) -> usize {
    let skin = layer.association.blended_skin(&layer.rig);
    let heaviest = |vertex: usize| skin.of(vertex).map(|(_, weight)| weight).fold(0.0, f64::max);
    (0..skin.point_count()).min_by(|a, b| heaviest(*a).total_cmp(&heaviest(*b))).unwrap_or(0)
}
