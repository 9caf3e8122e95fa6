//! The one-sided energy of the default recipe, as weights on correspondences.
//!
//! Deviation: P2 §4.3 pulls every vertex to the capture with equal weight while it tracks. Here a vertex inside the
//! capture is pulled weakly and robustly, because under loose cloth its closest point is not skin.

use glam::DVec3;
use habitus_geometry::PointGrid;

use super::body_levels::BodyLevel;
use super::captured_frame::{CaptureSample, CapturedFrame, bounds_of};
use super::config::SurfaceConfig;
use crate::body::PartLabel;
use crate::fitting::correspondence::{ClosestField, Correspondence};

/// Geman–McClure: ρ(d) = s² d² / (s² + d²); its weight in iteratively reweighted least squares.
pub(super) fn robust_weight(distance_squared: f64, scale: f64) -> f64 {
    let share = scale * scale / (scale * scale + distance_squared);
    share * share
}

/// Geman–McClure energy of a squared distance.
pub(super) fn robust_energy(distance_squared: f64, scale: f64) -> f64 {
    scale * scale * distance_squared / (scale * scale + distance_squared)
}

/// How a covered vertex is drawn to the capture from within.
#[derive(Clone, Copy)]
pub(super) struct Inside {
    /// Weight before the robust kernel.
    pub weight: f64,
    /// Geman–McClure scale, metres.
    pub scale: f64,
    /// How far below the capture the vertex belongs, metres.
    pub gap: f64,
}

/// Makes a pair one-sided: sets its weight and, beyond the tolerance outside, moves its target out by the tolerance, so
/// that the noise of the capture does not push the body in. Returns the pair's robust energy in square metres.
pub(super) fn weigh_one_sided(
    pair: &mut Correspondence,
    part: PartLabel,
    inside: Inside,
    config: &SurfaceConfig,
) -> f64 {
    let beyond = pair.signed_distance - config.outside_tolerance;
    let (distance, weight, scale) = if beyond > 0.0 {
        pair.target += pair.normal * config.outside_tolerance;
        (beyond, config.outside_weight, config.outside_scale)
    } else if part.is_bare() {
        (pair.signed_distance, config.bare_weight, config.bare_scale)
    } else {
        pair.target -= pair.normal * inside.gap;
        (pair.signed_distance + inside.gap, inside.weight, inside.scale)
    };
    let squared = distance * distance;
    // Fingers that stick out of a fist are pulled in, but say nothing against the pose: a hand that has gone astray
    // into the trunk has none outside.
    let is_finger_outside = beyond > 0.0 && part == PartLabel::Hand;
    let pull = if is_finger_outside { config.hand_outside_weight } else { weight };
    pair.weight = pull * robust_weight(squared, scale);
    weight * robust_energy(squared, scale)
}

/// The frozen pairs of one round and the energy they stand for.
pub(super) struct ClothedPairs {
    pub pairs: Vec<Correspondence>,
    /// Mean robust energy per vertex in square metres; a vertex without a credible pair counts as far away.
    pub energy: f64,
    /// Share of vertices with a credible pair.
    pub inlier_share: f64,
}

/// Pairs of the body with the capture, weighted one-sidedly.
pub(super) fn clothed_pairs(
    level: &BodyLevel,
    field: &ClosestField,
    vertices: &[DVec3],
    normals: &[DVec3],
    config: &SurfaceConfig,
) -> ClothedPairs {
    let mut pairs = field.correspondences(vertices, normals, &config.compatibility);
    let inside = Inside { weight: config.inside_weight, scale: config.inside_scale, gap: 0.0 };
    let mut energy = 0.0;
    for pair in &mut pairs {
        energy += weigh_one_sided(pair, level.parts[pair.vertex as usize], inside, config);
    }
    let paired = pairs.len() as f64;
    let count = vertices.len().max(1) as f64;
    energy += (count - paired) * config.bare_weight * config.bare_scale * config.bare_scale;
    ClothedPairs { pairs, energy: energy / count, inlier_share: paired / count }
}

/// Whether the head, a hand or a foot has most of its vertices farther than `distance` from the capture. They are seen
/// through most clothing, so that a part that is not there has gone astray.
pub(super) fn is_extremity_missing(
    level: &BodyLevel,
    field: &ClosestField,
    distance: f64,
    share: f64,
) -> bool {
    level.extremities.iter().any(|part| {
        let far = part
            .iter()
            .filter(|vertex| field.points[**vertex as usize].distance_squared > distance * distance)
            .count();
        far as f64 > share * part.len() as f64
    })
}

/// The pair that draws a body vertex to a sample of the capture.
fn pair_with_sample(sample: &CaptureSample, vertex: usize, position: DVec3, weight: f64) -> Correspondence {
    let signed_distance = (position - sample.position).dot(sample.normal);
    Correspondence {
        vertex: vertex as u32,
        target: sample.position,
        normal: sample.normal,
        is_outside: signed_distance > 0.0,
        signed_distance,
        weight,
    }
}

/// Pairs from capture samples to their nearest body vertices, robustly weighted; they pull limbs into parts of the
/// capture that no vertex has found. Returns the pairs and the mean robust energy per sample.
pub(super) fn capture_pairs(
    frame: &CapturedFrame,
    sample_stride: usize,
    vertices: &[DVec3],
    normals: &[DVec3],
    weight: f64,
    scale: f64,
) -> (Vec<Correspondence>, f64) {
    let samples = || frame.samples.iter().step_by(sample_stride.max(1));
    let weight_sum = samples().map(CaptureSample::weight).sum::<f64>().max(1.0);
    // Each direction weighs the same, however many vertices and samples there are.
    let share = weight * vertices.len() as f64 / weight_sum;
    let mut energy = 0.0;
    let grid = PointGrid::new(vertices);
    let pairs = samples()
        .filter_map(|sample| {
            let faces_sample = |vertex: usize| normals[vertex].dot(sample.normal) > 0.0;
            let (vertex, squared) = grid.nearest_where(sample.position, faces_sample)?;
            energy += sample.weight() * robust_energy(squared, scale);
            let weight = share * sample.weight() * robust_weight(squared, scale);
            Some(pair_with_sample(sample, vertex, vertices[vertex], weight))
        })
        .collect();
    (pairs, energy / weight_sum)
}

/// Pairs from capture samples to bare vertices that lie inside them. Bare parts are two-sided in both directions: the
/// closest points of a toe lie above and below it, and only the capture's own tip says how long the foot is.
pub(super) fn bare_capture_pairs(
    level: &BodyLevel,
    frame: &CapturedFrame,
    vertices: &[DVec3],
    normals: &[DVec3],
    config: &SurfaceConfig,
) -> Vec<Correspondence> {
    let smallest_cosine = config.compatibility.angle_deg.to_radians().cos();
    let reach = DVec3::splat(config.bare_scale);
    let boxes: Vec<[DVec3; 2]> = level
        .extremities
        .iter()
        .map(|part| {
            let positions: Vec<DVec3> = part.iter().map(|vertex| vertices[*vertex as usize]).collect();
            let [low, high] = bounds_of(&positions);
            [low - reach, high + reach]
        })
        .collect();
    let is_near = |position: DVec3| {
        boxes.iter().any(|[low, high]| position.cmpge(*low).all() && position.cmple(*high).all())
    };
    // A sample stands for as much area as a vertex would if there were as many of both.
    let share = config.bare_capture_weight * vertices.len() as f64 / frame.samples.len().max(1) as f64;
    let grid = PointGrid::new(vertices);
    frame
        .samples
        .iter()
        .filter(|sample| is_near(sample.position))
        .filter_map(|sample| {
            let faces_sample = |vertex: usize| normals[vertex].dot(sample.normal) > 0.0;
            let (vertex, squared) = grid.nearest_where(sample.position, faces_sample)?;
            let weight = share * robust_weight(squared, config.bare_scale);
            let pair = pair_with_sample(sample, vertex, vertices[vertex], weight);
            let is_pulled = level.parts[vertex].is_bare()
                && pair.signed_distance < 0.0
                && normals[vertex].dot(sample.normal) >= smallest_cosine;
            is_pulled.then_some(pair)
        })
        .collect()
}

/// Pairs from the lowest samples of the capture to feet that are away from them. What a person stands on is no cloth: below
/// a wide hem only toes and soles show, too few to hold a foot that the hem around it draws up.
pub(super) fn sole_pairs(
    level: &BodyLevel,
    frame: &CapturedFrame,
    vertices: &[DVec3],
    config: &SurfaceConfig,
) -> Vec<Correspondence> {
    let share = config.sole_weight * vertices.len() as f64 / frame.samples.len().max(1) as f64;
    let grid = PointGrid::new(vertices);
    let is_foot = |vertex: usize| level.parts[vertex] == PartLabel::Foot;
    frame
        .samples
        .iter()
        .filter(|sample| is_as_low_as_soles(sample, frame, config))
        .filter_map(|sample| {
            let (vertex, squared) = grid.nearest_where(sample.position, is_foot)?;
            let weight = share * robust_weight(squared, config.sole_scale);
            // Nearer ones are held as bare parts are; shoes are thicker than feet.
            (squared > config.bare_scale * config.bare_scale)
                .then(|| pair_with_sample(sample, vertex, vertices[vertex], weight))
        })
        .collect()
}

fn is_as_low_as_soles(sample: &CaptureSample, frame: &CapturedFrame, config: &SurfaceConfig) -> bool {
    sample.position.y < frame.bounds[0].y + config.sole_height
}

/// Share of all samples that look like a limb and have no body within `distance`: a limb that has gone astray.
pub(super) fn uncovered_limb_share(frame: &CapturedFrame, vertices: &[DVec3], distance: f64) -> f64 {
    uncovered_share(frame, vertices, distance, |sample| sample.is_limb_like)
}

/// Share of all samples that are as low as soles and have no body within `distance`: feet that have gone astray, or a hem on
/// the ground.
pub(super) fn uncovered_sole_share(
    frame: &CapturedFrame,
    vertices: &[DVec3],
    distance: f64,
    config: &SurfaceConfig,
) -> f64 {
    uncovered_share(frame, vertices, distance, |sample| is_as_low_as_soles(sample, frame, config))
}

/// Share of all samples that are of a kind and have no body within `distance`.
pub(super) fn uncovered_share(
    frame: &CapturedFrame,
    vertices: &[DVec3],
    distance: f64,
    is_of_kind: impl Fn(&CaptureSample) -> bool,
) -> f64 {
    let grid = PointGrid::new(vertices);
    let of_kind = frame.samples.iter().filter(|sample| is_of_kind(sample));
    let uncovered = of_kind.filter(|sample| !grid.has_within(sample.position, distance));
    uncovered.count() as f64 / frame.samples.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use habitus_geometry::{Surface, TriangleMesh};

    use super::super::captured_frame::FitFromInput;
    use super::super::config::{CodeThresholds, FrameConfig};
    use super::*;
    use crate::body::BodyModel;

    fn pair(signed_distance: f64) -> Correspondence {
        Correspondence {
            vertex: 0,
            target: DVec3::ZERO,
            normal: DVec3::Z,
            is_outside: signed_distance > 0.0,
            signed_distance,
            weight: 1.0,
        }
    }

    fn frame_of(mesh: TriangleMesh) -> CapturedFrame {
        let surface = Surface::Mesh(mesh);
        let fit_from_input = FitFromInput {
            scale: 1.0,
            rotation: DMat3::IDENTITY,
            translation: DVec3::ZERO,
            usual_size: super::super::captured_frame::size_of(&surface),
        };
        let config = FrameConfig::default();
        CapturedFrame::prepare(surface, &fit_from_input, &config, (1, "body")).expect("a frame")
    }

    #[test]
    fn a_finger_outside_pulls_like_a_hand_and_costs_like_any_vertex() {
        let config = SurfaceConfig::default();
        let (mut finger, mut toe) = (pair(0.03), pair(0.03));
        let costs = [(&mut finger, PartLabel::Hand), (&mut toe, PartLabel::Foot)].map(|(pair, part)| {
            weigh_one_sided(pair, part, Inside { weight: 0.1, scale: 0.03, gap: 0.0 }, &config)
        });
        assert_eq!(costs[0], costs[1]);
        let ratio = config.hand_outside_weight / config.outside_weight;
        assert!((finger.weight / toe.weight - ratio).abs() < 1e-12);
    }

    #[test]
    fn a_capture_beyond_the_toes_draws_feet_hands_and_head_out_and_leaves_the_trunk() {
        let model = BodyModel::default_space().expect("the embedded model");
        let level = BodyLevel::full(&model, 1);
        let vertices = model.mean_vertices();
        let normals = habitus_geometry::vertex_normals(vertices, model.faces());
        // The capture is the body, two centimetres thicker all over.
        let thicker: Vec<DVec3> = vertices.iter().zip(&normals).map(|(v, n)| *v + *n * 0.02).collect();
        let mesh = TriangleMesh::new(thicker, model.faces().to_vec()).expect("a mesh");
        let frame = frame_of(mesh);
        let pairs = bare_capture_pairs(&level, &frame, vertices, &normals, &SurfaceConfig::default());
        for pair in &pairs {
            assert!(level.parts[pair.vertex as usize].is_bare() && pair.signed_distance < 0.0);
            assert!(pair.weight > 0.0);
        }
        for part in &level.extremities {
            assert!(pairs.iter().any(|pair| part.contains(&pair.vertex)), "nothing draws a part out");
        }
    }

    #[test]
    fn what_stands_on_the_ground_draws_feet_that_are_away_and_no_other() {
        let model = BodyModel::default_space().expect("the embedded model");
        let level = BodyLevel::full(&model, 1);
        let vertices = model.mean_vertices();
        let frame = frame_of(TriangleMesh::new(vertices.to_vec(), model.faces().to_vec()).expect("a mesh"));
        let config = SurfaceConfig::default();
        assert!(sole_pairs(&level, &frame, vertices, &config).is_empty(), "feet are where they are");
        // The whole body a hand's breadth higher and to the side, as if its feet hung in a wide hem.
        let lifted: Vec<DVec3> = vertices.iter().map(|v| *v + DVec3::new(0.03, 0.12, 0.0)).collect();
        let pairs = sole_pairs(&level, &frame, &lifted, &config);
        assert!(!pairs.is_empty());
        let lowest = frame.bounds[0].y + config.sole_height;
        for pair in &pairs {
            assert_eq!(level.parts[pair.vertex as usize], PartLabel::Foot);
            assert!(pair.target.y < lowest && pair.weight > 0.0);
        }
        let share = uncovered_sole_share(&frame, &lifted, 0.09, &config);
        assert!(share > CodeThresholds::default().uncovered_sole_share, "{share}");
    }
}
