//! Patches of a template: the vertices within a distance over its edges of each vertex.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use glam::DVec3;
use habitus_geometry::{Topology, TriangleMesh};
use rayon::prelude::*;

/// A patch around each vertex of a template.
#[derive(Clone, Debug, PartialEq)]
pub struct Patches {
    /// Where each vertex's patch starts in `members`; one more than there are vertices.
    starts: Vec<usize>,
    members: Vec<u32>,
    /// A third of the area of the faces around each vertex, square metres.
    areas: Vec<f64>,
}

/// The patch whose mean residual is largest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorstPatch {
    /// Its mean residual, metres.
    pub mean: f64,
    /// Its middle.
    pub vertex: u32,
}

impl Patches {
    /// Patches of a template whose vertices lie within `radius` metres over edges: an upper bound of the geodesic
    /// distance, at most some tenths too long on an even mesh.
    pub fn of_template(positions: &[DVec3], faces: &[[u32; 3]], radius: f64) -> Self {
        let topology = Topology::new(positions.len(), faces);
        let patches: Vec<Vec<u32>> = (0..positions.len())
            .into_par_iter()
            .map(|vertex| within(positions, &topology, vertex as u32, radius))
            .collect();
        let mut starts = vec![0];
        starts.extend(patches.iter().scan(0, |end, patch| {
            *end += patch.len();
            Some(*end)
        }));
        let mut areas = vec![0.0; positions.len()];
        for face in faces {
            let [a, b, c] = face.map(|vertex| positions[vertex as usize]);
            let share = (b - a).cross(c - a).length() / 6.0;
            face.iter().for_each(|vertex| areas[*vertex as usize] += share);
        }
        Self { starts, members: patches.concat(), areas }
    }

    /// The vertices of the patch around a vertex, in ascending order.
    pub fn of(&self, vertex: usize) -> &[u32] {
        &self.members[self.starts[vertex]..self.starts[vertex + 1]]
    }

    /// The patch whose area-weighted mean residual is largest. A patch counts if residuals are known on half of it.
    pub fn worst(&self, residual: &[Option<f64>]) -> WorstPatch {
        let mean = |vertex: usize| {
            let (mut sum, mut known, mut all) = (0.0, 0.0, 0.0);
            for member in self.of(vertex) {
                let area = self.areas[*member as usize];
                all += area;
                if let Some(residual) = residual[*member as usize] {
                    sum += area * residual;
                    known += area;
                }
            }
            (known > 0.5 * all).then(|| sum / known)
        };
        let count = (self.starts.len() - 1).min(residual.len());
        let means: Vec<Option<f64>> = (0..count).into_par_iter().map(mean).collect();
        let known = means.iter().enumerate().filter_map(|(vertex, mean)| mean.map(|mean| (vertex, mean)));
        known.fold(WorstPatch::default(), |worst, (vertex, mean)| {
            if mean > worst.mean { WorstPatch { mean, vertex: vertex as u32 } } else { worst }
        })
    }
}

/// Dijkstra's search, ended at `radius`.
fn within(positions: &[DVec3], topology: &Topology, start: u32, radius: f64) -> Vec<u32> {
    // Distances are not negative, so that their bits order as they do.
    let mut queue = BinaryHeap::from([(Reverse(0_u64), start)]);
    let mut distances = HashMap::from([(start, 0.0)]);
    while let Some((Reverse(bits), vertex)) = queue.pop() {
        let distance = f64::from_bits(bits);
        if distances.get(&vertex).is_some_and(|known| distance > *known) {
            continue;
        }
        for other in topology.one_ring(vertex as usize) {
            let reached = distance + positions[vertex as usize].distance(positions[*other as usize]);
            let is_nearer = distances.get(other).is_none_or(|known| reached < *known);
            if is_nearer && reached <= radius {
                distances.insert(*other, reached);
                queue.push((Reverse(reached.to_bits()), *other));
            }
        }
    }
    let mut members: Vec<u32> = distances.into_keys().collect();
    members.sort_unstable();
    members
}

/// For each face, which of the edges opposite its corners, and which corners, lie on the border.
pub(super) struct BorderCorners(Vec<[bool; 6]>);

pub(super) fn border_corners(mesh: &TriangleMesh) -> BorderCorners {
    let topology = Topology::of_mesh(mesh);
    let mut is_border_vertex = vec![false; mesh.positions().len()];
    let mut border_edges: Vec<[u32; 2]> = topology.boundary_edges().collect();
    border_edges.sort_unstable();
    border_edges.iter().flatten().for_each(|vertex| is_border_vertex[*vertex as usize] = true);
    let is_border = |a: u32, b: u32| border_edges.binary_search(&[a.min(b), a.max(b)]).is_ok();
    let faces = mesh.faces().iter().map(|[a, b, c]| {
        let corners = [*a, *b, *c].map(|vertex| is_border_vertex[vertex as usize]);
        [is_border(*b, *c), is_border(*c, *a), is_border(*a, *b), corners[0], corners[1], corners[2]]
    });
    BorderCorners(faces.collect())
}

/// Whether a point of a face lies on a border: on one of its border edges, or at a corner where others have one.
pub(super) fn lies_on_border(border: &BorderCorners, face: u32, weights: [f64; 3]) -> bool {
    let is_on = border.0[face as usize];
    (0..3).any(|k| (is_on[k] && weights[k] < 1e-9) || (is_on[k + 3] && weights[k] > 1.0 - 1e-9))
}
