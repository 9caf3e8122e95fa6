//! What the readers of all formats collect, and the checks that they share.

use glam::DVec3;

use super::error::{Fault, Place, Problem};
use super::{Format, ReadReport};
use crate::mesh::repeated_vertex;

/// The vertices and triangles of a file while it is being read.
pub(super) struct Content {
    pub positions: Vec<DVec3>,
    pub normals: Option<Vec<DVec3>>,
    pub faces: Vec<[u32; 3]>,
    pub report: ReadReport,
    highest: Option<NamedVertex>,
}

/// The highest vertex that a face names, to be checked when the vertices are all known.
struct NamedVertex {
    vertex: u32,
    face: usize,
    place: Place,
}

impl Content {
    pub fn new(format: Format) -> Self {
        Self {
            positions: Vec::new(),
            normals: None,
            faces: Vec::new(),
            report: ReadReport::new(format),
            highest: None,
        }
    }

    pub fn add_position(&mut self, position: DVec3, place: Place) -> Result<(), Fault> {
        if !position.is_finite() {
            return Err(Fault { place, problem: Problem::NonFiniteVertex { vertex: self.positions.len() } });
        }
        self.positions.push(position);
        Ok(())
    }

    /// Adds a polygon as a fan about its first corner; triangles without area are counted, not kept.
    pub fn add_polygon(&mut self, corners: &[u32], place: Place) {
        let face = self.report.polygon_count;
        self.report.polygon_count += 1;
        if let Some(&vertex) = corners.iter().max()
            && self.highest.as_ref().is_none_or(|highest| vertex > highest.vertex)
        {
            self.highest = Some(NamedVertex { vertex, face, place });
        }
        if corners.len() < 3 {
            self.report.degenerate_face_count += 1;
            return;
        }
        if corners.len() > 3 {
            self.report.fanned_polygon_count += 1;
        }
        for pair in corners[1..].windows(2) {
            let triangle = [corners[0], pair[0], pair[1]];
            if repeated_vertex(triangle).is_some() {
                self.report.degenerate_face_count += 1;
            } else {
                self.faces.push(triangle);
            }
        }
    }

    /// The checks that need the whole file; `end` is the place for what belongs to no line.
    pub fn finish(mut self, end: Place) -> Result<Self, Fault> {
        let vertex_count = self.positions.len();
        if let Some(NamedVertex { vertex, face, place }) = self.highest
            && vertex as usize >= vertex_count
        {
            let problem = Problem::VertexOutOfRange { face, vertex: i64::from(vertex), vertex_count };
            return Err(Fault { place, problem });
        }
        if self.report.polygon_count > 0 && self.faces.is_empty() {
            let problem = Problem::OnlyDegenerateFaces { face_count: self.report.polygon_count };
            return Err(Fault { place: end, problem });
        }
        if let Some(normals) = &self.normals {
            let unusable = normals.iter().filter(|normal| normal.try_normalize().is_none()).count();
            self.report.unusable_normal_count = unusable;
            if unusable > 0 || normals.len() != vertex_count {
                self.normals = None;
            }
        }
        Ok(self)
    }
}
