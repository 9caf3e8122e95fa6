//! Triangles to pixels: a visibility buffer in bands of rows, then one shading of every sample.

use glam::DVec3;
use habitus::geometry::vertex_normals_into;
use rayon::prelude::*;

use super::camera::Projector;
use super::ground::Ground;
use super::marks::{balls, tube};
use super::shade::Studio;
use super::{Camera, Color, Image, Layer, Lighting, Paint, RenderError, Scene, Smoothness};

/// Samples along a pixel's side.
const SAMPLES: usize = 2;
/// Sample rows that one task draws; small enough for balance, large enough that few triangles cross a border.
const BAND_ROWS: usize = 32;
/// Marks a sample that shows nothing.
const NOTHING: u32 = u32::MAX;

/// What a sample of the picture shows of one buffer: the nearest face.
#[derive(Clone, Copy)]
struct Fragment {
    distance: f32,
    layer: u32,
    face: u32,
    /// Perspective-correct shares of the face's second and third vertex.
    shares: [f32; 2],
}

const EMPTY: Fragment = Fragment { distance: f32::INFINITY, layer: NOTHING, face: 0, shares: [0.0; 2] };

/// A layer made ready: vertices on the screen, normals in space.
struct Prepared<'a> {
    layer: &'a Layer,
    /// Column, row and distance of each vertex, in samples and metres.
    screen: Vec<[f64; 3]>,
    normals: Vec<DVec3>,
    /// Faces that touch each band.
    bands: Vec<Vec<u32>>,
}

/// Everything that shading a sample needs.
struct Picture<'a> {
    scene: &'a Scene,
    projector: Projector,
    studio: Studio,
    ground: Option<Ground>,
    layers: Vec<Prepared<'a>>,
    columns: usize,
    rows: usize,
}

/// Draws a scene: opaque layers hide each other, and of each translucent layer the nearest face is blended over what is behind it.
///
/// The pixels do not depend on the number of threads. Faces that reach behind the camera are left out.
///
/// # Errors
/// When the size is unusable, a face names a missing vertex or vertex colours are missing.
pub fn render(scene: &Scene, camera: &Camera, width: usize, height: usize) -> Result<Image, RenderError> {
    let mut image = Image::filled(width, height, scene.background.to_srgb())?;
    check(scene)?;
    let marks: Vec<Layer> = scene.curves.iter().filter_map(tube).chain(balls(&scene.dots)).collect();
    let [columns, rows] = [width, height].map(|side| side * SAMPLES);
    let projector = Projector::new(camera, columns, rows);
    let layers = scene.layers.iter().chain(&marks);
    let layers = layers.map(|layer| prepare(layer, &projector, columns, rows)).collect();
    let picture = Picture {
        scene,
        studio: Studio::new(projector.axes(), camera.up),
        ground: Ground::new(scene, camera.up),
        projector,
        layers,
        columns,
        rows,
    };
    let pixels_per_band = BAND_ROWS / SAMPLES * width;
    image.pixels_mut().par_chunks_mut(pixels_per_band).enumerate().for_each(|(band, pixels)| {
        picture.draw_band(band, pixels);
    });
    Ok(image)
}

fn check(scene: &Scene) -> Result<(), RenderError> {
    for (number, layer) in scene.layers.iter().enumerate() {
        let vertex_count = layer.positions.len();
        if let Paint::PerVertex(colors) = &layer.paint
            && colors.len() != vertex_count
        {
            return Err(RenderError::ColorCount { layer: number, color_count: colors.len(), vertex_count });
        }
        for (face, corners) in layer.faces.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&vertex| vertex as usize >= vertex_count) {
                return Err(RenderError::FaceOutOfRange { layer: number, face, vertex, vertex_count });
            }
        }
    }
    Ok(())
}

fn prepare<'a>(layer: &'a Layer, projector: &Projector, columns: usize, rows: usize) -> Prepared<'a> {
    let screen: Vec<[f64; 3]> = layer.positions.par_iter().map(|&p| projector.project(p)).collect();
    let mut bands = vec![Vec::new(); rows.div_ceil(BAND_ROWS)];
    for (number, face) in layer.faces.iter().enumerate() {
        let corners = face.map(|vertex| screen[vertex as usize]);
        if corners.iter().flatten().any(|value| !value.is_finite()) {
            continue;
        }
        let [low_x, high_x] = range(corners.map(|c| c[0]));
        let [low_y, high_y] = range(corners.map(|c| c[1]));
        if high_x < 0.0 || low_x > columns as f64 || high_y < 0.0 || low_y > rows as f64 {
            continue;
        }
        let first = low_y.max(0.0) as usize / BAND_ROWS;
        let last = (high_y as usize / BAND_ROWS).min(bands.len() - 1);
        for band in &mut bands[first.min(last)..=last] {
            band.push(number as u32);
        }
    }
    let mut normals = Vec::new();
    vertex_normals_into(&layer.positions, &layer.faces, &mut normals);
    Prepared { layer, screen, normals, bands }
}

fn range(values: [f64; 3]) -> [f64; 2] {
    [values[0].min(values[1]).min(values[2]), values[0].max(values[1]).max(values[2])]
}

impl Picture<'_> {
    fn draw_band(&self, band: usize, pixels: &mut [[u8; 3]]) {
        let first_row = band * BAND_ROWS;
        let row_count = BAND_ROWS.min(self.rows - first_row);
        let mut opaque = vec![EMPTY; row_count * self.columns];
        let mut translucent = Vec::new();
        for (number, prepared) in self.layers.iter().enumerate() {
            if prepared.layer.is_opaque() {
                self.draw_layer(number, band, &mut opaque);
            } else if prepared.layer.opacity > 0.0 || prepared.layer.edge_opacity > 0.0 {
                let mut buffer = vec![EMPTY; opaque.len()];
                self.draw_layer(number, band, &mut buffer);
                translucent.push(buffer);
            }
        }
        let width = self.columns / SAMPLES;
        let mut behind = Vec::with_capacity(translucent.len());
        for (number, pixel) in pixels.iter_mut().enumerate() {
            let [x, y] = [number % width, number / width].map(|place| place * SAMPLES);
            let mut sum = Color { red: 0.0, green: 0.0, blue: 0.0 };
            for [dx, dy] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                let sample = (y + dy) * self.columns + x + dx;
                let place = [(x + dx) as f64 + 0.5, (first_row + y + dy) as f64 + 0.5];
                behind.clear();
                behind.extend(translucent.iter().map(|buffer| buffer[sample]));
                sum = sum.plus(self.shade_sample(place, opaque[sample], &mut behind));
            }
            *pixel = sum.scaled(1.0 / (SAMPLES * SAMPLES) as f32).to_srgb();
        }
    }

    /// Keeps, for each sample of the band, the nearest of its own fragment and the layer's faces.
    fn draw_layer(&self, number: usize, band: usize, buffer: &mut [Fragment]) {
        let prepared = &self.layers[number];
        let first_row = band * BAND_ROWS;
        let last_row = first_row + buffer.len() / self.columns;
        for &face in &prepared.bands[band] {
            let [a, b, c] = prepared.layer.faces[face as usize].map(|v| prepared.screen[v as usize]);
            let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            if area.abs() < 1e-12 {
                continue;
            }
            let [low_x, high_x] = range([a[0], b[0], c[0]]);
            let [low_y, high_y] = range([a[1], b[1], c[1]]);
            let x_range = sample_range(low_x, high_x, 0, self.columns);
            for y in sample_range(low_y, high_y, first_row, last_row) {
                let py = y as f64 + 0.5;
                let row = &mut buffer[(y - first_row) * self.columns..][..self.columns];
                for x in x_range.clone() {
                    let px = x as f64 + 0.5;
                    let share_b = ((px - a[0]) * (c[1] - a[1]) - (py - a[1]) * (c[0] - a[0])) / area;
                    let share_c = ((b[0] - a[0]) * (py - a[1]) - (b[1] - a[1]) * (px - a[0])) / area;
                    let share_a = 1.0 - share_b - share_c;
                    if share_a < 0.0 || share_b < 0.0 || share_c < 0.0 {
                        continue;
                    }
                    let (distance, shares) = self.depth([a[2], b[2], c[2]], [share_a, share_b, share_c]);
                    if distance < row[x].distance {
                        row[x] = Fragment { distance, layer: number as u32, face, shares };
                    }
                }
            }
        }
    }

    /// Distance of a place in a triangle from its corner distances and its shares on the screen.
    fn depth(&self, corners: [f64; 3], shares: [f64; 3]) -> (f32, [f32; 2]) {
        if !self.projector.is_perspective() {
            let distance = corners[0] * shares[0] + corners[1] * shares[1] + corners[2] * shares[2];
            return (distance as f32, [shares[1] as f32, shares[2] as f32]);
        }
        // Inverse distance, not distance, is linear on the screen.
        let inverse = [shares[0] / corners[0], shares[1] / corners[1], shares[2] / corners[2]];
        let distance = 1.0 / (inverse[0] + inverse[1] + inverse[2]);
        (distance as f32, [(inverse[1] * distance) as f32, (inverse[2] * distance) as f32])
    }

    fn shade_sample(&self, place: [f64; 2], opaque: Fragment, translucent: &mut Vec<Fragment>) -> Color {
        let (origin, direction) = self.projector.ray(place[0], place[1]);
        let mut nearest = opaque.distance;
        let mut color = self.scene.background;
        if opaque.layer != NOTHING {
            color = self.shade_fragment(opaque, direction).0;
        }
        if let Some(ground) = &self.ground
            && let Some((along_ray, floor)) = ground.hit(origin, direction, self.scene.background)
        {
            let distance = (along_ray * -self.projector.axes()[2].dot(direction)) as f32;
            if distance < nearest {
                (nearest, color) = (distance, floor);
            }
        }
        translucent.retain(|fragment| fragment.layer != NOTHING && fragment.distance < nearest);
        translucent.sort_by(|a, b| b.distance.total_cmp(&a.distance));
        for &fragment in translucent.iter() {
            let (surface, opacity) = self.shade_fragment(fragment, direction);
            color = color.mix(surface, opacity as f32);
        }
        color
    }

    /// Light of a fragment's surface and how much of what is behind it the surface hides.
    fn shade_fragment(&self, fragment: Fragment, direction: DVec3) -> (Color, f64) {
        let prepared = &self.layers[fragment.layer as usize];
        let layer = prepared.layer;
        let corners = layer.faces[fragment.face as usize].map(|vertex| vertex as usize);
        let shares = [1.0 - fragment.shares[0] - fragment.shares[1], fragment.shares[0], fragment.shares[1]];
        let albedo = match &layer.paint {
            Paint::Uniform(color) => *color,
            Paint::PerVertex(colors) => (0..3).fold(Color { red: 0.0, green: 0.0, blue: 0.0 }, |sum, k| {
                sum.plus(colors[corners[k]].scaled(shares[k]))
            }),
        };
        if self.scene.lighting == Lighting::Unlit {
            return (albedo, layer.opacity);
        }
        let [a, b, c] = corners.map(|vertex| layer.positions[vertex]);
        let flat = (b - a).cross(c - a).normalize_or_zero();
        let smooth =
            (0..3).fold(DVec3::ZERO, |sum, k| sum + prepared.normals[corners[k]] * f64::from(shares[k]));
        let normal = match layer.smoothness {
            Smoothness::Smooth => smooth.normalize_or(flat),
            Smoothness::Faceted => flat,
        };
        let toward_eye = -direction;
        // A face seen from behind is a hole's inside: it is lit from our side, and darker.
        let is_back = flat.dot(toward_eye) < 0.0;
        let facing = if is_back { -normal } else { normal };
        let albedo = if is_back && layer.is_opaque() { albedo.scaled(0.45) } else { albedo };
        let edge = (1.0 - facing.dot(toward_eye).clamp(0.0, 1.0)).powi(2);
        let opacity = layer.opacity + (layer.edge_opacity - layer.opacity) * edge;
        (self.studio.shade(albedo, facing, toward_eye), opacity)
    }
}

/// Samples whose centres may lie between two places, cut to `first..last`.
fn sample_range(low: f64, high: f64, first: usize, last: usize) -> std::ops::Range<usize> {
    let start = ((low - 0.5).ceil().max(0.0) as usize).max(first);
    let end = ((high + 0.5).floor().max(0.0) as usize).min(last);
    start..end.max(start)
}
