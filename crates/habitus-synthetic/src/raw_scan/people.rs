//! People outside the space that is fitted, as many as are asked for.

use glam::DVec3;
use habitus::body::BodyModel;
use habitus::statistics::RandomStream;
use serde::{Deserialize, Serialize};

use crate::error::SyntheticError;

use crate::source_bodies::{source_body, source_body_names};

/// How the people of a [`Population`] are mixed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PeopleSettings {
    /// Share of a source body's build in a person's build (0 to 1); the rest is a draw of the population.
    pub source_share: f64,
    /// Scale of what the space cannot express, relative to that of the source bodies.
    pub detail_scale: f64,
    /// Number of local swellings and dents that no body of the data has.
    pub bump_count: usize,
    /// Standard deviation of their height along the normal, millimetres.
    pub bump_height_mm: f64,
    /// Their radius, smallest and largest, millimetres.
    pub bump_radius_mm: [f64; 2],
}

impl Default for PeopleSettings {
    fn default() -> Self {
        Self {
            source_share: 0.6,
            detail_scale: 1.0,
            bump_count: 14,
            bump_height_mm: 2.5,
            bump_radius_mm: [30.0, 100.0],
        }
    }
}

/// The source bodies, split into what the default space can express and what it cannot.
///
/// There are two dozen source bodies, and more people are needed. A person is: in the space, a blend of one source
/// body's coefficients and a draw of the population; outside the space, a mixture of two source bodies' residuals
/// (asymmetry, pregnancy, knock-knees, spread fingers, faces) with random signs; and local bumps that nothing in the
/// data has.
#[derive(Debug, Clone)]
pub struct Population {
    coefficients: Vec<Vec<f64>>,
    residuals: Vec<Vec<DVec3>>,
}

/// Coefficients beyond this many standard deviations do not occur among the people, as in P2 §4.1.
const LARGEST_COEFFICIENT: f64 = 2.5;

impl Population {
    /// Splits the source bodies; `model` is the default space.
    pub fn new(model: &BodyModel) -> Result<Self, SyntheticError> {
        let mut population = Self { coefficients: Vec::new(), residuals: Vec::new() };
        for index in 0..source_body_names()?.len() {
            let body = source_body(model, index)?;
            let coefficients = project(model, &body);
            let expressed = model.rest_vertices(&coefficients);
            population
                .residuals
                .push(body.iter().zip(&expressed).map(|(body, part)| *body - *part).collect());
            population.coefficients.push(coefficients);
        }
        Ok(population)
    }

    /// Rest vertices of the person of this name in the template's topology, metres.
    pub fn person(&self, model: &BodyModel, settings: &PeopleSettings, seed: u64, name: &str) -> Vec<DVec3> {
        let mut random = RandomStream::named(seed, &format!("{name} is born"));
        let count = self.coefficients.len();
        let (first, second) = (random.below(count), random.below(count));
        let own_share = (1.0 - settings.source_share * settings.source_share).max(0.0).sqrt();
        let coefficients: Vec<f64> = self.coefficients[first]
            .iter()
            .map(|source| {
                (settings.source_share * source + own_share * random.normal())
                    .clamp(-LARGEST_COEFFICIENT, LARGEST_COEFFICIENT)
            })
            .collect();
        // The squares sum to one: the mixture is as far from the space as a source body.
        let angle = random.between(0.0, std::f64::consts::TAU);
        let (share, other_share) = (angle.cos() * settings.detail_scale, angle.sin() * settings.detail_scale);
        let mut vertices = model.rest_vertices(&coefficients);
        for (vertex, (one, other)) in
            vertices.iter_mut().zip(self.residuals[first].iter().zip(&self.residuals[second]))
        {
            *vertex += *one * share + *other * other_share;
        }
        add_bumps(&mut vertices, model.faces(), settings, &mut random);
        vertices
    }
}

/// Coefficients of a body in standard deviations: the components are orthogonal.
pub(super) fn project(model: &BodyModel, body: &[DVec3]) -> Vec<f64> {
    let surface = model.surface();
    let width = surface.component_count();
    let mut sums = vec![0.0; width];
    let mut squares = vec![0.0; width];
    for (vertex, (position, mean)) in body.iter().zip(model.mean_vertices()).enumerate() {
        let rows = surface.vertex_basis(vertex);
        for (axis, offset) in (*position - *mean).to_array().into_iter().enumerate() {
            for (component, entry) in rows[axis * width..(axis + 1) * width].iter().enumerate() {
                sums[component] += offset * f64::from(*entry);
                squares[component] += f64::from(*entry).powi(2);
            }
        }
    }
    sums.iter().zip(&squares).map(|(sum, square)| if *square > 0.0 { sum / square } else { 0.0 }).collect()
}

/// Swells or dents the surface about random vertices.
fn add_bumps(
    vertices: &mut [DVec3],
    faces: &[[u32; 3]],
    settings: &PeopleSettings,
    random: &mut RandomStream,
) {
    let normals = habitus::geometry::vertex_normals(vertices, faces);
    let rest = vertices.to_vec();
    for _ in 0..settings.bump_count {
        let centre = (random.unit() * rest.len() as f64) as usize % rest.len();
        let height = random.normal() * settings.bump_height_mm / 1000.0;
        let radius = random.between(settings.bump_radius_mm[0], settings.bump_radius_mm[1]) / 1000.0;
        for (vertex, (position, normal)) in vertices.iter_mut().zip(rest.iter().zip(&normals)) {
            let squared = position.distance_squared(rest[centre]) / (radius * radius);
            // Facing away is the other side of a limb, not the neighbourhood.
            if squared < 1.0 && normal.dot(normals[centre]) > 0.0 {
                *vertex += *normal * (height * (1.0 - squared).powi(2));
            }
        }
    }
}
