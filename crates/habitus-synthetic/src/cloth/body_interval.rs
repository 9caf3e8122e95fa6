//! The body as cloth meets it: a surface that moves through one frame interval.

use glam::DVec3;
use habitus::geometry::{SurfaceIndex, SurfacePoint, TriangleMesh, vertex_normals};
use rayon::prelude::*;

use super::ClothSettings;
use crate::error::SyntheticError;

/// The body surface over one frame interval, moving in straight lines from `start` to `end`.
#[derive(Debug)]
pub struct BodyInterval<'a> {
    faces: &'a [[u32; 3]],
    /// Faces that push the cloth, in the order of the lookups.
    felt: &'a [u32],
    positions: [&'a [DVec3]; 2],
    normals: [Vec<DVec3>; 2],
    pub(super) duration: f64,
    /// Lookups of the surface in the middle of each contact interval.
    surfaces: Vec<SurfaceIndex>,
}

impl<'a> BodyInterval<'a> {
    /// Prepares the contact lookups; shared by all garments of the frame. `felt` are the numbers of the faces that push
    /// the cloth.
    pub fn new(
        faces: &'a [[u32; 3]],
        felt: &'a [u32],
        start: &'a [DVec3],
        end: &'a [DVec3],
        duration: f64,
        settings: &ClothSettings,
    ) -> Result<Self, SyntheticError> {
        let update_count = (duration * settings.contact_updates_per_second).round().max(1.0) as usize;
        let felt_faces: Vec<[u32; 3]> = felt.iter().map(|face| faces[*face as usize]).collect();
        let surfaces = (0..update_count)
            .into_par_iter()
            .map(|update| {
                let time = (update as f64 + 0.5) / update_count as f64;
                let positions = start.iter().zip(end).map(|(start, end)| start.lerp(*end, time)).collect();
                Ok(SurfaceIndex::of_mesh(&TriangleMesh::new(positions, felt_faces.clone())?))
            })
            .collect::<Result<_, SyntheticError>>()?;
        let normals = [vertex_normals(start, faces), vertex_normals(end, faces)];
        Ok(Self { faces, felt, positions: [start, end], normals, duration, surfaces })
    }

    /// Contact lookups of the interval.
    pub(super) fn update_count(&self) -> usize {
        self.surfaces.len()
    }

    /// The felt point nearest to a place in the middle of a contact interval.
    pub(super) fn nearest(&self, update: usize, place: DVec3, radius: f64) -> Option<SurfacePoint> {
        let nearest = self.surfaces[update].closest_within(place, radius)?;
        Some(SurfacePoint { face: self.felt[nearest.face as usize], ..nearest })
    }

    pub(super) fn mean_velocity(&self) -> DVec3 {
        let [start, end] = self.positions;
        let way: DVec3 = end.iter().zip(start).map(|(end, start)| *end - *start).sum();
        way / (start.len() as f64 * self.duration)
    }

    pub(super) fn skin_point(&self, face: u32, barycentric: [f64; 3]) -> SkinPoint {
        let corners = self.faces[face as usize].map(|vertex| vertex as usize);
        let blend = |values: &[DVec3]| -> DVec3 {
            corners.iter().zip(barycentric).map(|(&vertex, share)| values[vertex] * share).sum()
        };
        SkinPoint {
            positions: self.positions.map(blend),
            normals: [blend(&self.normals[0]), blend(&self.normals[1])],
        }
    }
}

/// A body point that moves in a straight line over the frame interval, and the skin's normal there.
#[derive(Debug, Clone, Copy)]
pub(super) struct SkinPoint {
    positions: [DVec3; 2],
    normals: [DVec3; 2],
}

impl SkinPoint {
    /// At a time in 0..=1 of the interval.
    pub(super) fn position(&self, time: f64) -> DVec3 {
        self.positions[0].lerp(self.positions[1], time)
    }

    pub(super) fn normal(&self, time: f64) -> DVec3 {
        self.normals[0].lerp(self.normals[1], time).normalize_or_zero()
    }

    /// Way from one time to another.
    pub(super) fn way(&self, start: f64, end: f64) -> DVec3 {
        (self.positions[1] - self.positions[0]) * (end - start)
    }
}
