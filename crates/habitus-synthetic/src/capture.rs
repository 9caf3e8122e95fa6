//! An independent mesh per frame, as a stage of cameras gives it: space is carved wherever a camera sees past it.
//!
//! The grid that is carved lies turned and shifted at random in each frame, so captures share no correspondence.
//! With silhouettes alone (no depth) the result is the visual hull that P2 §6.1 captures with 68 cameras.

use glam::{DMat3, DVec3};
use habitus::statistics::RandomStream;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::carve::{BrickSet, carve};
use crate::depth_map::Camera;
use crate::isosurface::{ScalarGrid, Triangles};
use crate::view::View;

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
    let mut random = RandomStream::named(seed, name);
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

pub(crate) fn bounds(positions: impl Iterator<Item = DVec3>) -> (DVec3, DVec3) {
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

    /// Views that say nothing of a block of voxels are passed over; that must not be seen in the hull.
    #[test]
    fn the_visual_hull_of_a_hollow_shape_is_the_same_with_fine_and_coarse_images() {
        let (positions, faces) = ball(0.3, -0.05);
        let subject = Subject { positions: &positions, faces: &faces, substance: Substance::Solid };
        let hull = |image_height: usize| {
            let settings =
                CaptureSettings { image_height, camera_count: 10, ..noiseless(CaptureMode::VisualHull) };
            let (hull, hull_faces) = capture(&[subject], &settings, 5, "bowl");
            let mesh = habitus::geometry::TriangleMesh::new(hull, hull_faces).unwrap();
            (habitus::geometry::SurfaceIndex::of_mesh(&mesh), mesh.positions().to_vec())
        };
        // Of a fine image only few pixels of distance are followed, so that hardly any view is passed over there.
        let ((_, coarse), (fine, _)) = (hull(400), hull(1200));
        let farthest =
            coarse.iter().map(|&position| fine.closest(position).distance_squared.sqrt()).fold(0.0, f64::max);
        // Pixels of the coarse image are 2.3 mm wide; a block that was wrongly passed over would err by four voxels.
        let voxel = CaptureSettings::default().voxel_mm / 1000.0;
        assert!(farthest < voxel, "{farthest}");
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
