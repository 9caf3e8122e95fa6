//! Small repairs of open triangle sheets: even edges, smooth borders, one part.

use glam::DVec3;
use habitus::geometry::components;

use crate::capture::compact;
use crate::isosurface::Triangles;

/// Moves each vertex towards the mean of its neighbours, then back to the zero level of `distance`.
pub(crate) fn even_out(
    positions: &mut [DVec3],
    faces: &[[u32; 3]],
    rounds: usize,
    distance: impl Fn(DVec3) -> f64 + Sync,
) {
    use rayon::prelude::*;
    let neighbours = neighbours(positions.len(), faces);
    for _ in 0..rounds {
        let moved: Vec<DVec3> = positions
            .par_iter()
            .enumerate()
            .map(|(vertex, &position)| {
                let ring = &neighbours[vertex];
                let mean = ring.iter().map(|&other| positions[other as usize]).sum::<DVec3>()
                    / ring.len().max(1) as f64;
                to_zero_level(position.lerp(mean, 0.5), &distance)
            })
            .collect();
        positions.copy_from_slice(&moved);
    }
}

/// One Newton step along a gradient from central differences; steps are bounded where the field is not smooth.
fn to_zero_level(position: DVec3, distance: &impl Fn(DVec3) -> f64) -> DVec3 {
    const REACH: f64 = 1e-3;
    const LONGEST_STEP: f64 = 0.01;
    let slope =
        |axis: DVec3| (distance(position + axis * REACH) - distance(position - axis * REACH)) / (2.0 * REACH);
    let gradient = DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z));
    if gradient.length_squared() < 1e-6 {
        return position;
    }
    position - (gradient * (distance(position) / gradient.length_squared())).clamp_length_max(LONGEST_STEP)
}

fn neighbours(vertex_count: usize, faces: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut neighbours = vec![Vec::new(); vertex_count];
    for &[a, b, c] in faces {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            neighbours[from as usize].push(to);
            neighbours[to as usize].push(from);
        }
    }
    for ring in &mut neighbours {
        ring.sort_unstable();
        ring.dedup();
    }
    neighbours
}

/// Edges that belong to one face only.
fn border_edges(faces: &[[u32; 3]]) -> Vec<[u32; 2]> {
    let mut edges: Vec<[u32; 2]> = faces
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    edges.sort_unstable();
    edges
        .chunk_by(|first, second| first == second)
        .filter(|group| group.len() == 1)
        .map(|group| group[0])
        .collect()
}

/// Takes the staircase out of cut borders: each border vertex moves towards the middle of its border neighbours.
pub(crate) fn smooth_borders(positions: &mut [DVec3], faces: &[[u32; 3]], rounds: usize) {
    let borders = border_edges(faces);
    for _ in 0..rounds {
        let mut sums = vec![(DVec3::ZERO, 0.0_f64); positions.len()];
        for &[a, b] in &borders {
            for (from, to) in [(a, b), (b, a)] {
                sums[to as usize].0 += positions[from as usize];
                sums[to as usize].1 += 1.0;
            }
        }
        for (position, (sum, count)) in positions.iter_mut().zip(sums) {
            if count > 0.0 {
                *position = position.lerp(sum / count, 0.5);
            }
        }
    }
}

/// The connected part with the most faces.
pub(crate) fn largest_part(positions: Vec<DVec3>, mut faces: Vec<[u32; 3]>) -> Triangles {
    let labels = components(positions.len(), &faces);
    let mut counts = std::collections::BTreeMap::new();
    for face in &faces {
        *counts.entry(labels[face[0] as usize]).or_insert(0_usize) += 1;
    }
    let largest = counts.into_iter().max_by_key(|&(label, count)| (count, std::cmp::Reverse(label)));
    faces.retain(|face| Some(labels[face[0] as usize]) == largest.map(|(label, _)| label));
    compact(positions, faces)
}
