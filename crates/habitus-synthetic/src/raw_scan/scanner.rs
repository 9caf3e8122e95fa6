//! A body scanner: heads around the subject, each a grid of depths, merged into one open mesh.
//!
//! What no head sees (armpits, crotch, soles, between the fingers) is missing, as in real scans.

use glam::{DVec3, Vec3};
use habitus::statistics::RandomStream;
use rayon::prelude::*;

use super::RawScanSettings;
use crate::depth_map::{Camera, DepthMap, NO_FACE};
use crate::isosurface::Triangles;

/// Columns of heads around the subject.
const COLUMNS: usize = 4;
/// Heights of the heads in each column, metres, and where each looks: the upper see shoulders, the lower feet.
const HEADS: [(f64, f64); 2] = [(0.75, 0.6), (2.0, 1.3)];
/// Distance of the columns from the middle, metres.
const DISTANCE: f64 = 2.6;
/// Surfaces seen flatter than this (cosine) are not measured.
const GRAZING_COSINE: f64 = 0.22;
/// A head keeps a point unless another sees it this much more frontally (cosine).
const OVERLAP_COSINE: f64 = 0.08;
/// Depths that differ by more than this many pixel widths are not joined.
const LARGEST_STEP_PIXELS: f64 = 8.0;
/// Image height of the view that measures how many points a pixel width gives.
const PROBE_HEIGHT: usize = 160;

/// One point as one head measures it.
#[derive(Clone, Copy)]
struct Measured {
    position: DVec3,
    cosine: f64,
}

struct Head {
    map: DepthMap,
    offset: DVec3,
}

/// Scans a closed body to about `settings.point_count` points.
pub(super) fn scan_body(
    vertices: &[DVec3],
    faces: &[[u32; 3]],
    settings: &RawScanSettings,
    random: &mut RandomStream,
) -> Triangles {
    let turn = random.between(0.0, std::f64::consts::TAU);
    let misalignment = settings.head_misalignment_mm / 1000.0;
    let offsets: Vec<DVec3> = (0..COLUMNS * HEADS.len())
        .map(|_| DVec3::new(random.normal(), random.normal(), random.normal()) * misalignment)
        .collect();
    let heads = |height: usize| -> Vec<Head> {
        cameras(vertices, turn, height)
            .into_par_iter()
            .zip(&offsets)
            .map(|(camera, offset)| Head {
                map: DepthMap::render(camera, &[(vertices, faces)]),
                offset: *offset,
            })
            .collect()
    };
    let probe = heads(PROBE_HEIGHT);
    let kept: usize = (0..probe.len()).map(|head| kept_points(&probe, head).iter().flatten().count()).sum();
    let scale = (settings.point_count as f64 / kept.max(1) as f64).sqrt();
    let heads = heads((PROBE_HEIGHT as f64 * scale).round() as usize);
    let points: Vec<Vec<Option<Measured>>> =
        (0..heads.len()).into_par_iter().map(|head| kept_points(&heads, head)).collect();
    let mut merged = (Vec::new(), Vec::new());
    for (head, points) in heads.iter().zip(&points) {
        append_grid(head, points, settings.noise_mm / 1000.0, random, &mut merged);
    }
    crate::capture::compact(merged.0, merged.1)
}

fn cameras(vertices: &[DVec3], turn: f64, height: usize) -> Vec<Camera> {
    let (low, high) = crate::capture::bounds(vertices.iter().copied());
    let middle = (low + high) * 0.5;
    let mut cameras = Vec::new();
    for column in 0..COLUMNS {
        let azimuth = turn + std::f64::consts::TAU * column as f64 / COLUMNS as f64;
        let outward = DVec3::new(azimuth.sin(), 0.0, azimuth.cos());
        for (stands_at, looks_at) in HEADS {
            let eye = DVec3::new(middle.x, stands_at, middle.z) + outward * DISTANCE;
            let target = DVec3::new(middle.x, looks_at, middle.z);
            // The whole person is in the image with room for outstretched arms.
            let focal = height as f64 * 0.9;
            cameras.push(Camera::looking_at(eye, target, focal, height, height));
        }
    }
    cameras
}

/// What a head measures at a pixel.
fn measured(map: &DepthMap, pixel: usize) -> Option<Measured> {
    let face = map.face[pixel];
    if face == NO_FACE {
        return None;
    }
    let camera = &map.camera;
    let (x, y) = ((pixel % camera.width) as f64 + 0.5, (pixel / camera.width) as f64 + 0.5);
    let depth = 1.0 / f64::from(map.inverse_depth[pixel]);
    let ray = DVec3::new(
        (x - camera.width as f64 * 0.5) / camera.focal_pixels,
        (y - camera.height as f64 * 0.5) / camera.focal_pixels,
        1.0,
    );
    let plane = &map.planes[face as usize];
    let cosine = -plane.normal.as_dvec3().dot(ray.normalize());
    let position = camera.eye + camera.camera_from_world.transpose() * (ray * depth);
    (plane.is_front && cosine > GRAZING_COSINE).then_some(Measured { position, cosine })
}

/// How frontally another head sees a point; zero if it does not see it.
fn cosine_in(map: &DepthMap, position: DVec3) -> f64 {
    let in_camera = map.camera.in_camera(position).as_vec3();
    let (u, v) = map.camera.pixel(in_camera);
    if !(u >= 0.0 && v >= 0.0) {
        return 0.0;
    }
    let (x, y) = (u as usize, v as usize);
    if x >= map.camera.width || y >= map.camera.height {
        return 0.0;
    }
    let pixel = y * map.camera.width + x;
    let face = map.face[pixel];
    if face == NO_FACE {
        return 0.0;
    }
    let plane = &map.planes[face as usize];
    let is_seen = (plane.normal.dot(in_camera) - plane.offset).abs() < 0.01
        && (1.0 / map.inverse_depth[pixel] - in_camera.z).abs() < 0.03;
    if is_seen && plane.is_front {
        f64::from(-plane.normal.dot(in_camera.normalize_or(Vec3::Z)))
    } else {
        0.0
    }
}

/// The points that a head keeps, pixel by pixel.
fn kept_points(heads: &[Head], head: usize) -> Vec<Option<Measured>> {
    let map = &heads[head].map;
    (0..map.face.len())
        .map(|pixel| {
            let point = measured(map, pixel)?;
            let best_other = heads
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != head)
                .map(|(_, other)| cosine_in(&other.map, point.position))
                .fold(0.0, f64::max);
            (point.cosine > best_other - OVERLAP_COSINE).then_some(point)
        })
        .collect()
}

/// Joins a head's neighbouring pixels to triangles, with noise along the line of sight.
fn append_grid(
    head: &Head,
    points: &[Option<Measured>],
    noise: f64,
    random: &mut RandomStream,
    merged: &mut Triangles,
) {
    let camera = &head.map.camera;
    let width = camera.width;
    let first = merged.0.len() as u32;
    let mut index = vec![u32::MAX; points.len()];
    for (pixel, point) in points.iter().enumerate() {
        let Some(point) = point else { continue };
        index[pixel] = first + (merged.0.len() as u32 - first);
        let sight = (point.position - camera.eye).normalize_or_zero();
        let spread = noise * (0.5 / point.cosine).clamp(1.0, 2.0);
        merged.0.push(point.position + head.offset + sight * (random.normal() * spread));
    }
    let depth = |pixel: usize| f64::from(head.map.inverse_depth[pixel]).recip();
    let is_joined = |corners: [usize; 3]| {
        let depths = corners.map(depth);
        let (near, far) = (
            depths.iter().copied().fold(f64::INFINITY, f64::min),
            depths.iter().copied().fold(0.0, f64::max),
        );
        corners.iter().all(|pixel| index[*pixel] != u32::MAX)
            && far - near < LARGEST_STEP_PIXELS * far / camera.focal_pixels
    };
    for y in 0..camera.height - 1 {
        for x in 0..width - 1 {
            let a = y * width + x;
            let (b, c, d) = (a + 1, a + width, a + width + 1);
            // Image y runs down, so these are counter-clockwise seen from the head.
            let triangles = if (depth(a) - depth(d)).abs() < (depth(b) - depth(c)).abs() {
                [[a, c, d], [a, d, b]]
            } else {
                [[a, c, b], [b, c, d]]
            };
            for corners in triangles {
                if is_joined(corners) {
                    merged.1.push(corners.map(|pixel| index[pixel]));
                }
            }
        }
    }
}
