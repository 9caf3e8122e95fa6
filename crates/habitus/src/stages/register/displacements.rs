//! The default recipe's last part: vertices move along their normals to the scan under a stiffness that falls.
//!
//! Σ w (b·x − (b·y + n g))² + stiffness Σ_edges ‖d_i − d_j‖² + anchor Σ ‖d_i‖², with y the vertices of the round
//! before, g the gap of the mesh point b along its normal n, and d = x − start. A target on the normal keeps a vertex
//! where it is sideways: what slides is decided by the start, not by the nearest bump. The axes decouple, so that one
//! factor of vertex-count rows serves all three.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, TriangleMesh, vertex_normals_into};

use super::RegisterError;
use super::prepared_scan::PreparedScan;
use super::template::{PreparedTemplate, folded_faces};
use crate::body::PartLabel;
use crate::fitting::gaps::{Gap, GapRules, gaps_of_scan, gaps_of_vertices};

/// Moves `start` onto the scan; both in metres.
pub(super) fn displace(
    template: &PreparedTemplate<'_>,
    scan: &PreparedScan,
    start: &[DVec3],
) -> Result<Vec<DVec3>, RegisterError> {
    let config = &template.config.displacements;
    // A posed body may itself be folded, in the armpits for example.
    let mut start = start.to_vec();
    relax_folds(template, &mut start);
    let start = start.as_slice();
    let mut edge_factors = edge_factors(template);
    let mut vertices = start.to_vec();
    let mut hints = Vec::new();
    let rounds = config.stiffness.len();
    for (round, stiffness) in config.stiffness.iter().enumerate() {
        let rules = interpolate(&config.first_pairs, &config.last_pairs, round, rounds);
        let gaps = gaps(template, scan, &vertices, &rules, round, &mut hints)?;
        vertices = solve(template, start, &vertices, &gaps, *stiffness, &edge_factors)?;
    }
    let Some(last_stiffness) = config.stiffness.last() else { return Ok(vertices) };
    for unfolding in 0..config.unfolding_rounds {
        let folded = folded_faces(&template.faces, &template.face_neighbours, &template.rest, &vertices);
        if folded.is_empty() {
            break;
        }
        stiffen_around(template, &folded, config.unfolding_factor, &mut edge_factors);
        let gaps = gaps(template, scan, &vertices, &config.last_pairs, rounds + unfolding, &mut hints)?;
        vertices = solve(template, start, &vertices, &gaps, *last_stiffness, &edge_factors)?;
    }
    relax_folds(template, &mut vertices);
    Ok(vertices)
}

/// Draws the corners of folded faces, and those around them, to the middle of their neighbours until nothing is folded.
fn relax_folds(template: &PreparedTemplate<'_>, vertices: &mut [DVec3]) {
    /// What does not unfold in this many rounds needs more of its surroundings.
    const ROUNDS_PER_STEP: usize = 10;
    for round in 0..template.config.displacements.relaxation_rounds {
        let folded = folded_faces(&template.faces, &template.face_neighbours, &template.rest, vertices);
        if folded.is_empty() {
            return;
        }
        let is_near = near_faces(template, &folded, round / ROUNDS_PER_STEP);
        let mut sums = vec![(DVec3::ZERO, 0.0); vertices.len()];
        for [a, b] in template.edges.iter().map(|edge| edge.map(|vertex| vertex as usize)) {
            for (own, other) in [(a, b), (b, a)] {
                sums[own].0 += vertices[other];
                sums[own].1 += 1.0;
            }
        }
        for (vertex, (sum, count)) in sums.into_iter().enumerate().filter(|(vertex, _)| is_near[*vertex]) {
            vertices[vertex] = 0.5 * (vertices[vertex] + sum / count);
        }
    }
}

fn interpolate(first: &GapRules, last: &GapRules, round: usize, rounds: usize) -> GapRules {
    let share = if rounds > 1 { round as f64 / (rounds - 1) as f64 } else { 1.0 };
    let between = |from: f64, to: f64| from * (to / from).powf(share);
    GapRules {
        distance_mm: between(first.distance_mm, last.distance_mm),
        angle_deg: between(first.angle_deg, last.angle_deg),
        robust_mm: between(first.robust_mm, last.robust_mm),
    }
}

/// Hands are stiffer.
fn edge_factors(template: &PreparedTemplate<'_>) -> Vec<f64> {
    let is_hand = |vertex: u32| template.parts[vertex as usize] == PartLabel::Hand;
    let factor = template.config.displacements.hand_stiffness;
    template
        .edges
        .iter()
        .map(|edge| if edge.iter().all(|vertex| is_hand(*vertex)) { factor } else { 1.0 })
        .collect()
}

/// Edges within two steps of folded faces become stiffer.
fn stiffen_around(template: &PreparedTemplate<'_>, folded: &[usize], factor: f64, factors: &mut [f64]) {
    let is_near = near_faces(template, folded, 2);
    for (edge, edge_factor) in template.edges.iter().zip(factors) {
        if edge.iter().all(|vertex| is_near[*vertex as usize]) {
            *edge_factor *= factor;
        }
    }
}

/// Whether each vertex is within some steps of these faces.
fn near_faces(template: &PreparedTemplate<'_>, folded: &[usize], steps: usize) -> Vec<bool> {
    let mut is_near = vec![false; template.rest.len()];
    for vertex in folded.iter().flat_map(|face| template.faces[*face]) {
        is_near[vertex as usize] = true;
    }
    for _ in 0..steps {
        let before = is_near.clone();
        for [a, b] in template.edges.iter().map(|edge| edge.map(|vertex| vertex as usize)) {
            if before[a] || before[b] {
                (is_near[a], is_near[b]) = (true, true);
            }
        }
    }
    is_near
}

/// Gaps of both directions; their weights sum to about one for each vertex.
fn gaps(
    template: &PreparedTemplate<'_>,
    scan: &PreparedScan,
    vertices: &[DVec3],
    rules: &GapRules,
    round: usize,
    hints: &mut Vec<u32>,
) -> Result<Vec<Gap>, RegisterError> {
    let config = &template.config.displacements;
    let mut normals = Vec::new();
    vertex_normals_into(vertices, &template.faces, &mut normals);
    let all: Vec<u32> = (0..vertices.len() as u32).collect();
    let points = scan.points();
    let mut gaps = gaps_of_vertices(&points, &all, vertices, &normals, rules, hints);
    for gap in &mut gaps {
        gap.weight *= config.vertex_share;
    }
    let mesh = TriangleMesh::new(vertices.to_vec(), template.faces.clone())?;
    let index = SurfaceIndex::of_mesh(&mesh);
    let stride = scan.positions.len().div_ceil(config.sample_count.max(1)).max(1);
    let mut from_scan =
        gaps_of_scan(&points, [round % stride, stride], &index, &template.faces, &normals, rules);
    let sample_count = (scan.positions.len() / stride).max(1) as f64;
    let share = (1.0 - config.vertex_share) * vertices.len() as f64 / sample_count;
    for gap in &mut from_scan {
        gap.weight *= share;
    }
    gaps.extend(from_scan);
    Ok(gaps)
}

fn solve(
    template: &PreparedTemplate<'_>,
    start: &[DVec3],
    vertices: &[DVec3],
    gaps: &[Gap],
    stiffness: f64,
    edge_factors: &[f64],
) -> Result<Vec<DVec3>, RegisterError> {
    let count = vertices.len();
    let mut matrix = template.displacement_matrix.clone();
    matrix.clear();
    // The unknowns are displacements from the start.
    let mut sides = vec![0.0; 3 * count];
    for (edge, factor) in template.edges.iter().zip(edge_factors) {
        let [a, b] = edge.map(|vertex| vertex as usize);
        let weight = stiffness * factor;
        matrix.add(a, a, weight);
        matrix.add(b, b, weight);
        matrix.add(a, b, -weight);
    }
    for vertex in 0..count {
        matrix.add(vertex, vertex, template.config.displacements.anchor);
    }
    for gap in gaps {
        let own = gap.vertices.map(|vertex| vertex as usize);
        let moved: DVec3 = own
            .iter()
            .zip(gap.barycentric)
            .map(|(vertex, share)| (vertices[*vertex] - start[*vertex]) * share)
            .sum();
        let target = (moved + gap.normal * gap.gap).to_array();
        let corner_count = if own[1] == own[0] { 1 } else { 3 };
        for i in 0..corner_count {
            let weighted = gap.weight * gap.barycentric[i];
            for (axis, value) in target.iter().enumerate() {
                sides[axis * count + own[i]] += weighted * value;
            }
            for j in 0..=i {
                matrix.add(own[i], own[j], weighted * gap.barycentric[j]);
            }
        }
    }
    template.displacement_cholesky.factorize(&matrix)?.solve(&mut sides);
    Ok((0..count)
        .map(|vertex| {
            start[vertex] + DVec3::new(sides[vertex], sides[count + vertex], sides[2 * count + vertex])
        })
        .collect())
}
