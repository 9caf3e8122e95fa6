//! The body at three resolutions, and one identity prepared at one of them.

use glam::DVec3;
use habitus_geometry::{farthest_points, vertex_normals};

use crate::body::{BodyModel, BodySurface, PartLabel, PosedSkeleton};
use crate::fitting::deformers::{BodyParameters, FreeParameters};

/// Some vertices of the model.
pub(super) struct BodyLevel {
    /// Their indices in the model.
    pub vertices: Vec<u32>,
    /// The same vertices as a surface of their own.
    pub surface: BodySurface,
    /// The heaviest bone of each vertex.
    pub main_bones: Vec<u8>,
    /// The clothing part of each vertex.
    pub parts: Vec<PartLabel>,
    /// Vertices of the head, of each hand and of each foot.
    pub extremities: Vec<Vec<u32>>,
}

impl BodyLevel {
    fn new(model: &BodyModel, vertices: Vec<u32>, components: usize) -> Self {
        Self::of_surface(model, &model.surface().truncated(components), vertices)
    }

    /// Some vertices of a surface that moves the model's vertices.
    fn of_surface(model: &BodyModel, surface: &BodySurface, vertices: Vec<u32>) -> Self {
        let parts = vertices.iter().map(|v| model.part_labels()[*v as usize]).collect();
        let surface = surface.subset(&vertices);
        let extremities = extremities(model, &vertices);
        let main_bone = |vertex: usize| {
            let heaviest = surface.skin().of(vertex).max_by(|a, b| a.1.total_cmp(&b.1));
            heaviest.map_or(0, |(bone, _)| bone as u8)
        };
        let main_bones = (0..vertices.len()).map(main_bone).collect();
        Self { vertices, surface, main_bones, parts, extremities }
    }

    /// All vertices.
    pub fn full(model: &BodyModel, components: usize) -> Self {
        Self::new(model, (0..model.vertex_count() as u32).collect(), components)
    }

    /// The vertices of another level, moved by a surface of more components.
    pub fn with_surface(&self, model: &BodyModel, surface: &BodySurface) -> Self {
        Self::of_surface(model, surface, self.vertices.clone())
    }

    /// About `count` vertices, evenly spread over the mean body, and the landmarks.
    pub fn spread(model: &BodyModel, count: usize, components: usize) -> Self {
        let mut vertices = farthest_points(model.mean_vertices(), count);
        // Landmarks can be given at every resolution.
        vertices.extend(model.landmark_vertices());
        vertices.sort_unstable();
        vertices.dedup();
        Self::new(model, vertices, components)
    }
}

/// Bare vertices by the side and part they belong to, as positions in `vertices`; parts without vertices are left out.
fn extremities(model: &BodyModel, vertices: &[u32]) -> Vec<Vec<u32>> {
    let mean = model.mean_vertices();
    let mut parts = vec![Vec::new(); 5];
    for (slot, vertex) in vertices.iter().enumerate() {
        let side = usize::from(mean[*vertex as usize].x < 0.0);
        match model.part_labels()[*vertex as usize] {
            PartLabel::Covered => {}
            PartLabel::Head => parts[0].push(slot as u32),
            PartLabel::Hand => parts[1 + side].push(slot as u32),
            PartLabel::Foot => parts[3 + side].push(slot as u32),
        }
    }
    parts.retain(|part| !part.is_empty());
    parts
}

/// A person at rest, of the space or of a surface with more components.
#[derive(Clone, Debug)]
pub(super) struct RestBody {
    /// Coefficients in standard deviations; those of the space come first.
    pub coefficients: Vec<f64>,
    /// All vertices, metres.
    pub vertices: Vec<DVec3>,
    /// Joints, metres.
    pub joints: Vec<DVec3>,
}

impl RestBody {
    /// A person of the space.
    pub fn of_space(model: &BodyModel, identity: &[f64]) -> Self {
        Self::of_surface(model.surface(), identity)
    }

    /// A person of a surface that has all vertices; missing coefficients are zero.
    pub fn of_surface(surface: &BodySurface, coefficients: &[f64]) -> Self {
        Self {
            coefficients: coefficients.to_vec(),
            vertices: surface.rest_vertices(coefficients),
            joints: surface.rest_joints(coefficients),
        }
    }
}

/// An identity at one level: what stays the same over poses.
pub(super) struct PreparedIdentity<'a> {
    pub level: &'a BodyLevel,
    pub coefficients: Vec<f64>,
    pub rest: Vec<DVec3>,
    pub rest_normals: Vec<DVec3>,
    pub joints: Vec<DVec3>,
    pub deformer: BodyParameters<'a>,
}

impl<'a> PreparedIdentity<'a> {
    /// A person of the space.
    pub fn new(model: &BodyModel, level: &'a BodyLevel, identity: &[f64]) -> Self {
        Self::of_body(model, level, &RestBody::of_space(model, identity))
    }

    /// Any person.
    pub fn of_body(model: &BodyModel, level: &'a BodyLevel, body: &RestBody) -> Self {
        let all_normals = vertex_normals(&body.vertices, model.faces());
        let rest: Vec<DVec3> = level.vertices.iter().map(|v| body.vertices[*v as usize]).collect();
        let rest_normals = level.vertices.iter().map(|v| all_normals[*v as usize]).collect();
        let free = FreeParameters::Pose { rest: rest.clone(), joints: body.joints.clone() };
        Self {
            level,
            coefficients: body.coefficients.clone(),
            rest,
            rest_normals,
            joints: body.joints.clone(),
            deformer: BodyParameters::new(&level.surface, free),
        }
    }

    /// Bone transforms in a pose.
    pub fn posed(&self, pose: &[f64]) -> PosedSkeleton {
        self.level.surface.skeleton().pose(&self.joints, pose)
    }

    /// Posed vertices and their normals; the normals turn with the blended bones, which is right up to the
    /// shear of the blend and costs no pass over faces.
    pub fn vertices_and_normals(&self, posed: &PosedSkeleton) -> (Vec<DVec3>, Vec<DVec3>) {
        let vertices = self.level.surface.skin_vertices(&self.rest, posed);
        (vertices, turned_normals(&self.level.surface, &self.rest_normals, posed))
    }
}

pub(super) fn turned_normals(
    surface: &BodySurface,
    rest_normals: &[DVec3],
    posed: &PosedSkeleton,
) -> Vec<DVec3> {
    rest_normals
        .iter()
        .enumerate()
        .map(|(vertex, normal)| {
            let turned: DVec3 = surface
                .skin()
                .of(vertex)
                .map(|(bone, weight)| posed.rotations[bone] * *normal * weight)
                .sum();
            turned.normalize_or(*normal)
        })
        .collect()
}
