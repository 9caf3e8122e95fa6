//! Contact of cloth with the body, and with what is worn beneath it.

use rayon::prelude::*;

use super::body_interval::{BodyInterval, SkinPoint};
use super::{Cloth, ClothSettings, Span};

/// Outward speed that contact may leave a vertex with, m/s: pushing out of the body must not fling.
const LARGEST_BOUNCE: f64 = 0.05;
/// Smallest cosine between a sheet's normal and the way to a vertex above it. Beside a hem the nearest point is on the
/// hem and the way to it lies along the sheet: there is nothing to rest on.
const LEAST_FACING: f64 = 0.5;

/// A vertex and what it may rest on until the next lookup.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contact {
    vertex: u32,
    skin: SkinPoint,
    /// Distance that is kept, metres.
    offset: f64,
}

impl Cloth {
    /// Looks up what is near each vertex in the middle of a contact interval.
    pub(super) fn find_contacts(
        &mut self,
        body: &BodyInterval<'_>,
        beneath: Option<&BodyInterval<'_>>,
        update: usize,
        settings: &ClothSettings,
    ) {
        let radius = settings.contact_range_mm / 1000.0;
        let layer_radius = settings.layer_contact_mm / 1000.0;
        let layer_offset = settings.contact_offset_mm / 1000.0;
        let contacts = |(vertex, &position): (usize, &glam::DVec3)| {
            let vertex = vertex as u32;
            let on_skin = body.nearest(update, position, radius).map(|nearest| Contact {
                vertex,
                skin: body.skin_point(nearest.face, nearest.barycentric),
                offset: self.contact_offset,
            });
            let on_layer = beneath.and_then(|layer| {
                let nearest = layer.nearest(update, position, layer_radius)?;
                let way = position - nearest.position;
                let is_over = way.dot(nearest.normal).abs() >= LEAST_FACING * way.length();
                let skin = layer.skin_point(nearest.face, nearest.barycentric);
                is_over.then_some(Contact { vertex, skin, offset: layer_offset })
            });
            [on_skin, on_layer].into_iter().flatten()
        };
        self.contacts = self.positions.par_iter().enumerate().flat_map_iter(contacts).collect();
    }

    /// Pushes vertices out to the contact distance and takes up to the Coulomb limit of the sliding away.
    pub(super) fn project_contacts(&mut self, span: &Span, settings: &ClothSettings) {
        for Contact { vertex, skin, offset } in &self.contacts {
            let position = &mut self.positions[*vertex as usize];
            let normal = skin.normal(span.end);
            let depth = offset - (*position - skin.position(span.end)).dot(normal);
            if depth <= 0.0 {
                continue;
            }
            let push = depth.min(settings.largest_push_mm / 1000.0);
            *position += normal * push;
            let moved = *position - self.previous[*vertex as usize] - skin.way(span.start, span.end);
            let sliding = moved - normal * moved.dot(normal);
            let length = sliding.length();
            if length > 0.0 {
                *position -= sliding * (settings.friction * push / length).min(1.0);
            }
        }
    }

    pub(super) fn limit_bounce(&mut self, span: &Span) {
        for Contact { vertex, skin, offset } in &self.contacts {
            let vertex = *vertex as usize;
            let normal = skin.normal(span.end);
            if (self.positions[vertex] - skin.position(span.end)).dot(normal) > offset + 1e-6 {
                continue;
            }
            let leaving =
                (self.velocities[vertex] - skin.way(span.start, span.end) / span.seconds).dot(normal);
            if leaving > LARGEST_BOUNCE {
                self.velocities[vertex] -= normal * (leaving - LARGEST_BOUNCE);
            }
        }
    }
}
