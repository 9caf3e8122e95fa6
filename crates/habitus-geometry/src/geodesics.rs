//! Exact geodesic distances on a triangle mesh, inside a radius around a vertex.
//!
//! Windows (intervals of edges that a straight line from the source reaches) are unfolded face by face, nearest first
//! (Chen and Han 1990; Xin and Wang 2009). Lines bend only at saddles and borders, which become sources of their own.
//! Distances are those of the polyhedron itself, exact but for rounding: no error of the discretisation, unlike
//! distances along edges, by heat or by fast marching.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::normals::corner_angles;

/// No face on the other side of an edge.
const NONE: u32 = u32::MAX;
/// Windows of one source at most; only a mesh with faces of no height comes near, and keeps distances along edges there.
const MOST_WINDOWS: usize = 1_000_000;
/// Sources per parallel piece.
const SOURCE_CHUNK: usize = 32;
/// Relative rounding that a comparison of two distances may suffer from.
const ROUNDING: f64 = 1e-12;

/// A mesh prepared for distances along its surface.
#[derive(Debug, Clone)]
pub struct Geodesics {
    positions: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    /// For half-edge `3 · face + corner`, which runs from that corner to the next, its twin in the face beyond.
    twins: Vec<u32>,
    /// Length of each half-edge.
    lengths: Vec<f64>,
    /// For each vertex the half-edges that leave it, one for each of its faces.
    leaving: Vec<u32>,
    leaving_starts: Vec<u32>,
    /// Saddles and border vertices: a shortest path may bend there.
    bends: Vec<bool>,
}

/// Memory that many searches share.
#[derive(Debug, Clone, Default)]
pub struct GeodesicWorkspace {
    distances: Vec<f64>,
    touched: Vec<u32>,
    events: BinaryHeap<Event>,
}

/// What happens next, nearest first.
#[derive(Debug, Clone, Copy)]
struct Event {
    distance: f64,
    what: What,
}

#[derive(Debug, Clone, Copy)]
enum What {
    Vertex(u32),
    Window(Window),
}

/// An interval of a half-edge, seen in the plane where that edge runs along x from 0 and its face lies above.
#[derive(Debug, Clone, Copy)]
struct Window {
    half_edge: u32,
    interval: [f64; 2],
    /// The unfolded source, below the edge.
    source: DVec2,
    /// Distance of that source from the first one.
    base: f64,
}

impl PartialEq for Event {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Event {}

impl PartialOrd for Event {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Event {
    /// The heap gives the greatest first, so the nearest is the greatest.
    fn cmp(&self, other: &Self) -> Ordering {
        other.distance.total_cmp(&self.distance)
    }
}

impl Geodesics {
    /// Prepares faces whose indices are in range. Edges of other than two faces with equal winding count as borders.
    pub fn new(positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        let half_edge_count = 3 * faces.len();
        let ends = |half_edge: usize| {
            let [a, b, c] = faces[half_edge / 3];
            match half_edge % 3 {
                0 => [a, b],
                1 => [b, c],
                _ => [c, a],
            }
        };
        let mut sorted: Vec<(u32, u32, u32)> = (0..half_edge_count)
            .map(|half_edge| {
                let [from, to] = ends(half_edge);
                (from.min(to), from.max(to), half_edge as u32)
            })
            .collect();
        sorted.sort_unstable();
        let mut twins = vec![NONE; half_edge_count];
        for group in sorted.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            if let [(.., one), (.., other)] = *group
                && ends(one as usize)[0] != ends(other as usize)[0]
            {
                twins[one as usize] = other;
                twins[other as usize] = one;
            }
        }
        let mut leaving_starts = vec![0; positions.len() + 1];
        for face in faces {
            face.iter().for_each(|vertex| leaving_starts[*vertex as usize + 1] += 1);
        }
        for vertex in 0..positions.len() {
            leaving_starts[vertex + 1] += leaving_starts[vertex];
        }
        let mut next = leaving_starts.clone();
        let mut leaving = vec![0; half_edge_count];
        let mut angle_sums = vec![0.0; positions.len()];
        let mut bends = vec![false; positions.len()];
        for (face, corners) in faces.iter().enumerate() {
            let angles = corner_angles(corners.map(|vertex| positions[vertex as usize]));
            for corner in 0..3 {
                let vertex = corners[corner] as usize;
                let half_edge = 3 * face + corner;
                leaving[next[vertex] as usize] = half_edge as u32;
                next[vertex] += 1;
                angle_sums[vertex] += angles[corner];
                if twins[half_edge] == NONE {
                    ends(half_edge).iter().for_each(|end| bends[*end as usize] = true);
                }
            }
        }
        for (bends, angle) in bends.iter_mut().zip(&angle_sums) {
            *bends |= *angle > std::f64::consts::TAU * (1.0 + ROUNDING);
        }
        let length = |half_edge| {
            let [from, to] = ends(half_edge);
            positions[from as usize].distance(positions[to as usize])
        };
        Self {
            lengths: (0..half_edge_count).map(length).collect(),
            positions: positions.to_vec(),
            faces: faces.to_vec(),
            twins,
            leaving,
            leaving_starts,
            bends,
        }
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.positions.len()
    }

    /// All vertices within `radius` of a vertex along the surface, with their distances, in ascending order of vertices;
    /// the vertex itself is among them.
    pub fn within(&self, source: u32, radius: f64) -> Vec<(u32, f64)> {
        let mut found = Vec::new();
        self.within_into(source, radius, &mut GeodesicWorkspace::default(), &mut found);
        found
    }

    /// [`Geodesics::within`] for many sources, in parallel.
    pub fn within_many(&self, sources: &[u32], radius: f64) -> Vec<Vec<(u32, f64)>> {
        sources
            .par_iter()
            .with_min_len(SOURCE_CHUNK)
            .map_init(GeodesicWorkspace::default, |workspace, source| {
                let mut found = Vec::new();
                self.within_into(*source, radius, workspace, &mut found);
                found
            })
            .collect()
    }

    /// [`Geodesics::within`] without allocation.
    pub fn within_into(
        &self,
        source: u32,
        radius: f64,
        workspace: &mut GeodesicWorkspace,
        found: &mut Vec<(u32, f64)>,
    ) {
        workspace.distances.resize(self.positions.len(), f64::INFINITY);
        workspace.touched.clear();
        workspace.events.clear();
        let mut search = Search { mesh: self, radius, memory: workspace };
        search.reach(source, 0.0);
        search.run(source);
        workspace.touched.sort_unstable();
        found.clear();
        for vertex in &workspace.touched {
            found.push((*vertex, workspace.distances[*vertex as usize]));
            workspace.distances[*vertex as usize] = f64::INFINITY;
        }
    }

    fn leaving(&self, vertex: u32) -> &[u32] {
        let range = self.leaving_starts[vertex as usize]..self.leaving_starts[vertex as usize + 1];
        &self.leaving[range.start as usize..range.end as usize]
    }

    /// The vertex that a half-edge leaves.
    fn origin(&self, half_edge: u32) -> u32 {
        self.faces[half_edge as usize / 3][half_edge as usize % 3]
    }

    /// The third corner of a half-edge's face, in the plane where the edge runs along x from 0.
    fn apex(&self, half_edge: u32) -> DVec2 {
        let length = self.lengths[half_edge as usize];
        let to_end = self.lengths[following(half_edge) as usize];
        let from_start = self.lengths[following(following(half_edge)) as usize];
        let x = (length * length + from_start * from_start - to_end * to_end) / (2.0 * length);
        DVec2::new(x, (from_start * from_start - x * x).max(0.0).sqrt())
    }
}

/// The next half-edge around the same face.
fn following(half_edge: u32) -> u32 {
    if half_edge % 3 == 2 { half_edge - 2 } else { half_edge + 1 }
}

struct Search<'a> {
    mesh: &'a Geodesics,
    radius: f64,
    memory: &'a mut GeodesicWorkspace,
}

impl Search<'_> {
    fn run(&mut self, source: u32) {
        let mut window_count = 0;
        while let Some(Event { distance, what }) = self.memory.events.pop() {
            match what {
                What::Vertex(vertex) if distance > self.memory.distances[vertex as usize] => {}
                What::Vertex(vertex) => {
                    self.relax_edges(vertex, distance);
                    if vertex == source || self.mesh.bends[vertex as usize] {
                        self.emit_windows(vertex, distance);
                    }
                }
                What::Window(window) if window_count < MOST_WINDOWS => {
                    window_count += 1;
                    self.unfold(&window);
                }
                What::Window(_) => {}
            }
        }
    }

    /// A path of this length leads to a vertex.
    fn reach(&mut self, vertex: u32, distance: f64) {
        let known = &mut self.memory.distances[vertex as usize];
        if distance > self.radius || distance >= *known {
            return;
        }
        if known.is_infinite() {
            self.memory.touched.push(vertex);
        }
        *known = distance;
        self.memory.events.push(Event { distance, what: What::Vertex(vertex) });
    }

    /// Distances along edges: upper bounds that rule windows out.
    fn relax_edges(&mut self, vertex: u32, distance: f64) {
        for &half_edge in self.mesh.leaving(vertex) {
            let back = following(following(half_edge));
            let (ahead, behind) = (self.mesh.origin(following(half_edge)), self.mesh.origin(back));
            self.reach(ahead, distance + self.mesh.lengths[half_edge as usize]);
            self.reach(behind, distance + self.mesh.lengths[back as usize]);
        }
    }

    /// All of the edges opposite to a vertex are in sight of it.
    fn emit_windows(&mut self, vertex: u32, base: f64) {
        for &half_edge in self.mesh.leaving(vertex) {
            let opposite = following(half_edge);
            let twin = self.mesh.twins[opposite as usize];
            if twin == NONE {
                continue;
            }
            let apex = self.mesh.apex(opposite);
            let length = self.mesh.lengths[opposite as usize];
            // The twin runs the other way, and the vertex lies below it.
            let source = DVec2::new(length - apex.x, -apex.y);
            self.push(Window { half_edge: twin, interval: [0.0, length], source, base });
        }
    }

    fn push(&mut self, window: Window) {
        let [start, end] = window.interval;
        let length = self.mesh.lengths[window.half_edge as usize];
        if end - start <= ROUNDING * length {
            return;
        }
        let nearest = DVec2::new(window.source.x.clamp(start, end), 0.0);
        let distance = window.base + window.source.distance(nearest);
        if distance > self.radius || self.is_dominated(&window, length) {
            return;
        }
        self.memory.events.push(Event { distance, what: What::Window(window) });
    }

    /// Whether the way over an end of the edge and along it is shorter than through any point of the window (Xin and
    /// Wang 2009): if it is at the far end of the interval, it is so everywhere in it.
    fn is_dominated(&self, window: &Window, length: f64) -> bool {
        let [start, end] = window.interval;
        let through = |x: f64| window.base + window.source.distance(DVec2::new(x, 0.0));
        let from = self.memory.distances[self.mesh.origin(window.half_edge) as usize];
        let to = self.memory.distances[self.mesh.origin(following(window.half_edge)) as usize];
        from + end < through(end) - ROUNDING * length
            || to + (length - start) < through(start) - ROUNDING * length
    }

    /// Carries a window over its face: to the third corner, if that is in sight, and to the two edges beyond.
    fn unfold(&mut self, window: &Window) {
        let length = self.mesh.lengths[window.half_edge as usize];
        // Distances have become shorter since it was pushed.
        if self.is_dominated(window, length) {
            return;
        }
        let apex = self.mesh.apex(window.half_edge);
        let source = window.source;
        let height = apex.y - source.y;
        if height <= 0.0 {
            return;
        }
        let [start, end] = window.interval;
        let split = source.x - (apex.x - source.x) * source.y / height;
        if (start..=end).contains(&split) {
            let third = self.mesh.origin(following(following(window.half_edge)));
            self.reach(third, window.base + source.distance(apex));
        }
        let after = following(window.half_edge);
        if start < split {
            // The edge from the third corner back to the start; its twin runs from the start to that corner.
            let far = (end < split).then_some(end);
            self.carry(following(after), DVec2::ZERO, apex, window, [Some(start), far]);
        }
        if end > split {
            let near = (start > split).then_some(start);
            self.carry(after, apex, DVec2::new(length, 0.0), window, [near, Some(end)]);
        }
    }

    /// The part of a window that falls on one edge of its face, which runs from `from` to `to` in the window's plane when
    /// seen from the face beyond. The limits are points of the window's own edge; none stands for the third corner.
    fn carry(&mut self, edge: u32, from: DVec2, to: DVec2, window: &Window, limits: [Option<f64>; 2]) {
        let twin = self.mesh.twins[edge as usize];
        if twin == NONE {
            return;
        }
        let length = self.mesh.lengths[edge as usize];
        let along = (to - from) / length;
        let enter = |point: DVec2| {
            let relative = point - from;
            DVec2::new(along.dot(relative), along.perp_dot(relative))
        };
        let source = enter(window.source);
        let meets = |limit: f64| {
            let through = enter(DVec2::new(limit, 0.0));
            let rise = through.y - source.y;
            let crossing =
                if rise > 0.0 { source.x - (through.x - source.x) * source.y / rise } else { through.x };
            crossing.clamp(0.0, length)
        };
        // The third corner is the end of the first edge and the start of the second.
        let start = limits[0].map_or(0.0, meets);
        let end = limits[1].map_or(length, meets);
        self.push(Window { half_edge: twin, interval: [start, end], source, base: window.base });
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::*;

    /// A grid in the plane z = 0 with diagonals in both directions, moved by a function.
    fn grid(columns: u32, rows: u32, place: impl Fn(f64, f64) -> DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let at = |column: u32, row: u32| row * (columns + 1) + column;
        let positions = (0..=rows)
            .flat_map(|row| (0..=columns).map(move |column| (column, row)))
            .map(|(column, row)| place(f64::from(column), f64::from(row)))
            .collect();
        let mut faces = Vec::new();
        for row in 0..rows {
            for column in 0..columns {
                let [a, b] = [at(column, row), at(column + 1, row)];
                let [c, d] = [at(column + 1, row + 1), at(column, row + 1)];
                match (row + column) % 2 {
                    0 => faces.extend([[a, b, c], [a, c, d]]),
                    _ => faces.extend([[a, b, d], [b, c, d]]),
                }
            }
        }
        (positions, faces)
    }

    fn distances(geodesics: &Geodesics, source: u32) -> Vec<f64> {
        let mut all = vec![f64::INFINITY; geodesics.vertex_count()];
        for (vertex, distance) in geodesics.within(source, f64::INFINITY) {
            all[vertex as usize] = distance;
        }
        all
    }

    #[test]
    fn in_the_plane_distances_are_straight_and_the_radius_is_kept() {
        let place = |x: f64, y: f64| DVec3::new(x + 0.3 * (2.1 * y).sin(), y + 0.2 * (1.7 * x).cos(), 0.0);
        let (positions, faces) = grid(14, 11, place);
        let geodesics = Geodesics::new(&positions, &faces);
        let source = 95;
        // Around the middle the straight line stays on the sheet.
        let found = geodesics.within(source, 4.0);
        let expected: Vec<u32> = (0..positions.len())
            .filter(|vertex| positions[*vertex].distance(positions[source as usize]) <= 4.0)
            .map(|vertex| vertex as u32)
            .collect();
        assert_eq!(found.iter().map(|(vertex, _)| *vertex).collect::<Vec<_>>(), expected);
        for (vertex, distance) in found {
            let straight = positions[vertex as usize].distance(positions[source as usize]);
            assert!((distance - straight).abs() < 1e-12, "{distance} is not {straight}");
        }
    }

    #[test]
    fn around_a_corner_of_the_border_the_path_bends() {
        let (positions, faces) = grid(4, 4, |x, y| DVec3::new(x, y, 0.0));
        // Without the upper right quarter the way from (4, 1) to (1, 4) leads over (2, 2).
        let kept: Vec<[u32; 3]> = faces
            .into_iter()
            .filter(|face| {
                let centre = face.iter().map(|v| positions[*v as usize]).sum::<DVec3>() / 3.0;
                centre.x < 2.0 || centre.y < 2.0
            })
            .collect();
        let geodesics = Geodesics::new(&positions, &kept);
        let found = distances(&geodesics, 9);
        let expected = 5.0_f64.sqrt() + 5.0_f64.sqrt();
        assert!((found[21] - expected).abs() < 1e-12, "{} is not {expected}", found[21]);
        assert!(found[24].is_infinite(), "what no face joins is not reached");
    }

    #[test]
    fn on_a_cone_of_more_than_a_full_turn_paths_lead_over_its_tip() {
        // Sixteen right-angled wedges of 40° each make a saddle of 640°: opposite points meet over the tip.
        let count = 16;
        let half = 20.0_f64.to_radians();
        let mut positions = vec![DVec3::ZERO];
        for k in 0..count {
            // Any bending of the wedges will do, as lengths decide: rise and fall between neighbours of equal distance.
            let angle = TAU * f64::from(k) / f64::from(count);
            let height = if k % 2 == 0 { 1.0 } else { -1.0 };
            // Chord of the unit wedge: 2 sin 20°; solve for the radius and height that give it.
            let chord = 2.0 * half.sin();
            let step = (TAU / f64::from(count) / 2.0).sin();
            let radius_squared = (4.0 - chord * chord) / (4.0 - 4.0 * step * step);
            let (radius, rise) = (radius_squared.sqrt(), (1.0 - radius_squared).sqrt());
            positions.push(DVec3::new(radius * angle.cos(), radius * angle.sin(), height * rise));
        }
        let faces: Vec<[u32; 3]> = (0..count).map(|k| [0, 1 + k, 1 + (k + 1) % count]).collect();
        let geodesics = Geodesics::new(&positions, &faces);
        let found = distances(&geodesics, 1);
        for k in 0..count {
            let apart = f64::from(k.min(count - k)) * 2.0 * half;
            let expected = if apart < PI { 2.0 * (0.5 * apart).sin() } else { 2.0 };
            let distance = found[1 + k as usize];
            assert!((distance - expected).abs() < 1e-12, "{k}: {distance} is not {expected}");
        }
    }

    #[test]
    fn on_a_cylinder_distances_are_those_of_the_unrolled_sheet() {
        let (around, up) = (24, 12);
        let step = 0.1;
        // A prism of 24 sides unrolls exactly; its last column is its first.
        let (flat, mut faces) = grid(around, up, |x, y| DVec3::new(x * step, y * step, 0.0));
        let radius = 0.5 * step / (0.5 * TAU / f64::from(around)).sin();
        let positions: Vec<DVec3> = flat
            .iter()
            .map(|p| {
                let angle = TAU * p.x / (step * f64::from(around));
                DVec3::new(radius * angle.cos(), radius * angle.sin(), p.y)
            })
            .collect();
        for vertex in faces.iter_mut().flatten() {
            if *vertex % (around + 1) == around {
                *vertex -= around;
            }
        }
        let geodesics = Geodesics::new(&positions, &faces);
        let source = 6 * (around + 1) + 2;
        let width = step * f64::from(around);
        for (vertex, distance) in geodesics.within(source, 0.45) {
            let apart = (flat[vertex as usize].x - flat[source as usize].x).abs();
            let across = apart.min(width - apart);
            let expected = across.hypot(flat[vertex as usize].y - flat[source as usize].y);
            assert!((distance - expected).abs() < 1e-12, "{distance} is not {expected}");
        }
    }

    /// An octahedron, split several times, on the unit sphere.
    fn sphere(rounds: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let axes = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y];
        let mut positions = vec![DVec3::Z, -DVec3::Z];
        positions.extend(axes);
        let mut faces: Vec<[u32; 3]> = (0..4)
            .flat_map(|k| {
                let (a, b) = (2 + k, 2 + (k + 1) % 4);
                [[0, a, b], [1, b, a]]
            })
            .collect();
        for _ in 0..rounds {
            (positions, faces) = split(&positions, &faces);
            positions.iter_mut().for_each(|position| *position = position.normalize());
        }
        (positions, faces)
    }

    /// Each face becomes four, with the middles of its edges as corners.
    fn split(positions: &[DVec3], faces: &[[u32; 3]]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut positions = positions.to_vec();
        let mut middles = std::collections::BTreeMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                positions.push((positions[a as usize] + positions[b as usize]) * 0.5);
                positions.len() as u32 - 1
            })
        };
        let mut smaller = Vec::new();
        for [a, b, c] in faces.iter().copied() {
            let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
            smaller.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        (positions, smaller)
    }

    #[test]
    fn on_a_sphere_distances_approach_great_circles() {
        for rounds in [3_i32, 4, 5] {
            let (positions, faces) = sphere(rounds as usize);
            let height = |face: &[u32; 3]| {
                let [a, b, c] = face.map(|vertex| positions[vertex as usize]);
                (b - a).cross(c - a).normalize().dot(a).abs()
            };
            // Seen from the centre, a face at this height shows at most 1 / height of its length on the unit sphere; the
            // gap shrinks to a quarter with each split.
            let tolerance = 1.0 - faces.iter().map(height).fold(1.0, f64::min);
            assert!(tolerance < 0.25_f64.powi(rounds), "{tolerance} after {rounds} splits");
            let geodesics = Geodesics::new(&positions, &faces);
            for source in [0, 7] {
                for (vertex, distance) in geodesics.within(source, 1.0) {
                    let arc = positions[vertex as usize].angle_between(positions[source as usize]);
                    assert!((distance - arc).abs() <= tolerance * arc + 1e-12, "{distance} is not {arc}");
                }
            }
        }
    }

    /// Splitting flat faces does not change the surface, so it must not change a distance: the law of exactness.
    #[test]
    fn splitting_faces_changes_no_distance_on_a_bumpy_surface() {
        let bump = |x: f64, y: f64| {
            DVec3::new(x, y, 0.9 * (1.3 * x).sin() * (1.1 * y + 0.4).cos() + 0.3 * (2.7 * x + y).sin())
        };
        let (positions, faces) = grid(9, 8, bump);
        let coarse = Geodesics::new(&positions, &faces);
        let (positions, faces) = split(&positions, &faces);
        let fine = Geodesics::new(&positions, &faces);
        assert!(coarse.bends.iter().filter(|bends| **bends).count() > 40, "there are saddles and borders");
        for source in [0, 13, 44, 60, 89] {
            let (coarse, fine) = (distances(&coarse, source), distances(&fine, source));
            for (vertex, (coarse, fine)) in coarse.iter().zip(&fine).enumerate() {
                assert!((coarse - fine).abs() < 1e-10, "{source} to {vertex}: {coarse} and {fine}");
            }
        }
    }

    #[test]
    fn distances_are_symmetric_and_the_memory_is_left_clean() {
        let bump = |x: f64, y: f64| DVec3::new(x, y, (1.3 * x).sin() * (1.1 * y).cos());
        let (positions, faces) = grid(9, 8, bump);
        let geodesics = Geodesics::new(&positions, &faces);
        let sources: Vec<u32> = (0..positions.len() as u32).collect();
        let many = geodesics.within_many(&sources, 2.5);
        for (source, found) in many.iter().enumerate() {
            assert_eq!(*found, geodesics.within(source as u32, 2.5));
            for (vertex, distance) in found {
                let back = many[*vertex as usize].iter().find(|(back, _)| *back as usize == source);
                assert!(back.is_some_and(|(_, back)| (back - distance).abs() < 1e-10));
            }
        }
    }
}
