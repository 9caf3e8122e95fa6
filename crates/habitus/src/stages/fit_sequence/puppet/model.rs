//! The puppet of a body model: parts with their spaces and how they are stitched, learnt from the model's own bodies.

use glam::{DMat3, DVec3};
use nalgebra::{DMatrix, Matrix3};
use rayon::prelude::*;

use super::super::config::PuppetConfig;
use super::parts::{
    BEND_COMPONENTS, COEFFICIENTS, Part, PartLayout, PartState, SHAPE_COMPONENTS, layouts, leading_components,
};
use super::stitching::Stitch;
use crate::body::{BodyModel, BodySurface, ROOT_LENGTH};
use crate::statistics::RandomStream;

/// Identity components that shape the parts; further ones are finer than a part's own space.
const IDENTITY_COMPONENTS: usize = 40;

/// Parts, stitches and the bodies that they were learnt from.
pub(in super::super) struct Puppet {
    pub(super) parts: Vec<Part>,
    /// One for each part but the first: how it hangs on its parent.
    pub(super) stitches: Vec<Option<Stitch>>,
    /// States of all parts in each of the learning bodies.
    pub(super) examples: Vec<Vec<PartState>>,
    /// Part and slot of each landmark of the model.
    pub(super) landmarks: Vec<(usize, usize)>,
    /// The part on the other side of the body; the same for those in the middle.
    pub(super) mirror_parts: Vec<usize>,
    surface: BodySurface,
    /// For each part the positions of its vertices in `surface`.
    places: Vec<Vec<usize>>,
}

/// A body as the parts see it.
struct LearningBody {
    rotations: Vec<DMat3>,
    joints: Vec<DVec3>,
    identity: Vec<f64>,
    /// For each part, each vertex in the bone's coordinates: at rest and posed.
    rest: Vec<Vec<DVec3>>,
    posed: Vec<Vec<DVec3>>,
}

impl Puppet {
    /// Learns parts and stitches. `typical_poses` are half of what the bodies are posed in, the joints' limits the rest.
    pub fn learn(model: &BodyModel, typical_poses: &[Vec<f64>], config: &PuppetConfig, seed: u64) -> Self {
        let layouts = layouts(model, config.points_per_part);
        let mut vertices: Vec<u32> =
            layouts.iter().flat_map(|layout| layout.vertices.iter().copied()).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let surface = model.surface().truncated(IDENTITY_COMPONENTS).subset(&vertices);
        let place = |vertex: &u32| vertices.binary_search(vertex).unwrap_or(0);
        let places: Vec<Vec<usize>> =
            layouts.iter().map(|layout| layout.vertices.iter().map(place).collect()).collect();
        let mut random = RandomStream::named(seed, "puppet bodies");
        let bodies: Vec<LearningBody> = (0..config.learning_bodies.max(2))
            .map(|index| {
                let identity: Vec<f64> =
                    (0..surface.component_count()).map(|_| random.normal().clamp(-2.5, 2.5)).collect();
                let pose = random_pose(&surface, typical_poses, index, &mut random);
                learning_body(&surface, &layouts, &places, &identity, &pose)
            })
            .collect();
        let normals = habitus_geometry::vertex_normals(model.mean_vertices(), model.faces());
        let parts: Vec<Part> = layouts
            .into_par_iter()
            .enumerate()
            .map(|(part, layout)| {
                learn_part(model, &surface, (part, layout), &places[part], &bodies, &normals)
            })
            .collect();
        let examples: Vec<Vec<PartState>> = bodies.iter().map(|body| states(&parts, body)).collect();
        let stitches = (0..parts.len())
            .map(|part| {
                parts[part].layout.parent.map(|parent| Stitch::learn(&parts, part, parent, &examples))
            })
            .collect();
        let landmarks = model.landmark_vertices().iter().map(|vertex| slot_of(&parts, *vertex)).collect();
        let mirror_parts = parts.iter().map(|part| mirror_part(model, &parts, part)).collect();
        Self { parts, stitches, examples, landmarks, mirror_parts, surface, places }
    }

    /// The states of all parts of a body of the model.
    pub(super) fn states_of(&self, identity: &[f64], pose: &[f64]) -> Vec<PartState> {
        let layouts: Vec<PartLayout> = self.parts.iter().map(|part| part.layout.clone()).collect();
        let identity = &identity[..identity.len().min(self.surface.component_count())];
        states(&self.parts, &learning_body(&self.surface, &layouts, &self.places, identity, pose))
    }
}

/// The part whose bone moves most of the mirror images of a part's vertices.
fn mirror_part(model: &BodyModel, parts: &[Part], part: &Part) -> usize {
    let dominant = model.dominant_bones();
    let mut votes = vec![0_usize; parts.len()];
    for vertex in &part.layout.vertices[..part.layout.data_count] {
        let bone = dominant[model.mirror_vertices()[*vertex as usize] as usize];
        if let Some(found) = parts.iter().position(|other| other.layout.bone == bone) {
            votes[found] += 1;
        }
    }
    (0..parts.len()).max_by_key(|other| (votes[*other], std::cmp::Reverse(*other))).unwrap_or(0)
}

fn slot_of(parts: &[Part], vertex: u32) -> (usize, usize) {
    for (index, part) in parts.iter().enumerate() {
        let end = part.layout.vertices.len();
        if let Some(slot) = (0..end).find(|slot| part.layout.vertices[*slot] == vertex) {
            return (index, slot);
        }
    }
    (0, 0)
}

/// Half the bodies stand in one of the typical poses, loosely; the joints of the others are anywhere in their limits.
fn random_pose(
    surface: &BodySurface,
    typical: &[Vec<f64>],
    index: usize,
    random: &mut RandomStream,
) -> Vec<f64> {
    const LOOSE: f64 = 0.25;
    /// Of the way from rest to the limits.
    const REACH: f64 = 0.8;
    let skeleton = surface.skeleton();
    let mut pose = vec![0.0; skeleton.pose_length()];
    for (axis, of) in skeleton.axes().iter().enumerate() {
        let [low, high] = of.limits;
        let parameter = ROOT_LENGTH + axis;
        let angle = match typical.get((index / 2) % typical.len().max(1)) {
            Some(typical) if index.is_multiple_of(2) => typical[parameter] + LOOSE * random.normal(),
            _ => REACH * random.between(low, high),
        };
        pose[parameter] = angle.clamp(low, high);
    }
    pose
}

fn learning_body(
    surface: &BodySurface,
    layouts: &[PartLayout],
    places: &[Vec<usize>],
    identity: &[f64],
    pose: &[f64],
) -> LearningBody {
    let rest = surface.rest_vertices(identity);
    let rest_joints = surface.rest_joints(identity);
    let posed = surface.skeleton().pose(&rest_joints, pose);
    let vertices = surface.skin_vertices(&rest, &posed);
    let of_parts = |local: &dyn Fn(usize, usize) -> DVec3| -> Vec<Vec<DVec3>> {
        layouts
            .iter()
            .zip(places)
            .map(|(layout, places)| places.iter().map(|place| local(layout.bone, *place)).collect())
            .collect()
    };
    LearningBody {
        identity: identity.to_vec(),
        rest: of_parts(&|bone, place| rest[place] - rest_joints[bone]),
        posed: of_parts(&|bone, place| {
            posed.rotations[bone].transpose() * (vertices[place] - posed.joints[bone])
        }),
        rotations: layouts.iter().map(|layout| posed.rotations[layout.bone]).collect(),
        joints: layouts.iter().map(|layout| posed.joints[layout.bone]).collect(),
    }
}

fn learn_part(
    model: &BodyModel,
    surface: &BodySurface,
    (part, layout): (usize, PartLayout),
    places: &[usize],
    bodies: &[LearningBody],
    normals: &[DVec3],
) -> Part {
    let joints = surface.joint_map();
    let count = places.len();
    let width = surface.component_count();
    // The vertex is linear in the identity and so is the joint: the columns are exact, not sampled.
    let shape = DMatrix::from_fn(3 * count, width, |row, component| {
        let rows = surface.vertex_basis(places[row / 3]);
        f64::from(rows[(row % 3) * width + component]) - joints.basis[component][layout.bone][row % 3]
    });
    let shape = leading_components(&shape, SHAPE_COMPONENTS);
    let bend_of = |body: &LearningBody, slot: usize| body.posed[part][slot] - body.rest[part][slot];
    let scale = 1.0 / bodies.len() as f64;
    let bend_mean: Vec<DVec3> =
        (0..count).map(|slot| bodies.iter().map(|body| bend_of(body, slot)).sum::<DVec3>() * scale).collect();
    let bend = DMatrix::from_fn(3 * count, bodies.len(), |row, body| {
        let slot = row / 3;
        (bend_of(&bodies[body], slot) - bend_mean[slot])[row % 3] * scale.sqrt()
    });
    let bend = leading_components(&bend, BEND_COMPONENTS);
    let basis = (0..count)
        .map(|slot| {
            let mut directions = [DVec3::ZERO; COEFFICIENTS];
            let all = shape.directions.iter().chain(&bend.directions);
            for (direction, column) in directions.iter_mut().zip(all) {
                *direction = DVec3::from_slice(&column[3 * slot..3 * slot + 3]);
            }
            directions
        })
        .collect();
    let data = &layout.vertices[..layout.data_count];
    Part {
        mean: (0..count)
            .map(|slot| surface.mean_vertices()[places[slot]] - joints.mean[layout.bone] + bend_mean[slot])
            .collect(),
        bend_mean,
        basis,
        normals: data.iter().map(|vertex| normals[*vertex as usize]).collect(),
        is_bare: data.iter().map(|vertex| model.part_labels()[*vertex as usize].is_bare()).collect(),
        shape_of_identity: shape.rows,
        layout,
    }
}

/// The state of each part that comes closest to a body.
fn states(parts: &[Part], body: &LearningBody) -> Vec<PartState> {
    parts
        .iter()
        .enumerate()
        .map(|(index, part)| {
            let mut coefficients = [0.0; COEFFICIENTS];
            for (component, value) in coefficients.iter_mut().take(SHAPE_COMPONENTS).enumerate() {
                let row = part.shape_of_identity.row(component);
                *value = row.iter().zip(&body.identity).map(|(x, y)| x * y).sum();
            }
            for component in SHAPE_COMPONENTS..COEFFICIENTS {
                let (mut along, mut length) = (0.0, 0.0);
                for (slot, basis) in part.basis.iter().enumerate() {
                    // What bending does is measured from the body's own rest, not from the part's approximation of it.
                    let bend = body.posed[index][slot] - body.rest[index][slot];
                    let residual = bend - part.bend_mean[slot];
                    along += basis[component].dot(residual);
                    length += basis[component].length_squared();
                }
                coefficients[component] = if length > 1e-12 { along / length } else { 0.0 };
            }
            PartState { rotation: body.rotations[index], joint: body.joints[index], coefficients }
        })
        .collect()
}

/// Mean and covariance of rotation vectors.
pub(super) fn mean_and_covariance(vectors: &[DVec3]) -> (DVec3, Matrix3<f64>) {
    let count = vectors.len().max(1) as f64;
    let mean = vectors.iter().sum::<DVec3>() / count;
    let mut covariance = Matrix3::zeros();
    for vector in vectors {
        let offset = nalgebra::Vector3::from((*vector - mean).to_array());
        covariance += offset * offset.transpose() / count;
    }
    (mean, covariance)
}
