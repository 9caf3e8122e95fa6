//! The recipe `paper`: P1 §3.1 and §3.2 with the details of §4.1.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, vertex_normals};
use habitus_optimize::{Bounds, GaussNewtonSettings, Silent, ValueSum, gauss_newton};

use super::RegisterError;
use super::affines::AffineFit;
use super::prepared_scan::{PreparedScan, named_random};
use super::template::PreparedTemplate;
use crate::body::{BodyModel, IdentityCoefficients, PartLabel, ROOT_LENGTH};
use crate::fitting::Fit;
use crate::fitting::correspondence::{ClosestField, CompatibilityRules, Correspondence};
use crate::fitting::deformers::{BodyParameters, FreeParameters};
use crate::fitting::model_fit::ModelState;
use crate::fitting::terms::{ClosestPoints, DistanceForm, LandmarkPull};

/// P1 §4.1: the scan subsampled to about three times the template's vertices.
pub(super) struct SubsampledScan {
    index: SurfaceIndex,
}

impl SubsampledScan {
    pub fn new(template: &PreparedTemplate<'_>, scan: &PreparedScan, name: &str) -> Self {
        let wanted = template.config.paper.scan_points_per_vertex * template.rest.len() as f64;
        let count = scan.positions.len();
        let mut order: Vec<u32> = (0..count as u32).collect();
        let mut random = named_random(template.config.seed, name, "subsampled");
        let kept = (wanted as usize).clamp(1, count);
        for place in 0..kept {
            let other = place + (random.unit() * (count - place) as f64) as usize;
            order.swap(place, other.min(count - 1));
        }
        let pick = |values: &[DVec3]| -> Vec<DVec3> {
            order[..kept].iter().map(|point| values[*point as usize]).collect()
        };
        Self { index: SurfaceIndex::of_cloud(&pick(&scan.positions), &pick(&scan.normals)) }
    }

    /// P1 Eq. 4 with the rules of §3.1 and §4.1, distances of body and head: head vertices by their own rule, hand vertices without data.
    fn pairs(
        &self,
        template: &PreparedTemplate<'_>,
        vertices: &[DVec3],
        distances_mm: [f64; 2],
        earlier: &mut Option<ClosestField>,
    ) -> Vec<Correspondence> {
        let config = &template.config.paper;
        let normals = vertex_normals(vertices, &template.faces);
        let field = ClosestField::find(&self.index, vertices, earlier.as_ref());
        let rules = |distance_mm: f64, angle_deg: f64| CompatibilityRules {
            distance: distance_mm / 1000.0,
            angle_deg,
        };
        let is_part = |pair: &Correspondence, part| template.parts[pair.vertex as usize] == part;
        let body = field
            .correspondences(vertices, &normals, &rules(distances_mm[0], config.angle_deg))
            .into_iter()
            .filter(|pair| !is_part(pair, PartLabel::Head) && !is_part(pair, PartLabel::Hand));
        let head = field
            .correspondences(vertices, &normals, &rules(distances_mm[1], config.head_angle_deg))
            .into_iter()
            .filter(|pair| is_part(pair, PartLabel::Head));
        let pairs = body.chain(head).collect();
        *earlier = Some(field);
        pairs
    }
}

/// P1 §3.2, second step: pose and shape in turn, α = 1 and γ = 0, until the energy does not change significantly.
pub(super) fn fit_model(
    template: &PreparedTemplate<'_>,
    model: &BodyModel,
    scan: &SubsampledScan,
    state: &mut ModelState,
) -> Result<(), RegisterError> {
    let config = &template.config.paper;
    let surface = model.surface();
    let components = surface.component_count();
    state.identity.resize(components, 0.0);
    let settings = GaussNewtonSettings { max_iterations: 4, ..GaussNewtonSettings::default() };
    let (mut low, mut high) = model.skeleton().pose_limits();
    // Hands have no data: they stay as the rest pose holds them.
    for parameter in hand_angles(model) {
        state.pose[parameter] = 0.0_f64.clamp(low[parameter], high[parameter]);
        low[parameter] = state.pose[parameter];
        high[parameter] = state.pose[parameter];
    }
    let pose_bounds = Bounds::new(low, high)?;
    let limit = IdentityCoefficients::LIMIT;
    let identity_bounds = Bounds::new(vec![-limit; components], vec![limit; components])?;
    let mut earlier = None;
    let mut last_energy = f64::INFINITY;
    for _ in 0..config.model_rounds {
        let deformer = BodyParameters::of_pose(surface, &state.identity);
        let vertices = {
            use crate::fitting::Deformer;
            deformer.deform(&state.pose).vertices().to_vec()
        };
        let pairs = scan.pairs(template, &vertices, [config.model_distance_mm; 2], &mut earlier);
        let term = ClosestPoints::new(&pairs, DistanceForm::Point);
        let fit = Fit::new(&deformer).with(1.0, &term);
        gauss_newton(&fit, &mut state.pose, &pose_bounds, &settings, &mut Silent)?;
        let deformer = BodyParameters::new(surface, FreeParameters::Identity { pose: state.pose.clone() });
        let fit = Fit::new(&deformer).with(1.0, &term);
        gauss_newton(&fit, &mut state.identity, &identity_bounds, &settings, &mut Silent)?;
        // The sum over pairs jumps when a pair comes or goes; their mean does not.
        let energy = ValueSum::of(&fit, &state.identity).value / pairs.len().max(1) as f64;
        if (last_energy - energy).abs() <= config.model_tolerance * energy {
            break;
        }
        last_energy = energy;
    }
    Ok(())
}

/// Pose parameters that move hands alone.
fn hand_angles(model: &BodyModel) -> Vec<usize> {
    let bones = model.dominant_bones();
    let is_hand = |bone: usize| {
        let mut own = (0..bones.len()).filter(|vertex| bones[*vertex] == bone).peekable();
        own.peek().is_some() && own.all(|vertex| model.part_labels()[vertex] == PartLabel::Hand)
    };
    let axes = model.skeleton().axes().iter().enumerate();
    axes.filter(|(_, axis)| is_hand(axis.bone)).map(|(index, _)| ROOT_LENGTH + index).collect()
}

/// P1 §3.1: affine maps of a start under the schedule of weights; metres.
pub(super) fn deform(
    template: &PreparedTemplate<'_>,
    scan: &SubsampledScan,
    start: &[DVec3],
    landmarks: &[(u32, DVec3)],
) -> Result<Vec<DVec3>, RegisterError> {
    let pulls: Vec<LandmarkPull> = landmarks
        .iter()
        .filter(|(vertex, _)| template.parts[*vertex as usize] != PartLabel::Hand)
        .map(|(vertex, target)| LandmarkPull { vertex: *vertex, target: *target, confidence: 1.0 })
        .collect();
    let mut fit = AffineFit::new(template, start);
    let mut earlier = None;
    for round in template.config.paper.schedule() {
        let pairs = match round.closest_points {
            0.0 if pulls.is_empty() => continue,
            0.0 => Vec::new(),
            _ => {
                let distances = [template.config.paper.distance_mm, template.config.paper.head_distance_mm];
                scan.pairs(template, &fit.vertices(), distances, &mut earlier)
            }
        };
        fit.solve(&round, &pairs, &pulls)?;
    }
    Ok(fit.vertices())
}
