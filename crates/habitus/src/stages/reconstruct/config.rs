//! Settings of `reconstruct`.

use serde::{Deserialize, Serialize};

use crate::fitting::model_fit::ModelFitConfig;

/// Settings of the whole stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReconstructConfig {
    /// Step in depth between neighbouring pixels at which the surface is torn, metres.
    pub largest_step: f64,
    /// Nearest and farthest depth of the person, metres.
    pub depth_range: [f64; 2],
    /// Pixels to each side over which depth is averaged.
    pub smoothing_pixels: usize,
    /// Levels of the model fit that each view passes alone before the identity is shared (P1 §6).
    pub levels_alone: usize,
    /// Fit of the body model.
    pub model: ModelFitConfig,
}

impl Default for ReconstructConfig {
    fn default() -> Self {
        Self {
            largest_step: 0.03,
            depth_range: [0.3, 5.0],
            smoothing_pixels: 2,
            levels_alone: 3,
            model: ModelFitConfig::default(),
        }
    }
}
