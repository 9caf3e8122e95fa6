//! Settings of `extract_clothing`. Lengths are metres.

use serde::{Deserialize, Serialize};

use crate::fitting::correspondence::CompatibilityRules;
use crate::fitting::schedule::RoundSchedule;

/// Settings of the whole stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExtractClothingConfig {
    /// What each clothing vertex hangs on.
    pub association: AssociationConfig,
    /// How captures without correspondences are brought into one connectivity.
    pub alignment: AlignmentConfig,
}

/// What happens to a ray that meets the body again before it meets the clothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BlockedRays {
    /// It makes no pair: what lies behind a leg does not hang on this one.
    #[default]
    Drop,
    /// It goes on through the body, as P3 §3.1 is printed.
    Keep,
}

/// Settings of the association (P3 §3.1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AssociationConfig {
    /// Frames that pairs are taken from, spread over the sequence. P3 §3.1 takes the first frame alone; more of them
    /// reach vertices that a fold or an arm hides.
    pub frames: usize,
    /// Longest ray from the body to the clothing. P3 §3.1: 15 cm.
    pub ray_length: f64,
    /// How far inside the body a ray starts, for skin that lies a little outside its capture. P3 §3.1: 0.
    pub ray_start_inside: f64,
    /// Rays that meet the body first.
    pub blocked_rays: BlockedRays,
    /// How far a pair may come apart in any of the frames: a sleeve that touches the trunk does not hang on it. Not in P3,
    /// which looks at one frame.
    pub largest_parting: f64,
    /// P3 §3.1: σ = 1 cm.
    pub diffusion_radius: f64,
    /// Largest geodesic distance that diffusion reaches, on the clothing and on the body. P3 §3.1: 3 cm.
    pub diffusion_reach: f64,
    /// P3's n_f: body vertices that a clothing vertex may hang on. The paper shows several and names none.
    pub body_vertices_per_clothing_vertex: usize,
    /// Rounds that smooth the association of vertices that no pair reaches; the paper leaves them without any.
    pub completion_rounds: usize,
    /// Smallest singular value of a blended transform (P3 Eq. 3): below it the blend cannot be undone safely. 0.2 keeps
    /// an error of the surface from growing more than fivefold in the offsets.
    pub smallest_stretch: f64,
    /// How far the bone weights of loose cloth are evened out.
    pub spreading: SpreadingConfig,
}

impl Default for AssociationConfig {
    fn default() -> Self {
        Self {
            frames: 8,
            ray_length: 0.15,
            ray_start_inside: 0.01,
            blocked_rays: BlockedRays::Drop,
            largest_parting: 0.3,
            diffusion_radius: 0.01,
            diffusion_reach: 0.03,
            body_vertices_per_clothing_vertex: 16,
            completion_rounds: 30,
            smallest_stretch: 0.2,
            spreading: SpreadingConfig::default(),
        }
    }
}

/// Settings of the bone weights of cloth that stands off the skin. Not in P3, whose widths are those of the diffusion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpreadingConfig {
    /// Width over which weights are evened out, for each metre that the cloth stands off beyond `tight_clearance`. 0
    /// leaves the weights as P3 Eq. 3 has them; with 2.5 and more a skirt hangs on the hips and its legs come through.
    pub width_per_clearance: f64,
    /// Mean distance from the skin up to which cloth counts as lying on it, and keeps its weights: the reach of P3's
    /// diffusion.
    pub tight_clearance: f64,
    /// Implicit steps that the width is reached in: more of them make the transition rounder.
    pub steps: usize,
    /// Weights that are a smaller share of the vertex's heaviest one after evening out are dropped.
    pub smallest_share: f64,
}

impl Default for SpreadingConfig {
    fn default() -> Self {
        Self { width_per_clearance: 1.5, tight_clearance: 0.03, steps: 2, smallest_share: 1e-3 }
    }
}

/// Settings of the alignment (P3 §3, after Li et al. 2009).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignmentConfig {
    /// The frame whose surface all others get; the one with the largest surface if none is named.
    pub template_frame: Option<usize>,
    /// Frames, spread over the sequence, among which that one is sought.
    pub template_candidates: usize,
    /// Connected pieces with a smaller share of a capture's area are dropped.
    pub smallest_component_share: f64,
    /// Edges of the template below this length in metres are collapsed: slivers turn over at a touch.
    pub shortest_edge: f64,
    /// Neighbours for the normals of clouds that have none.
    pub normal_neighbours: usize,
    /// Nodes of the deformation graph.
    pub nodes: usize,
    /// Rounds of pairs for each frame.
    pub rounds: usize,
    /// Steps of the solver in each round.
    pub solver_iterations: usize,
    /// When a pair is credible.
    pub compatibility: CompatibilityRules,
    /// Distance in metres beyond which a pair loses its weight, round by round.
    pub robust_scale: RoundSchedule,
    /// It never falls below this, in metres.
    pub smallest_robust_scale: f64,
    /// Weight of the distance to the point beside that to its plane: what is larger holds vertices back where they
    /// should slide.
    pub point_share: f64,
    /// Weight of all pairs from the capture to the template beside those from the template.
    pub capture_weight: f64,
    /// Vertices of the template that look for pairs while the graph bends.
    pub template_samples: usize,
    /// Points sampled on the capture.
    pub capture_samples: usize,
    /// Weight of the rigidity of the graph, round by round. Mean squares are compared: of neighbours that disagree about
    /// each other's place, and of distances to the capture.
    pub rigidity: RoundSchedule,
    /// It never falls below this.
    pub smallest_rigidity: f64,
    /// Weight of turning alike, as a share of the rigidity.
    pub smoothness_share: f64,
    /// Folds finer than the graph.
    pub detail: DetailConfig,
    /// Mean distance to or from the capture in metres above which a frame is tried again from the template alone, and
    /// marked if that does not help.
    pub largest_error: f64,
    /// The same for the share of faces that are turned over.
    pub largest_folded_share: f64,
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self {
            template_frame: None,
            template_candidates: 12,
            smallest_component_share: 0.02,
            shortest_edge: 0.004,
            normal_neighbours: 12,
            nodes: 600,
            rounds: 10,
            solver_iterations: 1,
            compatibility: CompatibilityRules { distance: 0.15, angle_deg: 60.0 },
            robust_scale: RoundSchedule::Geometric { start: 0.08, factor: 0.75 },
            smallest_robust_scale: 0.01,
            point_share: 0.01,
            capture_weight: 1.0,
            template_samples: 5000,
            capture_samples: 3000,
            rigidity: RoundSchedule::Geometric { start: 30.0, factor: 0.5 },
            smallest_rigidity: 0.05,
            smoothness_share: 0.1,
            detail: DetailConfig::default(),
            largest_error: 0.005,
            largest_folded_share: 1e-3,
        }
    }
}

/// Settings of the last rounds, in which each vertex moves and its surroundings turn with it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetailConfig {
    /// Rounds; none leaves what the graph has reached.
    pub rounds: usize,
    /// Weight of the length and turn of an edge beside that of a vertex reaching the capture, round by round.
    pub stiffness: RoundSchedule,
    /// It never falls below this.
    pub smallest_stiffness: f64,
    /// Largest distance of a pair in metres.
    pub largest_shift: f64,
    /// Largest angle between the normals of a pair, in degrees.
    pub angle_deg: f64,
    /// Weight of staying in place, for vertices without a pair.
    pub resting_weight: f64,
}

impl Default for DetailConfig {
    fn default() -> Self {
        Self {
            rounds: 6,
            stiffness: RoundSchedule::Geometric { start: 3.0, factor: 0.6 },
            smallest_stiffness: 0.3,
            largest_shift: 0.03,
            angle_deg: 60.0,
            resting_weight: 0.01,
        }
    }
}
