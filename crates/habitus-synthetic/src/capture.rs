//! An independent mesh per frame, as a stage of cameras gives it: space is carved wherever a camera sees past it.
//!
//! The grid that is carved lies turned and shifted at random in each frame, so captures share no correspondence.
//! With silhouettes alone (no depth) the result is the visual hull that P2 §6.1 captures with 68 cameras.

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::depth_map::{Camera, DepthMap, NO_FACE, Plane};
use crate::isosurface::{ScalarGrid, Triangles};
use crate::random::Random;

/// What each virtual camera measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CaptureMode {
    /// A depth per pixel: concave places are seen, as scanners and depth cameras do.
    Scanner,
    /// Silhouettes only: the visual hull of P2 §6.1.
    VisualHull,
}

/// The virtual stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CaptureSettings {
    /// What each camera measures.
    pub mode: CaptureMode,
    /// Number of cameras. P2 §6.1: 68 (silhouettes); depth needs fewer.
    pub camera_count: usize,
    /// Distance of the cameras from the middle of the subject, metres.
    pub camera_distance: f64,
    /// Image height, pixels; the subject fills it.
    pub image_height: usize,
    /// Edge of a voxel, millimetres.
    pub voxel_mm: f64,
    /// Standard deviation of the noise on each vertex coordinate, millimetres.
    pub noise_mm: f64,
    /// Components with less than this share of the largest one's faces are dropped.
    pub smallest_component_share: f64,
}

impl Default for CaptureSettings {
    fn default() -> Self {
        Self {
            mode: CaptureMode::Scanner,
            camera_count: 18,
            camera_distance: 3.2,
            image_height: 560,
            voxel_mm: 12.0,
            noise_mm: 1.0,
            smallest_component_share: 0.02,
        }
    }
}

/// Field values are clamped to this many voxels.
const TRUNCATION_VOXELS: f32 = 2.5;
/// Depth seen flatter than this (cosine between ray and normal) says where a surface ends, not how deep a point is.
const GRAZING_COSINE: f32 = 0.25;
/// Depth seen steeper than this is good for the exact place of a surface.
const FRONTAL_COSINE: f32 = 0.65;
/// One pixel in chamfer distances (weights 3 and 4, Borgefors 1986).
const CHAMFER_PIXEL: u8 = 3;
/// Distances from the silhouette are not followed further, pixels.
const FARTHEST_PIXELS: usize = 32;
/// Cloth is captured at least this thick, voxels: thinner near fall between the samples.
const SHEET_VOXELS: f32 = 1.1;
/// Ears and fingers are captured at least this thick, voxels.
const THIN_VOXELS: f32 = 1.25;
/// Voxels are carved in blocks of this many along each axis.
const BRICK: usize = 4;

/// A mesh in front of the cameras.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// Vertices, metres.
    pub positions: &'a [DVec3],
    /// Faces, outward counter-clockwise.
    pub faces: &'a [[u32; 3]],
    /// What it is made of.
    pub substance: Substance,
}

/// Whether a mesh bounds a volume.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Substance {
    /// A closed surface around a solid.
    Solid,
    /// A thin open sheet.
    Sheet,
}

/// The capture of the union of some meshes; `name` and `seed` fix its grid, its stage's heading and its noise.
pub fn capture(subjects: &[Subject<'_>], settings: &CaptureSettings, seed: u64, name: &str) -> Triangles {
    let mut subjects = subjects.to_vec();
    subjects.sort_by_key(|subject| subject.substance == Substance::Sheet);
    let subjects = subjects.as_slice();
    let mut random = Random::named(seed, name);
    let positions = || subjects.iter().flat_map(|subject| subject.positions.iter().copied());
    let (low, high) = bounds(positions());
    let heading = random.between(0.0, std::f64::consts::TAU);
    let views: Vec<View> = stage(low, high, settings, heading)
        .into_par_iter()
        .map(|camera| View::new(camera, subjects, settings.mode))
        .collect();

    let spacing = settings.voxel_mm / 1000.0;
    let world_from_grid = DMat3::from_rotation_y(random.between(0.0, std::f64::consts::TAU))
        * DMat3::from_rotation_x(random.between(-0.2, 0.2))
        * DMat3::from_rotation_z(random.between(-0.2, 0.2));
    let (low, high) = bounds(positions().map(|position| world_from_grid.transpose() * position));
    let margin = || DVec3::splat(3.0 * spacing);
    let shift = DVec3::new(random.unit(), random.unit(), random.unit()) * spacing;
    let mut grid = ScalarGrid::covering(low - margin() - shift, high + margin(), spacing);
    let is_near_mesh = BrickSet::new(&grid, world_from_grid, subjects);
    carve(&mut grid, world_from_grid, &views, &is_near_mesh);

    let (positions, faces) = grid.surface();
    let (mut positions, faces) = largest_components(positions, faces, settings.smallest_component_share);
    let noise = settings.noise_mm / 1000.0;
    for position in &mut positions {
        let offset = DVec3::new(random.normal(), random.normal(), random.normal()) * noise;
        *position = world_from_grid * *position + offset;
    }
    (positions, faces)
}

fn bounds(positions: impl Iterator<Item = DVec3>) -> (DVec3, DVec3) {
    positions.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), position| {
        (low.min(position), high.max(position))
    })
}

/// Cameras spread evenly over the sphere around the subject (golden-angle spiral), from 12° below to 80° above.
fn stage(low: DVec3, high: DVec3, settings: &CaptureSettings, heading: f64) -> Vec<Camera> {
    let middle = (low + high) * 0.5;
    let half_diagonal = (high - low).length() * 0.5;
    let distance = settings.camera_distance.max(2.0 * half_diagonal);
    // The subject's bounding sphere touches the image's upper and lower edge.
    let focal =
        settings.image_height as f64 * 0.5 * (distance * distance - half_diagonal * half_diagonal).sqrt()
            / half_diagonal.max(1e-9);
    let golden_angle = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let (lowest, highest) = ((-12.0_f64).to_radians().sin(), 80.0_f64.to_radians().sin());
    (0..settings.camera_count)
        .map(|index| {
            let sine = lowest + (highest - lowest) * (index as f64 + 0.5) / settings.camera_count as f64;
            let azimuth = heading + golden_angle * index as f64;
            let level = (1.0 - sine * sine).sqrt();
            let direction = DVec3::new(level * azimuth.sin(), sine, level * azimuth.cos());
            let size = settings.image_height;
            Camera::looking_at(middle + direction * distance, middle, focal, size, size)
        })
        .collect()
}

/// A depth map with the distance of each pixel from the silhouette.
struct View {
    map: DepthMap,
    mode: CaptureMode,
    /// Chamfer distance to the nearest covered pixel (on empty ones) or empty pixel (on covered ones).
    silhouette: Vec<u8>,
    /// Faces from here on belong to near.
    first_sheet_face: u32,
}

impl View {
    fn new(camera: Camera, subjects: &[Subject<'_>], mode: CaptureMode) -> Self {
        let meshes: Vec<_> = subjects.iter().map(|subject| (subject.positions, subject.faces)).collect();
        let map = DepthMap::render(camera, &meshes);
        let silhouette = chamfer_distances(&map);
        // Solids come first, so that one number parts the faces.
        let solid_faces = subjects.iter().filter(|subject| subject.substance == Substance::Solid);
        let first_sheet_face = solid_faces.map(|subject| subject.faces.len()).sum::<usize>() as u32;
        Self { map, mode, silhouette, first_sheet_face }
    }

    /// What this camera says about a point: how far outside of what it sees the point lies (metres, at most
    /// ±`truncation`), and the distance to a surface of its thickness that it sees right there.
    fn look(&self, in_camera: Vec3, truncation: f32) -> (f32, f32) {
        let (u, v) = self.map.camera.pixel(in_camera);
        let Some(pixel) = self.pixel_at(u, v) else {
            return (truncation, truncation);
        };
        let (outside, near) = self.look_through(pixel, in_camera, truncation);
        if outside <= 0.0 || self.silhouette[pixel] > 2 * CHAMFER_PIXEL {
            return (outside, near);
        }
        // A pixel stands for its centre only. Beside an edge a point counts as empty only if the next pixels on its
        // side agree, otherwise every edge would lose half a pixel to whichever camera saw it worst.
        let (aside, above) =
            (u + if u.fract() < 0.5 { -1.0 } else { 1.0 }, v + if v.fract() < 0.5 { -1.0 } else { 1.0 });
        let others =
            [(aside, v), (u, above), (aside, above)].into_iter().filter_map(|(u, v)| self.pixel_at(u, v));
        let agreed =
            others.map(|pixel| self.look_through(pixel, in_camera, truncation).0).fold(outside, f32::min);
        (agreed, near)
    }

    fn pixel_at(&self, u: f32, v: f32) -> Option<usize> {
        let camera = &self.map.camera;
        // Casts saturate, so a coordinate below zero needs its own test.
        let (x, y) = (u as usize, v as usize);
        (u >= 0.0 && v >= 0.0 && x < camera.width && y < camera.height).then_some(y * camera.width + x)
    }

    fn look_through(&self, pixel: usize, in_camera: Vec3, truncation: f32) -> (f32, f32) {
        let face = self.map.face[pixel];
        if face == NO_FACE || self.mode == CaptureMode::VisualHull {
            let metres_per_pixel = in_camera.z / self.map.camera.focal_pixels as f32;
            let distance =
                (f32::from(self.silhouette[pixel]) / f32::from(CHAMFER_PIXEL) - 0.5) * metres_per_pixel;
            let outside = if face == NO_FACE { distance } else { -distance };
            return (outside.clamp(-truncation, truncation), truncation);
        }
        let plane = &self.map.planes[face as usize];
        let distance = plane.normal.dot(in_camera) - plane.offset;
        if -plane.normal.dot(in_camera) < GRAZING_COSINE * in_camera.length() {
            return (if distance < 0.0 { -truncation } else { distance.min(truncation) }, truncation);
        }
        let near = self.near_surface(face, plane, distance, in_camera, truncation);
        (distance.clamp(-truncation, truncation), near)
    }

    /// Whether a ball lies wholly beside the silhouette.
    fn is_beside(&self, centre_in_camera: Vec3, radius: f32) -> bool {
        let (u, v) = self.map.camera.pixel(centre_in_camera);
        let Some(pixel) = self.pixel_at(u, v) else {
            return false;
        };
        let radius_pixels = radius * self.map.camera.focal_pixels as f32 / (centre_in_camera.z - radius);
        // Chamfer distances are at most 6 % too long, and both ends are only known to half a pixel.
        let distance = f32::from(self.silhouette[pixel]) / f32::from(CHAMFER_PIXEL) * 0.94 - 2.0;
        self.map.face[pixel] == NO_FACE && distance > radius_pixels
    }

    /// Distance to the surface that is seen right there, if it is seen well; of a sheet, to its thickened form.
    fn near_surface(&self, face: u32, plane: &Plane, distance: f32, in_camera: Vec3, truncation: f32) -> f32 {
        let is_seen_well = -plane.normal.dot(in_camera) > FRONTAL_COSINE * in_camera.length();
        if !is_seen_well || !plane.is_front {
            return truncation;
        }
        let voxels = if face >= self.first_sheet_face { SHEET_VOXELS } else { THIN_VOXELS };
        let half_sheet = 0.5 * voxels / TRUNCATION_VOXELS * truncation;
        ((distance + half_sheet).abs() - half_sheet).min(truncation)
    }
}

/// Two-pass 3–4 chamfer distance to the silhouette's edge, both inside and outside (Borgefors 1986), up to
/// [`FARTHEST_PIXELS`].
fn chamfer_distances(map: &DepthMap) -> Vec<u8> {
    let (width, height) = (map.camera.width, map.camera.height);
    let farthest = FARTHEST_PIXELS as u8 * CHAMFER_PIXEL;
    let mut distances = vec![farthest; width * height];
    let is_covered = |pixel: usize| map.face[pixel] != NO_FACE;
    let relax = |distances: &mut [u8], pixel: usize, neighbour: usize, step: u8| {
        let through = if is_covered(pixel) == is_covered(neighbour) { distances[neighbour] } else { 0 };
        distances[pixel] = distances[pixel].min(through.saturating_add(step));
    };
    let (straight, diagonal) = (CHAMFER_PIXEL, CHAMFER_PIXEL + 1);
    // A standing person leaves most columns empty; those further off keep the largest value.
    let columns = (0..width).filter(|x| (0..height).any(|y| is_covered(y * width + x)));
    let (low, high) = columns.fold((width, 0), |(low, high), x| (low.min(x), high.max(x)));
    let columns = low.saturating_sub(FARTHEST_PIXELS).max(1)..(high + FARTHEST_PIXELS).min(width - 1);
    for y in 1..height - 1 {
        for pixel in columns.clone().map(|x| y * width + x) {
            relax(&mut distances, pixel, pixel - 1, straight);
            relax(&mut distances, pixel, pixel - width - 1, diagonal);
            relax(&mut distances, pixel, pixel - width, straight);
            relax(&mut distances, pixel, pixel - width + 1, diagonal);
        }
    }
    for y in (1..height - 1).rev() {
        for pixel in columns.clone().rev().map(|x| y * width + x) {
            relax(&mut distances, pixel, pixel + 1, straight);
            relax(&mut distances, pixel, pixel + width + 1, diagonal);
            relax(&mut distances, pixel, pixel + width, straight);
            relax(&mut distances, pixel, pixel + width - 1, diagonal);
        }
    }
    distances
}

/// Fills the grid with the largest "outside" over all views, brick by brick so that a view's image stays in cache.
///
/// Cloth has no volume, so a camera that looks under a hem would carve it away from within: next to a mesh, a sheet
/// of some thickness behind each outer face that a camera sees is kept.
fn carve(grid: &mut ScalarGrid, world_from_grid: DMat3, views: &[View], is_near_mesh: &BrickSet) {
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
        let mut near = [self.truncation; BRICK * BRICK * BRICK];
        if !has_mesh && views.iter().any(|view| self.is_beside(view)) {
            self.each_voxel(|sample, _, _| samples[sample] = self.truncation);
            return;
        }
        for view in views {
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

    fn is_beside(&self, view: &View) -> bool {
        let spacing = self.world_from_grid.x_axis.length();
        let half = BRICK as f64 * 0.5;
        let centre = self.world_from_grid * (self.corner / spacing + half);
        view.is_beside(view.map.camera.in_camera(centre).as_vec3(), (half * spacing * 3.0_f64.sqrt()) as f32)
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
struct BrickSet {
    counts: [usize; 3],
    is_member: Vec<bool>,
}

impl BrickSet {
    fn new(grid: &ScalarGrid, world_from_grid: DMat3, subjects: &[Subject<'_>]) -> Self {
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

/// Drops components with a small share of the largest one's faces, and vertices that no face uses.
fn largest_components(positions: Vec<DVec3>, faces: Vec<[u32; 3]>, smallest_share: f64) -> Triangles {
    let labels = habitus::geometry::components(positions.len(), &faces);
    let mut face_counts = vec![0_usize; positions.len()];
    for face in &faces {
        face_counts[labels[face[0] as usize] as usize] += 1;
    }
    let largest = face_counts.iter().copied().max().unwrap_or(0);
    let is_kept = |face: &[u32; 3]| {
        face_counts[labels[face[0] as usize] as usize] as f64 >= smallest_share * largest as f64
    };
    let faces: Vec<[u32; 3]> = faces.into_iter().filter(is_kept).collect();
    compact(positions, faces)
}

/// Removes vertices that no face uses.
pub(crate) fn compact(positions: Vec<DVec3>, mut faces: Vec<[u32; 3]>) -> Triangles {
    let mut new_index = vec![u32::MAX; positions.len()];
    let mut kept = Vec::with_capacity(positions.len());
    for vertex in faces.iter_mut().flatten() {
        let slot = &mut new_index[*vertex as usize];
        if *slot == u32::MAX {
            *slot = kept.len() as u32;
            kept.push(positions[*vertex as usize]);
        }
        *vertex = *slot;
    }
    (kept, faces)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball or, cut open below, a bell without thickness.
    fn ball(radius: f64, lowest: f64) -> Triangles {
        let half = DVec3::splat(radius + 0.03);
        let mut grid = ScalarGrid::covering(-half, half, 0.01);
        let [nx, ny, _] = grid.dimensions;
        let origin = grid.origin;
        for (sample, value) in grid.samples.iter_mut().enumerate() {
            let place = [sample % nx, sample / nx % ny, sample / (nx * ny)].map(|count| count as f64 * 0.01);
            *value = ((origin + DVec3::from_array(place)).length() - radius) as f32;
        }
        let (mut positions, mut faces) = grid.surface();
        positions.iter_mut().for_each(|position| *position *= radius / position.length());
        faces.retain(|face| face.iter().all(|&vertex| positions[vertex as usize].y > lowest));
        compact(positions, faces)
    }

    fn noiseless(mode: CaptureMode) -> CaptureSettings {
        CaptureSettings { mode, noise_mm: 0.0, camera_count: 40, ..CaptureSettings::default() }
    }

    fn capture_ball(settings: &CaptureSettings, name: &str) -> Triangles {
        let (positions, faces) = ball(0.3, -1.0);
        let subject = Subject { positions: &positions, faces: &faces, substance: Substance::Solid };
        capture(&[subject], settings, 5, name)
    }

    #[test]
    fn a_scanned_ball_has_its_radius() {
        let settings = noiseless(CaptureMode::Scanner);
        let (positions, _) = capture_ball(&settings, "ball");
        let quarter = settings.voxel_mm / 4000.0;
        let errors: Vec<f64> = positions.iter().map(|position| position.length() - 0.3).collect();
        let root_mean_square =
            (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
        assert!(root_mean_square < quarter, "{root_mean_square}");
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!(mean.abs() < quarter / 2.0, "neither fat nor thin: {mean}");
    }

    #[test]
    fn the_visual_hull_of_a_ball_holds_it_tightly() {
        let settings = noiseless(CaptureMode::VisualHull);
        let (positions, _) = capture_ball(&settings, "ball");
        let voxel = settings.voxel_mm / 1000.0;
        let mean =
            positions.iter().map(|position| position.length() - 0.3).sum::<f64>() / positions.len() as f64;
        // The hull of few views is too large between their rims, never too small by more than a pixel.
        assert!((-voxel / 4.0..voxel).contains(&mean), "{mean}");
    }

    #[test]
    fn thin_cloth_is_captured_down_to_its_hem() {
        let (positions, faces) = ball(0.3, -0.1);
        let subject = Subject { positions: &positions, faces: &faces, substance: Substance::Sheet };
        let settings = noiseless(CaptureMode::Scanner);
        let (captured, captured_faces) = capture(&[subject], &settings, 5, "bell");
        let index = habitus::geometry::SurfaceIndex::of_mesh(
            &habitus::geometry::TriangleMesh::new(captured, captured_faces).unwrap(),
        );
        let voxel = settings.voxel_mm / 1000.0;
        let lost = positions
            .iter()
            .filter(|&&position| index.closest(position).distance_squared.sqrt() > voxel)
            .count();
        assert!(lost * 100 < positions.len(), "{lost} of {} vertices are lost", positions.len());
    }

    #[test]
    fn captures_of_one_scene_share_no_vertices() {
        let settings = noiseless(CaptureMode::Scanner);
        let (first, _) = capture_ball(&settings, "frame 1");
        let (second, _) = capture_ball(&settings, "frame 2");
        assert_ne!(first.len(), second.len());
        let shared = first.iter().filter(|position| second.contains(position)).count();
        assert_eq!(shared, 0);
    }

    #[test]
    fn a_capture_is_the_same_on_one_thread_and_two() {
        let settings = CaptureSettings { voxel_mm: 30.0, ..CaptureSettings::default() };
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| capture_ball(&settings, "ball"))
        };
        assert_eq!(on(1), on(2));
    }
}
