//! A surface moved by the rigid motions of a few hundred of its points (Sumner et al. 2007; Li et al. 2009, P3's [18]).
//!
//! `vertex = Σ_j w_j (R_j (v − g_j) + g_j + t_j)`, over the four nearest nodes g_j along the surface. Nodes turn and
//! move but do not stretch: cloth hardly does, and a node then has 6 parameters and not 12.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::{DMat3, DQuat, DVec3};
use habitus_geometry::{Geodesics, Topology, TriangleMesh};

use super::super::deformer::{DeformedSurface, Deformer, DerivativeColumns};
use crate::body::left_jacobian;

/// Nodes that move a vertex (Sumner et al. 2007, §3.2).
const NODES_PER_VERTEX: usize = 4;
/// Parameters of a node: rotation vector, then translation in metres.
pub const NODE_PARAMETERS: usize = 6;

/// The nodes of a surface and what they move.
#[derive(Clone, Debug)]
pub struct DeformationGraph {
    template: Vec<DVec3>,
    nodes: Vec<u32>,
    bindings: Vec<[(u32, f64); NODES_PER_VERTEX]>,
    edges: Vec<[u32; 2]>,
    /// For each node the vertices that it moves most.
    neighbourhoods: Vec<Vec<u32>>,
}

impl DeformationGraph {
    /// Spreads up to `node_count` nodes over a mesh by farthest points along it.
    pub fn new(mesh: &TriangleMesh, node_count: usize) -> Self {
        let topology = Topology::of_mesh(mesh);
        let nodes = farthest_points(mesh.positions(), &topology, node_count.max(1));
        let bindings = bindings(mesh, &nodes);
        let mut edges: Vec<[u32; 2]> = bindings
            .iter()
            .flat_map(|binding| {
                let used = binding.iter().filter(|(_, weight)| *weight > 0.0).map(|(node, _)| *node);
                let used: Vec<u32> = used.collect();
                let pairs =
                    used.iter().enumerate().flat_map(|(k, a)| used[..k].iter().map(move |b| (*a, *b)));
                pairs.map(|(a, b)| [a.min(b), a.max(b)]).collect::<Vec<_>>()
            })
            .collect();
        edges.sort_unstable();
        edges.dedup();
        let mut neighbourhoods = vec![Vec::new(); nodes.len()];
        for (vertex, binding) in bindings.iter().enumerate() {
            for (node, weight) in binding {
                if *weight > 0.0 {
                    neighbourhoods[*node as usize].push(vertex as u32);
                }
            }
        }
        Self { template: mesh.positions().to_vec(), nodes, bindings, edges, neighbourhoods }
    }

    /// The same graph over other positions of the template's vertices, in metres.
    #[must_use]
    pub fn about(&self, positions: &[DVec3]) -> Self {
        assert_eq!(positions.len(), self.template.len(), "one position for each vertex");
        Self { template: positions.to_vec(), ..self.clone() }
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// Pairs of nodes that move a vertex together.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// A node's position on the template, in metres.
    pub fn node(&self, node: usize) -> DVec3 {
        self.template[self.nodes[node] as usize]
    }

    /// The places of a normal matrix over the parameters: nodes meet along edges only.
    pub fn places(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let own = (0..self.nodes.len() as u32).map(|node| [node, node]);
        own.chain(self.edges.iter().copied()).flat_map(|[a, b]| {
            (0..NODE_PARAMETERS).flat_map(move |i| {
                (0..NODE_PARAMETERS)
                    .map(move |j| (a as usize * NODE_PARAMETERS + i, b as usize * NODE_PARAMETERS + j))
            })
        })
    }

    /// The rotation of each node and the parameters that come nearest to a surface of the template's vertices, in metres:
    /// each node takes the rigid motion of its neighbourhood.
    pub fn pose_of(&self, surface: &[DVec3]) -> (Vec<DMat3>, Vec<f64>) {
        let mut rotations = Vec::with_capacity(self.nodes.len());
        let mut parameters = vec![0.0; NODE_PARAMETERS * self.nodes.len()];
        for (node, near) in self.neighbourhoods.iter().enumerate() {
            let count = near.len().max(1) as f64;
            let mean = |positions: &[DVec3]| {
                near.iter().map(|vertex| positions[*vertex as usize]).sum::<DVec3>() / count
            };
            let (from, to) = (mean(&self.template), mean(surface));
            let arms = near.iter().map(|vertex| {
                let vertex = *vertex as usize;
                (self.template[vertex] - from, surface[vertex] - to)
            });
            let rotation = nearest_rotation(arms);
            rotations.push(rotation);
            let centre = self.node(node);
            let translation = to - rotation * (from - centre) - centre;
            parameters[NODE_PARAMETERS * node + 3..NODE_PARAMETERS * (node + 1)]
                .copy_from_slice(&translation.to_array());
        }
        (rotations, parameters)
    }
}

/// The rotation that turns the first of each pair onto the second best (Kabsch 1976), found by the quaternion's power
/// iteration (Horn 1987), which has no trouble with flat neighbourhoods.
fn nearest_rotation(pairs: impl Iterator<Item = (DVec3, DVec3)>) -> DMat3 {
    let mut covariance = DMat3::ZERO;
    for (from, to) in pairs {
        covariance += DMat3::from_cols(from * to.x, from * to.y, from * to.z);
    }
    let c = covariance.to_cols_array_2d();
    let (sxx, sxy, sxz) = (c[0][0], c[1][0], c[2][0]);
    let (syx, syy, syz) = (c[0][1], c[1][1], c[2][1]);
    let (szx, szy, szz) = (c[0][2], c[1][2], c[2][2]);
    let matrix = nalgebra::Matrix4::new(
        sxx + syy + szz,
        syz - szy,
        szx - sxz,
        sxy - syx,
        syz - szy,
        sxx - syy - szz,
        sxy + syx,
        szx + sxz,
        szx - sxz,
        sxy + syx,
        syy - sxx - szz,
        syz + szy,
        sxy - syx,
        szx + sxz,
        syz + szy,
        szz - sxx - syy,
    );
    let eigen = matrix.symmetric_eigen();
    let q = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    let quaternion = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    if quaternion.is_finite() && quaternion.length_squared() > 0.5 {
        DMat3::from_quat(quaternion.normalize())
    } else {
        DMat3::IDENTITY
    }
}

/// A place to visit, nearest first.
#[derive(PartialEq)]
struct Visit {
    distance: f64,
    vertex: u32,
}

impl Eq for Visit {}

impl PartialOrd for Visit {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Visit {
    fn cmp(&self, other: &Self) -> Ordering {
        other.distance.total_cmp(&self.distance).then(other.vertex.cmp(&self.vertex))
    }
}

/// Farthest-point sampling with distances along edges; every connected piece gets one node at least.
fn farthest_points(positions: &[DVec3], topology: &Topology, count: usize) -> Vec<u32> {
    let mut distances = vec![f64::INFINITY; positions.len()];
    let is_used = |vertex: usize| !topology.one_ring(vertex).is_empty();
    let mut chosen = Vec::new();
    let mut heap = BinaryHeap::new();
    while chosen.len() < count {
        let farthest = (0..positions.len())
            .filter(|vertex| is_used(*vertex))
            .max_by(|a, b| distances[*a].total_cmp(&distances[*b]).then(b.cmp(a)));
        let Some(farthest) = farthest.filter(|vertex| distances[*vertex] > 0.0) else { break };
        chosen.push(farthest as u32);
        distances[farthest] = 0.0;
        heap.push(Visit { distance: 0.0, vertex: farthest as u32 });
        while let Some(Visit { distance, vertex }) = heap.pop() {
            if distance > distances[vertex as usize] {
                continue;
            }
            for neighbour in topology.one_ring(vertex as usize) {
                let step = positions[vertex as usize].distance(positions[*neighbour as usize]);
                if distance + step < distances[*neighbour as usize] {
                    distances[*neighbour as usize] = distance + step;
                    heap.push(Visit { distance: distance + step, vertex: *neighbour });
                }
            }
        }
    }
    chosen
}

/// The four nearest nodes of each vertex with the weights (1 − d/d_max)² of Sumner et al. 2007, Eq. 4; d_max is the
/// distance of the fifth.
fn bindings(mesh: &TriangleMesh, nodes: &[u32]) -> Vec<[(u32, f64); NODES_PER_VERTEX]> {
    let geodesics = Geodesics::new(mesh.positions(), mesh.faces());
    let area: f64 = (0..mesh.faces().len())
        .map(|face| {
            let [a, b, c] = mesh.corners(face);
            0.5 * (b - a).cross(c - a).length()
        })
        .sum();
    // Nodes lie about √(area / count) apart; the radius grows until every vertex that can be reached has found five.
    let mut radius = 2.2 * (area / nodes.len() as f64).sqrt();
    let largest = mesh.positions().iter().fold(0.0_f64, |far, p| far.max(p.distance(mesh.positions()[0])));
    let mut found: Vec<Vec<(f64, u32)>> = vec![Vec::new(); mesh.positions().len()];
    loop {
        found.iter_mut().for_each(Vec::clear);
        for (node, near) in geodesics.within_many(nodes, radius).into_iter().enumerate() {
            for (vertex, distance) in near {
                found[vertex as usize].push((distance, node as u32));
            }
        }
        let poorest = found.iter().map(Vec::len).min().unwrap_or(0);
        if poorest > NODES_PER_VERTEX || radius > 4.0 * largest {
            break;
        }
        radius *= 1.6;
    }
    found
        .iter_mut()
        .enumerate()
        .map(|(vertex, near)| {
            near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            binding(near, mesh.positions()[vertex], mesh.positions(), nodes)
        })
        .collect()
}

fn binding(
    near: &[(f64, u32)],
    position: DVec3,
    positions: &[DVec3],
    nodes: &[u32],
) -> [(u32, f64); NODES_PER_VERTEX] {
    let mut binding = [(0, 0.0); NODES_PER_VERTEX];
    let Some((farthest, _)) = near.get(NODES_PER_VERTEX).or(near.last()) else {
        // A vertex without faces: the nearest node in space carries it.
        let distance = |node: usize| positions[nodes[node] as usize].distance_squared(position);
        let nearest = (0..nodes.len()).min_by(|a, b| distance(*a).total_cmp(&distance(*b)));
        binding[0] = (nearest.unwrap_or(0) as u32, 1.0);
        return binding;
    };
    let mut sum = 0.0;
    for (slot, (distance, node)) in binding.iter_mut().zip(near) {
        let weight = (1.0 - distance / (farthest * (1.0 + 1e-6)).max(1e-9)).max(1e-6).powi(2);
        *slot = (*node, weight);
        sum += weight;
    }
    binding.iter_mut().for_each(|(_, weight)| *weight /= sum);
    binding
}

/// A graph about given rotations of its nodes: parameters are small turns from them, and translations.
pub struct GraphDeformer<'a> {
    graph: &'a DeformationGraph,
    rotations: Vec<DMat3>,
}

impl<'a> GraphDeformer<'a> {
    /// Turns count from `rotations`, one for each node.
    pub fn new(graph: &'a DeformationGraph, rotations: Vec<DMat3>) -> Self {
        assert_eq!(rotations.len(), graph.node_count(), "one rotation for each node");
        Self { graph, rotations }
    }

    /// The motion of each node at these parameters.
    pub fn motions(&self, parameters: &[f64]) -> Vec<NodeMotion> {
        self.rotations
            .iter()
            .zip(parameters.as_chunks::<NODE_PARAMETERS>().0)
            .map(|(base, own)| {
                let turn = DVec3::from_slice(own);
                NodeMotion {
                    rotation: DMat3::from_quat(DQuat::from_scaled_axis(turn)) * *base,
                    translation: DVec3::from_slice(&own[3..]),
                    turn_derivative: left_jacobian(turn),
                }
            })
            .collect()
    }

    /// The graph.
    pub fn graph(&self) -> &DeformationGraph {
        self.graph
    }
}

/// The motion of one node.
#[derive(Clone, Copy, Debug)]
pub struct NodeMotion {
    /// Deformed from template.
    pub rotation: DMat3,
    /// In metres.
    pub translation: DVec3,
    /// Column k is the angular velocity that rotation parameter k causes.
    pub turn_derivative: DMat3,
}

impl Deformer for GraphDeformer<'_> {
    fn parameter_count(&self) -> usize {
        NODE_PARAMETERS * self.graph.node_count()
    }

    fn deform<'a>(&'a self, parameters: &'a [f64]) -> Box<dyn DeformedSurface + 'a> {
        let motions = self.motions(parameters);
        let graph = self.graph;
        let vertices = graph
            .template
            .iter()
            .zip(&graph.bindings)
            .map(|(position, binding)| {
                let moved = |(node, weight): &(u32, f64)| {
                    let (centre, motion) = (graph.node(*node as usize), &motions[*node as usize]);
                    (motion.rotation * (*position - centre) + centre + motion.translation) * *weight
                };
                binding.iter().filter(|(_, weight)| *weight > 0.0).map(moved).sum()
            })
            .collect();
        Box::new(GraphSurface { graph, motions, vertices })
    }
}

struct GraphSurface<'a> {
    graph: &'a DeformationGraph,
    motions: Vec<NodeMotion>,
    vertices: Vec<DVec3>,
}

impl DeformedSurface for GraphSurface<'_> {
    fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    fn vertex_derivatives(&self, vertex: usize, columns: &mut DerivativeColumns) {
        for (node, weight) in self.graph.bindings[vertex].iter().filter(|(_, weight)| *weight > 0.0) {
            let motion = &self.motions[*node as usize];
            let arm = motion.rotation * (self.graph.template[vertex] - self.graph.node(*node as usize));
            let first = *node as usize * NODE_PARAMETERS;
            for axis in 0..3 {
                columns.push((first + axis, motion.turn_derivative.col(axis).cross(arm) * *weight));
            }
            for (axis, direction) in DVec3::AXES.into_iter().enumerate() {
                columns.push((first + 3 + axis, direction * *weight));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use habitus_optimize::{
        NormalEquations, Objective, SparseCholesky, SparseNormalEquations, SymmetricMatrix,
        assert_derivatives_match,
    };

    use super::*;
    use crate::fitting::correspondence::Correspondence;
    use crate::fitting::terms::{ClosestPoints, DistanceForm, GraphRigidity, GraphSmoothness};
    use crate::fitting::{Fit, Term};

    /// A bumpy sheet of 0.9 m × 0.8 m.
    fn sheet() -> TriangleMesh {
        let (columns, rows) = (10_u32, 9_u32);
        let positions = (0..columns * rows).map(|k| {
            let (x, y) = (0.1 * f64::from(k % columns), 0.1 * f64::from(k / columns));
            DVec3::new(x, y, 0.08 * (7.0 * x).sin() * (5.0 * y).cos())
        });
        let at = |column: u32, row: u32| row * columns + column;
        let faces = (0..rows - 1).flat_map(|row| {
            (0..columns - 1).flat_map(move |column| {
                let [a, b] = [at(column, row), at(column + 1, row)];
                let [c, d] = [at(column, row + 1), at(column + 1, row + 1)];
                [[a, b, c], [b, d, c]]
            })
        });
        TriangleMesh::new(positions.collect(), faces.collect()).expect("a sheet")
    }

    fn wavy(count: usize, size: f64) -> Vec<f64> {
        (0..count).map(|k| size * (1.7 * k as f64 + 0.3).sin()).collect()
    }

    fn turned(graph: &DeformationGraph) -> Vec<DMat3> {
        let turn = |node| DMat3::from_rotation_y(0.1 * node as f64) * DMat3::from_rotation_x(0.5);
        (0..graph.node_count()).map(turn).collect()
    }

    #[test]
    fn derivatives_of_every_term_over_a_deformation_graph_follow_from_its_values() {
        let graph = DeformationGraph::new(&sheet(), 7);
        let deformer = GraphDeformer::new(&graph, turned(&graph));
        let pairs: Vec<Correspondence> = (0..90)
            .step_by(4)
            .map(|vertex| Correspondence {
                vertex,
                target: DVec3::new(0.3, 0.1 * f64::from(vertex % 7), 0.2),
                normal: DVec3::new(0.6, 0.0, 0.8),
                is_outside: true,
                signed_distance: 0.1,
                weight: 0.5 + 0.01 * f64::from(vertex),
            })
            .collect();
        let plane = ClosestPoints::new(&pairs, DistanceForm::Plane);
        let point = ClosestPoints::new(&pairs, DistanceForm::Point);
        let (rigidity, smoothness) = (GraphRigidity(&deformer), GraphSmoothness(&deformer));
        let terms: [&dyn Term; 4] = [&plane, &point, &rigidity, &smoothness];
        for size in [0.0, 0.4] {
            let at = wavy(deformer.parameter_count(), size);
            for term in terms {
                assert_derivatives_match(&Fit::new(&deformer).with(2.0, term), &at);
            }
            let all = terms.iter().fold(Fit::new(&deformer), |fit, term| fit.with(0.7, *term));
            assert_derivatives_match(&all, &at);
            assert_sparse_sums_are_the_dense_ones(&all, &graph, &at);
        }
    }

    fn assert_sparse_sums_are_the_dense_ones(
        objective: &dyn Objective,
        graph: &DeformationGraph,
        at: &[f64],
    ) {
        let pattern = SymmetricMatrix::with_places(at.len(), graph.places());
        let mut sparse = SparseNormalEquations::new(&pattern);
        sparse.evaluate(objective, at);
        let dense = NormalEquations::of(objective, at);
        assert!((sparse.value - dense.value).abs() < 1e-12 * dense.value.max(1.0));
        for column in 0..at.len() {
            let mut unit = vec![0.0; at.len()];
            unit[column] = 1.0;
            for (row, value) in sparse.matrix.times(&unit).into_iter().enumerate() {
                let expected = dense.matrix[(row.max(column), row.min(column))];
                assert!((value - expected).abs() < 1e-10, "({row}, {column}): {value} is not {expected}");
            }
            assert!((sparse.half_gradient[column] - dense.half_gradient[column]).abs() < 1e-10);
        }
        assert!(SparseCholesky::analyse(&pattern).is_ok());
    }

    #[test]
    fn a_rigid_motion_of_all_nodes_moves_the_surface_rigidly_at_no_cost() {
        let mesh = sheet();
        let graph = DeformationGraph::new(&mesh, 12);
        let (turn, shift) =
            (DMat3::from_rotation_z(1.9) * DMat3::from_rotation_x(0.7), DVec3::new(1.0, -2.0, 0.5));
        let moved: Vec<DVec3> = mesh.positions().iter().map(|p| turn * *p + shift).collect();
        let (rotations, parameters) = graph.pose_of(&moved);
        let deformer = GraphDeformer::new(&graph, rotations);
        for (a, b) in deformer.deform(&parameters).vertices().iter().zip(&moved) {
            assert!(a.distance(*b) < 1e-12);
        }
        let (rigidity, smoothness) = (GraphRigidity(&deformer), GraphSmoothness(&deformer));
        let objective = Fit::new(&deformer).with(1.0, &rigidity).with(1.0, &smoothness);
        assert!(NormalEquations::of(&objective, &parameters).value < 1e-24);
    }

    #[test]
    fn nodes_spread_over_every_piece_and_weights_sum_to_one() {
        let mesh = sheet();
        let offset = mesh.positions().len() as u32;
        let far = mesh.positions().iter().map(|p| *p + DVec3::Z * 9.0);
        let positions = mesh.positions().iter().copied().chain(far).collect();
        let other = mesh.faces().iter().map(|face| face.map(|vertex| vertex + offset));
        let faces = mesh.faces().iter().copied().chain(other).collect();
        let both = TriangleMesh::new(positions, faces).expect("two sheets");
        let graph = DeformationGraph::new(&both, 20);
        assert_eq!(graph.node_count(), 20);
        let on_first = graph.nodes.iter().filter(|node| **node < offset).count();
        assert!((8..=12).contains(&on_first), "equal sheets get about as many nodes: {on_first}");
        for (vertex, binding) in graph.bindings.iter().enumerate() {
            assert!((binding.iter().map(|(_, weight)| weight).sum::<f64>() - 1.0).abs() < 1e-12);
            for (node, weight) in binding {
                let same_piece = (graph.nodes[*node as usize] < offset) == ((vertex as u32) < offset);
                assert!(same_piece || *weight == 0.0, "a node moves the other piece");
            }
        }
    }
}
