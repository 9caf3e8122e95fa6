//! Poses that agree over time about how the clothes hang.
//!
//! Each frame was fitted to a surface without knowing which of its points is which. A layer has one topology: the median
//! layer, posed, says where each vertex of the clothing should be, and the pose that brings it nearest is a better
//! estimate of the motion than the fitted one. Alternating the two (a generalised Procrustes alignment, Gower 1975, with
//! a skeleton in place of a rigid motion) leaves to the offsets what the skeleton cannot explain.
//!
//! Deviation: P3 takes the poses of the body estimate as they are; see book/src/deviations.md.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::config::SettleConfig;
use crate::artifacts::clothing_layer::ClothingLayer;
use crate::body::BlendedSkin;

/// Moves the poses of `layers`, which have one association, and changes the offsets so that each frame's dressed surface
/// stays where it is.
pub(super) fn settle_poses(layers: &mut [ClothingLayer], config: &SettleConfig) {
    for layer in layers.iter_mut() {
        if layer.frames.len() < 2 {
            continue;
        }
        let skin = layer.association.blended_skin(&layer.rig);
        let anchors = layer.association.anchors(&layer.rest_vertices);
        let surfaces: Vec<Vec<DVec3>> =
            (0..layer.frames.len()).into_par_iter().map(|frame| layer.clothing_vertices(frame)).collect();
        for _ in 0..config.rounds {
            let median = median_offsets(layer);
            let in_rest: Vec<DVec3> = anchors.iter().zip(&median).map(|(a, offset)| *a + *offset).collect();
            let settle = Settling::new(layer, &skin, &in_rest, config);
            let poses: Vec<Vec<f64>> = surfaces
                .par_iter()
                .zip(&layer.frames)
                .map(|(surface, frame)| settle.pose(&frame.pose, surface))
                .collect();
            layer.frames.iter_mut().zip(poses).for_each(|(frame, pose)| frame.pose = pose);
            unpose(layer, &skin, &anchors, &surfaces);
        }
    }
}

/// Median of each coordinate over the frames, in metres.
fn median_offsets(layer: &ClothingLayer) -> Vec<DVec3> {
    let (count, width) = (layer.frames.len(), 3 * layer.clothing_vertex_count());
    let medians: Vec<f64> = (0..width)
        .into_par_iter()
        .map(|k| {
            let mut values: Vec<f32> = (0..count).map(|frame| layer.offsets[frame * width + k]).collect();
            let (_, median, _) = values.select_nth_unstable_by(count / 2, f32::total_cmp);
            f64::from(*median)
        })
        .collect();
    medians.chunks_exact(3).map(DVec3::from_slice).collect()
}

/// Offsets of given surfaces in the layer's present poses.
fn unpose(layer: &mut ClothingLayer, skin: &BlendedSkin, anchors: &[DVec3], surfaces: &[Vec<DVec3>]) {
    let offsets: Vec<Vec<f32>> = surfaces
        .par_iter()
        .enumerate()
        .map(|(frame, surface)| {
            let stretch = layer.association.smallest_stretch;
            let carriers = skin.carriers(anchors, &layer.posed_skeleton(frame), stretch);
            let unposed = carriers.iter().zip(surface).map(|(carrier, posed)| carrier.unpose(*posed));
            unposed.flat_map(|offset| offset.as_vec3().to_array()).collect()
        })
        .collect();
    layer.offsets = offsets.concat();
}

/// What all frames of a round share.
struct Settling<'a> {
    layer: &'a ClothingLayer,
    skin: &'a BlendedSkin,
    in_rest: &'a [DVec3],
    vertices: Vec<usize>,
    config: &'a SettleConfig,
}

impl<'a> Settling<'a> {
    fn new(
        layer: &'a ClothingLayer,
        skin: &'a BlendedSkin,
        in_rest: &'a [DVec3],
        config: &'a SettleConfig,
    ) -> Self {
        let step = (in_rest.len() / config.vertices.max(1)).max(1);
        Self { layer, skin, in_rest, vertices: (0..in_rest.len()).step_by(step).collect(), config }
    }

    /// The pose near `start` that brings the median layer nearest to a frame's surface.
    fn pose(&self, start: &[f64], surface: &[DVec3]) -> Vec<f64> {
        let mut pose = start.to_vec();
        for _ in 0..self.config.steps {
            let (mut matrix, right) = self.normal_equations(&pose, surface);
            // The root is free; angles that the clothes hardly show stay where they are.
            let damping = self.config.damping * self.vertices.len() as f64;
            (0..pose.len()).for_each(|k| matrix[(k, k)] += if k < 6 { 1e-9 } else { damping });
            let Some(factor) = matrix.cholesky() else { break };
            let step: DVector<f64> = factor.solve(&right);
            pose.iter_mut().zip(step.iter()).for_each(|(value, step)| *value += step);
        }
        pose
    }

    /// Jᵀ W J and Jᵀ W r of the distances from the posed layer to the surface, W the weights of Geman and McClure.
    fn normal_equations(&self, pose: &[f64], surface: &[DVec3]) -> (DMatrix<f64>, DVector<f64>) {
        let skeleton = &self.layer.rig.skeleton;
        let posed = skeleton.pose(&self.layer.rest_joints, pose);
        let count = pose.len();
        let (mut matrix, mut right) = (DMatrix::zeros(count, count), DVector::zeros(count));
        let mut slopes = vec![DVec3::ZERO; count];
        for vertex in self.vertices.iter().copied() {
            slopes.fill(DVec3::ZERO);
            let mut point = DVec3::ZERO;
            for (bone, weight) in self.skin.of(vertex) {
                let moved = posed.rotations[bone] * self.in_rest[vertex] + posed.translations[bone];
                point += moved * weight;
                for parameter in skeleton.chain(bone) {
                    slopes[*parameter] += posed.twists[*parameter].at(moved) * weight;
                }
            }
            let residual = surface[vertex] - point;
            let scale = self.config.robust_distance * self.config.robust_distance;
            let weight = scale / (scale + residual.length_squared());
            for (k, slope) in slopes.iter().enumerate().filter(|(_, slope)| **slope != DVec3::ZERO) {
                right[k] += weight * slope.dot(residual);
                for (l, other) in slopes[..=k].iter().enumerate() {
                    matrix[(k, l)] += weight * slope.dot(*other);
                }
            }
        }
        matrix.fill_upper_triangle_with_lower_triangle();
        (matrix, right)
    }
}
