//! P1 §3.4, after Neophytou and Hilton 2013 (NH): the skeleton turns each part of a registration into the mean pose, and
//! Laplacian coordinates, turned with it, keep the surface's detail and join the parts at the joints.

use glam::{DMat3, DVec3};
use habitus_geometry::best_rotation;

use super::super::LearnShapeError;
use super::super::config::SkeletonLaplacianConfig;
use super::super::laplacian_surface::LaplacianSurface;
use crate::body::{BodyModel, ROOT_LENGTH};
use crate::fitting::same_topology::SameTopologyFit;

/// The mean pose and the factorised Laplacian with anchors where the surface is rigid.
pub(super) struct SkeletonLaplacian<'a> {
    base: &'a BodyModel,
    surface: LaplacianSurface,
    mean_angles: Vec<f64>,
}

impl<'a> SkeletonLaplacian<'a> {
    pub fn new(
        base: &'a BodyModel,
        fits: &[SameTopologyFit],
        config: &SkeletonLaplacianConfig,
    ) -> Result<Self, LearnShapeError> {
        let anchors = (0..base.vertex_count())
            .map(|vertex| {
                let largest =
                    base.surface().skin().of(vertex).fold(0.0_f64, |most, (_, weight)| most.max(weight));
                let rigidity = largest.powi(4);
                config.joint_anchor + (config.rigid_anchor - config.joint_anchor) * rigidity
            })
            .collect();
        let surface = LaplacianSurface::new(base.faces(), anchors).map_err(LearnShapeError::Laplacian)?;
        let mut mean_angles = vec![0.0; base.skeleton().axes().len()];
        for fit in fits {
            for (mean, angle) in mean_angles.iter_mut().zip(&fit.pose[ROOT_LENGTH..]) {
                *mean += angle / fits.len() as f64;
            }
        }
        Ok(Self { base, surface, mean_angles })
    }

    /// The shape of `vertices`, which were found to be in the pose of `fit`, in the mean pose.
    pub fn normalized(&self, vertices: &[DVec3], fit: &SameTopologyFit) -> Vec<DVec3> {
        let joints = self.base.surface().rest_joints(&fit.identity);
        let skeleton = self.base.skeleton();
        let current = skeleton.pose(&joints, &fit.pose);
        // The root stays: only the angles change.
        let pose = [&fit.pose[..ROOT_LENGTH], &self.mean_angles].concat();
        let wanted = skeleton.pose(&joints, &pose);
        let moves: Vec<(DMat3, DVec3)> = (0..joints.len())
            .map(|bone| {
                let rotation = wanted.rotations[bone] * current.rotations[bone].transpose();
                (rotation, wanted.translations[bone] - rotation * current.translations[bone])
            })
            .collect();
        let mut coordinates = self.surface.coordinates(vertices);
        let mut targets = Vec::with_capacity(vertices.len());
        for (vertex, position) in vertices.iter().enumerate() {
            let (mut linear, mut target) = (DMat3::ZERO, DVec3::ZERO);
            for (bone, weight) in self.base.surface().skin().of(vertex) {
                let (rotation, translation) = moves[bone];
                linear += rotation * weight;
                target += (rotation * *position + translation) * weight;
            }
            targets.push(target);
            coordinates[vertex] = best_rotation(&linear).unwrap_or(DMat3::IDENTITY) * coordinates[vertex];
        }
        self.surface.solve(&coordinates, &targets)
    }
}
