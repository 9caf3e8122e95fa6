//! A floor that catches the soft shadow of what stands on it.

use glam::{DVec2, DVec3};

use super::{Color, Scene};

/// Cells along a side of the shadow map.
const CELLS: usize = 160;
/// Blur radius in cells; three box blurs look like a Gaussian.
const BLUR: usize = 4;
/// Height in metres over which the shadow of a vertex fades to a third.
const FADE_HEIGHT: f64 = 0.45;
/// Deepest shadow: share of light taken from the floor.
const DEPTH: f32 = 0.5;

/// Blurring spreads what small feet throw; this brings the middle of their shadow back to full depth.
const GAIN: f32 = 1.8;

/// The floor of a picture and the darkness on it.
pub(crate) struct Ground {
    height: f64,
    axes: [DVec3; 3],
    low: DVec2,
    cell: f64,
    darkness: Vec<f32>,
}

impl Ground {
    /// The floor of a scene, if it has one; `up` is the vertical.
    pub(crate) fn new(scene: &Scene, up: DVec3) -> Option<Self> {
        let height = scene.ground_height?;
        let up = up.normalize_or(DVec3::Y);
        let across = up.any_orthonormal_vector();
        let axes = [across, up.cross(across), up];
        let bounds = scene.bounds();
        let margin = 0.25;
        let half = 0.5 * (bounds.high - bounds.low).length() + margin;
        let middle = DVec2::new(axes[0].dot(bounds.center()), axes[1].dot(bounds.center()));
        let cell = 2.0 * half / CELLS as f64;
        let mut ground = Self { height, axes, low: middle - half, cell, darkness: vec![0.0; CELLS * CELLS] };
        ground.drop_shadows(scene);
        Some(ground)
    }

    fn drop_shadows(&mut self, scene: &Scene) {
        for position in scene.layers.iter().flat_map(|layer| &layer.positions).filter(|p| p.is_finite()) {
            let above = (self.axes[2].dot(*position) - self.height).max(0.0);
            let place = (self.plane(*position) - self.low) / self.cell;
            let [x, y] = [place.x as usize, place.y as usize];
            if x < CELLS && y < CELLS {
                let cell = &mut self.darkness[y * CELLS + x];
                *cell = cell.max((-above / FADE_HEIGHT).exp() as f32);
            }
        }
        for _ in 0..3 {
            self.darkness = blurred(&self.darkness, 1);
            self.darkness = blurred(&self.darkness, CELLS);
        }
    }

    fn plane(&self, position: DVec3) -> DVec2 {
        DVec2::new(self.axes[0].dot(position), self.axes[1].dot(position))
    }

    /// Distance in metres along a ray to the floor, and the floor's colour there.
    pub(crate) fn hit(&self, origin: DVec3, direction: DVec3, background: Color) -> Option<(f64, Color)> {
        let slope = self.axes[2].dot(direction);
        let distance = (self.height - self.axes[2].dot(origin)) / slope;
        if slope > -1e-6 || distance < 0.0 {
            return None;
        }
        let place = (self.plane(origin + direction * distance) - self.low) / self.cell - 0.5;
        let darkness = (GAIN * self.sample(place)).min(1.0);
        Some((distance, background.scaled(1.0 - DEPTH * darkness)))
    }

    fn sample(&self, place: DVec2) -> f32 {
        let base = place.floor();
        let share = (place - base).as_vec2();
        let at = |x: f64, y: f64| {
            let is_inside = x >= 0.0 && y >= 0.0 && x < CELLS as f64 && y < CELLS as f64;
            if is_inside { self.darkness[y as usize * CELLS + x as usize] } else { 0.0 }
        };
        let upper = at(base.x, base.y) * (1.0 - share.x) + at(base.x + 1.0, base.y) * share.x;
        let lower = at(base.x, base.y + 1.0) * (1.0 - share.x) + at(base.x + 1.0, base.y + 1.0) * share.x;
        upper * (1.0 - share.y) + lower * share.y
    }
}

/// A box blur of a square map along rows (stride 1) or columns (stride `CELLS`).
fn blurred(map: &[f32], stride: usize) -> Vec<f32> {
    let line_stride = if stride == 1 { CELLS } else { 1 };
    let mut out = vec![0.0; map.len()];
    for line in 0..CELLS {
        for i in 0..CELLS {
            let window = i.saturating_sub(BLUR)..(i + BLUR + 1).min(CELLS);
            let sum: f32 = window.map(|j| map[line * line_stride + j * stride]).sum();
            out[line * line_stride + i * stride] = sum / (2 * BLUR + 1) as f32;
        }
    }
    out
}
