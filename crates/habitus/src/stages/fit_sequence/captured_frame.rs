//! One capture, cleaned, in metres, indexed for closest-point queries and sampled.

use glam::{DMat3, DVec3};
use habitus_geometry::{Surface, SurfaceIndex, TriangleMesh, area_weighted_points, components, weld};

use super::FitSequenceError;
use super::config::FrameConfig;
use super::pose_solver::GivenLandmark;

/// From the input's coordinates to those of the fit: metres, y up, centred on the first frame and turned to its own
/// horizontal axes. All headings and offsets of a capture thereby give the same numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FitFromInput {
    pub scale: f64,
    pub rotation: DMat3,
    pub translation: DVec3,
    /// `size_of` the sequence's captures, in the input's unit.
    pub usual_size: f64,
}

impl FitFromInput {
    /// The same for a capture that is `factor` times too large.
    pub fn rescaled(&self, factor: f64) -> Self {
        Self { scale: self.scale / factor, ..*self }
    }

    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation * (point * self.scale) + self.translation
    }
}

/// A point of the capture with its outward unit normal, in the fit's coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) struct CaptureSample {
    pub position: DVec3,
    pub normal: DVec3,
    /// Whether the capture is as thick here as an arm or a shank.
    pub is_limb_like: bool,
}

impl CaptureSample {
    /// Limbs have little area for what they say about the pose.
    const LIMB_WEIGHT: f64 = 2.0;

    /// How much the sample counts among others.
    pub fn weight(&self) -> f64 {
        if self.is_limb_like { Self::LIMB_WEIGHT } else { 1.0 }
    }
}

/// Thickness of an arm or a shank, in a sleeve or bare; thinner are sheets of cloth, thicker trunks and skirts.
const LIMB_THICKNESS: [f64; 2] = [0.03, 0.16];

/// Whether the capture under a point is a tube: thin straight in, and from the middle thin in some direction across. A
/// fold of a skirt is thin straight in but wide in all directions across.
fn is_limb_like(index: &SurfaceIndex, position: DVec3, normal: DVec3) -> bool {
    /// Steps off the surface that the ray starts on.
    const STEP_IN: f64 = 1e-3;
    const DIRECTIONS_ACROSS: usize = 4;
    let way = |origin: DVec3, direction: DVec3| {
        index.ray_hit(origin, direction, LIMB_THICKNESS[1]).map_or(f64::INFINITY, |hit| hit.distance)
    };
    let thickness = way(position - normal * STEP_IN, -normal);
    if !(LIMB_THICKNESS[0]..LIMB_THICKNESS[1]).contains(&thickness) {
        return false;
    }
    let middle = position - normal * (0.5 * thickness);
    let (first, second) = normal.any_orthonormal_pair();
    (0..DIRECTIONS_ACROSS).any(|step| {
        let angle = std::f64::consts::PI * step as f64 / DIRECTIONS_ACROSS as f64;
        let across = first * angle.cos() + second * angle.sin();
        way(middle, across) + way(middle, -across) < LIMB_THICKNESS[1]
    })
}

/// A frame that is ready to be fitted.
pub(super) struct CapturedFrame {
    pub index: SurfaceIndex,
    pub samples: Vec<CaptureSample>,
    /// Lowest and highest corner of the capture.
    pub bounds: [DVec3; 2],
    /// Mean of the samples.
    pub middle: DVec3,
    /// How much larger the capture was than the rest of the sequence before it was brought to the same size.
    pub capture_scale: f64,
    /// Landmarks that the user gives for this frame.
    pub landmarks: Vec<GivenLandmark>,
}

/// A size of a capture that hardly depends on the pose: the root of a mesh's area, the spread of a cloud.
pub(super) fn size_of(surface: &Surface) -> f64 {
    match surface {
        Surface::Mesh(mesh) => {
            let area = |face: &[u32; 3]| {
                let [a, b, c] = face.map(|vertex| mesh.positions()[vertex as usize]);
                0.5 * (b - a).cross(c - a).length()
            };
            mesh.faces().iter().map(area).sum::<f64>().sqrt()
        }
        Surface::Cloud(cloud) => {
            let count = cloud.positions().len().max(1) as f64;
            let middle = cloud.positions().iter().copied().sum::<DVec3>() / count;
            let squares: f64 = cloud.positions().iter().map(|p| p.distance_squared(middle)).sum();
            (squares / count).sqrt()
        }
    }
}

/// A capture that is this much larger or smaller than the others has been exported at another scale.
const SCALE_JUMP: f64 = 1.5;

/// The factor by which a capture is larger than it should be; 1 unless it jumps.
fn capture_scale(surface: &Surface, usual_size: f64) -> f64 {
    let ratio = size_of(surface) / usual_size;
    if ratio.is_finite() && !(1.0 / SCALE_JUMP..=SCALE_JUMP).contains(&ratio) && ratio > 0.0 {
        ratio
    } else {
        1.0
    }
}

impl CapturedFrame {
    /// Cleans, moves, indexes and samples a capture.
    pub fn prepare(
        surface: Surface,
        fit_from_input: &FitFromInput,
        config: &FrameConfig,
        (seed, name): (u64, &str),
    ) -> Result<Self, FitSequenceError> {
        let capture_scale = capture_scale(&surface, fit_from_input.usual_size);
        let fit_from_input = &fit_from_input.rescaled(capture_scale);
        match surface {
            Surface::Mesh(mesh) => {
                let frame = Self::of_mesh(mesh, fit_from_input, config, (seed, name))?;
                Ok(Self { capture_scale, ..frame })
            }
            Surface::Cloud(cloud) => {
                let positions: Vec<DVec3> =
                    cloud.positions().iter().map(|point| fit_from_input.apply(*point)).collect();
                if positions.len() < SMALLEST_CLOUD {
                    return Err(FitSequenceError::TooLittleSurface {
                        frame: name.into(),
                        found: positions.len(),
                        needed: SMALLEST_CLOUD,
                    });
                }
                let normals = match cloud.normals() {
                    Some(normals) => normals.iter().map(|normal| fit_from_input.rotation * *normal).collect(),
                    None => habitus_geometry::estimate_cloud_normals(&positions, config.normal_neighbours),
                };
                let stride = positions.len().div_ceil(config.sample_count.max(1)).max(1);
                let samples = (0..positions.len())
                    .step_by(stride)
                    .map(|i| CaptureSample {
                        position: positions[i],
                        normal: normals[i],
                        is_limb_like: false,
                    })
                    .collect::<Vec<_>>();
                let middle = middle_of(&samples);
                let bounds = bounds_of(&positions);
                let index = SurfaceIndex::of_cloud(&positions, &normals);
                Ok(Self { index, samples, bounds, middle, capture_scale, landmarks: Vec::new() })
            }
        }
    }

    fn of_mesh(
        mesh: TriangleMesh,
        fit_from_input: &FitFromInput,
        config: &FrameConfig,
        (seed, name): (u64, &str),
    ) -> Result<Self, FitSequenceError> {
        let (mut positions, faces) = mesh.into_parts();
        for position in &mut positions {
            *position = fit_from_input.apply(*position);
        }
        let faces = without_small_pieces(&positions, faces, config.smallest_component_share);
        if faces.len() < SMALLEST_MESH {
            return Err(FitSequenceError::TooLittleSurface {
                frame: name.into(),
                found: faces.len(),
                needed: SMALLEST_MESH,
            });
        }
        let mesh = TriangleMesh::new(positions, faces)
            .map_err(|source| FitSequenceError::UnusableFrame { frame: name.into(), source })?;
        let normals = habitus_geometry::face_normals(mesh.positions(), mesh.faces());
        let index = SurfaceIndex::of_mesh(&mesh);
        let samples: Vec<CaptureSample> = area_weighted_points(&mesh, config.sample_count, seed)
            .into_iter()
            .map(|(position, face)| {
                let normal = normals[face as usize];
                let is_limb_like = is_limb_like(&index, position, normal);
                CaptureSample { position, normal, is_limb_like }
            })
            .collect();
        let used: Vec<DVec3> =
            mesh.faces().iter().flatten().map(|vertex| mesh.positions()[*vertex as usize]).collect();
        let middle = middle_of(&samples);
        let bounds = bounds_of(&used);
        Ok(Self { index, samples, bounds, middle, capture_scale: 1.0, landmarks: Vec::new() })
    }
}

fn middle_of(samples: &[CaptureSample]) -> DVec3 {
    samples.iter().map(|sample| sample.position).sum::<DVec3>() / samples.len().max(1) as f64
}

/// A person needs at least this many triangles or points to be told from noise.
const SMALLEST_MESH: usize = 100;
const SMALLEST_CLOUD: usize = 200;

pub(super) fn bounds_of(points: &[DVec3]) -> [DVec3; 2] {
    points.iter().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], point| {
        [low.min(*point), high.max(*point)]
    })
}

/// Drops connected pieces with a small share of the area. Seams (duplicate vertices) must not cut pieces apart, so
/// connectivity is taken on the welded mesh while the faces keep their own vertices.
fn without_small_pieces(positions: &[DVec3], faces: Vec<[u32; 3]>, smallest_share: f64) -> Vec<[u32; 3]> {
    let labels = components(positions.len(), &faces);
    if faces.iter().all(|face| labels[face[0] as usize] == labels[faces[0][0] as usize]) {
        return faces;
    }
    let welded = weld(positions, &faces, 0.0);
    let labels = components(welded.positions.len(), &welded.faces);
    let label_of = |face: &[u32; 3]| labels[welded.map[face[0] as usize] as usize] as usize;
    let mut areas = vec![0.0; welded.positions.len().max(1)];
    for face in &faces {
        let [a, b, c] = face.map(|vertex| positions[vertex as usize]);
        areas[label_of(face)] += 0.5 * (b - a).cross(c - a).length();
    }
    let smallest = smallest_share * areas.iter().sum::<f64>();
    faces.iter().copied().filter(|face| areas[label_of(face)] >= smallest).collect()
}
