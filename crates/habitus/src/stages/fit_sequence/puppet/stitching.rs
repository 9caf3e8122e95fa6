//! What it costs to tear neighbouring parts apart or to turn them beyond their joint.

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{DMatrix, Matrix3};

use super::model::mean_and_covariance;
use super::parts::{Part, PartState, SHAPE_COMPONENTS};
use crate::body::rotation_vector;

/// Independent distances among the points of an interface: neighbours are torn apart together.
const INDEPENDENT_DISTANCES: f64 = 4.0;
/// Tearing that counts as none: below what a capture can show.
const LEAST_DEVIATION: f64 = 0.003;
/// Added to what a joint's turns vary by, in radians, so that a hinge is not infinitely stiff across its axis.
const LEAST_TURN: f64 = 0.12;
/// Mahalanobis distance, squared, up to which a turn costs nothing: the learning bodies reach about as far.
const FREE_TURN: f64 = 6.0;
/// Cost of tearing beyond which the joint is not looked at.
const HOPELESS: f64 = 80.0;
/// Share of the correlation of neighbouring shapes that is relied on; at one a part would follow its neighbour rigidly.
const SHAPE_RELIANCE: f64 = 0.9;

/// How a part hangs on its parent.
#[derive(Clone, Debug)]
pub(super) struct Stitch {
    /// Variance of the distance of each interface point in a real body, in square metres along one axis.
    variances: Vec<f64>,
    /// Rotation vector of the part relative to its parent: mean and inverse covariance.
    turn_mean: DVec3,
    turn_precision: Matrix3<f64>,
    /// Mean shape coefficients of the part for those of the parent.
    pub shape_from_parent: DMatrix<f64>,
}

/// Interface points of one particle for one stitch, and its rotation.
pub(super) struct Seam {
    pub points: Vec<DVec3>,
    pub rotation: DQuat,
}

impl Stitch {
    pub fn learn(parts: &[Part], part: usize, parent: usize, examples: &[Vec<PartState>]) -> Self {
        let layout = &parts[part].layout;
        let mut variances = vec![LEAST_DEVIATION * LEAST_DEVIATION; layout.parent_slots.len()];
        let mut turns = Vec::with_capacity(examples.len());
        for states in examples {
            let own = parts[part].points(&states[part]);
            let other = parts[parent].points(&states[parent]);
            for ((variance, a), b) in variances.iter_mut().zip(&layout.parent_slots).zip(&layout.child_slots)
            {
                *variance += own[*a].distance_squared(other[*b]) / (3 * examples.len()) as f64;
            }
            turns.push(relative_turn(
                DQuat::from_mat3(&states[part].rotation),
                DQuat::from_mat3(&states[parent].rotation),
            ));
        }
        let (turn_mean, mut covariance) = mean_and_covariance(&turns);
        for axis in 0..3 {
            covariance[(axis, axis)] += LEAST_TURN * LEAST_TURN;
        }
        let shape_from_parent = &parts[part].shape_of_identity * parts[parent].shape_of_identity.transpose();
        Self {
            variances,
            turn_mean,
            turn_precision: covariance.try_inverse().unwrap_or_else(Matrix3::identity),
            shape_from_parent: shape_from_parent * SHAPE_RELIANCE,
        }
    }

    /// Negative logarithm of how likely a real body's parts are this far apart and turned like this; `looseness`
    /// (metres) is added to the learnt deviations.
    pub fn cost(&self, own: &Seam, parent: &Seam, looseness: f64) -> f64 {
        let mut torn = 0.0;
        for ((a, b), variance) in own.points.iter().zip(&parent.points).zip(&self.variances) {
            torn += a.distance_squared(*b) / (variance + looseness * looseness);
        }
        let torn = 0.5 * INDEPENDENT_DISTANCES * torn / self.variances.len().max(1) as f64;
        // Parts so far apart are no neighbours, however they are turned.
        if torn > HOPELESS { torn } else { torn + self.turn_cost(own.rotation, parent.rotation) }
    }

    fn turn_cost(&self, own: DQuat, parent: DQuat) -> f64 {
        let offset = relative_turn(own, parent) - self.turn_mean;
        let offset = nalgebra::Vector3::from(offset.to_array());
        0.5 * ((self.turn_precision * offset).dot(&offset) - FREE_TURN).max(0.0)
    }

    /// Shape coefficients that a part is expected to have beside its parent's, or a parent beside its part's.
    pub fn expected_shape(&self, known: &[f64], of_parent: bool) -> [f64; SHAPE_COMPONENTS] {
        std::array::from_fn(|row| {
            (0..SHAPE_COMPONENTS)
                .map(|column| {
                    let place = if of_parent { (column, row) } else { (row, column) };
                    self.shape_from_parent[place] * known[column]
                })
                .sum()
        })
    }
}

fn relative_turn(own: DQuat, parent: DQuat) -> DVec3 {
    rotation_vector(parent.inverse() * own)
}

/// The seam of a particle towards its parent.
pub(super) fn seam_to_parent(part: &Part, points: &[DVec3], rotation: &DMat3) -> Seam {
    let points = part.layout.parent_slots.iter().map(|slot| points[*slot]).collect();
    Seam { points, rotation: DQuat::from_mat3(rotation) }
}

/// The seam of a parent's particle towards one child.
pub(super) fn seam_to_child(child: &Part, points: &[DVec3], rotation: &DMat3) -> Seam {
    let points = child.layout.child_slots.iter().map(|slot| points[*slot]).collect();
    Seam { points, rotation: DQuat::from_mat3(rotation) }
}
