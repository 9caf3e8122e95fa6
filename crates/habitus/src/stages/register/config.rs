//! Settings of the stage; the paper's numbers are the defaults of [`PaperConfig`].

use serde::{Deserialize, Serialize};

use crate::fitting::gaps::GapRules;
use crate::fitting::model_fit::ModelFitConfig;

/// How a template is brought onto a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RegisterRecipe {
    /// Model fit by Gauss–Newton, then displacements along the normals under falling stiffness.
    #[default]
    Default,
    /// P1 §3.1–3.2: landmarks, model fit, then per-vertex affines with Eq. 4–7.
    Paper,
}

/// Unit of the scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScanUnit {
    /// Guess from the stature.
    #[default]
    Auto,
    /// Metres.
    M,
    /// Centimetres.
    Cm,
    /// Millimetres.
    Mm,
}

/// Up axis of the scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScanUp {
    /// Decide from the scan.
    #[default]
    Auto,
    /// +x.
    X,
    /// +y.
    Y,
    /// +z.
    Z,
}

/// Settings of the whole stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegisterConfig {
    /// The recipe.
    pub recipe: RegisterRecipe,
    /// Unit of the scans.
    pub unit: ScanUnit,
    /// Up axis of the scans.
    pub up: ScanUp,
    /// Seed of held-out points and of the subsampled scan.
    pub seed: u64,
    /// Connected pieces of the scan with less than this share of its area are dropped.
    pub smallest_piece_share: f64,
    /// Share of the scan's points that the fit never sees, to measure with.
    pub held_out_share: f64,
    /// Fit of a body model, if there is one.
    pub model: ModelFitConfig,
    /// Landmarks alone, before any surface.
    pub landmark_start: LandmarkStartConfig,
    /// The default recipe's last part.
    pub displacements: DisplacementConfig,
    /// The recipe `paper`; without a body model also the default recipe's first part.
    pub paper: PaperConfig,
    /// When a registration must not be used unseen.
    pub codes: RegisterThresholds,
}

impl Default for RegisterConfig {
    fn default() -> Self {
        Self {
            recipe: RegisterRecipe::Default,
            unit: ScanUnit::Auto,
            up: ScanUp::Auto,
            seed: 1,
            smallest_piece_share: 0.002,
            held_out_share: 0.05,
            model: ModelFitConfig::default(),
            landmark_start: LandmarkStartConfig::default(),
            displacements: DisplacementConfig::default(),
            paper: PaperConfig::default(),
            codes: RegisterThresholds::default(),
        }
    }
}

/// Landmarks alone, before any surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LandmarkStartConfig {
    /// A rigid start needs at least this many.
    pub fewest: usize,
    /// Gauss–Newton steps of the pose.
    pub iterations: usize,
    /// Identity components that are free; P1 §3.2 fits the pose alone.
    pub components: usize,
    /// Levels of the model fit that decide which way a person without landmarks faces.
    pub deciding_levels: usize,
}

impl Default for LandmarkStartConfig {
    fn default() -> Self {
        Self { fewest: 4, iterations: 15, components: 3, deciding_levels: 2 }
    }
}

/// Displacements of the vertices: Σ w (n·x − n·q)² + stiffness Σ_edges ‖d_i − d_j‖², d the displacement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DisplacementConfig {
    /// Stiffness of an edge in each round, relative to one vertex's data.
    pub stiffness: Vec<f64>,
    /// How much stiffer edges between hand vertices are: fingers are thin and badly scanned.
    pub hand_stiffness: f64,
    /// Pull to the start in each vertex, relative to its data; holds what no data reaches.
    pub anchor: f64,
    /// Weight of the gaps from vertices to the scan; those from the scan to the surface have the rest of one.
    pub vertex_share: f64,
    /// Points of the scan that are used in each round at most.
    pub sample_count: usize,
    /// Which pairs count, and how much, in the first round.
    pub first_pairs: GapRules,
    /// The same in the last round; geometric in between.
    pub last_pairs: GapRules,
    /// Rounds that stiffen the surroundings of folded faces at most.
    pub unfolding_rounds: usize,
    /// How much stiffer they become in each.
    pub unfolding_factor: f64,
    /// Rounds that draw what is still folded to the middle of its neighbours, before and after, at most.
    pub relaxation_rounds: usize,
}

impl Default for DisplacementConfig {
    fn default() -> Self {
        Self {
            stiffness: vec![100.0, 30.0, 10.0, 3.0, 1.0, 0.5],
            hand_stiffness: 10.0,
            anchor: 1e-3,
            vertex_share: 0.3,
            sample_count: 30_000,
            first_pairs: GapRules { distance_mm: 30.0, angle_deg: 60.0, robust_mm: 15.0 },
            last_pairs: GapRules { distance_mm: 15.0, angle_deg: 60.0, robust_mm: 6.0 },
            unfolding_rounds: 4,
            unfolding_factor: 8.0,
            relaxation_rounds: 40,
        }
    }
}

/// How the quadratic energy of a round is minimised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AffineSolver {
    /// Exactly: the axes decouple and share one sparse matrix.
    #[default]
    SparseCholesky,
    /// P1 §3.1: L-BFGS-B.
    Lbfgsb,
}

/// Where the smoothness of affine maps is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AffineOrigin {
    /// At the edge, linear parts over the body's size.
    #[default]
    Edge,
    /// P1 Eq. 5 as printed: 4 × 4 matrices over absolute millimetres; badly conditioned.
    World,
}

/// P1 §3.2: how a scan and the template are brought together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PaperStart {
    /// Pose and shape of a body model (`S-SCAPE + NRD` of P1 §4.3).
    #[default]
    Model,
    /// Rigid alignment of landmarks (`NRD` of P1 §4.3).
    Rigid,
}

/// P1 §3.1 and §4.1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PaperConfig {
    /// How the scan and the template are brought together.
    pub start: PaperStart,
    /// Solver of each round.
    pub solver: AffineSolver,
    /// Where the smoothness is measured.
    pub origin: AffineOrigin,
    /// Iterations of L-BFGS-B in each round.
    pub lbfgsb_iterations: usize,
    /// P1 §3.1: β of the first rounds, over millimetres.
    pub first_smooth_affines: f64,
    /// P1 §3.1: γ of the first rounds, over millimetres.
    pub first_landmarks: f64,
    /// P1 §3.1: factor of β and γ after each round.
    pub relaxation: f64,
    /// P1 §3.1: repeated until β is no larger than this.
    pub last_smooth_affines: f64,
    /// P1 §3.1: largest distance of a pair, millimetres.
    pub distance_mm: f64,
    /// P1 §3.1: largest angle between normals, degrees.
    pub angle_deg: f64,
    /// P1 §4.1: the same for the head, millimetres.
    pub head_distance_mm: f64,
    /// P1 §4.1: the same for the head, degrees.
    pub head_angle_deg: f64,
    /// P1 §4.1: points of the subsampled scan over vertices of the template.
    pub scan_points_per_vertex: f64,
    /// Largest distance of a pair while pose and shape are fitted, millimetres. Deviation: P1 §3.1's 20 mm would leave
    /// arms behind that landmarks alone put farther off.
    pub model_distance_mm: f64,
    /// P1 §3.2: alternations of pose and shape at most.
    pub model_rounds: usize,
    /// P1 §3.2: "until E does not change significantly", relative.
    pub model_tolerance: f64,
}

impl Default for PaperConfig {
    fn default() -> Self {
        Self {
            start: PaperStart::Model,
            solver: AffineSolver::SparseCholesky,
            origin: AffineOrigin::Edge,
            lbfgsb_iterations: 100,
            first_smooth_affines: 1e6,
            first_landmarks: 1e-3,
            relaxation: 0.25,
            last_smooth_affines: 1e3,
            distance_mm: 20.0,
            angle_deg: 60.0,
            head_distance_mm: 50.0,
            head_angle_deg: 30.0,
            scan_points_per_vertex: 3.0,
            model_distance_mm: 100.0,
            model_rounds: 25,
            model_tolerance: 0.002,
        }
    }
}

impl PaperConfig {
    /// P1 §3.1: weights of smoothness and landmarks round by round: once without data, then with data, relaxed after each.
    pub fn schedule(&self) -> Vec<PaperRound> {
        let mut rounds = vec![PaperRound {
            closest_points: 0.0,
            smooth_affines: self.first_smooth_affines,
            landmarks: self.first_landmarks,
        }];
        let (mut smooth_affines, mut landmarks) = (self.first_smooth_affines, self.first_landmarks);
        loop {
            rounds.push(PaperRound { closest_points: 1.0, smooth_affines, landmarks });
            let is_last =
                smooth_affines <= self.last_smooth_affines || !(0.0..1.0).contains(&self.relaxation);
            if is_last {
                return rounds;
            }
            smooth_affines *= self.relaxation;
            landmarks *= self.relaxation;
        }
    }
}

/// P1 Eq. 7: weights of one round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperRound {
    /// α.
    pub closest_points: f64,
    /// β.
    pub smooth_affines: f64,
    /// γ.
    pub landmarks: f64,
}

/// When a registration must not be used unseen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RegisterThresholds {
    /// Points of the scan farther than this from the surface are not explained, millimetres.
    pub unexplained_mm: f64,
    /// Largest share of them.
    pub largest_unexplained_share: f64,
    /// Smallest share of vertices that the scan covers.
    pub smallest_covered_share: f64,
    /// Largest number of folded faces.
    pub most_flipped_faces: usize,
    /// Edges are stretched beyond what a body does: smallest and largest ratio of the percentiles.
    pub edge_ratio: [f64; 2],
    /// Largest mean distance of landmarks, millimetres.
    pub landmark_mm: f64,
    /// Smallest energy of the second facing over that of the first.
    pub smallest_margin: f64,
}

impl Default for RegisterThresholds {
    fn default() -> Self {
        Self {
            unexplained_mm: 15.0,
            largest_unexplained_share: 0.01,
            smallest_covered_share: 0.5,
            most_flipped_faces: 20,
            edge_ratio: [0.5, 2.0],
            landmark_mm: 25.0,
            smallest_margin: 1.15,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_s_schedule_relaxes_by_a_quarter_until_a_thousand() {
        let rounds = PaperConfig::default().schedule();
        let smooth: Vec<f64> = rounds.iter().map(|round| round.smooth_affines).collect();
        assert_eq!(smooth, [1e6, 1e6, 250_000.0, 62_500.0, 15_625.0, 3_906.25, 976.5625]);
        let data: Vec<f64> = rounds.iter().map(|round| round.closest_points).collect();
        assert_eq!(data, [0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        assert!((rounds[6].landmarks - 1e-3 * 0.25_f64.powi(5)).abs() < 1e-18);
    }

    #[test]
    fn constant_weights_are_a_schedule_of_two() {
        let config = PaperConfig { relaxation: 1.0, ..PaperConfig::default() };
        assert_eq!(config.schedule().len(), 2);
    }
}
