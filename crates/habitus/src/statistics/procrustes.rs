//! Generalized Procrustes alignment of corresponding point sets (P1 §2, [Goodall 1991]): every sample is turned and moved
//! onto the mean of all, which they change in turn, until nothing moves.

use glam::{DMat3, DVec3};
use habitus_geometry::best_rotation;
use habitus_optimize::map_chunks;
use serde::{Deserialize, Serialize};

use super::sample_matrix::SampleMatrix;

/// Whether size is a part of shape.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SizeRule {
    /// Samples keep their size: a tall person is another shape than a short one.
    #[default]
    Keep,
    /// Samples are scaled to the mean size.
    Normalize,
}

/// How samples are aligned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProcrustesSettings {
    /// Whether size is a part of shape.
    pub size: SizeRule,
    /// Rounds at most.
    pub rounds: usize,
    /// Change of the mean, in metres (root mean square over vertices), at which the rounds end.
    pub tolerance: f64,
}

impl Default for ProcrustesSettings {
    fn default() -> Self {
        Self { size: SizeRule::Keep, rounds: 50, tolerance: 1e-10 }
    }
}

/// Turns and moves all samples (stacked vertices) onto their common mean, which then lies best on `anchor`.
///
/// Returns the mean. A sample whose rotation is not determined (all vertices on a line) is only moved.
pub fn align_samples(
    samples: &mut SampleMatrix,
    anchor: &[DVec3],
    settings: &ProcrustesSettings,
) -> Vec<DVec3> {
    assert_eq!(3 * anchor.len(), samples.sample_length(), "an anchor of the samples' length");
    if samples.is_empty() {
        return anchor.to_vec();
    }
    let anchor_centre = centre(anchor.iter().copied());
    let anchor: Vec<DVec3> = anchor.iter().map(|point| *point - anchor_centre).collect();
    centre_samples(samples, settings.size);
    let mut mean = anchor.clone();
    for _ in 0..settings.rounds.max(1) {
        turn_onto(samples, &mean);
        let next = mean_points(samples);
        let change = root_mean_square(&next, &mean);
        mean = next;
        if change <= settings.tolerance {
            break;
        }
    }
    // One common turn and shift changes no shape: the mean is brought where the anchor is.
    let turn = rotation_onto(&mean, &anchor).unwrap_or(DMat3::IDENTITY);
    let placed = |point: DVec3| turn * point + anchor_centre;
    change_samples(samples, |_, point| placed(point));
    mean.into_iter().map(placed).collect()
}

/// The rigid motion that turns a sample (stacked vertices, changed in place) best onto a mean.
pub fn align_to(sample: &mut [f64], mean: &[DVec3]) {
    let mean_centre = centre(mean.iter().copied());
    let sample_centre = centre(sample.chunks_exact(3).map(DVec3::from_slice));
    let mut covariance = DMat3::ZERO;
    for (point, target) in sample.chunks_exact(3).map(DVec3::from_slice).zip(mean) {
        covariance += outer(*target - mean_centre, point - sample_centre);
    }
    let turn = best_rotation(&covariance).unwrap_or(DMat3::IDENTITY);
    for point in sample.chunks_exact_mut(3) {
        let moved = turn * (DVec3::from_slice(point) - sample_centre) + mean_centre;
        point.copy_from_slice(&moved.to_array());
    }
}

fn centre_samples(samples: &mut SampleMatrix, size: SizeRule) {
    let centres: Vec<DVec3> =
        samples.samples().map(|sample| centre(sample.chunks_exact(3).map(DVec3::from_slice))).collect();
    change_samples(samples, |index, point| point - centres[index]);
    if size == SizeRule::Normalize {
        let sizes: Vec<f64> =
            samples.samples().map(|s| s.iter().map(|x| x * x).sum::<f64>().sqrt()).collect();
        let mean_size = sizes.iter().sum::<f64>() / sizes.len() as f64;
        change_samples(samples, |index, point| point * (mean_size / sizes[index].max(f64::MIN_POSITIVE)));
    }
}

fn turn_onto(samples: &mut SampleMatrix, mean: &[DVec3]) {
    let turns: Vec<DMat3> = map_chunks(samples.len(), 1, |range| {
        let sample = samples.sample(range.start);
        let mut covariance = DMat3::ZERO;
        for (point, target) in sample.chunks_exact(3).map(DVec3::from_slice).zip(mean) {
            covariance += outer(*target, point);
        }
        best_rotation(&covariance).unwrap_or(DMat3::IDENTITY)
    });
    change_samples(samples, |index, point| turns[index] * point);
}

fn change_samples(samples: &mut SampleMatrix, change: impl Fn(usize, DVec3) -> DVec3) {
    for index in 0..samples.len() {
        for point in samples.sample_mut(index).chunks_exact_mut(3) {
            let changed = change(index, DVec3::from_slice(point));
            point.copy_from_slice(&changed.to_array());
        }
    }
}

fn mean_points(samples: &SampleMatrix) -> Vec<DVec3> {
    samples.mean().chunks_exact(3).map(DVec3::from_slice).collect()
}

fn rotation_onto(points: &[DVec3], targets: &[DVec3]) -> Option<DMat3> {
    let mut covariance = DMat3::ZERO;
    for (point, target) in points.iter().zip(targets) {
        covariance += outer(*target, *point);
    }
    best_rotation(&covariance)
}

/// `left · rightᵀ`.
pub(crate) fn outer(left: DVec3, right: DVec3) -> DMat3 {
    DMat3::from_cols(left * right.x, left * right.y, left * right.z)
}

fn centre(points: impl ExactSizeIterator<Item = DVec3>) -> DVec3 {
    let count = points.len().max(1) as f64;
    points.sum::<DVec3>() / count
}

fn root_mean_square(left: &[DVec3], right: &[DVec3]) -> f64 {
    let sum: f64 = left.iter().zip(right).map(|(x, y)| x.distance_squared(*y)).sum();
    (sum / left.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use crate::statistics::RandomStream;

    fn shape(stream: &mut RandomStream, variation: f64) -> Vec<DVec3> {
        (0..40)
            .map(|k| {
                let k = f64::from(k);
                let base = DVec3::new((k * 0.9).sin(), 0.1 * k, (k * 1.7).cos());
                base + variation * DVec3::new(stream.normal(), stream.normal(), stream.normal())
            })
            .collect()
    }

    fn moved(points: &[DVec3], stream: &mut RandomStream) -> Vec<DVec3> {
        let axis = DVec3::new(stream.normal(), stream.normal(), stream.normal());
        let turn = DQuat::from_scaled_axis(axis);
        points.iter().map(|point| turn * *point + axis * 2.0).collect()
    }

    #[test]
    fn moved_copies_of_one_shape_become_that_shape() {
        let mut stream = RandomStream::named(1, "copies");
        let anchor = shape(&mut stream, 0.0);
        let copies: Vec<_> = (0..6).map(|_| moved(&anchor, &mut stream)).collect();
        let mut samples = SampleMatrix::of_points(copies.iter().map(Vec::as_slice));
        let mean = align_samples(&mut samples, &anchor, &ProcrustesSettings::default());
        for index in 0..samples.len() {
            assert!(root_mean_square(&samples.points(index), &anchor) < 1e-12);
        }
        assert!(root_mean_square(&mean, &anchor) < 1e-12);
    }

    /// At the optimum no sample can be turned to lie closer to the mean, which an ordinary least-squares linear map with
    /// its rotation cut out afterwards does not reach.
    #[test]
    fn every_sample_lies_best_on_the_mean_of_all() {
        let mut stream = RandomStream::named(2, "shapes");
        let anchor = shape(&mut stream, 0.0);
        let shapes: Vec<_> = (0..9)
            .map(|_| {
                let points = shape(&mut stream, 0.2);
                moved(&points, &mut stream)
            })
            .collect();
        let mut samples = SampleMatrix::of_points(shapes.iter().map(Vec::as_slice));
        let mean = align_samples(&mut samples, &anchor, &ProcrustesSettings::default());
        assert!(root_mean_square(&mean, &mean_points(&samples)) < 1e-9);
        for (index, original) in shapes.iter().enumerate() {
            let aligned = samples.points(index);
            let mut again = samples.sample(index).to_vec();
            align_to(&mut again, &mean);
            let again: Vec<DVec3> = again.chunks_exact(3).map(DVec3::from_slice).collect();
            assert!(root_mean_square(&aligned, &again) < 1e-8);
            // Distances between vertices are untouched: a true rotation, no scale.
            let kept = aligned[3].distance(aligned[30]) - original[3].distance(original[30]);
            assert!(kept.abs() < 1e-12);
        }
    }

    #[test]
    fn sizes_are_kept_or_made_equal() {
        let mut stream = RandomStream::named(4, "sizes");
        let anchor = shape(&mut stream, 0.0);
        let large: Vec<DVec3> = anchor.iter().map(|point| *point * 3.0).collect();
        let aligned = |size| {
            let mut samples = SampleMatrix::of_points([&anchor[..], &large]);
            align_samples(&mut samples, &anchor, &ProcrustesSettings { size, ..Default::default() });
            root_mean_square(&samples.points(0), &samples.points(1))
        };
        assert!(aligned(SizeRule::Keep) > 0.5);
        assert!(aligned(SizeRule::Normalize) < 1e-12);
    }
}
