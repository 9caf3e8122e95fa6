//! What one camera saw of a person, as a surface that can be searched.

use glam::DVec3;
use habitus_geometry::{
    PointCloud, SurfaceIndex, TriangleMesh, estimate_cloud_normals, remove_small_components, vertex_normals,
};

use super::ReconstructError;
use super::config::ReconstructConfig;
use crate::artifacts::depth_image::DepthImage;
use crate::fitting::gaps::ScanPoints;

/// Which side of the person the camera saw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The person faces the camera.
    Front,
    /// The person faces away.
    Back,
}

impl Side {
    /// The name in messages and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Back => "back",
        }
    }
}

/// A partial surface; the camera is the origin, y is up, it looks along −z; metres.
pub struct PartialView {
    pub(super) side: Side,
    pub(super) positions: Vec<DVec3>,
    pub(super) normals: Vec<DVec3>,
    pub(super) index: SurfaceIndex,
}

/// Parts of a depth image with less than this share of its faces are no person.
const SMALLEST_PART: f64 = 0.05;
/// Neighbours from which the normals of a bare cloud are estimated.
const NORMAL_NEIGHBOURS: usize = 40;

impl PartialView {
    /// Joins the pixels of a depth image to a surface, torn where depth jumps.
    pub fn of_depth(
        side: Side,
        image: &DepthImage,
        config: &ReconstructConfig,
    ) -> Result<Self, ReconstructError> {
        let image = &smoothed(image, config);
        let (width, height) = (image.intrinsics.width, image.intrinsics.height);
        let [nearest, farthest] = config.depth_range;
        let mut vertex_of = vec![u32::MAX; width * height];
        let mut positions = Vec::new();
        for row in 0..height {
            for column in 0..width {
                if let Some(point) = image.point(column, row).filter(|p| (nearest..=farthest).contains(&-p.z))
                {
                    vertex_of[row * width + column] = positions.len() as u32;
                    positions.push(point);
                }
            }
        }
        let mut faces = Vec::new();
        for row in 0..height.saturating_sub(1) {
            for column in 0..width.saturating_sub(1) {
                let corner = |down: usize, right: usize| vertex_of[(row + down) * width + column + right];
                // Counter-clockwise as the camera sees it.
                for face in
                    [[corner(0, 0), corner(1, 0), corner(1, 1)], [corner(0, 0), corner(1, 1), corner(0, 1)]]
                {
                    if face.contains(&u32::MAX) {
                        continue;
                    }
                    let depths = face.map(|vertex| positions[vertex as usize].z);
                    let step = depths.iter().fold(f64::MIN, |m, z| m.max(*z))
                        - depths.iter().fold(f64::MAX, |m, z| m.min(*z));
                    if step <= config.largest_step {
                        faces.push(face);
                    }
                }
            }
        }
        let mesh = TriangleMesh::new(positions, faces)
            .map_err(|_| ReconstructError::NothingSeen { side: side.name() })?;
        let (mesh, _) = remove_small_components(&mesh, SMALLEST_PART);
        Self::of_mesh(side, &mesh)
    }

    /// Takes a partial mesh as it is.
    pub fn of_mesh(side: Side, mesh: &TriangleMesh) -> Result<Self, ReconstructError> {
        if mesh.faces().is_empty() {
            return Err(ReconstructError::NothingSeen { side: side.name() });
        }
        Ok(Self {
            side,
            positions: mesh.positions().to_vec(),
            normals: vertex_normals(mesh.positions(), mesh.faces()),
            index: SurfaceIndex::of_mesh(mesh),
        })
    }

    pub(super) fn points(&self) -> ScanPoints<'_> {
        ScanPoints { index: &self.index, positions: &self.positions, normals: &self.normals }
    }

    /// Takes a partial cloud; normals that are missing are estimated, and all are turned to the camera.
    pub fn of_cloud(side: Side, cloud: &PointCloud) -> Self {
        let positions = cloud.positions().to_vec();
        let mut normals = cloud
            .normals()
            .map_or_else(|| estimate_cloud_normals(&positions, NORMAL_NEIGHBOURS), <[DVec3]>::to_vec);
        for (normal, position) in normals.iter_mut().zip(&positions) {
            if normal.dot(*position) > 0.0 {
                *normal = -*normal;
            }
        }
        let index = SurfaceIndex::of_cloud(&positions, &normals);
        Self { side, positions, normals, index }
    }
}

/// Each depth becomes the mean of those around it on the same surface: noise of a few millimetres at a pixel of a few
/// millimetres would turn the normals anywhere.
fn smoothed(image: &DepthImage, config: &ReconstructConfig) -> DepthImage {
    let (width, height) = (image.intrinsics.width, image.intrinsics.height);
    let reach = config.smoothing_pixels;
    let step = config.largest_step / image.intrinsics.depth_scale;
    let mut depths = image.depths.clone();
    // A finer unit, so that the mean is not rounded away.
    let fine = f64::from(u16::MAX) / f64::from(depths.iter().copied().max().unwrap_or(1).max(1));
    for row in 0..height {
        for column in 0..width {
            let own = f64::from(image.depths[row * width + column]);
            if own == 0.0 {
                continue;
            }
            let (mut sum, mut count) = (0.0, 0.0);
            for near_row in row.saturating_sub(reach)..(row + reach + 1).min(height) {
                for near_column in column.saturating_sub(reach)..(column + reach + 1).min(width) {
                    let depth = f64::from(image.depths[near_row * width + near_column]);
                    if depth > 0.0 && (depth - own).abs() <= step {
                        sum += depth;
                        count += 1.0;
                    }
                }
            }
            depths[row * width + column] = (sum / count * fine).round() as u16;
        }
    }
    let mut intrinsics = image.intrinsics.clone();
    intrinsics.depth_scale /= fine;
    DepthImage { intrinsics, depths }
}
