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

/// How much kinds of inputs count in the kernels of the default recipe, each in its own unit. Of each list that value is used
/// which is best on left-out blocks of the frames that are learnt from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelevanceConfig {
    /// Factors for each joint between the part and an input's joint.
    pub closeness: Vec<f64>,
    /// Of a joint's angular speed against its angle, seconds.
    pub rates: Vec<f64>,
    /// Of the direction up as the pelvis sees it, against an angle in radians.
    pub up: Vec<f64>,
    /// Of the root's velocity, radians per metre per second.
    pub velocity: Vec<f64>,
    /// Of the root's angular velocity, seconds.
    pub turn: Vec<f64>,
    /// Of a control's standard deviation over the sequences, radians; it counts only where `kernels.controls` is empty.
    pub control: f64,
}

impl Default for RelevanceConfig {
    fn default() -> Self {
        Self {
            closeness: vec![1.0, 0.7, 0.5, 0.3],
            rates: vec![0.0, 0.03, 0.1],
            up: vec![1.0, 0.3, 0.1],
            velocity: vec![0.0, 0.1, 0.3],
            turn: vec![0.0, 0.05, 0.15],
            control: 1.0,
        }
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
