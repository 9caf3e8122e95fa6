//! Carves a grid of voxels with the views of many cameras.

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use crate::capture::{Subject, bounds};
use crate::isosurface::ScalarGrid;
use crate::view::{SHEET_VOXELS, TRUNCATION_VOXELS, View};

/// Voxels are carved in blocks of this many along each axis.
const BRICK: usize = 4;

/// Fills the grid with the largest "outside" over all views, brick by brick so that a view's image stays in cache.
///
/// Cloth has no volume, so a camera that looks under a hem would carve it away from within: next to a mesh, a sheet
/// of some thickness behind each outer face that a camera sees is kept.
pub(crate) fn carve(grid: &mut ScalarGrid, world_from_grid: DMat3, views: &[View], is_near_mesh: &BrickSet) {
    let [nx, ny, nz] = grid.dimensions;
    let (origin, spacing) = (grid.origin, grid.spacing);
    let truncation = TRUNCATION_VOXELS * spacing as f32;
    grid.samples.par_chunks_mut(nx * ny * BRICK).enumerate().for_each(|(layer, samples)| {
        let first_z = layer * BRICK;
        samples.fill(-truncation);
        for first_y in (0..ny).step_by(BRICK) {
            for first_x in (0..nx).step_by(BRICK) {
                let brick = Brick {
                    corner: origin + DVec3::new(first_x as f64, first_y as f64, first_z as f64) * spacing,
                    world_from_grid: world_from_grid * spacing,
                    counts: [nx - first_x, ny - first_y, nz - first_z].map(|left| left.min(BRICK)),
                    start: first_y * nx + first_x,
                    strides: [nx, nx * ny],
                    truncation,
                };
                let has_mesh = is_near_mesh.contains([first_x / BRICK, first_y / BRICK, layer]);
                brick.carve(samples, views, has_mesh);
            }
        }
    });
}

/// A block of voxels.
struct Brick {
    /// Grid space, metres.
    corner: DVec3,
    /// One voxel's steps in world space.
    world_from_grid: DMat3,
    counts: [usize; 3],
    start: usize,
    strides: [usize; 2],
    truncation: f32,
}

impl Brick {
    fn carve(&self, samples: &mut [f32], views: &[View], has_mesh: bool) {
        // Silhouettes never know the distance to a surface that is seen right there: nothing is kept near a mesh.
        let has_mesh = has_mesh && views.iter().any(|view| !view.is_silhouette());
        let mut near = [self.truncation; BRICK * BRICK * BRICK];
        if !has_mesh && views.iter().any(|view| self.is_beside(view)) {
            self.each_voxel(|sample, _, _| samples[sample] = self.truncation);
            return;
        }
        for view in views.iter().filter(|view| !self.is_deep_within(view)) {
            let is_any_left = self.carve_by(samples, view, has_mesh.then_some(&mut near));
            if !is_any_left && !has_mesh {
                return;
            }
        }
        if has_mesh {
            // Views from the side carve at once where a frontal view knows the distance: keep the better number.
            self.each_voxel(|sample, voxel, _| samples[sample] = samples[sample].min(near[voxel]));
        }
    }

    /// Whether a view says of every voxel that it lies as far outside as is counted. Silhouettes alone bound the
    /// hull wherever it is hollow, so that a brick next to one of them is carved voxel by voxel.
    fn is_beside(&self, view: &View) -> bool {
        let (centre, radius) = self.ball(view);
        view.is_beside(centre, if view.is_silhouette() { radius + self.truncation } else { radius })
    }

    /// Whether a view says of every voxel that it lies as deep inside as is counted, and so carves nothing.
    fn is_deep_within(&self, view: &View) -> bool {
        let (centre, radius) = self.ball(view);
        view.is_silhouette() && view.is_within(centre, radius + self.truncation)
    }

    /// Centre of the brick in a camera's frame, and the radius around it that holds all voxels.
    fn ball(&self, view: &View) -> (Vec3, f32) {
        let spacing = self.world_from_grid.x_axis.length();
        let half = BRICK as f64 * 0.5;
        let centre = self.world_from_grid * (self.corner / spacing + half);
        (view.map.camera.in_camera(centre).as_vec3(), (half * spacing * 3.0_f64.sqrt()) as f32)
    }

    /// Carves by one view; false once every voxel is certainly empty.
    fn carve_by(
        &self,
        samples: &mut [f32],
        view: &View,
        mut near: Option<&mut [f32; BRICK * BRICK * BRICK]>,
    ) -> bool {
        let camera = &view.map.camera;
        let spacing = self.world_from_grid.x_axis.length();
        let steps = camera.camera_from_world * self.world_from_grid;
        let steps = [steps.x_axis, steps.y_axis, steps.z_axis].map(|axis| axis.as_vec3());
        let corner = camera.in_camera(self.world_from_grid * (self.corner / spacing)).as_vec3();
        let mut is_any_left = false;
        self.each_voxel(|sample, voxel, [x, y, z]| {
            if near.is_none() && samples[sample] >= self.truncation {
                return;
            }
            let place = corner + steps[0] * x + steps[1] * y + steps[2] * z;
            let (outside, near_here) = view.look(place, self.truncation);
            samples[sample] = samples[sample].max(outside);
            is_any_left |= samples[sample] < self.truncation;
            if let Some(near) = &mut near {
                near[voxel] = near[voxel].min(near_here);
            }
        });
        is_any_left
    }

    /// Visits the voxels: place in the layer's samples, place in the brick, steps from the corner.
    fn each_voxel(&self, mut visit: impl FnMut(usize, usize, [f32; 3])) {
        for z in 0..self.counts[2] {
            for y in 0..self.counts[1] {
                let row = self.start + y * self.strides[0] + z * self.strides[1];
                for x in 0..self.counts[0] {
                    visit(row + x, (z * BRICK + y) * BRICK + x, [x as f32, y as f32, z as f32]);
                }
            }
        }
    }
}

/// The bricks that any mesh passes through.
pub(crate) struct BrickSet {
    counts: [usize; 3],
    is_member: Vec<bool>,
}

impl BrickSet {
    pub(crate) fn new(grid: &ScalarGrid, world_from_grid: DMat3, subjects: &[Subject<'_>]) -> Self {
        let counts = grid.dimensions.map(|count| count.div_ceil(BRICK));
        let mut set = Self { counts, is_member: vec![false; counts.iter().product()] };
        let grid_from_world = world_from_grid.transpose();
        // Half a sheet and the next sample outside.
        let margin = DVec3::splat(f64::from(SHEET_VOXELS) + 1.0);
        for subject in subjects {
            let places: Vec<DVec3> = subject
                .positions
                .iter()
                .map(|&position| (grid_from_world * position - grid.origin) / grid.spacing)
                .collect();
            for face in subject.faces {
                let (low, high) = bounds(face.iter().map(|&vertex| places[vertex as usize]));
                // Float to integer casts saturate at zero, the grid's own margin covers the rest.
                let first = ((low - margin) / BRICK as f64).to_array().map(|place| place as usize);
                let last = ((high + margin) / BRICK as f64).to_array().map(|place| place as usize);
                set.insert(first, last);
            }
        }
        set
    }

    fn insert(&mut self, first: [usize; 3], last: [usize; 3]) {
        for z in first[2]..=last[2].min(self.counts[2] - 1) {
            for y in first[1]..=last[1].min(self.counts[1] - 1) {
                for x in first[0]..=last[0].min(self.counts[0] - 1) {
                    self.is_member[(z * self.counts[1] + y) * self.counts[0] + x] = true;
                }
            }
        }
    }

    fn contains(&self, [x, y, z]: [usize; 3]) -> bool {
        self.is_member[(z * self.counts[1] + y) * self.counts[0] + x]
    }
}
