//! How faces hang together: edges, borders, one-rings, components.

use crate::mesh::TriangleMesh;

/// The edges of a face list with what meets at them.
#[derive(Debug, Clone)]
pub struct Topology {
    vertex_count: usize,
    face_count: usize,
    edges: Vec<[u32; 2]>,
    edge_faces: Vec<u32>,
    edge_face_offsets: Vec<u32>,
    ring: Vec<u32>,
    ring_offsets: Vec<u32>,
    is_consistently_wound: bool,
    has_one_fan_per_vertex: bool,
}

impl Topology {
    /// Finds the edges of these faces; every face index must be below `vertex_count`.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]]) -> Self {
        let mut half_edges: Vec<HalfEdge> = faces.iter().enumerate().flat_map(half_edges_of).collect();
        half_edges.sort_unstable();

        let mut topology = Self {
            vertex_count,
            face_count: faces.len(),
            edges: Vec::with_capacity(half_edges.len() / 2 + 1),
            edge_faces: half_edges.iter().map(|half_edge| half_edge.face).collect(),
            edge_face_offsets: vec![0],
            ring: Vec::new(),
            ring_offsets: vec![0; vertex_count + 1],
            is_consistently_wound: true,
            has_one_fan_per_vertex: every_vertex_has_one_fan(vertex_count, faces),
        };
        for group in half_edges.chunk_by(|first, second| first.ends == second.ends) {
            topology.edges.push(group[0].ends);
            let end = topology.edge_face_offsets[topology.edges.len() - 1] + group.len() as u32;
            topology.edge_face_offsets.push(end);
            // Two faces that agree on which side is out run along their edge in opposite directions.
            if group.len() == 2 && group[0].is_ascending == group[1].is_ascending {
                topology.is_consistently_wound = false;
            }
        }
        topology.fill_rings();
        topology
    }

    /// The topology of a mesh.
    pub fn of_mesh(mesh: &TriangleMesh) -> Self {
        Self::new(mesh.positions().len(), mesh.faces())
    }

    fn fill_rings(&mut self) {
        for edge in &self.edges {
            for vertex in edge {
                self.ring_offsets[*vertex as usize + 1] += 1;
            }
        }
        for vertex in 0..self.vertex_count {
            self.ring_offsets[vertex + 1] += self.ring_offsets[vertex];
        }
        let mut next = self.ring_offsets.clone();
        self.ring = vec![0; 2 * self.edges.len()];
        for &[low, high] in &self.edges {
            for (vertex, neighbour) in [(low, high), (high, low)] {
                self.ring[next[vertex as usize] as usize] = neighbour;
                next[vertex as usize] += 1;
            }
        }
    }

    /// The edges, each once with its lower vertex first, in ascending order.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// The faces at an edge (by its place in [`Topology::edges`]), in ascending order: one on a border, two inside.
    pub fn edge_faces(&self, edge: usize) -> &[u32] {
        &self.edge_faces[self.edge_face_offsets[edge] as usize..self.edge_face_offsets[edge + 1] as usize]
    }

    /// The vertices joined to a vertex by an edge, in ascending order.
    pub fn one_ring(&self, vertex: usize) -> &[u32] {
        &self.ring[self.ring_offsets[vertex] as usize..self.ring_offsets[vertex + 1] as usize]
    }

    /// The edges with one face only.
    pub fn boundary_edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        (0..self.edges.len()).filter(|&edge| self.edge_faces(edge).len() == 1).map(|edge| self.edges[edge])
    }

    /// The edges with more than two faces.
    pub fn non_manifold_edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        (0..self.edges.len()).filter(|&edge| self.edge_faces(edge).len() > 2).map(|edge| self.edges[edge])
    }

    /// True where two faces that share an edge never disagree about the outside.
    pub fn is_consistently_wound(&self) -> bool {
        self.is_consistently_wound
    }

    /// True where every edge has two faces of equal winding and the faces around every used vertex form one fan.
    pub fn is_closed_manifold(&self) -> bool {
        (0..self.edges.len()).all(|edge| self.edge_faces(edge).len() == 2)
            && self.is_consistently_wound
            && self.has_one_fan_per_vertex
    }

    /// Used vertices − edges + faces: 2 for a sphere, 0 for a torus.
    pub fn euler_characteristic(&self) -> i64 {
        let used_vertices =
            (0..self.vertex_count).filter(|&vertex| !self.one_ring(vertex).is_empty()).count();
        used_vertices as i64 - self.edges.len() as i64 + self.face_count as i64
    }

    /// The borders as closed loops of vertices; a pinched border gives several loops.
    pub fn boundary_loops(&self) -> Vec<Vec<u32>> {
        let mut neighbours = std::collections::BTreeMap::<u32, Vec<u32>>::new();
        for [low, high] in self.boundary_edges() {
            neighbours.entry(low).or_default().push(high);
            neighbours.entry(high).or_default().push(low);
        }
        let mut loops = Vec::new();
        while let Some((&start, _)) = neighbours.iter().find(|(_, open)| !open.is_empty()) {
            let mut border = vec![start];
            let mut vertex = start;
            while let Some(next) = neighbours.get_mut(&vertex).and_then(Vec::pop) {
                if let Some(back) = neighbours.get_mut(&next)
                    && let Some(place) = back.iter().position(|&other| other == vertex)
                {
                    back.swap_remove(place);
                }
                if next == start {
                    break;
                }
                border.push(next);
                vertex = next;
            }
            loops.push(border);
        }
        loops
    }
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct HalfEdge {
    ends: [u32; 2],
    face: u32,
    is_ascending: bool,
}

fn half_edges_of((face, corners): (usize, &[u32; 3])) -> [HalfEdge; 3] {
    [0, 1, 2].map(|corner| {
        let (from, to) = (corners[corner], corners[(corner + 1) % 3]);
        HalfEdge { ends: [from.min(to), from.max(to)], face: face as u32, is_ascending: from < to }
    })
}

/// Where all edges are manifold, a vertex with two fans is one where two sheets only touch.
fn every_vertex_has_one_fan(vertex_count: usize, faces: &[[u32; 3]]) -> bool {
    // Around one vertex each face leads from its next corner to its previous one; one fan is one cycle.
    let mut around: Vec<Vec<(u32, u32)>> = vec![Vec::new(); vertex_count];
    for [a, b, c] in faces.iter().copied() {
        for (vertex, from, to) in [(a, b, c), (b, c, a), (c, a, b)] {
            around[vertex as usize].push((from, to));
        }
    }
    around.iter().filter(|fan| !fan.is_empty()).all(|fan| {
        let start = fan[0].0;
        let mut vertex = start;
        for step in 1..=fan.len() {
            let Some(&(_, to)) = fan.iter().find(|(from, _)| *from == vertex) else { return false };
            vertex = to;
            if vertex == start {
                return step == fan.len();
            }
        }
        false
    })
}

/// The component of each vertex: labels count from 0 in the order of each component's lowest vertex.
pub fn components(vertex_count: usize, faces: &[[u32; 3]]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..vertex_count as u32).collect();
    for [a, b, c] in faces.iter().copied() {
        for (one, other) in [(a, b), (b, c)] {
            let (one, other) = (root(&mut parent, one), root(&mut parent, other));
            // The lower vertex leads, so that labels do not hang on the order of the faces.
            parent[one.max(other) as usize] = one.min(other);
        }
    }
    let mut labels = vec![u32::MAX; vertex_count];
    let mut label_count = 0;
    for vertex in 0..vertex_count {
        let leader = root(&mut parent, vertex as u32) as usize;
        if labels[leader] == u32::MAX {
            labels[leader] = label_count;
            label_count += 1;
        }
        labels[vertex] = labels[leader];
    }
    labels
}

fn root(parent: &mut [u32], mut vertex: u32) -> u32 {
    while parent[vertex as usize] != vertex {
        parent[vertex as usize] = parent[parent[vertex as usize] as usize];
        vertex = parent[vertex as usize];
    }
    vertex
}

#[cfg(test)]
mod tests {
    use super::*;

    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];

    #[test]
    fn a_tetrahedron_is_a_closed_sphere() {
        let topology = Topology::new(4, &TETRAHEDRON);
        assert_eq!(topology.edges().len(), 6);
        assert_eq!(topology.euler_characteristic(), 2);
        assert!(topology.is_closed_manifold());
        assert_eq!(topology.boundary_edges().count(), 0);
        assert_eq!(topology.one_ring(2), [0, 1, 3]);
        assert_eq!(topology.edge_faces(0), [0, 1]);
    }

    #[test]
    fn a_missing_face_leaves_one_border_of_three() {
        let topology = Topology::new(4, &TETRAHEDRON[..3]);
        assert!(!topology.is_closed_manifold());
        let loops = topology.boundary_loops();
        assert_eq!(loops.len(), 1);
        let mut border = loops[0].clone();
        border.sort_unstable();
        assert_eq!(border, [0, 2, 3]);
    }

    #[test]
    fn a_flipped_face_is_noticed() {
        let mut faces = TETRAHEDRON;
        faces[0].swap(0, 1);
        let topology = Topology::new(4, &faces);
        assert!(!topology.is_consistently_wound());
        assert!(!topology.is_closed_manifold());
    }

    #[test]
    fn two_tetrahedra_that_touch_in_a_vertex_are_no_manifold() {
        let mut faces = TETRAHEDRON.to_vec();
        faces.extend(TETRAHEDRON.map(|face| face.map(|vertex| if vertex == 0 { 0 } else { vertex + 3 })));
        let topology = Topology::new(7, &faces);
        assert!(topology.is_consistently_wound());
        assert!(!topology.is_closed_manifold());
    }

    #[test]
    fn components_are_labelled_by_their_lowest_vertex() {
        assert_eq!(components(7, &[[5, 2, 6], [0, 1, 3]]), [0, 0, 1, 0, 2, 1, 1]);
    }

    #[test]
    fn three_faces_at_an_edge_are_reported() {
        let topology = Topology::new(5, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]);
        assert_eq!(topology.non_manifold_edges().collect::<Vec<_>>(), [[0, 1]]);
    }
}
