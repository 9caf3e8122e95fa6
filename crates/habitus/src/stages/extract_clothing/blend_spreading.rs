//! Bone weights of loose cloth, evened out over the cloth as far as it stands off the skin.
//!
//! Each implicit step of `∂w/∂t = ∇·(ℓ² ∇w)`, for all bones at once and with one factorisation, solves
//!
//! ```text
//! (A + L) w' = A w      A: area around each vertex,  L_ij = −cot_ij · min(ℓ_i, ℓ_j)² / steps,  L_ii = −Σ_j L_ij
//! ```
//!
//! with cotangents that are not negative: what is not negative stays so, and what sums to one stays so.

use habitus_geometry::{SurfaceIndex, TriangleMesh};
use habitus_optimize::{SolveError, SparseCholesky, SymmetricMatrix};
use rayon::prelude::*;

use super::config::SpreadingConfig;
use crate::body::BlendedSkin;

/// Largest cotangent: the angle of a sliver says nothing beyond that its corners belong together.
const LARGEST_COTANGENT: f64 = 100.0;
/// Smallest area of a vertex beside the mean, so that one without faces keeps its weights.
const SMALLEST_AREA_SHARE: f64 = 1e-6;

/// Mean distance of each clothing vertex from the skin over posed bodies and their clothing, in metres.
pub(super) fn clearances(frames: &[(&TriangleMesh, &TriangleMesh)]) -> Vec<f64> {
    let of_frame = |(body, clothing): &(&TriangleMesh, &TriangleMesh)| -> Vec<f64> {
        let mut closest = Vec::new();
        SurfaceIndex::of_mesh(body).closest_many(clothing.positions(), None, &mut closest);
        closest.iter().map(|point| point.distance_squared.sqrt()).collect()
    };
    let distances: Vec<Vec<f64>> = frames.par_iter().map(of_frame).collect();
    let count = distances.first().map_or(0, Vec::len);
    let mean = |vertex: usize| distances.iter().map(|frame| frame[vertex]).sum::<f64>() / frames.len() as f64;
    (0..count).map(mean).collect()
}

/// Evens out bone weights over the clothing; `None` where all of it lies on the skin, or none is to be evened out.
///
/// Deviation: P3 §3.1 spreads each pair over 3 cm of the clothing, wherever it is. Between two legs that point apart a
/// skirt then opens within those 3 cm.
pub(super) fn spread_bones(
    skin: &BlendedSkin,
    bone_count: usize,
    clothing: &TriangleMesh,
    clearances: &[f64],
    config: &SpreadingConfig,
) -> Result<Option<BlendedSkin>, SolveError> {
    let widths: Vec<f64> = clearances
        .iter()
        .map(|clearance| config.width_per_clearance * (clearance - config.tight_clearance).max(0.0))
        .collect();
    if widths.iter().all(|width| *width <= 0.0) || config.steps == 0 {
        return Ok(None);
    }
    let areas = areas(clothing);
    let couplings = couplings(clothing, &widths, config.steps);
    let matrix = diffusion_matrix(&areas, &couplings);
    let factor = SparseCholesky::analyse(&matrix)?.factorize(&matrix)?;
    let count = areas.len();
    let table = skin.table(bone_count);
    let mut columns = vec![0.0; table.len()];
    for (place, value) in columns.iter_mut().enumerate() {
        *value = table[(place % count) * bone_count + place / count];
    }
    for _ in 0..config.steps {
        columns.iter_mut().enumerate().for_each(|(place, value)| *value *= areas[place % count]);
        factor.solve(&mut columns);
    }
    let mut is_spread = vec![false; count];
    for (corners, _) in &couplings {
        corners.iter().for_each(|vertex| is_spread[*vertex] = true);
    }
    let mut spread = table;
    for vertex in (0..count).filter(|vertex| is_spread[*vertex]) {
        let row = &mut spread[vertex * bone_count..(vertex + 1) * bone_count];
        for (bone, weight) in row.iter_mut().enumerate() {
            *weight = columns[bone * count + vertex];
        }
        drop_traces(row, config.smallest_share);
    }
    Ok(Some(BlendedSkin::of_table(bone_count, &spread)))
}

/// Pairs of neighbours between which weights flow, with `cot · min(ℓ)² / steps` of each face beside them.
fn couplings(clothing: &TriangleMesh, widths: &[f64], steps: usize) -> Vec<([usize; 2], f64)> {
    let mut couplings = Vec::new();
    for face in clothing.faces() {
        let corners = face.map(|vertex| vertex as usize);
        for k in 0..3 {
            let [a, b, opposite] = [corners[k], corners[(k + 1) % 3], corners[(k + 2) % 3]];
            // The narrower width counts: a vertex that lies on the skin keeps its weights.
            let width = widths[a].min(widths[b]);
            let coupling = 0.5 * cotangent(clothing, opposite, a, b) * width * width / steps as f64;
            if coupling > 0.0 {
                couplings.push(([a, b], coupling));
            }
        }
    }
    couplings
}

/// Cotangent of the angle at a corner, from zero to [`LARGEST_COTANGENT`].
fn cotangent(mesh: &TriangleMesh, corner: usize, a: usize, b: usize) -> f64 {
    let positions = mesh.positions();
    let (to_a, to_b) = (positions[a] - positions[corner], positions[b] - positions[corner]);
    let (along, across) = (to_a.dot(to_b), to_a.cross(to_b).length());
    if along <= 0.0 { 0.0 } else { (along / across).min(LARGEST_COTANGENT) }
}

/// A third of the faces around each vertex, in square metres.
fn areas(mesh: &TriangleMesh) -> Vec<f64> {
    let mut areas = vec![0.0; mesh.positions().len()];
    for (index, face) in mesh.faces().iter().enumerate() {
        let [a, b, c] = mesh.corners(index);
        let third = (b - a).cross(c - a).length() / 6.0;
        face.iter().for_each(|vertex| areas[*vertex as usize] += third);
    }
    let mean = areas.iter().sum::<f64>() / areas.len().max(1) as f64;
    areas.iter().map(|area| area.max(SMALLEST_AREA_SHARE * mean).max(f64::MIN_POSITIVE)).collect()
}

fn diffusion_matrix(areas: &[f64], couplings: &[([usize; 2], f64)]) -> SymmetricMatrix {
    let places = couplings.iter().map(|([a, b], _)| (*a, *b));
    let mut matrix = SymmetricMatrix::with_places(areas.len(), places);
    for (vertex, area) in areas.iter().enumerate() {
        matrix.add(vertex, vertex, *area);
    }
    for ([a, b], coupling) in couplings {
        matrix.add(*a, *a, *coupling);
        matrix.add(*b, *b, *coupling);
        matrix.add(*a, *b, -coupling);
    }
    matrix
}

/// Weights below this share of the heaviest are left out, and the others sum to one again: diffusion reaches everywhere,
/// if only with a millionth.
fn drop_traces(weights: &mut [f64], smallest_share: f64) {
    let smallest = smallest_share * weights.iter().copied().fold(0.0, f64::max);
    weights.iter_mut().filter(|weight| **weight < smallest).for_each(|weight| *weight = 0.0);
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= sum);
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    const COLUMNS: usize = 41;
    const ROWS: usize = 7;
    const EDGE: f64 = 0.01;

    /// A cloth 40 cm wide: the left half hangs on bone 0, the right half on bone 1.
    fn cloth() -> (TriangleMesh, BlendedSkin) {
        let place = |k: usize| DVec3::new((k % COLUMNS) as f64, (k / COLUMNS) as f64, 0.0) * EDGE;
        let cells = (0..ROWS - 1).flat_map(|row| (0..COLUMNS - 1).map(move |column| row * COLUMNS + column));
        let faces = cells.flat_map(|a| {
            let [a, b, c, d] = [a, a + 1, a + COLUMNS, a + COLUMNS + 1].map(|vertex| vertex as u32);
            [[a, b, d], [a, d, c]]
        });
        let mesh = TriangleMesh::new((0..COLUMNS * ROWS).map(place).collect(), faces.collect()).unwrap();
        let halves = (0..COLUMNS * ROWS).flat_map(|k| if k % COLUMNS < 21 { [1.0, 0.0] } else { [0.0, 1.0] });
        (mesh, BlendedSkin::of_table(2, &halves.collect::<Vec<f64>>()))
    }

    fn spread(clearances: &[f64], config: &SpreadingConfig) -> Option<BlendedSkin> {
        let (mesh, skin) = cloth();
        spread_bones(&skin, 2, &mesh, clearances, config).unwrap()
    }

    fn config(width_per_clearance: f64) -> SpreadingConfig {
        SpreadingConfig { width_per_clearance, tight_clearance: 0.02, steps: 1, smallest_share: 0.0 }
    }

    #[test]
    fn one_step_smooths_a_jump_as_the_screened_equation_does() {
        let width = 0.05;
        let skin = spread(&[0.12; COLUMNS * ROWS], &config(width / 0.1)).unwrap();
        for row in 0..ROWS {
            let weight = |column: usize| -> f64 {
                let of_left = skin.of(row * COLUMNS + column).filter(|(bone, _)| *bone == 0);
                of_left.map(|(_, weight)| weight).sum()
            };
            // On a line from 0 to L with a jump at s: 1 − sinh(L − s) cosh(x) / sinh(L) left of it, lengths in widths. The
            // jump lies between two columns, the first and last of which stand for half a column each.
            let (length, jump) = (0.40 / width, 0.205 / width);
            for column in 0..21 {
                let x = column as f64 * EDGE / width;
                let exact = 1.0 - (length - jump).sinh() * x.cosh() / length.sinh();
                // Of second order in the edge's length: (1 cm / 5 cm)² / 24 and less.
                assert!((weight(column) - exact).abs() < 3e-3, "{column}: {} for {exact}", weight(column));
            }
        }
    }

    #[test]
    fn weights_stay_shares_whatever_the_cloth() {
        let wild: Vec<f64> = (0..COLUMNS * ROWS).map(|k| 0.3 * (1.7 * k as f64).sin().abs()).collect();
        let (mesh, skin) = cloth();
        // Obtuse corners and slivers, whose cotangents are negative or huge.
        let sheared = mesh
            .positions()
            .iter()
            .map(|p| DVec3::new(p.x + 2.3 * p.y, 0.02 * p.y, 0.01 * (90.0 * p.x).sin()));
        let sheared = mesh.with_positions(sheared.collect()).unwrap();
        for steps in 1..4 {
            let config = SpreadingConfig { steps, smallest_share: 1e-3, ..config(3.0) };
            let spread = spread_bones(&skin, 2, &sheared, &wild, &config).unwrap().unwrap();
            for vertex in 0..COLUMNS * ROWS {
                assert!(spread.of(vertex).all(|(_, weight)| (0.0..=1.0).contains(&weight)));
                let sum: f64 = spread.of(vertex).map(|(_, weight)| weight).sum();
                assert!((sum - 1.0).abs() < 1e-12, "{sum}");
            }
        }
    }

    #[test]
    fn cloth_on_the_skin_keeps_its_weights() {
        let (_, before) = cloth();
        assert_eq!(spread(&[0.02; COLUMNS * ROWS], &config(2.0)), None);
        assert_eq!(spread(&[0.2; COLUMNS * ROWS], &config(0.0)), None);
        let is_loose = |vertex: usize| (10..30).contains(&(vertex % COLUMNS));
        let clearances: Vec<f64> =
            (0..COLUMNS * ROWS).map(|vertex| if is_loose(vertex) { 0.1 } else { 0.01 }).collect();
        let after = spread(&clearances, &config(2.0)).unwrap();
        for vertex in (0..COLUMNS * ROWS).filter(|vertex| !is_loose(*vertex)) {
            assert!(before.of(vertex).eq(after.of(vertex)), "vertex {vertex} lies on the skin");
        }
        assert!((0..COLUMNS * ROWS).any(|vertex| after.of(vertex).count() == 2));
    }

    #[test]
    fn clearances_are_means_over_the_frames() {
        let (body, _) = cloth();
        let lifted = |height: f64| {
            let positions = body.positions().iter().map(|place| *place + DVec3::Z * height);
            body.with_positions(positions.collect()).unwrap()
        };
        let (low, high) = (lifted(0.01), lifted(-0.05));
        for clearance in clearances(&[(&body, &low), (&body, &high)]) {
            assert!((clearance - 0.03).abs() < 1e-9);
        }
        assert!(clearances(&[]).is_empty());
    }
}
