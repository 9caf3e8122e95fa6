//! Fewer vertices for the view by vertex clustering on a grid (Rossignac and Borrel, 1993, "Multi-resolution 3D approximations").

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use super::CaptureView;

/// Trials of the search for the cell size; each halves the interval.
const SEARCH_STEPS: usize = 12;
/// Share of the limit at which the search is content.
const GOOD_SHARE: f64 = 0.95;

/// The capture with at most `vertex_limit` vertices; vertices that are not finite are left out with their faces.
pub(crate) fn decimated(capture: &CaptureView, vertex_limit: usize) -> CaptureView {
    let is_finite = capture.positions.iter().all(|position| position.is_finite());
    if is_finite && capture.positions.len() <= vertex_limit {
        return capture.clone();
    }
    let finite = capture.positions.iter().filter(|position| position.is_finite());
    let (low, high) = finite.clone().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), position| {
        (low.min(*position), high.max(*position))
    });
    let size = (high - low).max_element();
    if !size.is_finite() || vertex_limit == 0 {
        return CaptureView::default();
    }
    // Cells from a thousandth of the capture (too many) to twice its size (one vertex).
    let [mut fine, mut coarse] = [size.max(1e-9) * 1e-3, size.max(1e-9) * 2.0];
    let mut keys = Vec::with_capacity(capture.positions.len());
    for _ in 0..SEARCH_STEPS {
        let middle = (fine * coarse).sqrt();
        keys.clear();
        keys.extend(finite.clone().map(|position| cell_of(*position, low, middle)));
        keys.sort_unstable();
        keys.dedup();
        if keys.len() <= vertex_limit {
            coarse = middle;
            if keys.len() as f64 >= GOOD_SHARE * vertex_limit as f64 {
                break;
            }
        } else {
            fine = middle;
        }
    }
    clustered(capture, low, coarse)
}

/// Number of a position's cell: 21 bits an axis, far more than the finest grid has.
fn cell_of(position: DVec3, low: DVec3, cell: f64) -> u64 {
    let [x, y, z] = ((position - low) / cell).to_array().map(|steps| (steps as u64) & 0x1f_ffff);
    x | y << 21 | z << 42
}

/// One vertex a cell at the mean of its vertices, numbered by first appearance; faces that collapse or repeat go.
fn clustered(capture: &CaptureView, low: DVec3, cell: f64) -> CaptureView {
    let mut numbers: HashMap<u64, u32> = HashMap::new();
    let mut sums: Vec<(DVec3, f64)> = Vec::new();
    let mut cluster_of = vec![u32::MAX; capture.positions.len()];
    for (cluster, position) in cluster_of.iter_mut().zip(&capture.positions) {
        if position.is_finite() {
            *cluster = *numbers.entry(cell_of(*position, low, cell)).or_insert_with(|| {
                sums.push((DVec3::ZERO, 0.0));
                sums.len() as u32 - 1
            });
            let sum = &mut sums[*cluster as usize];
            *sum = (sum.0 + *position, sum.1 + 1.0);
        }
    }
    let mut known = HashSet::new();
    let mut faces = Vec::new();
    for face in &capture.faces {
        let [a, b, c] = face.map(|vertex| cluster_of[vertex as usize]);
        let is_whole = a != b && b != c && c != a && a.max(b).max(c) != u32::MAX;
        // The same turn of the same three clusters is the same face.
        let smallest = a.min(b).min(c);
        let turned = if smallest == a {
            [a, b, c]
        } else if smallest == b {
            [b, c, a]
        } else {
            [c, a, b]
        };
        if is_whole && known.insert(turned) {
            faces.push(turned);
        }
    }
    CaptureView { positions: sums.iter().map(|(sum, count)| *sum / *count).collect(), faces }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet(side: u32) -> CaptureView {
        let positions =
            (0..side * side).map(|i| DVec3::new(f64::from(i % side), f64::from(i / side), 0.0)).collect();
        let corners = (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| y * side + x));
        let faces = corners.flat_map(|i| [[i, i + 1, i + side + 1], [i, i + side + 1, i + side]]).collect();
        CaptureView { positions, faces }
    }

    fn area(capture: &CaptureView) -> f64 {
        let corner = |face: &[u32; 3]| face.map(|vertex| capture.positions[vertex as usize]);
        capture.faces.iter().map(corner).map(|[a, b, c]| 0.5 * (b - a).cross(c - a).z).sum()
    }

    #[test]
    fn a_small_capture_stays_as_it_is() {
        let capture = sheet(5);
        assert_eq!(decimated(&capture, 25).faces, capture.faces);
    }

    #[test]
    fn a_large_sheet_keeps_its_side_and_nearly_its_area_within_the_limit() {
        let capture = sheet(60);
        let small = decimated(&capture, 400);
        // The search ends within 2 % of the cell size: at least 80 % of the vertices asked for are used.
        assert!(small.positions.len() <= 400 && small.positions.len() > 320, "{}", small.positions.len());
        // Outer cells average inwards by half a cell on each side.
        let cell = 59.0 / 20.0;
        assert!(area(&small) > (59.0 - 1.2 * cell) * (59.0 - 1.2 * cell) && area(&small) <= 59.0 * 59.0);
    }

    #[test]
    fn vertices_that_are_not_finite_go_with_their_faces() {
        let mut capture = sheet(5);
        capture.positions[12] = DVec3::NAN;
        let cleaned = decimated(&capture, 1000);
        assert_eq!(cleaned.positions.len(), 24);
        assert_eq!(cleaned.faces.len(), capture.faces.len() - 6);
    }
}
