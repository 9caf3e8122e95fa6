//! A space that was learnt in the mean pose of the registrations, brought into the base model's rest pose.
//!
//! The base model's axes, limits and skin weights belong to its rest pose. One transform for each vertex, the inverse
//! skinning of the mean body, serves the whole space: it is linear in the identity.

use glam::DVec3;
use nalgebra::DMatrix;

use super::LearnShapeError;
use super::config::LearnShapeConfig;
use super::pose_normalization::{rest_transforms, undone};
use crate::body::BodyModel;
use crate::fitting::same_topology::SameTopologyFitter;
use crate::statistics::LinearSpace;

/// The same space with every vertex moved as the mean body needs it.
pub(super) fn brought_into_rest_pose(
    space: &LinearSpace,
    base: &BodyModel,
    config: &LearnShapeConfig,
) -> Result<LinearSpace, LearnShapeError> {
    let mean: Vec<DVec3> = space.mean().chunks_exact(3).map(DVec3::from_slice).collect();
    let fit = SameTopologyFitter::new(base, &config.pose_fit)
        .fit(&mean)
        .map_err(|source| LearnShapeError::PoseFit { name: "mean body".into(), source })?;
    let joints = base.surface().rest_joints(&fit.identity);
    let posed = base.skeleton().pose(&joints, &fit.pose);
    let transforms = rest_transforms(base, &posed, config.unpose.smallest_determinant);
    let rest_mean = mean.iter().zip(&transforms).flat_map(|(v, transform)| undone(transform, *v).to_array());
    let mut basis: DMatrix<f64> = space.basis().clone();
    for mut column in basis.column_iter_mut() {
        let values = column.as_mut_slice();
        for (direction, (inverse, _)) in values.chunks_exact_mut(3).zip(&transforms) {
            let turned = *inverse * DVec3::from_slice(direction);
            direction.copy_from_slice(&turned.to_array());
        }
    }
    Ok(LinearSpace::from_parts(
        rest_mean.collect(),
        basis,
        space.standard_deviations().to_vec(),
        Vec::new(),
        space.total_variance(),
    )?)
}
