//! Depth images of triangle meshes by a z-buffer: what the virtual cameras of [`crate::capture`] see.

use glam::{DMat3, DVec3, Vec3};

/// A pinhole camera without distortion; image x to the right, image y down, depth forward.
#[derive(Debug, Clone)]
pub struct Camera {
    /// Centre of projection, world space, metres.
    pub eye: DVec3,
    /// Rotation whose rows are the image's right, down and forward directions.
    pub camera_from_world: DMat3,
    /// Focal length, pixels.
    pub focal_pixels: f64,
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
}

impl Camera {
    /// A camera at `eye` that looks at `target` with +y up in the image.
    pub fn looking_at(eye: DVec3, target: DVec3, focal_pixels: f64, width: usize, height: usize) -> Self {
        let forward = (target - eye).normalize_or(DVec3::Z);
        // Straight up or down views have no horizon; any right direction will do.
        let right = forward.cross(DVec3::Y).try_normalize().unwrap_or(DVec3::X);
        let down = forward.cross(right);
        let camera_from_world = DMat3::from_cols(right, down, forward).transpose();
        Self { eye, camera_from_world, focal_pixels, width, height }
    }

    /// A world position in the camera's own frame (right, down, forward), metres.
    pub fn in_camera(&self, position: DVec3) -> DVec3 {
        self.camera_from_world * (position - self.eye)
    }

    fn principal_point(&self) -> (f32, f32) {
        (self.width as f32 * 0.5, self.height as f32 * 0.5)
    }

    /// Continuous pixel coordinates of a position in the camera's frame; pixel (0, 0) covers [0, 1) × [0, 1).
    pub(crate) fn pixel(&self, in_camera: Vec3) -> (f32, f32) {
        let (centre_x, centre_y) = self.principal_point();
        let scale = self.focal_pixels as f32 / in_camera.z;
        (centre_x + in_camera.x * scale, centre_y + in_camera.y * scale)
    }
}

/// A pixel that no triangle covers.
pub const NO_FACE: u32 = u32::MAX;

/// Triangles closer to the camera plane than this are not drawn, metres.
const NEAR_PLANE: f32 = 0.05;

/// One depth image: inverse depth and the face seen, per pixel.
#[derive(Debug, Clone)]
pub struct DepthMap {
    /// The camera that took it.
    pub camera: Camera,
    /// 1 / depth along the viewing axis, zero where nothing is seen, 1/metres.
    pub inverse_depth: Vec<f32>,
    /// Index of the face seen in the drawn list, [`NO_FACE`] where nothing is seen.
    pub face: Vec<u32>,
    /// Plane of each drawn face in the camera's frame.
    pub planes: Vec<Plane>,
}

/// The plane of a face as a camera sees it: normal · position = offset.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    /// Unit normal towards the camera.
    pub normal: Vec3,
    /// Offset along the normal, metres.
    pub offset: f32,
    /// Whether the camera sees the face's outer (counter-clockwise) side.
    pub is_front: bool,
}

impl DepthMap {
    /// Draws meshes (positions and faces) one after the other; faces are numbered on through the list.
    pub fn render(camera: Camera, meshes: &[(&[DVec3], &[[u32; 3]])]) -> Self {
        let pixel_count = camera.width * camera.height;
        let face_count = meshes.iter().map(|(_, faces)| faces.len()).sum();
        let mut map = Self {
            camera,
            inverse_depth: vec![0.0; pixel_count],
            face: vec![NO_FACE; pixel_count],
            planes: Vec::with_capacity(face_count),
        };
        for (positions, faces) in meshes {
            let in_camera: Vec<Vec3> =
                positions.iter().map(|&position| map.camera.in_camera(position).as_vec3()).collect();
            for face in *faces {
                map.draw(face.map(|vertex| in_camera[vertex as usize]));
            }
        }
        map
    }

    /// Draws only which pixels are covered: any covered pixel names the first face, and there is no depth. `is_solid` says
    /// of each mesh that it is closed, so that the faces which it turns to the camera cover all that it covers.
    pub(crate) fn silhouette(camera: Camera, meshes: &[(&[DVec3], &[[u32; 3]])], is_solid: &[bool]) -> Self {
        let pixel_count = camera.width * camera.height;
        let mut map =
            Self { camera, inverse_depth: Vec::new(), face: vec![NO_FACE; pixel_count], planes: Vec::new() };
        for ((positions, faces), is_solid) in meshes.iter().zip(is_solid) {
            let pixels: Vec<Option<(f32, f32)>> = positions
                .iter()
                .map(|&position| {
                    let in_camera = map.camera.in_camera(position).as_vec3();
                    (in_camera.z >= NEAR_PLANE).then(|| map.camera.pixel(in_camera))
                })
                .collect();
            for face in *faces {
                if let [Some(a), Some(b), Some(c)] = face.map(|vertex| pixels[vertex as usize]) {
                    map.cover([a, b, c], *is_solid);
                }
            }
        }
        map
    }

    fn cover(&mut self, [a, b, c]: [(f32, f32); 3], is_solid: bool) {
        let area = (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0);
        // Image y points down, so that a face seen from outside turns clockwise there.
        if area == 0.0 || (is_solid && area > 0.0) {
            return;
        }
        let (low_x, high_x) = pixel_range([a.0, b.0, c.0], self.camera.width);
        let (low_y, high_y) = pixel_range([a.1, b.1, c.1], self.camera.height);
        let sign = area.signum();
        let edges = [(a, b), (b, c), (c, a)].map(|(from, to)| {
            let (dx, dy) = ((to.0 - from.0) * sign, (to.1 - from.1) * sign);
            (from, dx, dy)
        });
        for y in low_y..high_y {
            let (row, centre_y) = (y * self.camera.width, y as f32 + 0.5);
            for x in low_x..high_x {
                let centre_x = x as f32 + 0.5;
                let is_inside = edges
                    .iter()
                    .all(|(from, dx, dy)| dx * (centre_y - from.1) - dy * (centre_x - from.0) >= 0.0);
                if is_inside {
                    self.face[row + x] = 0;
                }
            }
        }
    }

    fn draw(&mut self, corners: [Vec3; 3]) {
        let face = self.planes.len() as u32;
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        let is_front = normal.dot(corners[0]) <= 0.0;
        let normal = if is_front { normal } else { -normal };
        self.planes.push(Plane { normal, offset: normal.dot(corners[0]), is_front });
        if corners.iter().any(|corner| corner.z < NEAR_PLANE) {
            return;
        }
        let [a, b, c] = corners.map(|corner| self.camera.pixel(corner));
        let area = (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0);
        if area == 0.0 {
            return;
        }
        let (low_x, high_x) = pixel_range([a.0, b.0, c.0], self.camera.width);
        let (low_y, high_y) = pixel_range([a.1, b.1, c.1], self.camera.height);
        let inverse = corners.map(|corner| 1.0 / corner.z);
        for y in low_y..high_y {
            let row = y * self.camera.width;
            let centre_y = y as f32 + 0.5;
            for x in low_x..high_x {
                let centre_x = x as f32 + 0.5;
                let weight_b = ((centre_x - a.0) * (c.1 - a.1) - (centre_y - a.1) * (c.0 - a.0)) / area;
                let weight_c = ((b.0 - a.0) * (centre_y - a.1) - (b.1 - a.1) * (centre_x - a.0)) / area;
                let weight_a = 1.0 - weight_b - weight_c;
                if weight_a < 0.0 || weight_b < 0.0 || weight_c < 0.0 {
                    continue;
                }
                // Inverse depth is linear in the image, depth is not.
                let depth = weight_a * inverse[0] + weight_b * inverse[1] + weight_c * inverse[2];
                if depth > self.inverse_depth[row + x] {
                    self.inverse_depth[row + x] = depth;
                    self.face[row + x] = face;
                }
            }
        }
    }
}

/// Pixels whose centres may lie between the smallest and the largest coordinate.
fn pixel_range(coordinates: [f32; 3], size: usize) -> (usize, usize) {
    let low = coordinates[0].min(coordinates[1]).min(coordinates[2]);
    let high = coordinates[0].max(coordinates[1]).max(coordinates[2]);
    // Float to integer casts saturate, so far-off triangles give empty ranges.
    ((low - 0.5).ceil().max(0.0) as usize, ((high + 0.5).floor().max(0.0) as usize).min(size))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silhouette_covers_what_the_depth_image_covers() {
        let camera = Camera::looking_at(DVec3::new(1.0, 0.6, 2.0), DVec3::ZERO, 220.0, 120, 120);
        let corners = [(-0.5, -0.5, -0.5), (0.5, -0.5, -0.4), (0.0, 0.6, -0.3), (0.1, 0.0, 0.6)];
        let positions = corners.map(|(x, y, z)| DVec3::new(x, y, z));
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let meshes: [(&[DVec3], &[[u32; 3]]); 1] = [(&positions, &faces)];
        let covered =
            |map: &DepthMap| -> Vec<bool> { map.face.iter().map(|face| *face != NO_FACE).collect() };
        let seen = covered(&DepthMap::render(camera.clone(), &meshes));
        assert!(seen.iter().filter(|is| **is).count() > 1000);
        for is_solid in [false, true] {
            let silhouette = covered(&DepthMap::silhouette(camera.clone(), &meshes, &[is_solid]));
            // Rounding may decide otherwise on the very edge.
            let differ = seen.iter().zip(&silhouette).filter(|(a, b)| a != b).count();
            assert!(differ <= 3, "solid {is_solid}: {differ} pixels differ");
        }
    }

    #[test]
    fn a_tilted_square_is_seen_at_its_true_depth() {
        let camera = Camera::looking_at(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, 200.0, 100, 100);
        // Depth 3 − z with z = x: 45 degrees about the vertical.
        let positions =
            [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(x, y)| DVec3::new(x, y, x));
        let map = DepthMap::render(camera, &[(&positions, &[[0, 1, 2], [0, 2, 3]])]);
        for (x, y) in [(50, 50), (60, 40), (35, 55)] {
            let inverse = map.inverse_depth[y * 100 + x];
            // Pixel ray (s, ·, 1): x = s·depth and depth = 3 − x, so 1/depth = (1 + s)/3.
            let slope = (x as f32 + 0.5 - 50.0) / 200.0;
            assert!((inverse - (1.0 + slope) / 3.0).abs() < 1e-5, "{x} {y} {inverse}");
        }
        assert_eq!(map.face[0], NO_FACE);
        for plane in &map.planes {
            assert!(plane.normal.z < 0.0 && plane.is_front, "planes face the camera");
        }
    }
}
