//! The dressed surface that all frames of a sequence, or of several, are bent from.

use glam::DVec3;
use habitus_geometry::{Topology, TriangleMesh, remove_small_components, weld};

use super::super::config::ExtractClothingConfig;
use super::super::offsets::Unposing;
use super::super::{ExtractClothingError, Observed, associate_frames};
use super::read_capture;
use crate::artifacts::clothing_layer::{ClothingAssociation, ClothingLayer};
use crate::artifacts::frames::FrameSource;
use crate::artifacts::rigged_sequence::RiggedSequence;

/// Vertices nearer than this are one, in metres: seams of a capture, not its detail.
const WELD_DISTANCE: f64 = 1e-6;

/// A dressed surface as offsets over the rest body, with what it hangs on.
#[derive(Clone, Debug)]
pub struct ClothingTemplate {
    association: ClothingAssociation,
    faces: Vec<[u32; 3]>,
    /// Offset of each vertex in rest space, metres.
    offsets: Vec<DVec3>,
    /// The surface in the pose that it was taken from.
    shape: TriangleMesh,
    /// The frame that it was taken from, if of this sequence.
    frame: Option<usize>,
}

impl ClothingTemplate {
    /// Takes the surface of the frame that shows most of it: what touches hides surface from a capture.
    pub fn from_captures(
        fit: &RiggedSequence,
        captures: &dyn FrameSource,
        config: &ExtractClothingConfig,
    ) -> Result<Self, ExtractClothingError> {
        let total = fit.sequence.frames.len();
        let candidates = match config.alignment.template_frame {
            Some(frame) => vec![frame.min(total.saturating_sub(1))],
            None => super::super::spread(0, total, config.alignment.template_candidates.max(1)),
        };
        let mut best: Option<(f64, usize, TriangleMesh)> = None;
        let mut first_reason = String::from("there is none");
        for frame in candidates {
            match read_capture(fit, captures, frame, &config.alignment) {
                Ok(capture) => {
                    if let Some(mesh) = capture.mesh {
                        let area = area(&mesh);
                        if best.as_ref().is_none_or(|(largest, ..)| area > *largest) {
                            best = Some((area, frame, mesh));
                        }
                    } else {
                        first_reason = "a template must be a mesh, and this frame is a point cloud".into();
                    }
                }
                Err(reason) => first_reason = reason,
            }
        }
        let Some((_, frame, captured)) = best else {
            return Err(ExtractClothingError::NoUsableFrame { first_reason });
        };
        let shape = without_short_edges(&captured, config.alignment.shortest_edge).unwrap_or(captured);
        let seen = [Observed { frame, clothing: shape.clone() }];
        let (association, _) = associate_frames(fit, &seen, &config.association)?;
        let unposing = Unposing::new(fit, &association);
        let carriers = unposing.carriers(frame);
        let offsets = carriers
            .iter()
            .zip(shape.positions())
            .map(|(carrier, position)| carrier.unpose(*position))
            .collect();
        Ok(Self { association, faces: shape.faces().to_vec(), offsets, shape, frame: Some(frame) })
    }

    /// Takes connectivity, association and the mean offsets of a layer, so that another sequence gets the same vertices:
    /// the way from one to the other leads through the body.
    pub fn from_layer(layer: &ClothingLayer) -> Result<Self, ExtractClothingError> {
        let count = layer.frames.len().max(1) as f64;
        let mut offsets = vec![DVec3::ZERO; layer.clothing_vertex_count()];
        for frame in 0..layer.frames.len() {
            for (sum, offset) in offsets.iter_mut().zip(layer.frame_offsets(frame).as_chunks::<3>().0) {
                *sum += DVec3::from_array(offset.map(f64::from)) / count;
            }
        }
        let rest = layer.association.anchors(&layer.rest_vertices);
        let positions = rest.iter().zip(&offsets).map(|(anchor, offset)| *anchor + *offset).collect();
        let shape = TriangleMesh::new(positions, layer.clothing_faces.clone()).map_err(|error| {
            ExtractClothingError::NoUsableFrame { first_reason: format!("the template is no mesh: {error}") }
        })?;
        let association = layer.association.clone();
        Ok(Self { association, faces: layer.clothing_faces.clone(), offsets, shape, frame: None })
    }

    /// Triangles.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.offsets.len()
    }

    /// What the vertices hang on.
    pub fn association(&self) -> &ClothingAssociation {
        &self.association
    }

    /// The frame that it was taken from, if of this sequence.
    pub fn frame(&self) -> Option<usize> {
        self.frame
    }

    /// The surface that lengths are compared with.
    pub(super) fn shape(&self) -> &TriangleMesh {
        &self.shape
    }

    /// The template over the body of a frame, metres.
    pub(super) fn posed(&self, fit: &RiggedSequence, frame: usize) -> Vec<DVec3> {
        let carriers = Unposing::new(fit, &self.association).carriers(frame);
        carriers.iter().zip(&self.offsets).map(|(carrier, offset)| carrier.pose(*offset)).collect()
    }

    /// A surface of one frame, carried along by the body into another frame, metres.
    pub(super) fn carried(
        &self,
        fit: &RiggedSequence,
        from: usize,
        to: usize,
        surface: &[DVec3],
    ) -> Vec<DVec3> {
        let unposing = Unposing::new(fit, &self.association);
        let (before, after) = (unposing.carriers(from), unposing.carriers(to));
        let moved = before.iter().zip(&after).zip(surface);
        moved.map(|((before, after), position)| after.pose(before.unpose(*position))).collect()
    }
}

/// Welds seams and drops small pieces; `None` where nothing is left.
pub(super) fn cleaned(positions: &[DVec3], faces: &[[u32; 3]], smallest_share: f64) -> Option<TriangleMesh> {
    let welded = weld(positions, faces, WELD_DISTANCE);
    let mesh = TriangleMesh::new(welded.positions, welded.faces).ok()?;
    Some(remove_small_components(&mesh, smallest_share).0)
}

/// The same surface with edges below a length collapsed, the shortest first; `None` where nothing is left.
fn without_short_edges(mesh: &TriangleMesh, shortest: f64) -> Option<TriangleMesh> {
    let positions = mesh.positions();
    let length = |[a, b]: &[u32; 2]| positions[*a as usize].distance(positions[*b as usize]);
    let topology = Topology::of_mesh(mesh);
    let mut short: Vec<[u32; 2]> =
        topology.edges().iter().copied().filter(|edge| length(edge) < shortest).collect();
    short.sort_by(|a, b| length(a).total_cmp(&length(b)).then(a.cmp(b)));
    let mut kept: Vec<u32> = (0..positions.len() as u32).collect();
    let mut is_touched = vec![false; positions.len()];
    for [a, b] in short {
        // One collapse for each neighbourhood: chains would eat whole folds.
        if !is_touched[a as usize] && !is_touched[b as usize] {
            kept[b as usize] = a;
            is_touched[a as usize] = true;
            is_touched[b as usize] = true;
        }
    }
    let collapsed = mesh.faces().iter().map(|face| face.map(|vertex| kept[vertex as usize]));
    let faces: Vec<[u32; 3]> = collapsed.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    let mut places = vec![u32::MAX; positions.len()];
    let mut used = Vec::new();
    for vertex in faces.iter().flatten() {
        let place = &mut places[*vertex as usize];
        if *place == u32::MAX {
            *place = used.len() as u32;
            used.push(positions[*vertex as usize]);
        }
    }
    let renamed = faces.iter().map(|face| face.map(|vertex| places[vertex as usize])).collect();
    TriangleMesh::new(used, renamed).ok()
}

fn area(mesh: &TriangleMesh) -> f64 {
    (0..mesh.faces().len())
        .map(|face| {
            let [a, b, c] = mesh.corners(face);
            0.5 * (b - a).cross(c - a).length()
        })
        .sum()
}
