//! The body of the last passes of refinement: behind the space's components come local shapes, what no component shows.
//!
//! A local shape can look like posture: a shank that is turned at rest, and turned back in every pose, is the same body.
//! The space has been freed of posture; here linear functions of the coefficients tell how much of it they make up.

use glam::DVec3;
use habitus_geometry::farthest_points;
use nalgebra::DMatrix;

use super::body_levels::{BodyLevel, RestBody};
use super::config::RefineConfig;
use crate::body::{BodyModel, BodySurface, Skeleton};
use crate::fitting::local_shapes::with_local_shapes;

/// Vertices among which the centres of windows are chosen, at least.
const ORDERED_VERTICES: usize = 1500;

/// The space with local shapes.
pub(super) struct LocalBody {
    /// All vertices.
    surface: BodySurface,
    /// Those that the refinement looks at.
    pub level: BodyLevel,
    /// Posture in the coefficients: a row each, zero up to a deviation of one.
    pub posture: DMatrix<f64>,
}

impl LocalBody {
    /// Puts local shapes behind the first `own` components of the space, at the vertices of `level`.
    pub fn new(model: &BodyModel, level: &BodyLevel, own: usize, config: &RefineConfig) -> Self {
        let order = farthest_points(model.mean_vertices(), config.local.centres.max(ORDERED_VERTICES));
        let surface = with_local_shapes(model, own, &order, &config.local);
        let level = level.with_surface(model, &surface);
        let posture = posture_rows(&level.surface, own, config);
        Self { surface, level, posture }
    }

    /// The person of some coefficients; missing ones are zero.
    pub fn rest_body(&self, coefficients: &[f64]) -> RestBody {
        let mut all = coefficients.to_vec();
        all.resize(self.surface.component_count(), 0.0);
        RestBody::of_surface(&self.surface, &all)
    }
}

/// Turns of bones in local shapes, three rows for each bone but the root, and directions of limbs in all coefficients, two
/// rows for each bone with one child. The space's own first `own` coefficients turn nothing.
fn posture_rows(surface: &BodySurface, own: usize, config: &RefineConfig) -> DMatrix<f64> {
    let skeleton = surface.skeleton();
    let deviation = config.posture_deg.to_radians();
    let turns = (1..skeleton.bones().len())
        .flat_map(|bone| DVec3::AXES.map(|axis| (bone, axis)))
        .map(|(bone, axis)| turn_row(surface, own, bone, axis).map(|angle| angle / deviation));
    let deviation = config.limb_direction_deg.to_radians();
    let directions = limbs(skeleton).into_iter().flat_map(|limb| {
        direction_rows(surface, limb).map(|row| row.into_iter().map(|angle| angle / deviation).collect())
    });
    let rows: Vec<Vec<f64>> = turns.map(Iterator::collect).chain(directions).collect();
    DMatrix::from_fn(rows.len(), surface.component_count(), |row, column| rows[row][column])
}

/// By how many radians each coefficient turns the vertices that hang on a bone about its joint, in the least squares sense.
fn turn_row(
    surface: &BodySurface,
    own: usize,
    bone: usize,
    axis: DVec3,
) -> impl Iterator<Item = f64> + use<> {
    let width = surface.component_count();
    let joint = surface.joint_map().mean[bone];
    let moves = hangs_on(surface.skeleton(), bone);
    let mut row = vec![0.0; width];
    let mut square = 0.0;
    for (vertex, position) in surface.mean_vertices().iter().enumerate() {
        let share: f64 = surface.skin().of(vertex).filter(|(bone, _)| moves[*bone]).map(|(_, w)| w).sum();
        let motion = axis.cross(*position - joint) * share;
        square += motion.length_squared();
        for (along, basis) in motion.to_array().iter().zip(surface.vertex_basis(vertex).chunks_exact(width)) {
            for (sum, entry) in row[own..].iter_mut().zip(&basis[own..]) {
                *sum += along * f64::from(*entry);
            }
        }
    }
    row.into_iter().map(move |sum| sum / square.max(1e-12))
}

/// By how many radians each coefficient turns the line from one joint to the next, about two axes across it.
fn direction_rows(surface: &BodySurface, [from, to]: [usize; 2]) -> [Vec<f64>; 2] {
    let joints = surface.joint_map();
    let along = joints.mean[to] - joints.mean[from];
    let across = along.normalize_or(DVec3::Y).any_orthonormal_pair();
    [across.0, across.1].map(|axis| {
        let turn = |moves: &Vec<DVec3>| (moves[to] - moves[from]).dot(axis) / along.length().max(1e-9);
        joints.basis.iter().map(turn).collect()
    })
}

/// Bones that a bone carries along, itself among them.
fn hangs_on(skeleton: &Skeleton, bone: usize) -> Vec<bool> {
    let bones = skeleton.bones();
    let mut hangs = vec![false; bones.len()];
    for other in bone..bones.len() {
        hangs[other] = other == bone || bones[other].parent.is_some_and(|parent| hangs[parent]);
    }
    hangs
}

/// Bones with one child, each with it.
fn limbs(skeleton: &Skeleton) -> Vec<[usize; 2]> {
    let bones = skeleton.bones();
    let children = |bone: usize| (0..bones.len()).filter(move |other| bones[*other].parent == Some(bone));
    (0..bones.len())
        .filter(|bone| children(*bone).count() == 1)
        .flat_map(|bone| children(bone).map(move |child| [bone, child]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fitting::local_shapes::LocalShapeConfig;

    #[test]
    fn a_turned_limb_counts_as_posture_and_a_thicker_one_does_not() {
        let model = BodyModel::default_space().expect("the embedded model");
        let config = RefineConfig::default();
        let base = model.surface().truncated(2);
        let forearm = model.skeleton().bones().iter().position(|bone| bone.name == "left_forearm");
        let forearm = forearm.expect("a forearm");
        let joint = model.surface().joint_map().mean[forearm];
        let hangs = hangs_on(model.skeleton(), forearm);
        let share = |vertex: usize| -> f64 {
            base.skin().of(vertex).filter(|(bone, _)| hangs[*bone]).map(|(_, weight)| weight).sum()
        };
        let normals = habitus_geometry::vertex_normals(model.mean_vertices(), model.faces());
        let places = || model.mean_vertices().iter().enumerate();
        let angle = 2.0_f64.to_radians();
        let turned: Vec<DVec3> =
            places().map(|(v, place)| DVec3::Z.cross(*place - joint) * share(v) * angle).collect();
        let thicker: Vec<DVec3> = places().map(|(v, _)| normals[v] * share(v) * 0.005).collect();
        let joints = [&turned, &thicker].map(|shape| model.joints(shape)).to_vec();
        let surface = base.with_components(&[turned, thicker], joints);
        let rows = posture_rows(&surface, 2, &config);
        // The turn of 2° about z is found whole, and the space's own components are left out of it.
        let first = rows.row(3 * (forearm - 1) + 2);
        assert!((first[2] * config.posture_deg - 2.0).abs() < 1e-6, "{}", first[2]);
        assert!(first[0] == 0.0 && first[1] == 0.0);
        let strongest = |column: usize| rows.column(column).iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        assert!(strongest(3) < 0.2 * strongest(2), "{} {}", strongest(3), strongest(2));
    }

    #[test]
    fn local_shapes_stand_behind_the_components_that_are_fitted() {
        let model = BodyModel::default_space().expect("the embedded model");
        let config = RefineConfig {
            local: LocalShapeConfig { centres: 4, ..LocalShapeConfig::default() },
            ..RefineConfig::default()
        };
        let level = BodyLevel::spread(&model, 300, 10);
        let local = LocalBody::new(&model, &level, 10, &config);
        assert_eq!(local.level.surface.component_count(), local.surface.component_count());
        let identity = [1.0, -2.0, 0.5];
        let body = local.rest_body(&identity);
        assert_eq!(body.coefficients.len(), local.surface.component_count());
        let expected = model.rest_vertices(&identity);
        let farthest = body.vertices.iter().zip(&expected).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(farthest < 1e-9, "{farthest}");
    }
}
