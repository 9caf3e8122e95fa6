//! Settings of `fit_sequence`. Lengths are metres, angles radians unless a suffix says otherwise.

use serde::{Deserialize, Serialize};

pub use crate::artifacts::fitted_sequence::StartMethod;
use crate::fitting::correspondence::CompatibilityRules;
use crate::fitting::local_shapes::LocalShapeConfig;
use crate::fitting::schedule::RoundSchedule;

/// Which recipe fits the sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Recipe {
    /// One-sided robust Gauss–Newton tracking and a joint refinement of identity and poses.
    #[default]
    Default,
    /// P2 §4 as printed, with L-BFGS-B.
    Paper2016,
}

/// The unit of the input's coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UnitChoice {
    /// Guess from the person's stature.
    #[default]
    Auto,
    /// Metres.
    M,
    /// Centimetres.
    Cm,
    /// Millimetres.
    Mm,
}

/// The axis of the input that points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UpChoice {
    /// Decide from the capture.
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
pub struct FitSequenceConfig {
    /// The recipe.
    pub recipe: Recipe,
    /// Unit of the input.
    pub unit: UnitChoice,
    /// Up axis of the input.
    pub up: UpChoice,
    /// Identity components that are fitted; a model with fewer uses all it has.
    pub components: usize,
    /// Cleaning of each frame.
    pub frame: FrameConfig,
    /// The search for the first pose.
    pub start: StartConfig,
    /// The part-based puppet: another start, and the search's second opinion.
    pub puppet: PuppetConfig,
    /// The one-sided surface energy of the default recipe.
    pub surface: SurfaceConfig,
    /// Pose tracking of the default recipe.
    pub track: TrackConfig,
    /// Joint refinement of the default recipe.
    pub refine: RefineConfig,
    /// The paper's recipe.
    pub paper2016: Paper2016Config,
    /// When codes fire.
    pub codes: CodeThresholds,
    /// Seed of the surface samples.
    pub seed: u64,
}

impl Default for FitSequenceConfig {
    fn default() -> Self {
        Self {
            recipe: Recipe::Default,
            unit: UnitChoice::Auto,
            up: UpChoice::Auto,
            components: 100,
            frame: FrameConfig::default(),
            start: StartConfig::default(),
            puppet: PuppetConfig::default(),
            surface: SurfaceConfig::default(),
            track: TrackConfig::default(),
            refine: RefineConfig::default(),
            paper2016: Paper2016Config::default(),
            codes: CodeThresholds::default(),
            seed: 1,
        }
    }
}

/// Cleaning of each frame before it is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FrameConfig {
    /// Connected pieces with a smaller share of the surface area are dropped.
    pub smallest_component_share: f64,
    /// Points sampled on the capture for the capture-to-body direction.
    pub sample_count: usize,
    /// Neighbours for the normals of clouds that have none.
    pub normal_neighbours: usize,
    /// Triangles or points, over all captures, that stay in memory for the next pass; about 250 bytes each.
    pub kept_primitives: usize,
}

impl Default for FrameConfig {
    fn default() -> Self {
        Self {
            smallest_component_share: 0.02,
            sample_count: 1200,
            normal_neighbours: 12,
            kept_primitives: 4_000_000,
        }
    }
}

/// The part-based puppet (P2 §4.2, after Zuffi and Black 2015). Costs are negative logarithms of probabilities.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PuppetConfig {
    /// Particles of each part on the first frame. P2 §5: 60.
    pub first_particles: usize,
    /// Particles of each part on later frames. P2 §5: 30.
    pub later_particles: usize,
    /// Particles that are selected together; more particles are more such sets.
    pub set_size: usize,
    /// Guesses for each particle that the first selection is made of.
    pub first_factor: usize,
    /// Steps on the first frame. Zuffi and Black 2015: 60.
    pub first_steps: usize,
    /// Steps on later frames.
    pub later_steps: usize,
    /// Bodies of the model from which parts and stitches are learnt.
    pub learning_bodies: usize,
    /// Vertices of a part that are compared with the capture.
    pub points_per_part: usize,
    /// Added to the learnt deviation of interface points in the first and in the last step, metres.
    pub looseness: [f64; 2],
    /// First random steps of a guess: radians, metres, standard deviations of the coefficients.
    pub walk: [f64; 3],
    /// Length of the last random steps relative to the first.
    pub last_walk: f64,
    /// Moves towards the capture that a guess makes, if it makes any.
    pub pulls: usize,
    /// Standard deviation of the distance to the capture where it is skin, metres.
    pub data_deviation: f64,
    /// Independent distances in a part: neighbours err together.
    pub independent_points: f64,
    /// Weight of a vertex outside the capture.
    pub outside_weight: f64,
    /// Geman–McClure scale of vertices outside, metres.
    pub outside_scale: f64,
    /// Weight of a covered vertex inside the capture.
    pub inside_weight: f64,
    /// Geman–McClure scale of covered vertices inside, metres.
    pub inside_scale: f64,
    /// Weight of bare vertices (head, hands, feet) inside.
    pub bare_weight: f64,
    /// Geman–McClure scale of bare vertices, metres.
    pub bare_scale: f64,
    /// Cost of a normal opposite to the capture's.
    pub normal_weight: f64,
    /// Largest coefficient of a part, standard deviations. P2 §4.1 allows 3 for the whole body.
    pub coefficient_limit: f64,
    /// Different bodies that are handed on at most.
    pub starts: usize,
    /// Bodies are different if a joint is farther away than this, metres.
    pub difference: f64,
}

impl Default for PuppetConfig {
    fn default() -> Self {
        Self {
            first_particles: 60,
            later_particles: 30,
            set_size: 30,
            first_factor: 8,
            first_steps: 60,
            later_steps: 30,
            learning_bodies: 120,
            points_per_part: 40,
            looseness: [0.06, 0.01],
            walk: [0.3, 0.05, 0.5],
            last_walk: 0.1,
            pulls: 2,
            data_deviation: 0.02,
            independent_points: 8.0,
            outside_weight: 1.0,
            outside_scale: 0.12,
            inside_weight: 0.15,
            inside_scale: 0.06,
            bare_weight: 1.0,
            bare_scale: 0.08,
            normal_weight: 1.5,
            coefficient_limit: 3.0,
            starts: 4,
            difference: 0.15,
        }
    }
}

/// The search for the first pose: hypotheses that are fitted coarsely and halved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StartConfig {
    /// What finds the first pose.
    pub method: StartMethod,
    /// The puppet gives a second opinion on the search if the second start comes within this ratio of the best energy,
    /// such as 1.08; 0: never.
    pub second_opinion_ratio: f64,
    /// Headings tried around the vertical.
    pub yaw_count: usize,
    /// Body vertices in the coarse fits.
    pub coarse_vertex_count: usize,
    /// Capture samples in the coarse fits.
    pub coarse_sample_count: usize,
    /// Identity components free during the search.
    pub component_count: usize,
    /// Hypotheses kept after each halving, with the Gauss–Newton steps that precede it.
    pub halvings: Vec<Halving>,
    /// Geman–McClure scale of the first and of the last steps.
    pub robust_scale: [f64; 2],
    /// Stiffness that keeps angles near the hypothesis, per vertex.
    pub pose_stiffness: f64,
    /// Stiffness of the population prior on the identity, per vertex.
    pub identity_stiffness: f64,
    /// Frames over which rivals of the first frame are tracked before one is chosen.
    pub trial_frames: usize,
    /// A rival within this ratio of the best energy is tracked too.
    pub rival_ratio: f64,
}

/// One halving of the search.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Halving {
    /// Gauss–Newton steps of each hypothesis.
    pub steps: usize,
    /// Hypotheses kept afterwards.
    pub keep: usize,
}

impl Default for StartConfig {
    fn default() -> Self {
        Self {
            method: StartMethod::Search,
            second_opinion_ratio: 0.0,
            yaw_count: 12,
            coarse_vertex_count: 320,
            coarse_sample_count: 320,
            component_count: 6,
            halvings: vec![
                Halving { steps: 0, keep: 80 },
                Halving { steps: 4, keep: 32 },
                Halving { steps: 5, keep: 14 },
                Halving { steps: 8, keep: 6 },
                Halving { steps: 15, keep: 4 },
            ],
            robust_scale: [0.25, 0.06],
            pose_stiffness: 1e-4,
            identity_stiffness: 2e-6,
            trial_frames: 5,
            rival_ratio: 1.35,
        }
    }
}

/// The one-sided energy: outside the capture is quadratic, inside weak and robust, bare parts two-sided.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceConfig {
    /// Which pairs count. P2 §4.3: 200 mm and 60°.
    pub compatibility: CompatibilityRules,
    /// Weight of a vertex outside the capture.
    pub outside_weight: f64,
    /// The same for hands: they are captured as fists or mittens, which spread fingers must not leave; nothing else is
    /// made thin by it.
    pub hand_outside_weight: f64,
    /// How far outside a vertex may lie before it counts as outside: the capture's own noise.
    pub outside_tolerance: f64,
    /// Weight of a vertex inside, before the robust kernel.
    pub inside_weight: f64,
    /// Geman–McClure scale of vertices inside.
    pub inside_scale: f64,
    /// Geman–McClure scale of vertices outside; far larger than any real protrusion.
    pub outside_scale: f64,
    /// Weight of bare parts (head, hands, feet) inside: they are drawn to the capture firmly.
    pub bare_weight: f64,
    /// Geman–McClure scale of bare parts.
    pub bare_scale: f64,
    /// Weight of capture samples whose nearest vertex is bare: they draw toes, crown and fingers out to the end of the
    /// capture, which the vertices' own closest points, on sole and instep, do not.
    pub bare_capture_weight: f64,
    /// How far above the lowest point of the capture its samples draw feet that are away from them: below any hem.
    pub sole_height: f64,
    /// Weight of these samples.
    pub sole_weight: f64,
    /// Their Geman–McClure scale.
    pub sole_scale: f64,
}

impl Default for SurfaceConfig {
    fn default() -> Self {
        Self {
            compatibility: CompatibilityRules::default(),
            outside_weight: 8.0,
            hand_outside_weight: 60.0,
            outside_tolerance: 0.002,
            inside_weight: 0.1,
            inside_scale: 0.03,
            outside_scale: 0.12,
            bare_weight: 1.0,
            bare_scale: 0.06,
            bare_capture_weight: 1.0,
            sole_height: 0.04,
            sole_weight: 4.0,
            sole_scale: 0.15,
        }
    }
}

/// Pose tracking of the default recipe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackConfig {
    /// Body vertices of the first rounds.
    pub coarse_vertex_count: usize,
    /// Correspondence rounds on the coarse vertices.
    pub coarse_rounds: usize,
    /// Correspondence rounds on the vertices of the refinement.
    pub fine_rounds: usize,
    /// Gauss–Newton steps in each round.
    pub steps_per_round: usize,
    /// Weight of the capture-to-body direction, relative to the body-to-capture direction.
    pub capture_weight: f64,
    /// Geman–McClure scale of the capture-to-body direction in the first and in the last coarse round: wide at first,
    /// so that a foot that has stayed behind is fetched, then narrow, so that a skirt does not pull the legs apart.
    pub capture_scale: [f64; 2],
    /// Stiffness that keeps angles near the prediction, per vertex and squared radian.
    pub prediction_stiffness: f64,
    /// Stiffness that keeps angles near the rest pose, per vertex and squared radian.
    pub rest_stiffness: f64,
    /// Share of the last frame's motion that the prediction continues.
    pub velocity: f64,
    /// A frame whose joints, where its neighbours in time expect them, are farther than this from where they were tracked is
    /// tracked again from that side.
    pub second_look_distance: f64,
    /// What the second difference in time of the joint that has the largest costs when two ways through the frames are
    /// compared, per square metre, beside the energies.
    pub unevenness_weight: f64,
    /// A joint that polishing a found pose moves farther than this, metres, has been thrown, and the pose stays.
    pub farthest_polish: f64,
}

impl TrackConfig {
    /// The capture-to-body scale of a round, shrinking geometrically.
    pub fn capture_scale(&self, round: usize, rounds: usize) -> f64 {
        geometric(self.capture_scale, round, rounds)
    }
}

/// Between a first and a last value, geometrically, at step `index` of `count`.
fn geometric([first, last]: [f64; 2], index: usize, count: usize) -> f64 {
    first * (last / first).powf(index as f64 / count.saturating_sub(1).max(1) as f64)
}

impl Default for TrackConfig {
    fn default() -> Self {
        Self {
            coarse_vertex_count: 700,
            coarse_rounds: 5,
            fine_rounds: 2,
            steps_per_round: 1,
            capture_weight: 0.15,
            capture_scale: [0.15, 0.05],
            prediction_stiffness: 2e-5,
            rest_stiffness: 2e-6,
            velocity: 1.0,
            second_look_distance: 0.05,
            unevenness_weight: 1e-2,
            farthest_polish: 0.15,
        }
    }
}

/// Joint refinement of identity and poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineConfig {
    /// Frames from which the first identity is estimated. P2 §5: N_k = 25.
    pub initial_frames: usize,
    /// Passes over the initial frames.
    pub initial_passes: usize,
    /// Body vertices of tracking's last rounds and of the refinement.
    pub vertex_count: usize,
    /// Frames, evenly spread, that the final refinement uses at most.
    pub frame_limit: usize,
    /// Passes of the final refinement.
    pub passes: usize,
    /// Passes after these with local shapes beside the space; zero for none.
    pub local_passes: usize,
    /// Largest share of vertices more than 5 mm outside, after the passes in the space, with which these passes are made: whom
    /// the space does not get inside is no person of it. Captures of people: 0.2 to 1.1 %; half a person: 11 %.
    pub local_outside_share: f64,
    /// Local shapes: what the space cannot express.
    pub local: LocalShapeConfig,
    /// Standard deviation of the turns of bones that local shapes may amount to, degrees: posture is of the pose.
    pub posture_deg: f64,
    /// Standard deviation of the directions of limb bones at rest about the mean's, degrees.
    pub limb_direction_deg: f64,
    /// Pose rounds on each frame before its equations are taken.
    pub pose_rounds: usize,
    /// Steps of the identity over what the quadratic of a pass asks for: where surfaces slide along one another, passes come
    /// near from one side, and slowly. Between 1 and 2.
    pub over_relaxation: f64,
    /// Standard deviation of a trustworthy residual.
    pub residual_deviation: f64,
    /// Independent residuals in a frame: neighbours err together, so far fewer than vertices.
    pub independent_residuals: f64,
    /// Errors of measurements over what the curvature of the energy says of them, for the stated ±: cloth errs together.
    /// Chosen on one subject of the benchmark (1.1 in tight, 1.7 in wide, 4.1 in layered clothing).
    pub error_over_curvature: f64,
    /// Smoothness of angles over time while the identity is refined, per vertex and squared radian.
    pub smoothness: f64,
    /// How far above a vertex's smallest clearance a frame still attracts it.
    pub clearance_tolerance: f64,
    /// Gap that is expected between a covered vertex and the cloth where it comes closest, over the deviation of its
    /// clearance over the frames. Made-up sequences: about 1.2 in a wide dress, 1.5 to 2 in a tight suit, 3 and more under
    /// layers. Visual hulls stand off farther: `configs/visual_hull.toml`.
    pub gap_per_deviation: f64,
    /// The largest expected gap, metres: hems swing farther than they stand off.
    pub largest_gap: f64,
    /// Weight of the attraction of covered vertices to the cloth at that gap.
    pub contact_weight: f64,
    /// Geman–McClure scale of that attraction in the first and in the last pass. A body that starts too thin must
    /// still feel the cloth around it, or it stays thin.
    pub contact_scale: [f64; 2],
    /// `outside_weight` of the refinement.
    pub outside_weight: f64,
    /// `bare_capture_weight` of the refinement: tracking and the first identity have drawn the feet out, and shoes and hair
    /// are thicker than skin.
    pub bare_capture_weight: f64,
    /// Weight of a vertex outside the capture in the final pass: with the identity settled, the pose alone can bring it
    /// in, and no longer makes the body thin.
    pub final_outside_weight: f64,
    /// Outside tolerance of the final pass.
    pub final_outside_tolerance: f64,
    /// Frames on both sides over which poses are smoothed before the final pass; zero for none.
    pub smoothing_reach: usize,
    /// Pull to the smoothed pose in the final pass, per vertex: of root translations over a square metre, of root rotations
    /// and of angles over a square radian.
    pub smoothing_stiffness: [f64; 3],
    /// A pose that smoothing would move by more than this moves too fast for the frame rate and stays as it was found:
    /// radians of any angle, and metres of the root.
    pub largest_tremble: [f64; 2],
    /// Pose rounds of the final pass over all frames, before one more on all vertices.
    pub final_rounds: usize,
}

impl RefineConfig {
    /// The contact scale of a pass, shrinking geometrically.
    pub fn contact_scale(&self, pass: usize, passes: usize) -> f64 {
        geometric(self.contact_scale, pass, passes)
    }
}

impl Default for RefineConfig {
    fn default() -> Self {
        Self {
            initial_frames: 25,
            initial_passes: 4,
            vertex_count: 2400,
            frame_limit: 28,
            passes: 10,
            local_passes: 6,
            local_outside_share: 0.05,
            local: LocalShapeConfig::default(),
            posture_deg: 0.2,
            limb_direction_deg: 0.5,
            pose_rounds: 1,
            over_relaxation: 1.6,
            residual_deviation: 0.006,
            independent_residuals: 500.0,
            error_over_curvature: 2.0,
            smoothness: 2e-5,
            clearance_tolerance: 0.008,
            gap_per_deviation: 2.0,
            largest_gap: 0.008,
            contact_weight: 0.6,
            contact_scale: [0.08, 0.02],
            outside_weight: 13.0,
            bare_capture_weight: 0.75,
            final_outside_weight: 60.0,
            final_outside_tolerance: 0.001,
            smoothing_reach: 5,
            smoothing_stiffness: [0.1, 0.02, 1e-3],
            largest_tremble: [0.25, 0.05],
            final_rounds: 2,
        }
    }
}

/// Which vertices the clothing energy of the paper's recipe draws to the capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClothingForm {
    /// Those outside of it (P2 Eq. 8).
    #[default]
    Outside,
    /// All: what the one-sided form keeps from happening, for comparison.
    Symmetric,
}

/// P2 §4.5 and §5.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Paper2016Config {
    /// P2 §5: N_k = 25 frames for the initial identity.
    pub initial_frames: usize,
    /// P2 §5: N_it = 6 alternations.
    pub alternations: usize,
    /// P2 §4.5: the landmark weight falls linearly from one and is zero in the last two rounds;
    /// the data weight is one minus it.
    pub landmark_weight: RoundSchedule,
    /// P2 §4.3: 200 mm, 60°.
    pub compatibility: CompatibilityRules,
    /// P2 Eq. 5: ω_cloth in the identity refinement. At 0 the identity of the first frames stays (P2 Fig. 3).
    pub clothing_weight: f64,
    /// Which vertices the clothing energy draws.
    pub clothing_form: ClothingForm,
    /// P2 §5: ω_r = 1, on coefficients in the metric units of the basis, once for each frame as Eq. 5 sums Eq. 8.
    pub stay_near_weight: f64,
    /// Rounds of the joint solve over the initial frames and of the refinement; the paper says "iteratively".
    pub joint_rounds: usize,
    /// Iterations of each L-BFGS-B solve at most.
    pub solver_iterations: usize,
}

impl Default for Paper2016Config {
    fn default() -> Self {
        Self {
            initial_frames: 25,
            alternations: 6,
            landmark_weight: RoundSchedule::LinearToZero { zero_rounds: 2 },
            compatibility: CompatibilityRules::default(),
            clothing_weight: 1.0,
            clothing_form: ClothingForm::Outside,
            stay_near_weight: 1.0,
            joint_rounds: 3,
            solver_iterations: 40,
        }
    }
}

/// When codes fire.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CodeThresholds {
    /// Statures that a person can have.
    pub stature: [f64; 2],
    /// Smallest share of body vertices with a compatible capture point.
    pub inlier_share: f64,
    /// Largest share of body vertices more than 5 mm outside; the paper's recipe, which does not aim for it, is exempt.
    pub outside_share_5mm: f64,
    /// Largest share of body vertices more than 20 mm outside.
    pub outside_share_20mm: f64,
    /// Distance from which a capture sample counts as not covered by the body.
    pub uncovered_distance: f64,
    /// Largest share of such samples.
    pub uncovered_share: f64,
    /// Distance from which a vertex of head, hand or foot counts as having no capture.
    pub missing_distance: f64,
    /// Largest share of such vertices in one of these parts.
    pub missing_share: f64,
    /// Distance from which a sample that looks like a limb has no body in it.
    pub limb_distance: f64,
    /// Largest share of such samples among all. Hems and folds of a wide dress reach 4 % under a right body, an arm
    /// alone is 5 %.
    pub uncovered_limb_share: f64,
    /// Distance from which a sample as low as the soles has no body near it.
    pub sole_distance: f64,
    /// Largest share of such samples among all: a third of what shows of feet.
    pub uncovered_sole_share: f64,
    /// How deep the bone of a forearm or a shank may lie inside the trunk.
    pub limb_depth: f64,
    /// Largest turn of a joint between frames, in radians.
    pub jump_angle: f64,
    /// Largest move of the root between frames.
    pub jump_distance: f64,
    /// A rival start or pose within this ratio of the best energy is ambiguous.
    pub rival_ratio: f64,
    /// How far a joint of a rival pose must be from where it is to make a difference.
    pub rival_distance: f64,
}

impl Default for CodeThresholds {
    fn default() -> Self {
        Self {
            stature: [1.2, 2.2],
            inlier_share: 0.5,
            outside_share_5mm: 0.1,
            outside_share_20mm: 0.12,
            uncovered_distance: 0.3,
            uncovered_share: 0.15,
            missing_distance: 0.05,
            missing_share: 0.6,
            limb_distance: 0.09,
            uncovered_limb_share: 0.06,
            sole_distance: 0.12,
            uncovered_sole_share: 0.005,
            limb_depth: 0.02,
            jump_angle: 1.2,
            jump_distance: 0.4,
            rival_ratio: 1.08,
            rival_distance: 0.1,
        }
    }
}
