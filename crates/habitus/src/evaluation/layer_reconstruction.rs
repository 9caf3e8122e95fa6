//! How far a reconstructed dressed surface is from the captured one (P3 §4).
//!
//! P3's error is the mean distance between corresponding vertices of the dressed surface in the captured pose.

use glam::DVec3;
use rayon::prelude::*;

use crate::artifacts::clothing_layer::ClothingLayer;
use crate::body::{BlendedSkin, Carrier};

/// A layer with what is needed to pose it.
pub struct PosedLayer<'a> {
    /// The layer.
    pub layer: &'a ClothingLayer,
    skin: BlendedSkin,
    anchors: Vec<DVec3>,
}

impl<'a> PosedLayer<'a> {
    /// Prepares a layer.
    pub fn new(layer: &'a ClothingLayer) -> Self {
        let skin = layer.association.blended_skin(&layer.rig);
        Self { layer, skin, anchors: layer.association.anchors(&layer.rest_vertices) }
    }

    /// Blended transforms of the clothing's vertices in a frame.
    pub fn carriers(&self, frame: usize) -> Vec<Carrier> {
        let posed = self.layer.posed_skeleton(frame);
        self.skin.carriers(&self.anchors, &posed, self.layer.association.smallest_stretch)
    }

    /// Distance of each vertex from where it was captured, in metres, if the frame's offsets were `offsets`.
    pub fn vertex_errors(&self, frame: usize, offsets: &[f64]) -> Vec<f64> {
        let truth = self.layer.frame_offsets(frame).as_chunks::<3>().0;
        let carriers = self.carriers(frame);
        carriers
            .iter()
            .zip(truth)
            .zip(offsets.chunks_exact(3))
            .map(|((carrier, truth), offset)| {
                let truth = DVec3::from_array(truth.map(f64::from));
                (carrier.linear * (DVec3::from_slice(offset) - truth)).length()
            })
            .collect()
    }

    /// Mean of [`PosedLayer::vertex_errors`], in metres.
    pub fn mean_error(&self, frame: usize, offsets: &[f64]) -> f64 {
        mean(&self.vertex_errors(frame, offsets))
    }
}

/// Mean over frames of the mean vertex error in millimetres; `offsets` gives the offsets of each frame named by layer and
/// frame.
pub fn mean_error_mm(
    layers: &[PosedLayer<'_>],
    frames: &[(usize, usize)],
    offsets: impl Fn(usize) -> Vec<f64> + Sync,
) -> f64 {
    let errors: Vec<f64> = frames
        .par_iter()
        .enumerate()
        .map(|(row, (layer, frame))| layers[*layer].mean_error(*frame, &offsets(row)))
        .collect();
    1000.0 * mean(&errors)
}

/// Mean of numbers; 0 of none.
pub fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 0.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// Captured and predicted dressed surfaces of some frames, posed.
pub struct SurfacePairs<'a> {
    faces: &'a [[u32; 3]],
    /// Layer and frame of each pair, and the time of the frame.
    frames: Vec<(usize, usize, f64)>,
    pairs: Vec<(Vec<DVec3>, Vec<DVec3>)>,
}

impl<'a> SurfacePairs<'a> {
    /// Poses the captured offsets and `offsets` of each frame, given by layer and frame.
    pub fn new(layers: &'a [PosedLayer<'_>], frames: &[(usize, usize)], offsets: &[Vec<f64>]) -> Self {
        let pairs = frames
            .par_iter()
            .zip(offsets)
            .map(|((layer, frame), offsets)| {
                let carriers = layers[*layer].carriers(*frame);
                let truth = layers[*layer].layer.frame_offsets(*frame).as_chunks::<3>().0;
                let pose = |(carrier, offset): (&Carrier, DVec3)| carrier.pose(offset);
                let captured = truth.iter().map(|offset| DVec3::from_array(offset.map(f64::from)));
                let predicted = offsets.chunks_exact(3).map(DVec3::from_slice);
                (
                    carriers.iter().zip(captured).map(pose).collect(),
                    carriers.iter().zip(predicted).map(pose).collect(),
                )
            })
            .collect();
        let frames = frames
            .iter()
            .map(|(layer, frame)| (*layer, *frame, layers[*layer].layer.time_of(*frame)))
            .collect();
        Self { faces: layers.first().map_or(&[], |layer| &layer.layer.clothing_faces), frames, pairs }
    }

    /// Captured and predicted surface of one of the frames.
    pub fn pair(&self, index: usize) -> (&[DVec3], Vec<DVec3>) {
        (&self.pairs[index].0, self.pairs[index].1.clone())
    }

    /// Mean angle between the normals of corresponding faces, in degrees.
    pub fn normal_error_deg(&self) -> f64 {
        let angles: Vec<f64> = self
            .pairs
            .par_iter()
            .map(|(captured, predicted)| {
                let normal = |vertices: &[DVec3], face: &[u32; 3]| {
                    let [a, b, c] = face.map(|vertex| vertices[vertex as usize]);
                    (b - a).cross(c - a)
                };
                let angles = self
                    .faces
                    .iter()
                    .map(|face| normal(captured, face).angle_between(normal(predicted, face)));
                mean(&angles.filter(|angle| angle.is_finite()).collect::<Vec<f64>>())
            })
            .collect();
        mean(&angles).to_degrees()
    }

    /// Mean difference of second differences over time of corresponding vertices, in m/s², over frames whose neighbours
    /// are there.
    pub fn acceleration_error(&self) -> f64 {
        let errors: Vec<f64> = (1..self.frames.len().saturating_sub(1))
            .filter_map(|middle| {
                let [before, here, after] = [middle - 1, middle, middle + 1].map(|k| self.frames[k]);
                let is_run = before.0 == here.0 && after.0 == here.0;
                let is_even = ((after.2 - here.2) - (here.2 - before.2)).abs() < 1e-9;
                if !(is_run && is_even) {
                    return None;
                }
                let step = here.2 - before.2;
                let error = |vertex: usize| {
                    let second = |surface: &dyn Fn(usize) -> DVec3| {
                        surface(middle - 1) - 2.0 * surface(middle) + surface(middle + 1)
                    };
                    let captured = second(&|k| self.pairs[k].0[vertex]);
                    let predicted = second(&|k| self.pairs[k].1[vertex]);
                    (captured - predicted).length() / (step * step)
                };
                Some(mean(&(0..self.pairs[middle].0.len()).map(error).collect::<Vec<f64>>()))
            })
            .collect();
        mean(&errors)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifacts::fixture::moving_layer;

    #[test]
    fn errors_are_distances_of_the_posed_surface() {
        let layer = moving_layer(6, 0.0);
        let posed = PosedLayer::new(&layer);
        let truth: Vec<f64> = layer.frame_offsets(3).iter().copied().map(f64::from).collect();
        assert!(posed.mean_error(3, &truth) < 1e-12);
        let other: Vec<f64> =
            truth.iter().enumerate().map(|(k, value)| value + 0.01 * (k as f64).sin()).collect();
        let pairs = SurfacePairs::new(std::slice::from_ref(&posed), &[(0, 3)], std::slice::from_ref(&other));
        let (captured, predicted) = pairs.pair(0);
        let distances: Vec<f64> = captured.iter().zip(&predicted).map(|(a, b)| a.distance(*b)).collect();
        for (error, distance) in posed.vertex_errors(3, &other).iter().zip(&distances) {
            assert!((error - distance).abs() < 1e-12);
        }
        assert!(
            (mean_error_mm(&[posed], &[(0, 3)], |_| other.clone()) - 1000.0 * mean(&distances)).abs() < 1e-9
        );
    }

    #[test]
    fn a_perfect_prediction_has_no_error_of_any_kind() {
        let layer = moving_layer(6, 0.0);
        let posed = [PosedLayer::new(&layer)];
        let frames: Vec<(usize, usize)> = (0..6).map(|frame| (0, frame)).collect();
        let truth: Vec<Vec<f64>> =
            (0..6).map(|frame| layer.frame_offsets(frame).iter().copied().map(f64::from).collect()).collect();
        let pairs = SurfacePairs::new(&posed, &frames, &truth);
        assert!(pairs.normal_error_deg() < 1e-4 && pairs.acceleration_error() < 1e-9);
    }
}
