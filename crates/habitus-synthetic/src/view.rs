//! What one virtual camera says about points in space.

use glam::Vec3;

use crate::capture::{CaptureMode, Subject, Substance};
use crate::depth_map::{Camera, DepthMap, NO_FACE, Plane};

/// Field values are clamped to this many voxels.
pub(crate) const TRUNCATION_VOXELS: f32 = 2.5;
/// Depth seen flatter than this (cosine between ray and normal) says where a surface ends, not how deep a point is.
const GRAZING_COSINE: f32 = 0.25;
/// Depth seen steeper than this is good for the exact place of a surface.
const FRONTAL_COSINE: f32 = 0.65;
/// One pixel in chamfer distances (weights 3 and 4, Borgefors 1986).
const CHAMFER_PIXEL: u8 = 3;
/// Distances from the silhouette are not followed further, pixels.
const FARTHEST_PIXELS: usize = 32;
/// Cloth is captured at least this thick, voxels: thinner near fall between the samples.
pub(crate) const SHEET_VOXELS: f32 = 1.1;
/// Ears and fingers are captured at least this thick, voxels.
const THIN_VOXELS: f32 = 1.25;

/// A depth map with the distance of each pixel from the silhouette.
pub(crate) struct View {
    pub(crate) map: DepthMap,
    mode: CaptureMode,
    /// Chamfer distance to the nearest covered pixel (on empty ones) or empty pixel (on covered ones).
    silhouette: Vec<u8>,
    /// Faces from here on belong to near.
    first_sheet_face: u32,
}

impl View {
    pub(crate) fn new(camera: Camera, subjects: &[Subject<'_>], mode: CaptureMode) -> Self {
        let meshes: Vec<_> = subjects.iter().map(|subject| (subject.positions, subject.faces)).collect();
        let is_solid: Vec<bool> =
            subjects.iter().map(|subject| subject.substance == Substance::Solid).collect();
        let map = match mode {
            CaptureMode::Scanner => DepthMap::render(camera, &meshes),
            CaptureMode::VisualHull => DepthMap::silhouette(camera, &meshes, &is_solid),
        };
        let silhouette = chamfer_distances(&map);
        // Solids come first, so that one number parts the faces.
        let solid_faces = subjects.iter().filter(|subject| subject.substance == Substance::Solid);
        let first_sheet_face = solid_faces.map(|subject| subject.faces.len()).sum::<usize>() as u32;
        Self { map, mode, silhouette, first_sheet_face }
    }

    /// What this camera says about a point: how far outside of what it sees the point lies (metres, at most
    /// ±`truncation`), and the distance to a surface of its thickness that it sees right there.
    pub(crate) fn look(&self, in_camera: Vec3, truncation: f32) -> (f32, f32) {
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

    /// Whether silhouettes are all that the camera knows.
    pub(crate) fn is_silhouette(&self) -> bool {
        self.mode == CaptureMode::VisualHull
    }

    /// Whether a ball lies wholly beside the silhouette.
    pub(crate) fn is_beside(&self, centre_in_camera: Vec3, radius: f32) -> bool {
        self.pixel_without_edge(centre_in_camera, radius).is_some_and(|pixel| self.map.face[pixel] == NO_FACE)
    }

    /// Whether a ball lies wholly within the silhouette.
    pub(crate) fn is_within(&self, centre_in_camera: Vec3, radius: f32) -> bool {
        self.pixel_without_edge(centre_in_camera, radius).is_some_and(|pixel| self.map.face[pixel] != NO_FACE)
    }

    /// The pixel of a ball's centre, if no edge of the silhouette passes through the ball's picture.
    fn pixel_without_edge(&self, centre_in_camera: Vec3, radius: f32) -> Option<usize> {
        let (u, v) = self.map.camera.pixel(centre_in_camera);
        let pixel = self.pixel_at(u, v)?;
        let radius_pixels = radius * self.map.camera.focal_pixels as f32 / (centre_in_camera.z - radius);
        // Chamfer distances are at most 6 % too long, and both ends are only known to half a pixel.
        let distance = f32::from(self.silhouette[pixel]) / f32::from(CHAMFER_PIXEL) * 0.94 - 2.0;
        (distance > radius_pixels).then_some(pixel)
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

/// From the first to the last of some lines of an image of `size` lines, and as far on as distances are followed.
fn reach(lines: impl Iterator<Item = usize>, size: usize) -> std::ops::Range<usize> {
    let (low, high) = lines.fold((size, 0), |(low, high), line| (low.min(line), high.max(line)));
    low.saturating_sub(FARTHEST_PIXELS).max(1)..(high + FARTHEST_PIXELS).min(size - 1)
}

/// Two-pass 3–4 chamfer distance to the silhouette's edge, both inside and outside (Borgefors 1986), up to
/// [`FARTHEST_PIXELS`].
fn chamfer_distances(map: &DepthMap) -> Vec<u8> {
    let (width, height) = (map.camera.width, map.camera.height);
    let farthest = FARTHEST_PIXELS as u8 * CHAMFER_PIXEL;
    let mut distances = vec![farthest; width * height];
    let coverage: Vec<bool> = map.face.iter().map(|face| *face != NO_FACE).collect();
    let is_covered = |pixel: usize| coverage[pixel];
    let relax = |distances: &mut [u8], pixel: usize, neighbour: usize, step: u8| {
        let through = if is_covered(pixel) == is_covered(neighbour) { distances[neighbour] } else { 0 };
        distances[pixel] = distances[pixel].min(through.saturating_add(step));
    };
    let (straight, diagonal) = (CHAMFER_PIXEL, CHAMFER_PIXEL + 1);
    // A standing person leaves most columns and some rows empty; those further off keep the largest value.
    let columns = (0..width).filter(|x| (0..height).any(|y| is_covered(y * width + x)));
    let columns = reach(columns, width);
    let rows = reach((0..height).filter(|y| coverage[y * width..(y + 1) * width].contains(&true)), height);
    for y in rows.clone() {
        for pixel in columns.clone().map(|x| y * width + x) {
            relax(&mut distances, pixel, pixel - 1, straight);
            relax(&mut distances, pixel, pixel - width - 1, diagonal);
            relax(&mut distances, pixel, pixel - width, straight);
            relax(&mut distances, pixel, pixel - width + 1, diagonal);
        }
    }
    for y in rows.rev() {
        for pixel in columns.clone().rev().map(|x| y * width + x) {
            relax(&mut distances, pixel, pixel + 1, straight);
            relax(&mut distances, pixel, pixel + width + 1, diagonal);
            relax(&mut distances, pixel, pixel + width, straight);
            relax(&mut distances, pixel, pixel + width - 1, diagonal);
        }
    }
    distances
}
