//! Settings of `learn_clothing`.

use serde::{Deserialize, Serialize};

use crate::statistics::kernel_ridge::KernelRidgeConfig;
use crate::statistics::network::NetworkConfig;

/// How the layer's motion is learnt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClothingRecipe {
    /// Kernel ridge regression for each part of the body, whose inputs count by how near they are to the part.
    #[default]
    Default,
    /// P3 §3.3 as printed: a network with two hidden layers.
    Paper2018,
}

/// Which frames are set aside to measure the prediction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClothingSplit {
    /// P3 §4.3: frames drawn at random. Their neighbours in time are learnt from, so this measures interpolation.
    #[default]
    Paper,
    /// The last frames of each sequence.
    Block,
}

/// How the vertices count in the components.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VertexWeights {
    /// Each vertex the same, as P3 §3.2.
    #[default]
    Equal,
    /// Each vertex by the area around it.
    Area,
}

/// How much kinds of inputs count in the kernels of the default recipe, each in its own unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelevanceConfig {
    /// Factor for each joint between the part and an input's joint.
    pub closeness: f64,
    /// Of a joint's angular speed against its angle, seconds; the best on left-out blocks is used.
    pub rates: Vec<f64>,
    /// Of the direction up as the pelvis sees it, against an angle in radians.
    pub up: f64,
    /// Of the root's velocity, radians per metre per second.
    pub velocity: f64,
    /// Of the root's angular velocity, seconds.
    pub turn: f64,
    /// Of a control's standard deviation over the sequences, radians.
    pub control: f64,
}

impl Default for RelevanceConfig {
    fn default() -> Self {
        Self { closeness: 0.4, rates: vec![0.0, 0.03, 0.1], up: 0.3, velocity: 0.1, turn: 0.05, control: 1.0 }
    }
}

/// How fitted poses settle on the dressed surface before the layer is learnt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SettleConfig {
    /// Rounds of the median layer and the poses that bring it nearest to the surface; 0 keeps the fitted poses.
    pub rounds: usize,
    /// Gauss–Newton steps of each pose in each round.
    pub steps: usize,
    /// Clothing vertices that are looked at, evenly spread.
    pub vertices: usize,
    /// Distance at which a vertex counts half, metres: folds must not pull a limb.
    pub robust_distance: f64,
    /// Weight of an angle's step against the mean squared distance of the vertices, m²/rad².
    pub damping: f64,
}

impl Default for SettleConfig {
    fn default() -> Self {
        Self { rounds: 3, steps: 2, vertices: 1000, robust_distance: 0.05, damping: 2e-5 }
    }
}

/// Settings of the stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnClothingConfig {
    /// How the layer's motion is learnt.
    pub recipe: ClothingRecipe,
    /// Which frames are set aside.
    pub split: ClothingSplit,
    /// Share of the frames that is set aside. P3 §4.3: 20 %.
    pub test_share: f64,
    /// Share of the frames to learn from that stops the network. P3 §3.3: 20 %.
    pub validation_share: f64,
    /// Components of one sequence. P3 §4.2: 40.
    pub components: usize,
    /// Components of several sequences. P3 §4.2: 100.
    pub components_of_several: usize,
    /// How the vertices count in the components.
    pub vertex_weights: VertexWeights,
    /// How fitted poses settle on the surface.
    pub settle: SettleConfig,
    /// The network of `paper2018`.
    pub network: NetworkConfig,
    /// The kernels of `default`.
    pub kernels: KernelRidgeConfig,
    /// How much kinds of inputs count in the kernels.
    pub relevance: RelevanceConfig,
    /// Components of fabric tables. P3 §5.2: 4.
    pub fabric_components: usize,
    /// Deviation of the noise on the controls of the frames that the network learns from, in deviations of each control
    /// over the sequences. P3 §5.2 and 5.3 add Gaussian noise and do not say how much.
    pub control_noise: f64,
    /// Seed of splits, noise and the networks' first weights.
    pub seed: u64,
}

impl Default for LearnClothingConfig {
    fn default() -> Self {
        Self {
            recipe: ClothingRecipe::default(),
            split: ClothingSplit::default(),
            test_share: 0.2,
            validation_share: 0.2,
            components: 40,
            components_of_several: 100,
            vertex_weights: VertexWeights::default(),
            settle: SettleConfig::default(),
            network: NetworkConfig::default(),
            kernels: KernelRidgeConfig::default(),
            relevance: RelevanceConfig::default(),
            fabric_components: 4,
            control_noise: 0.2,
            seed: 1,
        }
    }
}
