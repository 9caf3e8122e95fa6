//! What plays in a report, from a layer, a model or a synthesized sequence.

use glam::DVec3;
use habitus::artifacts::clothing_layer::{ClothingLayer, pose_offsets};
use habitus::artifacts::clothing_model::ClothingModel;
use habitus::artifacts::synthesized_sequence::SynthesizedSequence;
use habitus::body::PosedSkeleton;
use habitus::geometry::{SurfaceIndex, SurfacePoint, TriangleMesh};
use rayon::prelude::*;

use super::{DressedClip, FrameShape, frame_step};
use crate::dressing_room::SkinnedSurface;

/// Where the offsets of a synthesized frame come from.
#[derive(Clone, Copy)]
pub enum ClipSource<'a> {
    /// A model, by the coefficients of the sequence.
    Model(&'a ClothingModel),
    /// A layer that was replayed.
    Layer(&'a ClothingLayer),
}

/// The captured clothing of a layer over its body.
pub fn layer_clip(layer: &ClothingLayer) -> DressedClip {
    let count = layer.frames.len();
    let step = frame_step(count, layer.clothing_vertex_count(), 1);
    let frames: Vec<usize> = (0..count).step_by(step).collect();
    let skeletons: Vec<PosedSkeleton> = frames.iter().map(|frame| layer.posed_skeleton(*frame)).collect();
    let clothing = frames.par_iter().map(|frame| layer.clothing_vertices(*frame)).collect();
    let shown = with_clearance(layer, &layer.rest_vertices, &skeletons, clothing);
    let rate = layer.frame_rate.frames_per_second() / step as f64;
    clip_of(layer, layer.rest_vertices.clone(), rate, &skeletons, shown, Vec::new())
}

/// What a model makes of a motion, without push-out. `poses` in metres and radians.
pub fn model_clip(model: &ClothingModel, poses: &[Vec<f64>]) -> DressedClip {
    let layer = &model.dressed;
    let step = frame_step(poses.len(), layer.clothing_vertex_count(), 1);
    let rate = model.frame_rate();
    let all: Vec<&[f64]> = poses.iter().map(Vec::as_slice).collect();
    let times: Vec<f64> = (0..poses.len()).map(|frame| rate.time_of(frame)).collect();
    let coefficients = model.coefficients(&all, &times, &model.controls.defaults());
    let frames: Vec<usize> = (0..poses.len()).step_by(step).collect();
    let skeletons: Vec<PosedSkeleton> =
        frames.iter().map(|frame| layer.rig.skeleton.pose(&layer.rest_joints, &poses[*frame])).collect();
    let clothing = unpushed(layer, &layer.rest_vertices, &skeletons, &|shown| {
        let row: Vec<f64> = coefficients.row(frames[shown]).iter().copied().collect();
        model.offsets(&row)
    });
    let shown = with_clearance(layer, &layer.rest_vertices, &skeletons, clothing);
    let rate = rate.frames_per_second() / step as f64;
    clip_of(layer, layer.rest_vertices.clone(), rate, &skeletons, shown, Vec::new())
}

/// A synthesized sequence, after the push-out and before it.
pub fn synthesized_clip(
    sequence: &SynthesizedSequence,
    dressed: &ClothingLayer,
    source: ClipSource<'_>,
) -> DressedClip {
    let count = sequence.clothing.len();
    let step = frame_step(count, dressed.clothing_vertex_count(), 2);
    let frames: Vec<usize> = (0..count).step_by(step).collect();
    let skeletons: Vec<PosedSkeleton> =
        frames.iter().map(|frame| sequence.body.posed_skeleton(*frame)).collect();
    let rest = &sequence.body.sequence.rest_vertices;
    let offsets = |shown: usize| match source {
        ClipSource::Model(model) => {
            let row = sequence.coefficients.row(frames[shown]);
            model.offsets(&row.iter().copied().collect::<Vec<f64>>())
        }
        ClipSource::Layer(layer) => layer.frame_offsets(frames[shown]).to_vec(),
    };
    let before = with_clearance(dressed, rest, &skeletons, unpushed(dressed, rest, &skeletons, &offsets));
    let clothing = frames.iter().map(|frame| sequence.clothing[*frame].clone()).collect();
    let shown = with_clearance(dressed, rest, &skeletons, clothing);
    let rate = sequence.frame_rate.frames_per_second() / step as f64;
    clip_of(dressed, rest.clone(), rate, &skeletons, shown, before)
}

/// The clothing of offsets where the body carries it.
fn unpushed(
    layer: &ClothingLayer,
    rest: &[DVec3],
    skeletons: &[PosedSkeleton],
    offsets: &(dyn Fn(usize) -> Vec<f32> + Sync),
) -> Vec<Vec<DVec3>> {
    let skin = layer.association.blended_skin(&layer.rig);
    let anchors = layer.association.anchors(rest);
    let pose = |(shown, posed): (usize, &PosedSkeleton)| {
        let carriers = skin.carriers(&anchors, posed, layer.association.smallest_stretch);
        pose_offsets(&carriers, &offsets(shown))
    };
    skeletons.par_iter().enumerate().map(pose).collect()
}

/// Clothing with its signed distance from the skin; without it in all frames if a posed body is no mesh.
fn with_clearance(
    layer: &ClothingLayer,
    rest: &[DVec3],
    skeletons: &[PosedSkeleton],
    clothing: Vec<Vec<DVec3>>,
) -> Vec<FrameShape> {
    let clearance = |(posed, clothing): (&PosedSkeleton, &Vec<DVec3>)| {
        let mut body = Vec::new();
        layer.rig.skin.apply_into(rest, posed, &mut body);
        let body = TriangleMesh::new(body, layer.rig.faces.clone()).ok()?;
        let mut closest = Vec::new();
        SurfaceIndex::of_mesh(&body).closest_many(clothing, None, &mut closest);
        Some(clothing.iter().zip(&closest).map(|(place, point)| signed_mm(*place, point)).collect())
    };
    let found: Option<Vec<Vec<f64>>> = skeletons.par_iter().zip(&clothing).map(clearance).collect();
    let mut found = found.unwrap_or_default().into_iter();
    let shape = |clothing| FrameShape { clothing, clearance_mm: found.next().unwrap_or_default() };
    clothing.into_iter().map(shape).collect()
}

/// Distance from the skin in millimetres, negative inside.
pub(crate) fn signed_mm(place: DVec3, closest: &SurfacePoint) -> f64 {
    let distance = closest.distance_squared.sqrt() * 1000.0;
    if (place - closest.position).dot(closest.normal) < 0.0 { -distance } else { distance }
}

fn clip_of(
    layer: &ClothingLayer,
    rest_vertices: Vec<DVec3>,
    frames_per_second: f64,
    skeletons: &[PosedSkeleton],
    shown: Vec<FrameShape>,
    before: Vec<FrameShape>,
) -> DressedClip {
    let vertex_count = rest_vertices.len();
    DressedClip {
        body: SkinnedSurface {
            vertex_count,
            faces: layer.rig.faces.clone(),
            skin: (0..vertex_count).map(|vertex| layer.rig.skin.of(vertex).collect()).collect(),
        },
        rest_vertices,
        clothing_faces: layer.clothing_faces.clone(),
        frames_per_second,
        bones: skeletons
            .iter()
            .map(|posed| posed.rotations.iter().copied().zip(posed.translations.iter().copied()).collect())
            .collect(),
        shown,
        before,
    }
}
