//! Settings of `synthesize`.

use serde::{Deserialize, Serialize};

/// How clothing leaves the body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PushOutConfig {
    /// Rounds of closest points and one solve; 0 leaves the clothing where it is and does not look at what is inside.
    pub rounds: usize,
    /// Distance above the body that inside vertices are moved to, metres.
    pub clearance: f64,
    /// Tries for a vertex that the smooth displacement has left inside; each stays half as far from the surface.
    pub halvings: i32,
    /// Tries for edges and faces whose middles are inside.
    pub lifts: usize,
    /// Tries after which such a middle is lifted half as far beyond the surface as at first.
    pub patient_lifts: usize,
    /// Depth from which on neighbours must leave a limb on the same side, metres; halved with each round.
    pub divided_depth: f64,
    /// Stretch of an edge by the ways out of its ends above which these lead to different sides.
    pub torn_stretch: f64,
    /// Directions that are tried for clothing whose nearest ways out lead to opposite sides.
    pub directions: usize,
    /// Longest way, in all, that a vertex is lifted for the middles of its edges and faces, metres.
    pub longest_lift: f64,
    /// Radius of the narrowest part of the body that may poke through between the corners of a face, metres: what is farther
    /// from the body than such a part can reach is not looked at.
    pub smallest_radius: f64,
    /// Weight of an inside vertex's way out against the smoothness of the displacement along one edge.
    pub contact_weight: f64,
    /// Weight of no displacement at all against the smoothness: how far from the contact the clothing yields.
    pub rest_weight: f64,
    /// Displacements below this are not made, metres.
    pub least_displacement: f64,
    /// Accuracy of the conjugate gradients relative to their start.
    pub solver_accuracy: f64,
    /// Steps of the conjugate gradients at most.
    pub solver_steps: usize,
}

impl Default for PushOutConfig {
    fn default() -> Self {
        Self {
            rounds: 5,
            clearance: 0.003,
            halvings: 10,
            lifts: 600,
            patient_lifts: 15,
            divided_depth: 0.016,
            torn_stretch: 1.8,
            directions: 16,
            longest_lift: 2.0,
            smallest_radius: 0.01,
            contact_weight: 20.0,
            rest_weight: 0.05,
            least_displacement: 1e-4,
            solver_accuracy: 1e-1,
            solver_steps: 30,
        }
    }
}

/// Settings of the stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SynthesizeConfig {
    /// How clothing leaves the body.
    pub push_out: PushOutConfig,
}
