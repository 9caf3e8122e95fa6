//! Clothing that reaches into the body is moved out of it; P3 has no such step.
//!
//! Deviation: see book/src/deviations.md.
//!
//! 1. Vertices inside go to the nearest surface of the body (`obstacle.rs`) and a little beyond; the displacement is as smooth over
//!    the clothing as it can be, so that folds move as a whole:
//!    `min Σ_edges ‖u_i − u_j‖² + rest Σ_i ‖u_i‖² + contact Σ_inside ‖u_i − way out_i‖²`.
//!    The contact changes with every frame and round, so the system is solved by conjugate gradients rather than factorised.
//!    Where the nearest ways of neighbours lead to opposite sides of a limb, all go one way: the one that is shortest in all.
//! 2. Vertices that are still inside go straight out, each alone.
//! 3. Where the middle of an edge or face is still inside, because the body bulges between its corners, the corners follow.

use std::collections::BTreeMap;

use glam::DVec3;
use habitus_geometry::{MeshError, Topology, TriangleMesh};
use rayon::prelude::*;

use super::config::PushOutConfig;
use super::obstacle::{Exit, Obstacle, Place};
use crate::artifacts::synthesized_sequence::Penetration;

/// Vertices per parallel piece.
const CHUNK: usize = 512;

/// One clothing's neighbours: made once, used for each frame.
#[derive(Clone, Debug)]
pub struct PushOut {
    /// Neighbours of vertex `i` are `neighbours[starts[i] .. starts[i + 1]]`.
    starts: Vec<u32>,
    neighbours: Vec<u32>,
    /// Corners of each edge, the second twice, and then of each face: their middles are looked at too.
    spans: Vec<[u32; 3]>,
    /// Spans at vertex `i` are `vertex_spans[span_starts[i] .. span_starts[i + 1]]`.
    span_starts: Vec<u32>,
    vertex_spans: Vec<u32>,
    config: PushOutConfig,
}

/// The middle of an edge or face that is inside the body.
struct Inside {
    span: u32,
    exit: Exit,
}

impl PushOut {
    /// Prepares a clothing.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]], config: &PushOutConfig) -> Self {
        let topology = Topology::new(vertex_count, faces);
        let mut spans: Vec<[u32; 3]> = topology.edges().iter().map(|[a, b]| [*a, *b, *b]).collect();
        spans.extend_from_slice(faces);
        let (span_starts, vertex_spans) = spans_of_vertices(vertex_count, &spans);
        let mut push_out = Self {
            starts: vec![0],
            neighbours: Vec::new(),
            spans,
            span_starts,
            vertex_spans,
            config: config.clone(),
        };
        for vertex in 0..vertex_count {
            push_out.neighbours.extend_from_slice(topology.one_ring(vertex));
            push_out.starts.push(push_out.neighbours.len() as u32);
        }
        push_out
    }

    /// Moves `clothing` out of a closed body; says how much was inside before and after. `hints` are faces of the body
    /// near the vertices, kept from frame to frame.
    pub fn apply(
        &self,
        clothing: &mut [DVec3],
        body: &TriangleMesh,
        hints: &mut Vec<u32>,
    ) -> (Penetration, Penetration) {
        let obstacle = Obstacle::new(body);
        hints.resize(clothing.len(), 0);
        let mut exits = Vec::new();
        obstacle.exits_into(clothing, hints, &mut exits);
        let mut inside = self.middles_inside(clothing, &exits, None, &obstacle);
        let before = self.penetration(clothing, &exits, &inside);
        if self.config.rounds == 0 {
            return (before, before);
        }
        let mut has_moved = vec![false; clothing.len()];
        for round in 0..self.config.rounds {
            let ways_out = self.ways_out(clothing, &exits, round, &obstacle);
            if ways_out.iter().all(Option::is_none) {
                break;
            }
            let displacement = self.displacement(&ways_out);
            let is_moved = self.add(clothing, &displacement);
            has_moved.iter_mut().zip(&is_moved).for_each(|(has, is)| *has |= *is);
            update(clothing, &mut exits, &is_moved, &obstacle);
        }
        clothing
            .par_iter_mut()
            .zip(exits.par_iter_mut())
            .with_min_len(CHUNK)
            .for_each(|(vertex, exit)| self.leave_alone(vertex, exit, &obstacle));
        // Middles between corners that have not moved are where they were.
        inside.retain(|found| {
            self.spans[found.span as usize].iter().all(|corner| !has_moved[*corner as usize])
        });
        inside.extend(self.middles_inside(clothing, &exits, Some(&has_moved), &obstacle));
        self.lift_middles(clothing, &mut exits, &mut inside, &obstacle);
        hints.iter_mut().zip(&exits).for_each(|(hint, exit)| *hint = exit.face);
        (before, self.penetration(clothing, &exits, &inside))
    }

    /// Adds displacements that are worth it; says which vertices have moved. Far from the body the clothing stays as it is, to the bit.
    fn add(&self, clothing: &mut [DVec3], displacement: &[DVec3]) -> Vec<bool> {
        let least = self.config.least_displacement * self.config.least_displacement;
        let moved = |(vertex, moved): (&mut DVec3, &DVec3)| {
            let is_moved = moved.length_squared() >= least;
            if is_moved {
                *vertex += *moved;
            }
            is_moved
        };
        clothing.iter_mut().zip(displacement).map(moved).collect()
    }

    /// For each vertex inside: where it should go, relative to where it is.
    fn ways_out(
        &self,
        clothing: &[DVec3],
        exits: &[Exit],
        round: usize,
        obstacle: &Obstacle,
    ) -> Vec<Option<DVec3>> {
        let way = |(vertex, exit): (&DVec3, &Exit)| {
            (exit.depth() > 0.0).then(|| exit.position - *vertex + exit.normal * self.config.clearance)
        };
        let mut ways: Vec<Option<DVec3>> = clothing.iter().zip(exits).map(way).collect();
        for patch in
            self.divided_patches(clothing, exits, self.config.divided_depth * 0.5_f64.powi(round as i32))
        {
            let Some((direction, lengths)) = self.common_way(clothing, exits, &patch, obstacle) else {
                continue;
            };
            for (vertex, length) in patch.iter().zip(lengths) {
                ways[*vertex as usize] = Some(direction * (length + self.config.clearance));
            }
        }
        ways
    }

    /// Connected parts of the clothing that are deep inside and whose nearest ways out lead to opposite sides of a limb.
    fn divided_patches(&self, clothing: &[DVec3], exits: &[Exit], depth: f64) -> Vec<Vec<u32>> {
        let is_deep = |vertex: usize| exits[vertex].depth() > depth;
        // In a crease the ways to both sides meet; through a limb they lead apart.
        let do_part = |a: usize, b: usize| {
            let apart = exits[a].position.distance(exits[b].position);
            exits[a].normal.dot(exits[b].normal) < 0.0
                && apart > self.config.torn_stretch * clothing[a].distance(clothing[b])
        };
        let mut is_known = vec![false; exits.len()];
        let mut patches = Vec::new();
        for start in 0..exits.len() {
            if is_known[start] || !is_deep(start) {
                continue;
            }
            is_known[start] = true;
            let mut patch = vec![start as u32];
            let (mut next, mut is_divided) = (0, false);
            while let Some(vertex) = patch.get(next).copied() {
                next += 1;
                for other in
                    self.neighbours_of(vertex as usize).iter().copied().filter(|v| is_deep(*v as usize))
                {
                    is_divided |= do_part(vertex as usize, other as usize);
                    if !is_known[other as usize] {
                        is_known[other as usize] = true;
                        patch.push(other);
                    }
                }
            }
            if is_divided {
                patches.push(patch);
            }
        }
        patches
    }

    /// One direction for a whole patch, of those that single vertices would take: the one that is shortest in all, with the length
    /// of each vertex's way; none if no direction leads every vertex out.
    fn common_way(
        &self,
        clothing: &[DVec3],
        exits: &[Exit],
        patch: &[u32],
        obstacle: &Obstacle,
    ) -> Option<(DVec3, Vec<f64>)> {
        let step = patch.len().div_ceil(self.config.directions.max(1));
        let directions = patch.iter().step_by(step).map(|vertex| exits[*vertex as usize].normal);
        let ways = directions.filter_map(|direction| {
            let lengths: Option<Vec<f64>> =
                patch.iter().map(|vertex| obstacle.way(clothing[*vertex as usize], direction)).collect();
            Some((direction, lengths?))
        });
        let total = |way: &(DVec3, Vec<f64>)| way.1.iter().sum::<f64>();
        ways.min_by(|a, b| total(a).total_cmp(&total(b)))
    }

    fn neighbours_of(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }

    /// A vertex that the smooth displacement has left inside goes straight out, alone. At the mouth of a crease the way out of one
    /// part may end in the other: each further try goes less far beyond the surface, into what is between them.
    fn leave_alone(&self, vertex: &mut DVec3, exit: &mut Exit, obstacle: &Obstacle) {
        for attempt in 0..self.config.halvings {
            if exit.depth() <= 0.0 {
                break;
            }
            *vertex = exit.position + exit.normal * (self.config.clearance * 0.5_f64.powi(attempt));
            *exit = obstacle.exit(*vertex, exit.face);
        }
    }

    /// Brings the middles of edges and faces out that are inside because the body bulges between the corners: the corners follow.
    /// Leaves in `inside` what cannot be brought out.
    fn lift_middles(
        &self,
        clothing: &mut [DVec3],
        exits: &mut [Exit],
        inside: &mut Vec<Inside>,
        obstacle: &Obstacle,
    ) {
        let mut lifted: BTreeMap<u32, f64> = BTreeMap::new();
        for attempt in 0..self.config.lifts {
            // At the mouth of a crease a lift beyond the surface ends in the next part: later ones go less far.
            let beyond =
                self.config.clearance * 0.5 / (1.0 + attempt as f64 / self.config.patient_lifts as f64);
            let mut lifts: BTreeMap<u32, DVec3> = BTreeMap::new();
            for found in inside.iter() {
                let lift = found.exit.normal * (beyond + found.exit.distance);
                for corner in self.spans[found.span as usize] {
                    let known = lifts.entry(corner).or_default();
                    if lift.length_squared() > known.length_squared() {
                        *known = lift;
                    }
                }
            }
            // At the mouth of a crease some corners are in the air and others between two parts: they could be lifted for ever.
            lifts.retain(|corner, lift| {
                let way = lifted.entry(*corner).or_default();
                *way += lift.length();
                *way <= self.config.longest_lift
            });
            if lifts.is_empty() {
                break;
            }
            for (corner, lift) in &lifts {
                let (vertex, exit) = (&mut clothing[*corner as usize], &mut exits[*corner as usize]);
                *vertex += *lift;
                *exit = obstacle.exit(*vertex, exit.face);
                self.leave_alone(vertex, exit, obstacle);
            }
            let mut touched: Vec<u32> =
                lifts.keys().flat_map(|corner| self.spans_of(*corner as usize)).copied().collect();
            touched.sort_unstable();
            touched.dedup();
            inside.retain(|found| touched.binary_search(&found.span).is_err());
            inside.extend(
                touched.iter().filter_map(|span| self.middle_inside(*span, clothing, exits, obstacle)),
            );
        }
    }

    /// The middle of an edge or face, if it is inside. The body bulges between two corners outside it by `length² / 8 radius` at
    /// most, so that what is farther away is not looked at.
    fn middle_inside(
        &self,
        span: u32,
        clothing: &[DVec3],
        exits: &[Exit],
        obstacle: &Obstacle,
    ) -> Option<Inside> {
        let corners = self.spans[span as usize].map(|corner| corner as usize);
        let [a, b, c] = corners.map(|corner| clothing[corner]);
        let length_squared = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
        let nearest = corners.iter().map(|corner| -exits[*corner].depth()).fold(f64::INFINITY, f64::min);
        if nearest > 0.125 * length_squared / self.config.smallest_radius {
            return None;
        }
        let middle = if corners[1] == corners[2] { (a + b) * 0.5 } else { (a + b + c) / 3.0 };
        let exit = obstacle.exit(middle, exits[corners[0]].face);
        (exit.depth() > 0.0).then_some(Inside { span, exit })
    }

    /// All middles that are inside, or those next to vertices that have moved.
    fn middles_inside(
        &self,
        clothing: &[DVec3],
        exits: &[Exit],
        is_moved: Option<&[bool]>,
        obstacle: &Obstacle,
    ) -> Vec<Inside> {
        let is_meant = |span: &u32| {
            is_moved.is_none_or(|is_moved| {
                self.spans[*span as usize].iter().any(|corner| is_moved[*corner as usize])
            })
        };
        let spans = (0..self.spans.len() as u32).into_par_iter().with_min_len(CHUNK).filter(is_meant);
        spans.filter_map(|span| self.middle_inside(span, clothing, exits, obstacle)).collect()
    }

    fn spans_of(&self, vertex: usize) -> &[u32] {
        &self.vertex_spans[self.span_starts[vertex] as usize..self.span_starts[vertex + 1] as usize]
    }

    /// Shares and depth of what is inside or pinched.
    fn penetration(&self, clothing: &[DVec3], exits: &[Exit], middles: &[Inside]) -> Penetration {
        let depths = exits.iter().map(Exit::depth).filter(|depth| *depth > 0.0);
        let (mut count, mut sum, mut deepest) = (0_usize, 0.0, 0.0_f64);
        for depth in depths {
            count += 1;
            sum += depth;
            deepest = deepest.max(depth);
        }
        let pinched = exits.iter().filter(|exit| exit.place == Place::Pinched).count();
        let deepest = middles.iter().fold(deepest, |deepest, found| deepest.max(found.exit.depth()));
        Penetration {
            inside_share: count as f64 / clothing.len().max(1) as f64,
            mean_depth_mm: 1000.0 * sum / count.max(1) as f64,
            deepest_mm: 1000.0 * deepest,
            pinched_share: pinched as f64 / clothing.len().max(1) as f64,
        }
    }

    /// Minimiser of the energy in this module's head, by conjugate gradients with the diagonal as preconditioner.
    fn displacement(&self, ways_out: &[Option<DVec3>]) -> Vec<DVec3> {
        let count = ways_out.len();
        let contact = self.config.contact_weight;
        let diagonal: Vec<f64> = (0..count)
            .map(|i| {
                let degree = f64::from(self.starts[i + 1] - self.starts[i]);
                degree + self.config.rest_weight + if ways_out[i].is_some() { contact } else { 0.0 }
            })
            .collect();
        let mut solution: Vec<DVec3> = ways_out.iter().map(|way| way.unwrap_or(DVec3::ZERO)).collect();
        let image = self.product(&diagonal, &solution);
        let mut residual: Vec<DVec3> = ways_out
            .iter()
            .zip(&image)
            .map(|(way, image)| way.map_or(DVec3::ZERO, |way| way * contact) - *image)
            .collect();
        let scaled = |residual: &[DVec3]| -> Vec<DVec3> {
            residual.iter().zip(&diagonal).map(|(r, d)| *r / *d).collect()
        };
        let mut direction = scaled(&residual);
        // The three coordinates share one matrix but not one step.
        let mut slope = dot(&residual, &direction);
        let enough = slope * self.config.solver_accuracy * self.config.solver_accuracy;
        for _ in 0..self.config.solver_steps {
            let image = self.product(&diagonal, &direction);
            let curvature = dot(&direction, &image);
            let step = ratio(slope, curvature);
            solution.iter_mut().zip(&direction).for_each(|(x, d)| *x += *d * step);
            residual.iter_mut().zip(&image).for_each(|(r, image)| *r -= *image * step);
            let preconditioned = scaled(&residual);
            let next = dot(&residual, &preconditioned);
            if next.cmple(enough).all() {
                break;
            }
            let turn = ratio(next, slope);
            direction.iter_mut().zip(&preconditioned).for_each(|(d, p)| *d = *p + *d * turn);
            slope = next;
        }
        solution
    }

    /// Diagonal minus neighbours: the matrix of the energy, applied.
    fn product(&self, diagonal: &[f64], vector: &[DVec3]) -> Vec<DVec3> {
        let mut image = vec![DVec3::ZERO; vector.len()];
        image.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, part)| {
            for (k, value) in part.iter_mut().enumerate() {
                let i = chunk * CHUNK + k;
                let range = self.starts[i] as usize..self.starts[i + 1] as usize;
                let around: DVec3 = self.neighbours[range].iter().map(|j| vector[*j as usize]).sum();
                *value = vector[i] * diagonal[i] - around;
            }
        });
        image
    }
}

/// Sum of products, coordinate by coordinate.
fn dot(a: &[DVec3], b: &[DVec3]) -> DVec3 {
    a.iter().zip(b).map(|(a, b)| *a * *b).sum()
}

/// A quotient for each coordinate, zero where the divisor is.
fn ratio(a: DVec3, b: DVec3) -> DVec3 {
    let quotient = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
    DVec3::new(quotient(a.x, b.x), quotient(a.y, b.y), quotient(a.z, b.z))
}

/// For each vertex the spans that it is a corner of: where they start, and which they are.
fn spans_of_vertices(vertex_count: usize, spans: &[[u32; 3]]) -> (Vec<u32>, Vec<u32>) {
    let mut pairs: Vec<(u32, u32)> = spans
        .iter()
        .enumerate()
        .flat_map(|(span, corners)| corners.map(|corner| (corner, span as u32)))
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    let starts =
        (0..=vertex_count as u32).map(|vertex| pairs.partition_point(|(corner, _)| *corner < vertex) as u32);
    (starts.collect(), pairs.iter().map(|(_, span)| *span).collect())
}

/// Looks again for the way out of what has moved.
fn update(clothing: &[DVec3], exits: &mut [Exit], is_moved: &[bool], obstacle: &Obstacle) {
    let moved = clothing.par_iter().zip(exits.par_iter_mut()).zip(is_moved).with_min_len(CHUNK);
    moved.filter(|(_, is_moved)| **is_moved).for_each(|((vertex, exit), _)| {
        *exit = obstacle.exit(*vertex, exit.face);
    });
}

/// A body as a mesh.
pub fn body_mesh(vertices: Vec<DVec3>, faces: &[[u32; 3]]) -> Result<TriangleMesh, MeshError> {
    TriangleMesh::new(vertices, faces.to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sphere of latitudes and longitudes about the origin.
    fn sphere(radius: f64, rings: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let columns = 2 * rings;
        let mut vertices = vec![DVec3::new(0.0, radius, 0.0)];
        for ring in 1..rings {
            let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
            for column in 0..columns {
                let angle = std::f64::consts::TAU * f64::from(column) / f64::from(columns);
                let around = DVec3::new(angle.sin(), 0.0, angle.cos()) * polar.sin();
                vertices.push((around + DVec3::Y * polar.cos()) * radius);
            }
        }
        vertices.push(DVec3::new(0.0, -radius, 0.0));
        let last = vertices.len() as u32 - 1;
        let at = |ring: u32, column: u32| 1 + (ring - 1) * columns + column % columns;
        let mut faces = Vec::new();
        for column in 0..columns {
            faces.push([0, at(1, column), at(1, column + 1)]);
            faces.push([last, at(rings - 1, column + 1), at(rings - 1, column)]);
            for ring in 1..rings - 1 {
                faces.push([at(ring, column), at(ring + 1, column), at(ring + 1, column + 1)]);
                faces.push([at(ring, column), at(ring + 1, column + 1), at(ring, column + 1)]);
            }
        }
        (vertices, faces)
    }

    #[test]
    fn clothing_leaves_the_body_and_stays_smooth() {
        let (body, body_faces) = sphere(0.2, 24);
        let (mut clothing, faces) = sphere(0.215, 40);
        // A dent of 4 cm, 2.5 cm of it inside.
        for vertex in &mut clothing {
            let dent = 0.04 * (-vertex.distance(DVec3::new(0.0, 0.0, 0.215)).powi(2) / 0.003).exp();
            *vertex *= (vertex.length() - dent) / vertex.length();
        }
        let dented = clothing.clone();
        let body = body_mesh(body, &body_faces).unwrap();
        let push_out = PushOut::new(clothing.len(), &faces, &PushOutConfig::default());
        let (before, after) = push_out.apply(&mut clothing, &body, &mut Vec::new());
        assert!(before.deepest_mm > 20.0 && before.inside_share > 0.005, "{before:?}");
        assert!(after.deepest_mm <= 1.0, "{after:?}");
        // The displacement falls by a factor of e every four to five edges; the far side is thirty away.
        let far = |k: &usize| dented[*k].z < -0.1;
        let moved_far = (0..clothing.len()).filter(far).map(|k| clothing[k].distance(dented[k]));
        assert_eq!(moved_far.fold(0.0, f64::max), 0.0, "the far side stays");
        // Neighbours move together: no edge bears more than half of the longest way out.
        let topology = Topology::new(clothing.len(), &faces);
        let jump = |edge: &[u32; 2]| {
            let [a, b] = edge.map(|vertex| clothing[vertex as usize] - dented[vertex as usize]);
            a.distance(b)
        };
        let largest = topology.edges().iter().map(jump).fold(0.0, f64::max);
        assert!(largest < 0.5 * (1e-3 * before.deepest_mm + 0.0015), "{largest}");
    }

    /// Two overlapping balls, like calf and thigh of a bent knee, in one mesh.
    fn two_balls() -> TriangleMesh {
        let (ball, ball_faces) = sphere(0.1, 24);
        let count = ball.len() as u32;
        let shifted = |shift: DVec3| ball.iter().map(move |vertex| *vertex + shift);
        let vertices = shifted(DVec3::X * -0.08).chain(shifted(DVec3::X * 0.08)).collect();
        let other = ball_faces.iter().map(|face| face.map(|vertex| vertex + count));
        body_mesh(vertices, &ball_faces.iter().copied().chain(other).collect::<Vec<_>>()).unwrap()
    }

    /// A sheet of 10 mm squares in the plane x = 0, from the middle of the two balls to above them, with a wave in it.
    fn sheet(offset: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        const SIDE: u32 = 20;
        let at = |row: u32, column: u32| {
            let (y, z) = (0.01 * f64::from(row), 0.01 * (f64::from(column) - 9.5));
            DVec3::new(offset + 0.01 * (40.0 * y).sin(), y, z)
        };
        let vertices = (0..SIDE * SIDE).map(|k| at(k / SIDE, k % SIDE)).collect();
        let corner = |row, column| row * SIDE + column;
        let squares = (0..SIDE - 1).flat_map(|row| (0..SIDE - 1).map(move |column| (row, column)));
        let faces = squares.flat_map(|(r, c)| {
            [
                [corner(r, c), corner(r + 1, c), corner(r + 1, c + 1)],
                [corner(r, c), corner(r + 1, c + 1), corner(r, c + 1)],
            ]
        });
        (vertices, faces.collect())
    }

    fn longest_edge(vertices: &[DVec3], faces: &[[u32; 3]]) -> f64 {
        let edges = faces.iter().flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]]);
        edges.map(|[a, b]| vertices[*a as usize].distance(vertices[*b as usize])).fold(0.0, f64::max)
    }

    #[test]
    fn clothing_in_a_closed_crease_stays_in_it_and_in_one_piece() {
        let body = two_balls();
        let (mut clothing, faces) = sheet(0.03);
        let push_out = PushOut::new(clothing.len(), &faces, &PushOutConfig::default());
        let (before, after) = push_out.apply(&mut clothing, &body, &mut Vec::new());
        assert!(before.deepest_mm > 5.0 && before.inside_share > 0.05, "{before:?}");
        assert!(after.deepest_mm <= 1.0 && after.inside_share == 0.0, "{after:?}");
        assert!(after.pinched_share > 0.1, "the balls hold it between them: {after:?}");
        // At the mouth one end of an edge goes to the air and the other between the balls; squares have diagonals of 14 mm, and to the
        // air alone it is up to 10 cm, to all sides.
        assert!(longest_edge(&clothing, &faces) < 0.07, "{}", longest_edge(&clothing, &faces));
    }

    #[test]
    fn clothing_through_the_middle_of_a_limb_leaves_it_on_one_side() {
        let (ball, ball_faces) = sphere(0.06, 24);
        let body = body_mesh(ball, &ball_faces).unwrap();
        let (mut clothing, faces) = sheet(0.004);
        let push_out = PushOut::new(clothing.len(), &faces, &PushOutConfig::default());
        let (before, after) = push_out.apply(&mut clothing, &body, &mut Vec::new());
        assert!(before.deepest_mm > 40.0, "{before:?}");
        assert!(after.deepest_mm <= 1.0 && after.inside_share == 0.0, "{after:?}");
    }

    #[test]
    fn a_body_that_bulges_through_coarse_faces_is_covered() {
        let (ball, ball_faces) = sphere(0.1, 40);
        // Corners 1 mm outside; the middles of the faces 2 to 4 mm inside.
        let (mut clothing, faces) = sphere(0.101, 7);
        let body = body_mesh(ball, &ball_faces).unwrap();
        let push_out = PushOut::new(clothing.len(), &faces, &PushOutConfig::default());
        let (before, after) = push_out.apply(&mut clothing, &body, &mut Vec::new());
        assert!(before.inside_share == 0.0 && before.deepest_mm > 2.0, "{before:?}");
        assert!(after.deepest_mm <= 1.0, "{after:?}");
    }

    #[test]
    fn clothing_outside_is_not_touched() {
        let (body, body_faces) = sphere(0.2, 16);
        let (mut clothing, faces) = sphere(0.25, 20);
        let as_given = clothing.clone();
        let body = body_mesh(body, &body_faces).unwrap();
        let push_out = PushOut::new(clothing.len(), &faces, &PushOutConfig::default());
        let (before, after) = push_out.apply(&mut clothing, &body, &mut Vec::new());
        assert_eq!((before, after), (Penetration::default(), Penetration::default()));
        assert_eq!(clothing, as_given);
    }
}
