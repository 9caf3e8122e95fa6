//! Settings of `synthesize`.

use serde::{Deserialize, Serialize};

/// How clothing leaves the body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PushOutConfig {
    /// Rounds of closest points and one solve; 0 leaves the clothing where it is.
    pub rounds: usize,
    /// Distance above the body that inside vertices are moved to, metres.
    pub clearance: f64,
    /// Depth that the last round leaves nowhere, metres: what is deeper is set onto the body alone.
    pub deepest: f64,
    /// Weight of an inside vertex's way out against the smoothness of the displacement along one edge.
    pub contact_weight: f64,
    /// Weight of no displacement at all against the smoothness: how far from the contact the clothing yields.
    pub rest_weight: f64,
    /// Steps of the conjugate gradients at most.
    pub solver_steps: usize,
}

impl Default for PushOutConfig {
    fn default() -> Self {
        Self {
            rounds: 3,
            clearance: 0.0015,
            deepest: 0.001,
            contact_weight: 20.0,
            rest_weight: 0.05,
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
