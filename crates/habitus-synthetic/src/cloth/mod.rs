//! Cloth moved by extended position-based dynamics with many small steps, in contact with a moving body.
//!
//! XPBD: Macklin, Müller and Chentanez 2016; one iteration in each of many substeps: Macklin et al. 2019.
//! Gauss–Seidel in a fixed order, so a result never depends on the number of threads.

mod body_interval;
mod contact;
#[cfg(test)]
mod tests;

use glam::DVec3;
use habitus::artifacts::fabric::Fabric;
use habitus::geometry::{vertex_normals, vertex_normals_into};
use serde::{Deserialize, Serialize};

pub use body_interval::BodyInterval;
use body_interval::SkinPoint;
use contact::Contact;

/// Fabric and solver.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClothSettings {
    /// Solver steps per second; stretch under the cloth's own weight falls with its square.
    pub substeps_per_second: f64,
    /// Times per second that the nearest body point of each cloth vertex is looked up again.
    pub contact_updates_per_second: f64,
    /// Mass per area, kg/m².
    pub density: f64,
    /// Inverse stiffness of an edge that is stretched, m/N.
    pub stretch_compliance: f64,
    /// Inverse stiffness of an edge that is compressed, m/N: fabric gives way and folds.
    pub compression_compliance: f64,
    /// Inverse stiffness against folding across an edge, m/N.
    pub bending_compliance: f64,
    /// Rate at which air takes velocity away, 1/s.
    pub damping_per_second: f64,
    /// Resistance of air to motion across the cloth, kg/m³: half of air's density times a drag coefficient of two (a plate).
    pub air_drag: f64,
    /// Share of the person's speed that the air around them has: still air would blow a skirt out behind a walker.
    pub wake_share: f64,
    /// Share of a vertex's velocity that its neighbours' mean replaces at each contact update: fabric's own friction.
    pub internal_damping: f64,
    /// Coulomb coefficient between cloth and skin.
    pub friction: f64,
    /// Distance that is kept from the skin, millimetres.
    pub contact_offset_mm: f64,
    /// Further distance for each garment that is worn beneath, millimetres.
    pub layer_offset_mm: f64,
    /// Cloth further than this from the body is not tested against it until the next update, millimetres.
    pub contact_range_mm: f64,
    /// Largest push out of the body in one substep, millimetres: a vertex squeezed between two limbs must not explode. Two
    /// lose against the edges of a sleeve that is too tight for its arm; clothing data take twenty.
    pub largest_push_mm: f64,
    /// Distance within which a garment feels the one that it is worn over, millimetres; 0: layers pass through one another.
    pub layer_contact_mm: f64,
    /// Whether forearms and hands push the cloth.
    pub arms: ArmContact,
    /// Acceleration of free fall, m/s², downwards.
    pub gravity: f64,
}

/// Whether forearms and hands push cloth that does not cover them. Hands that graze a thigh end up inside loose cloth, and
/// then drag it along.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ArmContact {
    /// They push like the rest of the body.
    #[default]
    Felt,
    /// Cloth passes through them.
    PassThrough,
}

impl Default for ClothSettings {
    fn default() -> Self {
        Self {
            substeps_per_second: 2400.0,
            contact_updates_per_second: 90.0,
            density: 0.22,
            stretch_compliance: 0.0,
            compression_compliance: 3e-3,
            bending_compliance: 0.15,
            damping_per_second: 2.0,
            air_drag: 1.2,
            wake_share: 0.8,
            internal_damping: 0.2,
            friction: 0.3,
            contact_offset_mm: 4.0,
            layer_offset_mm: 8.0,
            contact_range_mm: 60.0,
            largest_push_mm: 2.0,
            layer_contact_mm: 0.0,
            arms: ArmContact::default(),
            gravity: 9.81,
        }
    }
}

/// Ties a cloth vertex to a point that rides on a body triangle (waistbands, necklines, tight suits).
#[derive(Debug, Clone, PartialEq)]
pub struct Anchor {
    /// The cloth vertex.
    pub vertex: u32,
    /// The body face that carries the point.
    pub face: u32,
    /// Barycentric place on that face.
    pub barycentric: [f64; 3],
    /// Height of the point above the body along its normal, metres.
    pub height: f64,
    /// Inverse stiffness, m/N; zero pins the vertex.
    pub compliance: f64,
}

#[derive(Debug, Clone, Copy)]
struct Distance {
    vertices: [u32; 2],
    rest_length: f64,
    /// Inverse stiffness when stretched and when compressed, m/N.
    compliances: [f64; 2],
}

/// What cloth is woven of, and how it lies on the garment.
#[derive(Debug, Clone, Copy)]
pub struct Weave<'a> {
    /// The fabric.
    pub fabric: &'a Fabric,
    /// Direction of the warp at each vertex of the cut garment.
    pub warp: &'a [DVec3],
}

/// A piece of cloth in motion.
#[derive(Debug, Clone)]
pub struct Cloth {
    positions: Vec<DVec3>,
    velocities: Vec<DVec3>,
    inverse_masses: Vec<f64>,
    contact_offset: f64,
    faces: Vec<[u32; 3]>,
    normals: Vec<DVec3>,
    edges: Vec<Distance>,
    bends: Vec<Distance>,
    anchors: Vec<Anchor>,
    contacts: Vec<Contact>,
    previous: Vec<DVec3>,
}

impl Cloth {
    /// Cloth at rest in the shape that its fabric was cut to.
    pub fn new(
        positions: Vec<DVec3>,
        faces: &[[u32; 3]],
        anchors: Vec<Anchor>,
        settings: &ClothSettings,
    ) -> Self {
        Self::woven(positions, faces, anchors, settings, None)
    }

    /// The same of a fabric that is not equally stiff along all directions.
    pub fn woven(
        positions: Vec<DVec3>,
        faces: &[[u32; 3]],
        anchors: Vec<Anchor>,
        settings: &ClothSettings,
        weave: Option<Weave<'_>>,
    ) -> Self {
        let mut masses = vec![0.0; positions.len()];
        for face in faces {
            let [a, b, c] = face.map(|vertex| positions[vertex as usize]);
            let share = (b - a).cross(c - a).length() / 6.0 * settings.density;
            for vertex in face {
                masses[*vertex as usize] += share;
            }
        }
        let (edges, bends) = distance_constraints(&positions, faces, settings, weave);
        Self {
            velocities: vec![DVec3::ZERO; positions.len()],
            inverse_masses: masses
                .iter()
                .map(|&mass: &f64| if mass > 0.0 { 1.0 / mass } else { 0.0 })
                .collect(),
            previous: positions.clone(),
            contact_offset: settings.contact_offset_mm / 1000.0,
            normals: vertex_normals(&positions, faces),
            positions,
            faces: faces.to_vec(),
            edges,
            bends,
            anchors,
            contacts: Vec::new(),
        }
    }

    /// Wears it over other garments.
    pub fn over(mut self, layer: u32, settings: &ClothSettings) -> Self {
        self.contact_offset += f64::from(layer) * settings.layer_offset_mm / 1000.0;
        self
    }

    /// Carries the cloth elsewhere without moving it through the space between.
    pub fn shift(&mut self, offset: DVec3) {
        for position in &mut self.positions {
            *position += offset;
        }
    }

    /// Current vertex positions, metres.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Current vertex velocities, m/s.
    pub fn velocities(&self) -> &[DVec3] {
        &self.velocities
    }

    /// Length of each edge over its length in the cut fabric.
    pub fn stretch_ratios(&self) -> impl Iterator<Item = f64> + '_ {
        self.edges.iter().map(|edge| {
            let [a, b] = edge.vertices.map(|vertex| self.positions[vertex as usize]);
            a.distance(b) / edge.rest_length
        })
    }

    /// Moves the cloth through one frame interval; `beneath` is a garment that it is worn over and feels.
    pub fn advance(
        &mut self,
        body: &BodyInterval<'_>,
        beneath: Option<&BodyInterval<'_>>,
        settings: &ClothSettings,
    ) {
        let update_count = body.update_count();
        let substeps =
            (body.duration * settings.substeps_per_second / update_count as f64).ceil().max(1.0) as usize;
        let step_share = 1.0 / (update_count * substeps) as f64;
        let anchored: Vec<SkinPoint> =
            self.anchors.iter().map(|anchor| body.skin_point(anchor.face, anchor.barycentric)).collect();
        let air = body.mean_velocity() * settings.wake_share;
        for update in 0..update_count {
            self.find_contacts(body, beneath, update, settings);
            self.damp_internally(settings.internal_damping);
            vertex_normals_into(&self.positions, &self.faces, &mut self.normals);
            for substep in 0..substeps {
                let start = (update * substeps + substep) as f64 * step_share;
                let span = Span { start, end: start + step_share, seconds: step_share * body.duration };
                self.substep(&anchored, air, &span, settings);
            }
        }
    }

    fn damp_internally(&mut self, share: f64) {
        let mut sums = vec![(DVec3::ZERO, 0.0); self.velocities.len()];
        for edge in &self.edges {
            let [a, b] = edge.vertices.map(|vertex| vertex as usize);
            for (to, from) in [(a, b), (b, a)] {
                sums[to].0 += self.velocities[from];
                sums[to].1 += 1.0;
            }
        }
        for (velocity, (sum, count)) in self.velocities.iter_mut().zip(sums) {
            *velocity = velocity.lerp(sum / f64::max(count, 1.0), share);
        }
    }

    fn substep(&mut self, anchored: &[SkinPoint], air: DVec3, span: &Span, settings: &ClothSettings) {
        self.previous.copy_from_slice(&self.positions);
        self.move_freely(air, span.seconds, settings);
        let step = span.seconds;
        project_distances(&mut self.positions, &self.inverse_masses, &self.edges, step);
        project_distances(&mut self.positions, &self.inverse_masses, &self.bends, step);
        self.project_anchors(anchored, span);
        self.project_contacts(span, settings);
        for ((velocity, position), previous) in
            self.velocities.iter_mut().zip(&self.positions).zip(&self.previous)
        {
            *velocity = (*position - *previous) / step;
        }
        self.limit_bounce(span);
    }

    /// Free fall through air, which resists motion across the cloth.
    fn move_freely(&mut self, air: DVec3, step: f64, settings: &ClothSettings) {
        let kept_velocity = (-settings.damping_per_second * step).exp();
        let fall = DVec3::NEG_Y * settings.gravity * step;
        let drag = settings.air_drag / settings.density * step;
        for (vertex, velocity) in self.velocities.iter_mut().enumerate() {
            if self.inverse_masses[vertex] > 0.0 {
                let mut wind = (*velocity + fall - air) * kept_velocity;
                let across = wind.dot(self.normals[vertex]);
                // The implicit form of dv/dt = −drag·v² never overshoots.
                wind -= self.normals[vertex] * (across - across / (1.0 + drag * across.abs()));
                *velocity = air + wind;
                self.positions[vertex] += *velocity * step;
            }
        }
    }

    fn project_anchors(&mut self, anchored: &[SkinPoint], span: &Span) {
        for (anchor, skin) in self.anchors.iter().zip(anchored) {
            let vertex = anchor.vertex as usize;
            let inverse_mass = self.inverse_masses[vertex];
            let share = inverse_mass / (inverse_mass + anchor.compliance / (span.seconds * span.seconds));
            let target = skin.position(span.end) + skin.normal(span.end) * anchor.height;
            self.positions[vertex] = self.positions[vertex].lerp(target, share);
        }
    }
}

/// One substep within a frame interval.
struct Span {
    /// In 0..=1 of the interval.
    start: f64,
    /// In 0..=1 of the interval.
    end: f64,
    seconds: f64,
}

/// One Gauss–Seidel sweep.
///
/// Always in the same direction: sweeps that alternate leave residuals that alternate, which become velocities.
fn project_distances(positions: &mut [DVec3], inverse_masses: &[f64], constraints: &[Distance], step: f64) {
    let per_step = 1.0 / (step * step);
    for constraint in constraints {
        constraint.project(positions, inverse_masses, per_step);
    }
}

impl Distance {
    fn project(&self, positions: &mut [DVec3], inverse_masses: &[f64], per_step: f64) {
        let [a, b] = self.vertices.map(|vertex| vertex as usize);
        let difference = positions[b] - positions[a];
        let length = difference.length();
        let excess = length - self.rest_length;
        let [stretched, compressed] = self.compliances;
        let softness = if excess > 0.0 { stretched } else { compressed } * per_step;
        let total = inverse_masses[a] + inverse_masses[b] + softness;
        if length <= 0.0 || total <= 0.0 {
            return;
        }
        let correction = difference * (excess / (length * total));
        positions[a] += correction * inverse_masses[a];
        positions[b] -= correction * inverse_masses[b];
    }
}

/// Edges against stretch, and pairs of vertices across each inner edge against bending.
fn distance_constraints(
    positions: &[DVec3],
    faces: &[[u32; 3]],
    settings: &ClothSettings,
    weave: Option<Weave<'_>>,
) -> (Vec<Distance>, Vec<Distance>) {
    let mut sides: Vec<([u32; 2], u32)> = faces
        .iter()
        .flat_map(|&[a, b, c]| {
            [([a.min(b), a.max(b)], c), ([b.min(c), b.max(c)], a), ([c.min(a), c.max(a)], b)]
        })
        .collect();
    sides.sort_unstable();
    let place = |vertex: u32| positions[vertex as usize];
    let distance = |vertices: [u32; 2], compliances: [f64; 2]| {
        let rest_length = place(vertices[0]).distance(place(vertices[1]));
        Distance { vertices, rest_length, compliances }
    };
    let mut edges = Vec::new();
    let mut bends = Vec::new();
    for group in sides.chunk_by(|first, second| first.0 == second.0) {
        let edge = group[0].0;
        let [a, b] = edge.map(place);
        let area: f64 =
            group.iter().map(|(_, tip)| (b - a).cross(place(*tip) - a).length() * 0.5).sum::<f64>() / 3.0;
        let stretch =
            weave.map_or(settings.stretch_compliance, |weave| weave.edge_compliance(edge, b - a, area));
        edges.push(distance(edge, [stretch, settings.compression_compliance.max(stretch)]));
        if let [(_, first), (_, second)] = group
            && first != second
        {
            let across = place(*second) - place(*first);
            let bend =
                weave.map_or(settings.bending_compliance, |weave| weave.bend_compliance(edge, across, area));
            bends.push(distance([*first, *second], [bend; 2]));
        }
    }
    (edges, bends)
}

/// Radius of the fold at which the spring across an edge holds the energy of a bent sheet, metres.
const FOLD_RADIUS: f64 = 0.03;

impl Weave<'_> {
    /// Cosine of a direction with the warp at an edge.
    fn cosine(&self, edge: [u32; 2], direction: DVec3) -> f64 {
        let warp = self.warp[edge[0] as usize] + self.warp[edge[1] as usize];
        warp.normalize_or_zero().dot(direction.normalize_or_zero())
    }

    /// Inverse stiffness of an edge that stands for a share of a sheet's `area`: k = 3 E A / L², which makes a lattice
    /// of equilateral triangles as stiff as the sheet (k = √3/2 · E).
    fn edge_compliance(&self, edge: [u32; 2], along: DVec3, area: f64) -> f64 {
        let modulus = self.fabric.stretch_along(self.cosine(edge, along));
        along.length_squared() / (3.0 * modulus * area.max(1e-12))
    }

    /// Inverse stiffness of the spring across an edge. A sheet of rigidity B bent to a radius R holds ½ B A / R² on the
    /// area A. A spring of length 2h along the bend is then the chord of an arc, shorter by δ = h φ² / 3 with φ = h / R;
    /// one at an angle θ to it by δ cos⁴θ, so that a lattice of springs holds ½ k δ² times the mean of cos⁸θ. Flatter
    /// folds meet a softer spring, sharper ones a stiffer.
    fn bend_compliance(&self, edge: [u32; 2], across: DVec3, area: f64) -> f64 {
        const MEAN_OF_COS_8: f64 = 35.0 / 128.0;
        let rigidity = self.fabric.bend_along(self.cosine(edge, across));
        let height = across.length() * 0.5;
        let angle = height / FOLD_RADIUS;
        let shortening = height * angle * angle / 3.0;
        (shortening * FOLD_RADIUS).powi(2) * MEAN_OF_COS_8 / (rigidity * area.max(1e-12))
    }
}

impl ClothSettings {
    /// These settings with the mass, damping and friction of a fabric.
    #[must_use]
    pub fn made_of(&self, fabric: Option<&Fabric>) -> Self {
        let Some(fabric) = fabric else { return self.clone() };
        Self {
            density: fabric.density,
            internal_damping: fabric.damping,
            friction: fabric.friction,
            ..self.clone()
        }
    }
}
