//! P1 §3.4, after Wuhrer, Shu and Xi 2012 (WSX): starting with the mean body, its localized Laplacian coordinates are
//! brought as close as possible to those of a registration, which gives that body's shape in the mean body's pose.
//!
//! Laplacian coordinates in the vertex's own frame say nothing about where a limb as a whole points: a weak pull to the
//! mean body, whose frames the first round uses, decides it.

use glam::DVec3;

use super::super::LearnShapeError;
use super::super::config::LocalLaplacianConfig;
use super::super::laplacian_surface::LaplacianSurface;
use crate::body::BodyModel;

/// The mean body with its factorised Laplacian.
pub(super) struct LocalLaplacian {
    surface: LaplacianSurface,
    mean: Vec<DVec3>,
    rounds: usize,
}

impl LocalLaplacian {
    pub fn new(
        base: &BodyModel,
        mean: Vec<DVec3>,
        config: &LocalLaplacianConfig,
    ) -> Result<Self, LearnShapeError> {
        let surface = LaplacianSurface::new(base.faces(), vec![config.anchor; mean.len()])
            .map_err(LearnShapeError::Laplacian)?;
        Ok(Self { surface, mean, rounds: config.rounds })
    }

    /// The shape of `vertices` in the pose of the mean.
    pub fn normalized(&self, vertices: &[DVec3]) -> Vec<DVec3> {
        let coordinates = self.surface.coordinates(vertices);
        let mut found = self.mean.clone();
        for _ in 0..self.rounds.max(1) {
            let turned: Vec<DVec3> = self
                .surface
                .frame_rotations(vertices, &found)
                .iter()
                .zip(&coordinates)
                .map(|(rotation, coordinate)| *rotation * *coordinate)
                .collect();
            found = self.surface.solve(&turned, &self.mean);
        }
        found
    }
}
