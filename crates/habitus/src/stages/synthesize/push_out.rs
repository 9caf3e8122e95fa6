//! Clothing that reaches into the body is moved out of it; P3 has no such step.
//!
//! Deviation: see book/src/deviations.md.
//!
//! Vertices inside go to the nearest point of the body and a little beyond; the displacement is as smooth over the
//! clothing as it can be, so that folds move as a whole:
//! `min Σ_edges ‖u_i − u_j‖² + rest Σ_i ‖u_i‖² + contact Σ_inside ‖u_i − way out_i‖²`.
//! The contact changes with every frame and round, so the system is solved by conjugate gradients rather than factorised.

use glam::DVec3;
use habitus_geometry::{MeshError, SurfaceIndex, SurfacePoint, Topology, TriangleMesh};
use rayon::prelude::*;

use super::config::PushOutConfig;
use crate::artifacts::synthesized_sequence::Penetration;

/// Vertices per parallel piece.
const CHUNK: usize = 512;

/// One clothing's neighbours: made once, used for each frame.
#[derive(Clone, Debug)]
pub struct PushOut {
    /// Neighbours of vertex `i` are `neighbours[starts[i] .. starts[i + 1]]`.
    starts: Vec<u32>,
    neighbours: Vec<u32>,
    config: PushOutConfig,
}

impl PushOut {
    /// Prepares a clothing.
    pub fn new(vertex_count: usize, faces: &[[u32; 3]], config: &PushOutConfig) -> Self {
        let topology = Topology::new(vertex_count, faces);
        let mut push_out = Self { starts: vec![0], neighbours: Vec::new(), config: config.clone() };
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
        let index = SurfaceIndex::of_mesh(body);
        hints.resize(clothing.len(), 0);
        let mut closest = Vec::new();
        index.closest_many(clothing, Some(hints), &mut closest);
        let before = penetration(clothing, &closest);
        let mut after = before;
        for round in 0..self.config.rounds {
            let ways_out = self.ways_out(clothing, &closest);
            if ways_out.iter().all(Option::is_none) {
                break;
            }
            let displacement = self.displacement(&ways_out);
            clothing.iter_mut().zip(&displacement).for_each(|(vertex, moved)| *vertex += *moved);
            hints.iter_mut().zip(&closest).for_each(|(hint, point)| *hint = point.face);
            index.closest_many(clothing, Some(hints), &mut closest);
            if round + 1 == self.config.rounds {
                self.set_onto_body(clothing, &index, &mut closest);
            }
            after = penetration(clothing, &closest);
        }
        hints.iter_mut().zip(&closest).for_each(|(hint, point)| *hint = point.face);
        (before, after)
    }

    /// For each vertex inside: where it should go, relative to where it is.
    fn ways_out(&self, clothing: &[DVec3], closest: &[SurfacePoint]) -> Vec<Option<DVec3>> {
        let way = |(vertex, point): (&DVec3, &SurfacePoint)| {
            let to_surface = point.position - *vertex;
            (to_surface.dot(point.normal) > 0.0).then(|| to_surface + point.normal * self.config.clearance)
        };
        clothing.iter().zip(closest).map(way).collect()
    }

    /// What the smooth displacement has left too deep goes straight out, one vertex at a time. Where two parts of the
    /// body touch, the way out of one leads into the other: each further try goes farther.
    fn set_onto_body(&self, clothing: &mut [DVec3], index: &SurfaceIndex, closest: &mut [SurfacePoint]) {
        const TRIES: u32 = 12;
        let is_too_deep = |vertex: DVec3, point: &SurfacePoint| {
            let is_inside = (point.position - vertex).dot(point.normal) > 0.0;
            is_inside && point.distance_squared.sqrt() > 0.5 * self.config.deepest
        };
        for (vertex, point) in clothing.iter_mut().zip(closest) {
            for attempt in 0..TRIES {
                if !is_too_deep(*vertex, point) {
                    break;
                }
                let beyond = self.config.clearance * f64::from(1 + attempt);
                *vertex = point.position + point.normal * beyond;
                *point = index.closest_warm(*vertex, point.face);
            }
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
        let enough = slope * 1e-8;
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

/// Share and depth of the vertices inside.
fn penetration(clothing: &[DVec3], closest: &[SurfacePoint]) -> Penetration {
    let is_inside =
        |(vertex, point): &(&DVec3, &SurfacePoint)| (point.position - **vertex).dot(point.normal) > 0.0;
    let depths =
        clothing.iter().zip(closest).filter(is_inside).map(|(_, point)| point.distance_squared.sqrt());
    let (mut count, mut sum, mut deepest) = (0_usize, 0.0, 0.0_f64);
    for depth in depths {
        count += 1;
        sum += depth;
        deepest = deepest.max(depth);
    }
    Penetration {
        inside_share: count as f64 / clothing.len().max(1) as f64,
        mean_depth_mm: 1000.0 * sum / count.max(1) as f64,
        deepest_mm: 1000.0 * deepest,
    }
}

/// How much of a clothing is inside a closed body.
pub fn penetration_of(clothing: &[DVec3], body: &TriangleMesh) -> Penetration {
    let mut closest = Vec::new();
    SurfaceIndex::of_mesh(body).closest_many(clothing, None, &mut closest);
    penetration(clothing, &closest)
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
        assert!(moved_far.fold(0.0, f64::max) < 2e-4, "the far side stays");
        // Neighbours move together: no edge bears more than half of the longest way out.
        let topology = Topology::new(clothing.len(), &faces);
        let jump = |edge: &[u32; 2]| {
            let [a, b] = edge.map(|vertex| clothing[vertex as usize] - dented[vertex as usize]);
            a.distance(b)
        };
        let largest = topology.edges().iter().map(jump).fold(0.0, f64::max);
        assert!(largest < 0.5 * (1e-3 * before.deepest_mm + 0.0015), "{largest}");
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
