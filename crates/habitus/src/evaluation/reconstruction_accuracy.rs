//! How far bodies reconstructed from two views are from the true ones (P1 §6.2): vertex by vertex, as a curve over
//! distances and as a mean at each vertex.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::statistics::align_to;

/// What is measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReconstructionAccuracySettings {
    /// Distances at which the curve is taken (P1 Fig. 5), millimetres.
    pub thresholds_mm: Vec<f64>,
    /// Numbers of components of the largest space (P1 §6.2, columns of Fig. 5).
    pub components: Vec<usize>,
    /// Numbers of registrations that spaces are learnt from (P1 §6.2, rows of Fig. 5).
    pub training_samples: Vec<usize>,
    /// Seed of the subsets of registrations.
    pub seed: u64,
}

impl Default for ReconstructionAccuracySettings {
    fn default() -> Self {
        Self {
            thresholds_mm: (0..=25).map(|step| f64::from(step) * 2.0).collect(),
            components: vec![5, 10, 20, 50, 100],
            training_samples: vec![10, 30, 100, 300, 1000],
            seed: 0,
        }
    }
}

/// Errors of one space over many people.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ReconstructionAccuracy {
    /// Components of the space.
    pub components: usize,
    /// Registrations that it was learnt from, if that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub training_samples: Option<usize>,
    /// People that were reconstructed.
    pub people: usize,
    /// People that were not found at all: they are in no other number.
    pub failed: usize,
    /// Mean vertex distance of the posed bodies, in the cameras' frames, over both views, millimetres.
    pub posed_mm: f64,
    /// Mean vertex distance of the rest bodies after rigid alignment, millimetres. Spaces that lie in slightly different rest
    /// poses differ in it without being worse.
    pub rest_mm: f64,
    /// Largest of these of a person, millimetres.
    pub worst_rest_mm: f64,
    /// Distances of the curve, millimetres.
    pub thresholds_mm: Vec<f64>,
    /// Share of the posed vertices that are nearer.
    pub share: Vec<f64>,
    /// Mean distance of the posed bodies at each vertex, millimetres. Drawn, not written.
    #[serde(skip)]
    pub vertex_mean_mm: Vec<f64>,
}

/// A body as it was found beside the true one; metres.
pub struct ComparedBody<'a> {
    /// Rest bodies: found, true.
    pub rest: [&'a [DVec3]; 2],
    /// Posed bodies of each view: found, true.
    pub posed: Vec<[&'a [DVec3]; 2]>,
}

impl ReconstructionAccuracy {
    /// Sums up bodies that were found.
    pub fn of(bodies: &[ComparedBody<'_>], failed: usize, thresholds_mm: &[f64]) -> Self {
        let rest: Vec<f64> = bodies.iter().map(|body| aligned_distance_mm(body.rest)).collect();
        let mut sums: Vec<f64> = Vec::new();
        let mut within = vec![0_usize; thresholds_mm.len()];
        let views: Vec<&[&[DVec3]; 2]> = bodies.iter().flat_map(|body| &body.posed).collect();
        for [found, truth] in &views {
            sums.resize(truth.len(), 0.0);
            for ((sum, found), truth) in sums.iter_mut().zip(*found).zip(*truth) {
                let distance = 1000.0 * found.distance(*truth);
                *sum += distance;
                for (count, threshold) in within.iter_mut().zip(thresholds_mm) {
                    *count += usize::from(distance <= *threshold);
                }
            }
        }
        let view_count = views.len().max(1) as f64;
        let vertex_mean_mm: Vec<f64> = sums.iter().map(|sum| sum / view_count).collect();
        let vertex_count = sums.len().max(1) as f64;
        Self {
            components: 0,
            training_samples: None,
            people: bodies.len(),
            failed,
            posed_mm: vertex_mean_mm.iter().sum::<f64>() / vertex_count,
            rest_mm: rest.iter().sum::<f64>() / rest.len().max(1) as f64,
            worst_rest_mm: rest.iter().copied().fold(0.0, f64::max),
            thresholds_mm: thresholds_mm.to_vec(),
            share: within.iter().map(|count| *count as f64 / (view_count * vertex_count)).collect(),
            vertex_mean_mm,
        }
    }
}

fn aligned_distance_mm([found, truth]: [&[DVec3]; 2]) -> f64 {
    let mut stacked: Vec<f64> = found.iter().flat_map(|vertex| vertex.to_array()).collect();
    align_to(&mut stacked, truth);
    let distances = stacked.chunks_exact(3).zip(truth).map(|(x, y)| DVec3::from_slice(x).distance(*y));
    1000.0 * distances.sum::<f64>() / truth.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rest_bodies_are_aligned_and_posed_ones_are_not() {
        let truth = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let moved = truth.map(|point| point + DVec3::X * 0.01);
        let body = ComparedBody { rest: [&moved, &truth], posed: vec![[&moved, &truth], [&truth, &truth]] };
        let found = ReconstructionAccuracy::of(&[body], 1, &[5.0, 20.0]);
        assert!(found.rest_mm < 1e-9 && (found.posed_mm - 5.0).abs() < 1e-9);
        assert_eq!((found.people, found.failed), (1, 1));
        assert_eq!(found.share, [0.5, 1.0]);
        assert!(found.vertex_mean_mm.iter().all(|mean| (mean - 5.0).abs() < 1e-9));
    }
}
