//! One identity and all poses together: poses are eliminated frame by frame, so that the identity sees through them.
//!
//! Deviation: P2 §4.5 refines the identity with frozen poses. Slightly wrong poses then push limbs thin; eliminating
//! the poses exactly (a Schur complement for each frame) costs little more.

use std::sync::Arc;

use glam::DVec3;
use habitus_optimize::minimize_box_quadratic;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::FitSequenceError;
use super::captured_frame::CapturedFrame;
use super::clearances::Clearances;
use super::clothed_surface::{Inside, bare_capture_pairs, sole_pairs, weigh_one_sided};
use super::config::RefineConfig;
use super::pose_solver::{PosePrior, PoseSolver};
use crate::body::{IdentityCoefficients, ROOT_LENGTH};
use crate::fitting::correspondence::{ClosestField, Correspondence};
use crate::fitting::deformers::body_assembly::{BodyAssembly, Gather, ShapeMoments};
use crate::fitting::terms::{ClosestPoints, DistanceForm};

/// Frames whose equations are in memory together; fixed, so that sums do not depend on the thread count.
const BATCH: usize = 8;

/// A vertex farther outside the capture than this, metres, counts as outside: the 5 mm of `outside_share_5mm`.
pub(super) const OUTSIDE_DEPTH: f64 = 0.005;

/// What one frame says about the identity once its pose is eliminated.
struct FrameShare {
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
    moments: ShapeMoments,
    clearance: Vec<f64>,
    pose: Vec<f64>,
    response: Option<PoseResponse>,
    energy: f64,
    vertex_count: usize,
}

/// How the pose of a frame answers a step of the identity, in the quadratic that both share.
struct PoseResponse {
    /// Minus the step of the pose if the identity stays.
    alone: DVector<f64>,
    /// Minus the step for a step of one in each coefficient.
    by_identity: DMatrix<f64>,
}

impl PoseResponse {
    /// Takes from the identity's equations what the pose can explain; nothing if the pose's own do not determine it.
    fn eliminating_pose(
        pose_matrix: DMatrix<f64>,
        pose_gradient: &DVector<f64>,
        pose_identity: &DMatrix<f64>,
        (identity_matrix, identity_gradient): (&mut DMatrix<f64>, &mut DVector<f64>),
    ) -> Option<Self> {
        let factor = pose_matrix.cholesky()?;
        let (alone, by_identity) = (factor.solve(pose_gradient), factor.solve(pose_identity));
        identity_matrix.gemm_tr(-1.0, pose_identity, &by_identity, 1.0);
        identity_gradient.gemv_tr(-1.0, &by_identity, pose_gradient, 1.0);
        Some(Self { alone, by_identity })
    }

    /// Moves the pose to where it is best after the identity has moved, inside its limits.
    fn follow(&self, identity_step: &DVector<f64>, pose: &mut [f64], (lower, upper): &(Vec<f64>, Vec<f64>)) {
        let back = &self.alone + &self.by_identity * identity_step;
        for (k, value) in pose.iter_mut().enumerate() {
            *value = (*value - back[k]).clamp(lower[k], upper[k]);
        }
    }
}

/// How covered vertices are drawn to the cloth in a pass.
pub(super) struct Contact<'a> {
    /// What the pass before saw.
    pub earlier: Option<&'a Clearances>,
    /// Geman–McClure scale of the attraction, in metres.
    pub scale: f64,
    /// Functions of the coefficients that are posture, not build: a row each, zero up to a deviation of one.
    pub posture: Option<&'a DMatrix<f64>>,
}

/// The body after a pass, with the curvature of the energy there.
pub(super) struct IdentityStep {
    /// Coefficients of the level's surface, in standard deviations.
    pub coefficients: Vec<f64>,
    /// Posterior covariance in standard deviations: inverse of the normal matrix, prior included, its data doubted.
    pub covariance: DMatrix<f64>,
    /// Mean energy per vertex.
    pub energy: f64,
    /// Share of vertices more than 5 mm outside the capture.
    pub outside_share_5mm: f64,
}

/// One pass over frames: polish each pose, take its equations, eliminate the pose, step the identity in its box and let the
/// poses follow.
///
/// `frames` yields (position in `poses`, capture); a frame that cannot be read is left out by returning `None`. With the step
/// comes what the frames saw between skin and cloth, for the next pass.
pub(super) fn refine_pass(
    solver: &PoseSolver<'_>,
    frames: &[usize],
    load: &(dyn Fn(usize) -> Option<Arc<CapturedFrame>> + Sync),
    poses: &mut [Vec<f64>],
    prior: &(dyn Fn(usize) -> PosePrior + Sync),
    contact: &Contact<'_>,
    config: &RefineConfig,
) -> Result<(IdentityStep, Clearances), FitSequenceError> {
    let body = &solver.fine;
    let surface = &body.level.surface;
    let width = surface.component_count();
    let mut matrix = DMatrix::zeros(width, width);
    let mut gradient = DVector::zeros(width);
    let mut moments = ShapeMoments::new(surface.vertex_count());
    let mut clearances = Clearances::new(surface.vertex_count());
    let (mut energy, mut vertex_count, mut frame_count, mut outside_count) = (0.0, 0, 0, 0);
    let mut responses = Vec::new();
    for batch in frames.chunks(BATCH) {
        let shares: Vec<Result<Option<FrameShare>, FitSequenceError>> = batch
            .par_iter()
            .map(|frame| match load(*frame) {
                None => Ok(None),
                Some(capture) => {
                    let start = poses[*frame].clone();
                    frame_share(solver, &capture, start, &prior(*frame), contact, config).map(Some)
                }
            })
            .collect();
        for (frame, share) in batch.iter().zip(shares) {
            let Some(share) = share? else { continue };
            matrix += share.matrix;
            gradient += share.gradient;
            moments.merge(&share.moments);
            clearances.add(&share.clearance);
            outside_count += share.clearance.iter().filter(|clearance| **clearance < -OUTSIDE_DEPTH).count();
            poses[*frame] = share.pose;
            responses.extend(share.response.map(|response| (*frame, response)));
            energy += share.energy;
            vertex_count += share.vertex_count;
            frame_count += 1;
        }
    }
    if frame_count == 0 {
        return Err(FitSequenceError::NoUsableFrame);
    }
    moments.apply(surface, Some(&mut matrix), gradient.as_mut_slice());
    let (coefficients, covariance) =
        identity_step(&body.coefficients, matrix, gradient, contact.posture, vertex_count, config)?;
    let moved = coefficients.iter().zip(&body.coefficients).map(|(next, z)| next - z);
    let moved = DVector::from_iterator(width, moved);
    let limits = surface.skeleton().pose_limits();
    for (frame, response) in responses {
        response.follow(&moved, &mut poses[frame], &limits);
    }
    let energy = energy / vertex_count.max(1) as f64;
    let outside_share_5mm = outside_count as f64 / vertex_count.max(1) as f64;
    Ok((IdentityStep { coefficients, covariance, energy, outside_share_5mm }, clearances))
}

/// Data against the population: residuals count as `independent_residuals` of deviation `residual_deviation`.
fn identity_step(
    identity: &[f64],
    mut matrix: DMatrix<f64>,
    mut gradient: DVector<f64>,
    posture: Option<&DMatrix<f64>>,
    vertex_count: usize,
    config: &RefineConfig,
) -> Result<(Vec<f64>, DMatrix<f64>), FitSequenceError> {
    let scale = config.independent_residuals
        / (vertex_count.max(1) as f64 * config.residual_deviation * config.residual_deviation);
    matrix *= scale;
    gradient *= scale;
    for (k, coefficient) in identity.iter().enumerate() {
        matrix[(k, k)] += 1.0;
        gradient[k] += coefficient;
    }
    if let Some(posture) = posture {
        let transposed = posture.transpose();
        gradient += &transposed * (posture * DVector::from_column_slice(identity));
        matrix += transposed * posture;
    }
    let symmetric = (&matrix + matrix.transpose()) * 0.5;
    let limit = IdentityCoefficients::LIMIT;
    let lower: Vec<f64> = identity.iter().map(|z| -limit - z).collect();
    let upper: Vec<f64> = identity.iter().map(|z| limit - z).collect();
    let step = minimize_box_quadratic(&symmetric, &gradient, &lower, &upper)?;
    let relaxed = |(z, step): (&f64, &f64)| (z + config.over_relaxation * step).clamp(-limit, limit);
    let next = identity.iter().zip(step.step.iter()).map(relaxed).collect();
    Ok((next, stated_covariance(&symmetric, config.error_over_curvature)))
}

/// Covariance of the coefficients when the data say less than their curvature claims: the population's share of the
/// normal matrix, the identity, stays; the data's is divided by the square of `error_over_curvature`.
fn stated_covariance(normal_matrix: &DMatrix<f64>, error_over_curvature: f64) -> DMatrix<f64> {
    let population = DMatrix::identity(normal_matrix.nrows(), normal_matrix.nrows());
    let data = (normal_matrix - &population) / (error_over_curvature * error_over_curvature);
    (data + &population).cholesky().map_or(population, |factor| factor.inverse())
}

fn frame_share(
    solver: &PoseSolver<'_>,
    capture: &CapturedFrame,
    start: Vec<f64>,
    prior: &PosePrior,
    contact: &Contact<'_>,
    config: &RefineConfig,
) -> Result<FrameShare, FitSequenceError> {
    let (pose, field) = solver.polish_found_pose(capture, start, prior, config.pose_rounds)?;
    let body = &solver.fine;
    let surface = &body.level.surface;
    let posed = body.posed(&pose);
    let (vertices, normals) = body.vertices_and_normals(&posed);
    let field = ClosestField::find(&capture.index, &vertices, field.as_ref());
    let mut pairs = field.correspondences(&vertices, &normals, &solver.surface.compatibility);
    let mut clearance = vec![f64::INFINITY; vertices.len()];
    for pair in &pairs {
        clearance[pair.vertex as usize] = -pair.signed_distance;
    }
    for pair in &mut pairs {
        let inside = Inside {
            weight: contact_weight(pair, contact, config),
            scale: contact.scale,
            gap: contact.earlier.map_or(0.0, |earlier| earlier.expected_gap(pair.vertex as usize, config)),
        };
        let part = body.level.parts[pair.vertex as usize];
        let is_inside = pair.signed_distance < 0.0 && !part.is_bare();
        weigh_one_sided(pair, part, inside, solver.surface);
        if is_inside {
            // Deviation: P2 Eq. 7, 8 measure to the capture. Cloth that hangs free leans: along its own normal it would
            // draw hips up into the cone of a skirt.
            pair.normal = normals[pair.vertex as usize];
        }
    }
    pairs.extend(bare_capture_pairs(body.level, capture, &vertices, &normals, solver.surface));
    let closest = ClosestPoints::new(&pairs, DistanceForm::Plane);
    let soles = sole_pairs(body.level, capture, &vertices, solver.surface);
    let soles = ClosestPoints::new(&soles, DistanceForm::Point);
    let mut assembly = BodyAssembly::new(surface, Gather::PoseAndIdentity, true);
    for term in [&closest, &soles] {
        assembly.add(surface, &posed, &body.rest, &vertices, term.residuals());
    }
    let mut equations = assembly.equations(surface, &posed);
    let count = vertices.len() as f64;
    for (target, stiffness) in &prior.angles {
        for k in ROOT_LENGTH..pose.len() {
            equations.pose_matrix[(k, k)] += stiffness * count;
            equations.pose_gradient[k] += stiffness * count * (pose[k] - target[k]);
        }
    }
    // A little of the diagonal keeps a pose parameter that nothing constrains from having a vote.
    for k in 0..pose.len() {
        let diagonal = equations.pose_matrix[(k, k)];
        equations.pose_matrix[(k, k)] = diagonal * (1.0 + 1e-6) + 1e-9;
    }
    let (mut matrix, mut gradient) = (equations.identity_matrix, equations.identity_gradient);
    let response = PoseResponse::eliminating_pose(
        equations.pose_matrix,
        &equations.pose_gradient,
        &equations.pose_identity,
        (&mut matrix, &mut gradient),
    );
    Ok(FrameShare {
        matrix,
        gradient,
        moments: assembly.into_moments(),
        clearance,
        pose,
        response,
        energy: equations.value,
        vertex_count: vertices.len(),
    })
}

/// Cloth touches skin somewhere, sometime: a covered vertex is drawn to the cloth only in frames in which it comes
/// about as close as it ever does, and, through the robust kernel, only if that is close.
fn contact_weight(pair: &Correspondence, contact: &Contact<'_>, config: &RefineConfig) -> f64 {
    let depth = (-pair.signed_distance).max(0.0);
    let smallest = contact.earlier.map_or(depth, |earlier| earlier.smallest[pair.vertex as usize].max(0.0));
    let above = (depth - smallest).max(0.0) / config.clearance_tolerance;
    config.contact_weight * (-above * above).exp()
}

/// Positions of `count` frames at most, evenly spread over the trusted ones.
pub(super) fn spread(trusted: &[usize], count: usize) -> Vec<usize> {
    if trusted.len() <= count {
        return trusted.to_vec();
    }
    (0..count).map(|k| trusted[(2 * k + 1) * trusted.len() / (2 * count)]).collect()
}

/// Vertices that lie outside the capture, deepest first in sum: (share beyond `depth`, mean depth of all vertices).
pub(super) fn outside(signed_distances: &[f64], depth: f64) -> (f64, f64) {
    let count = signed_distances.len().max(1) as f64;
    let beyond = signed_distances.iter().filter(|distance| **distance > depth).count() as f64;
    let sum: f64 = signed_distances.iter().map(|distance| distance.max(0.0)).sum();
    (beyond / count, sum / count)
}

/// Signed distances of vertices to a capture, positive outside, from a closest field.
pub(super) fn signed_distances(field: &ClosestField, vertices: &[DVec3]) -> Vec<f64> {
    field
        .points
        .iter()
        .zip(vertices)
        .map(|(point, vertex)| {
            let distance = point.distance_squared.sqrt();
            if (*vertex - point.position).dot(point.normal) > 0.0 { distance } else { -distance }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identity_and_the_poses_that_follow_it_reach_the_minimum_of_both() {
        // Any positive definite quadratic in three pose parameters and two coefficients.
        let root = DMatrix::from_fn(5, 5, |row, column| ((3 * row + 5 * column) as f64).sin());
        let matrix = &root.transpose() * &root + DMatrix::identity(5, 5);
        let gradient = DVector::from_fn(5, |row, _| (row as f64).cos());
        let minimum = -matrix.clone().cholesky().expect("positive definite").solve(&gradient);
        let mut identity_matrix = matrix.view((3, 3), (2, 2)).into_owned();
        let mut identity_gradient = gradient.rows(3, 2).into_owned();
        let response = PoseResponse::eliminating_pose(
            matrix.view((0, 0), (3, 3)).into_owned(),
            &gradient.rows(0, 3).into_owned(),
            &matrix.view((0, 3), (3, 2)).into_owned(),
            (&mut identity_matrix, &mut identity_gradient),
        );
        let step = -identity_matrix.cholesky().expect("positive definite").solve(&identity_gradient);
        let mut pose = vec![0.0; 3];
        let limits = (vec![-9.0, -9.0, 0.1 + minimum[2]], vec![9.0; 3]);
        response.expect("a determined pose").follow(&step, &mut pose, &limits);
        for (found, expected) in step.iter().zip(minimum.rows(3, 2).iter()) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        assert!((pose[0] - minimum[0]).abs() < 1e-12 && (pose[1] - minimum[1]).abs() < 1e-12);
        assert_eq!(pose[2], limits.0[2], "a limit holds");
    }

    #[test]
    fn a_doubted_curvature_doubles_what_is_well_known_and_leaves_what_only_the_population_knows() {
        let normal_matrix = DMatrix::from_diagonal(&DVector::from_vec(vec![1.0 + 1e8, 1.0]));
        let [trusted, doubted] = [1.0, 2.0].map(|ratio| stated_covariance(&normal_matrix, ratio));
        // 1e8 standard deviations' worth of data leave one part in 1e8 to the population.
        assert!((doubted[(0, 0)] / trusted[(0, 0)] - 4.0).abs() < 1e-6);
        assert!((doubted[(1, 1)] - 1.0).abs() < 1e-12 && (trusted[(1, 1)] - 1.0).abs() < 1e-12);
    }
}
