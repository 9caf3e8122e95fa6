//! Front and back depth images of one person who turned around in between (P1 §6.1).

use glam::DVec3;
use habitus::body::{BodyModel, PartLabel};
use habitus::statistics::RandomStream;
use serde::{Deserialize, Serialize};

use super::landmarks::place_landmarks;
use super::{LandmarkTable, PlacedLandmark, Population, RawScanSettings, StandingPerson, standing_person};
use crate::depth_map::{Camera, DepthMap, NO_FACE};
use crate::error::SyntheticError;

/// How the two images are taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthPairSettings {
    /// Image width and height, pixels.
    pub image_size: [usize; 2],
    /// Focal length, pixels.
    pub focal_pixels: f64,
    /// Distance of the camera, metres.
    pub camera_distance: f64,
    /// Height of the camera, metres.
    pub camera_height: f64,
    /// Standard deviation of the depth at one metre, millimetres; it grows with the square of the depth.
    pub noise_mm: f64,
    /// Surfaces seen flatter than this are not measured, degrees between ray and normal.
    pub grazing_deg: f64,
    /// Thickness of a tight suit over everything but head, hands and feet, millimetres.
    pub suit_mm: f64,
}

impl Default for DepthPairSettings {
    fn default() -> Self {
        // A common time-of-flight camera on its side: 576 × 640, 75° along the person.
        Self {
            image_size: [576, 640],
            focal_pixels: 504.0,
            camera_distance: 2.3,
            camera_height: 1.0,
            noise_mm: 0.8,
            grazing_deg: 78.0,
            suit_mm: 3.0,
        }
    }
}

/// Pinhole intrinsics of a depth image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point along x, pixels; the centre of the first pixel is 0.5.
    pub cx: f64,
    /// Principal point along y, pixels.
    pub cy: f64,
    /// Metres in one unit of the image.
    pub depth_scale: f64,
}

/// Depths along the viewing axis in millimetres, row by row; zero where nothing is seen.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    /// How pixels become points.
    pub intrinsics: Intrinsics,
    /// One depth a pixel, millimetres.
    pub depths: Vec<u16>,
}

impl DepthImage {
    /// The points that the image shows: the camera at the origin, x to the right, y up, looking along −z; metres.
    pub fn points(&self) -> Vec<DVec3> {
        let camera = &self.intrinsics;
        let depths = self.depths.iter().enumerate().filter(|(_, depth)| **depth > 0);
        depths
            .map(|(pixel, depth)| {
                let (x, y) = ((pixel % camera.width) as f64 + 0.5, (pixel / camera.width) as f64 + 0.5);
                let depth = f64::from(*depth) * camera.depth_scale;
                DVec3::new((x - camera.cx) / camera.fx, -(y - camera.cy) / camera.fy, -1.0) * depth
            })
            .collect()
    }
}

/// One of the two views with its truth in the camera's frame (x right, y up, looking along −z; metres).
#[derive(Debug, Clone)]
pub struct DepthView {
    /// What the camera gives.
    pub image: DepthImage,
    /// The person, without the suit.
    pub person: StandingPerson,
    /// The model's landmarks, placed by hand.
    pub landmarks: Vec<PlacedLandmark>,
}

/// Front and back of one person, each in their own pose.
#[derive(Debug, Clone)]
pub struct DepthPair {
    /// From the front.
    pub front: DepthView,
    /// From the back.
    pub back: DepthView,
}

/// Takes two depth images of the person of this name.
pub fn make_depth_pair(
    model: &BodyModel,
    population: &Population,
    table: &LandmarkTable,
    settings: &RawScanSettings,
    cameras: &DepthPairSettings,
    name: &str,
) -> Result<DepthPair, SyntheticError> {
    let view = |occasion: &str, turn: f64| {
        let mut facing = settings.clone();
        // People do not turn around exactly.
        let mut random = RandomStream::named(settings.seed, &format!("{name} shows the {occasion}"));
        facing.stance.heading_deg = 0.0;
        let mut person = standing_person(model, population, &facing, name, occasion);
        let turn = turn + (random.normal() * 6.0).to_radians();
        let translation = person.pose.translation();
        person.pose.set_root(glam::DQuat::from_rotation_y(turn), translation);
        look_at(model, person, table, settings, cameras, random)
    };
    Ok(DepthPair { front: view("front", 0.0), back: view("back", std::f64::consts::PI) })
}

fn look_at(
    model: &BodyModel,
    mut person: StandingPerson,
    table: &LandmarkTable,
    settings: &RawScanSettings,
    cameras: &DepthPairSettings,
    mut random: RandomStream,
) -> DepthView {
    // The camera is the origin.
    let eye = DVec3::new(0.0, cameras.camera_height, cameras.camera_distance);
    let moved = person.pose.translation() - eye;
    person.pose.parameters_mut()[..3].copy_from_slice(&moved.to_array());
    let joints = model.joints(&person.rest_vertices);
    let posed = model.skeleton().pose(&joints, person.pose.parameters());
    person.vertices = model.pose_vertices(&person.rest_vertices, &posed);
    let normals = habitus::geometry::vertex_normals(&person.vertices, model.faces());
    let suited: Vec<DVec3> = person
        .vertices
        .iter()
        .zip(&normals)
        .zip(model.part_labels())
        .map(|((vertex, normal), label)| {
            let thickness = if *label == PartLabel::Covered { cameras.suit_mm / 1000.0 } else { 0.0 };
            *vertex + *normal * thickness
        })
        .collect();
    let [width, height] = cameras.image_size;
    let camera = Camera::looking_at(DVec3::ZERO, DVec3::NEG_Z, cameras.focal_pixels, width, height);
    let map = DepthMap::render(camera, &[(&suited, model.faces())]);
    let image = depth_image(&map, cameras, &mut random);
    let landmarks = place_landmarks(model, &person.vertices, table, settings, &mut random);
    DepthView { image, person, landmarks }
}

fn depth_image(map: &DepthMap, cameras: &DepthPairSettings, random: &mut RandomStream) -> DepthImage {
    let camera = &map.camera;
    let smallest_cosine = cameras.grazing_deg.to_radians().cos() as f32;
    let depths = (0..map.face.len())
        .map(|pixel| {
            let noise = random.normal();
            if map.face[pixel] == NO_FACE {
                return 0;
            }
            let plane = &map.planes[map.face[pixel] as usize];
            let (x, y) = ((pixel % camera.width) as f32 + 0.5, (pixel / camera.width) as f32 + 0.5);
            let focal = camera.focal_pixels as f32;
            let ray = glam::Vec3::new(
                (x - camera.width as f32 * 0.5) / focal,
                (y - camera.height as f32 * 0.5) / focal,
                1.0,
            );
            if !plane.is_front || -plane.normal.dot(ray.normalize()) < smallest_cosine {
                return 0;
            }
            let depth = 1.0 / f64::from(map.inverse_depth[pixel]);
            let spread = cameras.noise_mm * depth * depth;
            (depth * 1000.0 + noise * spread).round().clamp(0.0, f64::from(u16::MAX)) as u16
        })
        .collect();
    let intrinsics = Intrinsics {
        width: camera.width,
        height: camera.height,
        fx: camera.focal_pixels,
        fy: camera.focal_pixels,
        cx: camera.width as f64 * 0.5,
        cy: camera.height as f64 * 0.5,
        depth_scale: 0.001,
    };
    DepthImage { intrinsics, depths }
}
