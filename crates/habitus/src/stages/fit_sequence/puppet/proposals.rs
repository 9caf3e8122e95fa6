//! New guesses for a part: a random walk, a neighbour's word, and a step towards the capture.

use glam::{DMat3, DQuat, DVec3};
use habitus_geometry::best_rotation;

use super::model::Puppet;
use super::particles::{Evidence, Particle};
use super::parts::{COEFFICIENTS, PartState, SHAPE_COMPONENTS};
use crate::statistics::RandomStream;

/// How far guesses walk: shrinks over the steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walk {
    /// Radians.
    pub turn: f64,
    /// Metres.
    pub shift: f64,
    /// Standard deviations of the coefficients.
    pub coefficients: f64,
}

impl Walk {
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            turn: self.turn * factor,
            shift: self.shift * factor,
            coefficients: self.coefficients * factor,
        }
    }
}

fn random_vector(random: &mut RandomStream) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal())
}

/// A Gaussian step about the middle of the part rather than about its joint, so that a turn does not fling it away.
pub(super) fn walked(state: &PartState, middle: DVec3, walk: Walk, random: &mut RandomStream) -> PartState {
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(random_vector(random) * walk.turn));
    // About the joint as often as about the middle: a limb swings, and a torso turns.
    let pivot = if random.unit() < 0.5 { state.joint } else { middle };
    let mut coefficients = state.coefficients;
    for value in &mut coefficients {
        *value += walk.coefficients * random.normal();
    }
    PartState {
        rotation: turn * state.rotation,
        joint: pivot + turn * (state.joint - pivot) + random_vector(random) * walk.shift,
        coefficients,
    }
}

/// Where a neighbour's guess expects the part. The turn between them is that of a learning body or, if `own` is given,
/// stays as the part has it; the shape goes with the neighbour's.
pub(super) fn expected_beside(
    puppet: &Puppet,
    (part, neighbour): (usize, usize),
    of_neighbour: &Particle,
    own: Option<&PartState>,
    walk: Walk,
    random: &mut RandomStream,
) -> Option<PartState> {
    let is_child = puppet.parts[part].layout.parent == Some(neighbour);
    let child = if is_child { part } else { neighbour };
    let stitch = puppet.stitches[child].as_ref()?;
    let example = &puppet.examples[random.below(puppet.examples.len())];
    let (rotation, mut coefficients) = match own {
        Some(own) => (own.rotation, own.coefficients),
        None => {
            let between = example[neighbour].rotation.transpose() * example[part].rotation;
            (of_neighbour.state.rotation * between, example[part].coefficients)
        }
    };
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(random_vector(random) * walk.turn * 0.3));
    let rotation = turn * rotation;
    let shape = stitch.expected_shape(&of_neighbour.state.coefficients[..SHAPE_COMPONENTS], is_child);
    for (value, expected) in coefficients.iter_mut().zip(shape) {
        *value = expected + walk.coefficients * random.normal();
    }
    // The points of the interface come together in the mean.
    let layout = &puppet.parts[child].layout;
    let (own_slots, other_slots) = if is_child {
        (&layout.parent_slots, &layout.child_slots)
    } else {
        (&layout.child_slots, &layout.parent_slots)
    };
    let mut state = PartState { rotation, joint: DVec3::ZERO, coefficients };
    let points = puppet.parts[part].points(&state);
    let offset: DVec3 = own_slots
        .iter()
        .zip(other_slots)
        .map(|(own, other)| of_neighbour.points[*other] - points[*own])
        .sum();
    state.joint = offset / own_slots.len().max(1) as f64;
    Some(state)
}

/// The same limbs seen from behind: every part takes the place of the part on its other side, reflected forwards to
/// backwards, so that the body stays where it is and faces the other way.
pub(super) fn facing_twin(puppet: &Puppet, states: &[PartState]) -> Vec<PartState> {
    let sideways = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
    let forward = (states[0].rotation * DVec3::Z * DVec3::new(1.0, 0.0, 1.0)).normalize_or(DVec3::Z);
    let middle = states.iter().map(|state| state.joint).sum::<DVec3>() / states.len().max(1) as f64;
    let reflected = |vector: DVec3| vector - forward * (2.0 * vector.dot(forward));
    (0..states.len())
        .map(|part| {
            let other = &states[puppet.mirror_parts[part]];
            let turned = other.rotation * sideways;
            PartState {
                rotation: DMat3::from_cols(
                    reflected(turned.x_axis),
                    reflected(turned.y_axis),
                    reflected(turned.z_axis),
                ),
                joint: middle + reflected(other.joint - middle),
                // Coefficients of the two sides are not the same ones.
                coefficients: [0.0; COEFFICIENTS],
            }
        })
        .collect()
}

/// Pulls a guess onto the capture and onto its neighbours' `anchors` (slot and position): the best rigid motion of
/// weighted pairs, and for the coefficients one damped step of least squares.
pub(super) fn pulled(
    puppet: &Puppet,
    part: usize,
    guess: &PartState,
    evidence: &Evidence<'_>,
    anchors: &[(usize, DVec3)],
    anchor_weight: f64,
) -> PartState {
    let model = &puppet.parts[part];
    let mut pairs: Vec<(usize, DVec3, f64)> = Vec::with_capacity(model.layout.data_count + anchors.len());
    let points = model.points(guess);
    for (slot, point) in points.iter().enumerate().take(model.layout.data_count) {
        let nearby = evidence.grid.at(*point);
        let normal = guess.rotation * model.normals[slot];
        if normal.dot(nearby.normal) > 0.0 {
            pairs.push((slot, nearby.target, evidence.judge(&nearby, normal, model.is_bare[slot]).0));
        }
    }
    let data_weight: f64 = pairs.iter().map(|pair| pair.2).sum();
    let each = anchor_weight * data_weight.max(1.0) / anchors.len().max(1) as f64;
    pairs.extend(anchors.iter().map(|(slot, position)| (*slot, *position, each)));
    let total: f64 = pairs.iter().map(|pair| pair.2).sum();
    if total <= 0.0 || pairs.len() < 4 {
        return *guess;
    }
    let local = model.local_points(&guess.coefficients);
    let mean = |of: &dyn Fn(&(usize, DVec3, f64)) -> DVec3| {
        pairs.iter().map(|pair| of(pair) * pair.2).sum::<DVec3>() / total
    };
    let (source, target) = (mean(&|pair| local[pair.0]), mean(&|pair| pair.1));
    let mut covariance = DMat3::ZERO;
    for (slot, position, weight) in &pairs {
        let (from, to) = (local[*slot] - source, (*position - target) * *weight);
        covariance += DMat3::from_cols(to * from.x, to * from.y, to * from.z);
    }
    let rotation = best_rotation(&covariance).unwrap_or(guess.rotation);
    let state = PartState { rotation, joint: target - rotation * source, coefficients: guess.coefficients };
    PartState { coefficients: settled_coefficients(puppet, part, &state, &pairs, evidence), ..state }
}

/// Coordinate by coordinate, the coefficients that bring the paired points nearest, held by their prior.
fn settled_coefficients(
    puppet: &Puppet,
    part: usize,
    state: &PartState,
    pairs: &[(usize, DVec3, f64)],
    evidence: &Evidence<'_>,
) -> [f64; COEFFICIENTS] {
    let model = &puppet.parts[part];
    let unit = evidence.config.independent_points
        / (evidence.config.data_deviation.powi(2) * model.layout.data_count.max(1) as f64);
    let mut coefficients = state.coefficients;
    let mut local = model.local_points(&coefficients);
    let targets: Vec<DVec3> =
        pairs.iter().map(|pair| state.rotation.transpose() * (pair.1 - state.joint)).collect();
    for component in 0..COEFFICIENTS {
        let (mut slope, mut curvature) = (-coefficients[component], 1.0);
        for ((slot, _, weight), target) in pairs.iter().zip(&targets) {
            let direction = model.basis[*slot][component];
            slope += unit * weight * direction.dot(*target - local[*slot]);
            curvature += unit * weight * direction.length_squared();
        }
        let step = slope / curvature;
        coefficients[component] += step;
        for (point, basis) in local.iter_mut().zip(&model.basis) {
            *point += basis[component] * step;
        }
    }
    coefficients
}
