//! Taking differences of pose out of registrations (P1 §3.4).

mod local_laplacian;
mod skeleton_laplacian;
mod unpose;

use glam::DVec3;
use habitus_optimize::{Observer, map_chunks};

use super::config::{LearnShapeConfig, PoseNormalization};
use super::{LearnShapeError, tell};
use crate::body::BodyModel;
use crate::fitting::same_topology::{SameTopologyFit, SameTopologyFitter};
use crate::statistics::SampleMatrix;

pub(super) use unpose::{rest_transforms, undone};

/// Registrations after the normalization.
#[derive(Clone, Debug, PartialEq)]
pub struct NormalizedSamples {
    /// Stacked vertices in metres.
    pub samples: SampleMatrix,
    /// Whether they are in the base model's rest pose, not in the mean pose of the registrations.
    pub is_in_rest_pose: bool,
}

/// Registrations that are worked on side by side before the observer hears of them.
const BATCH: usize = 16;

/// Takes differences of pose out of aligned samples.
pub fn normalize_pose(
    samples: SampleMatrix,
    names: &[&str],
    base: &BodyModel,
    config: &LearnShapeConfig,
    observer: &mut dyn Observer,
) -> Result<NormalizedSamples, LearnShapeError> {
    let is_in_rest_pose = config.pose_normalization == PoseNormalization::Unpose;
    let samples = match config.pose_normalization {
        PoseNormalization::None => samples,
        PoseNormalization::LocalLaplacian => {
            let mean = points(&samples.mean());
            let method = local_laplacian::LocalLaplacian::new(base, mean, &config.local_laplacian)?;
            mapped(&samples, observer, |index| Ok(method.normalized(&samples.points(index))))?
        }
        PoseNormalization::SkeletonLaplacian => {
            let fits = fitted_poses(&samples, names, base, config, observer)?;
            let method = skeleton_laplacian::SkeletonLaplacian::new(base, &fits, &config.skeleton_laplacian)?;
            mapped(&samples, observer, |index| Ok(method.normalized(&samples.points(index), &fits[index])))?
        }
        PoseNormalization::Unpose => {
            let fitter = SameTopologyFitter::new(base, &config.pose_fit);
            mapped(&samples, observer, |index| {
                let vertices = samples.points(index);
                let fit = fit_of(&fitter, names[index], &vertices)?;
                Ok(unpose::unposed(base, &vertices, &fit, &config.unpose))
            })?
        }
    };
    Ok(NormalizedSamples { samples, is_in_rest_pose })
}

fn fitted_poses(
    samples: &SampleMatrix,
    names: &[&str],
    base: &BodyModel,
    config: &LearnShapeConfig,
    observer: &mut dyn Observer,
) -> Result<Vec<SameTopologyFit>, LearnShapeError> {
    let fitter = SameTopologyFitter::new(base, &config.pose_fit);
    in_batches(samples.len(), "pose", observer, |index| fit_of(&fitter, names[index], &samples.points(index)))
}

fn fit_of(
    fitter: &SameTopologyFitter<'_>,
    name: &str,
    vertices: &[DVec3],
) -> Result<SameTopologyFit, LearnShapeError> {
    fitter.fit(vertices).map_err(|source| LearnShapeError::PoseFit { name: name.into(), source })
}

/// The samples, each changed by `change`.
fn mapped(
    samples: &SampleMatrix,
    observer: &mut dyn Observer,
    change: impl Fn(usize) -> Result<Vec<DVec3>, LearnShapeError> + Sync,
) -> Result<SampleMatrix, LearnShapeError> {
    let mut result = SampleMatrix::with_capacity(samples.sample_length(), samples.len());
    let changed = in_batches(samples.len(), "normalize", observer, change)?;
    changed.iter().for_each(|vertices| result.push_points(vertices));
    Ok(result)
}

fn in_batches<T: Send>(
    count: usize,
    stage: &'static str,
    observer: &mut dyn Observer,
    work: impl Fn(usize) -> Result<T, LearnShapeError> + Sync,
) -> Result<Vec<T>, LearnShapeError> {
    let mut results = Vec::with_capacity(count);
    while results.len() < count {
        let start = results.len();
        let length = BATCH.min(count - start);
        for result in map_chunks(length, 1, |range| work(start + range.start)) {
            results.push(result?);
        }
        tell(observer, stage, results.len(), count)?;
    }
    Ok(results)
}

fn points(stacked: &[f64]) -> Vec<DVec3> {
    stacked.chunks_exact(3).map(DVec3::from_slice).collect()
}
