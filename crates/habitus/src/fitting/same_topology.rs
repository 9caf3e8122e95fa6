//! Identity and pose of a body whose vertices are known: a registered mesh in the model's own topology (P1 §3.2 with
//! every vertex its own landmark).

use glam::{DMat3, DQuat, DVec3};
use habitus_geometry::procrustes;
use habitus_optimize::{Bounds, GaussNewtonSettings, Silent, SolveError, gauss_newton};
use serde::{Deserialize, Serialize};

use super::deformers::{BodyParameters, FreeParameters};
use super::fit::Fit;
use super::terms::{LandmarkPull, LandmarkTargets, StayNear};
use crate::body::{BodyModel, BodySurface, IdentityCoefficients, Pose};

/// How a body is fitted to vertices in its own topology.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SameTopologySettings {
    /// Identity components that are fitted; what they cannot express is left in the residual.
    pub components: usize,
    /// Vertices that are fitted, spread evenly over the model's list.
    pub vertices: usize,
    /// Price of one standard deviation of identity, in square metres of mean squared vertex distance.
    pub identity_stiffness: f64,
    /// Steps for the pose alone.
    pub pose_steps: usize,
    /// Steps for identity and pose together.
    pub steps: usize,
}

impl Default for SameTopologySettings {
    fn default() -> Self {
        Self { components: 30, vertices: 1000, identity_stiffness: 2e-7, pose_steps: 4, steps: 8 }
    }
}

/// The body that lies closest to given vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct SameTopologyFit {
    /// Identity in standard deviations, as many as the settings ask for.
    pub identity: Vec<f64>,
    /// The pose vector.
    pub pose: Vec<f64>,
}

/// A model prepared for many such fits.
pub struct SameTopologyFitter<'a> {
    model: &'a BodyModel,
    surface: BodySurface,
    vertices: Vec<u32>,
    settings: SameTopologySettings,
}

impl<'a> SameTopologyFitter<'a> {
    /// Prepares a model.
    pub fn new(model: &'a BodyModel, settings: &SameTopologySettings) -> Self {
        let count = model.vertex_count();
        let stride = count.div_ceil(settings.vertices.max(1)).max(1);
        let vertices: Vec<u32> = (0..count as u32).step_by(stride).collect();
        let surface = model.surface().subset(&vertices).truncated(settings.components);
        Self { model, surface, vertices, settings: settings.clone() }
    }

    /// Fits one mesh; its vertices are in metres, in any heading and place.
    pub fn fit(&self, mesh: &[DVec3]) -> Result<SameTopologyFit, SolveError> {
        assert_eq!(mesh.len(), self.model.vertex_count(), "a mesh in the model's topology");
        let targets: Vec<DVec3> = self.vertices.iter().map(|vertex| mesh[*vertex as usize]).collect();
        let pulls: Vec<LandmarkPull> = targets
            .iter()
            .enumerate()
            .map(|(vertex, target)| LandmarkPull { vertex: vertex as u32, target: *target, confidence: 1.0 })
            .collect();
        let term = LandmarkTargets::new(&pulls);
        let components = self.surface.component_count();
        let identity = vec![0.0; components];
        let mut pose = self.first_pose(&targets).parameters().to_vec();
        let (lower, upper) = self.surface.skeleton().pose_limits();
        {
            let deformer = BodyParameters::of_pose(&self.surface, &identity);
            let bounds = Bounds::new(lower.clone(), upper.clone())?;
            let fit = Fit::new(&deformer).with(1.0, &term);
            gauss_newton(&fit, &mut pose, &bounds, &steps(self.settings.pose_steps), &mut Silent)?;
        }
        let limit = IdentityCoefficients::LIMIT;
        let bounds = Bounds::new(
            [vec![-limit; components], lower].concat(),
            [vec![limit; components], upper].concat(),
        )?;
        let deformer = BodyParameters::new(&self.surface, FreeParameters::IdentityAndPose);
        let stiffness = self.settings.identity_stiffness * targets.len() as f64;
        let prior = StayNear::new(0, &identity, &vec![stiffness; components]);
        let fit = Fit::new(&deformer).with(1.0, &term).with(1.0, &prior);
        let mut parameters = [identity, pose].concat();
        gauss_newton(&fit, &mut parameters, &bounds, &steps(self.settings.steps), &mut Silent)?;
        let pose = parameters.split_off(components);
        Ok(SameTopologyFit { identity: parameters, pose })
    }

    /// The mean body, laid rigidly on the mesh.
    fn first_pose(&self, targets: &[DVec3]) -> Pose {
        let mut pose = self.surface.skeleton().rest_pose();
        if let Some(motion) = procrustes(self.surface.mean_vertices(), targets) {
            let root = self.surface.joint_map().mean[0];
            let rotation: DMat3 = motion.rotation;
            pose.set_root(DQuat::from_mat3(&rotation), motion.apply(root) - root);
        }
        pose
    }
}

fn steps(count: usize) -> GaussNewtonSettings {
    GaussNewtonSettings { max_iterations: count, ..GaussNewtonSettings::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::fixture;

    #[test]
    fn an_instance_of_the_model_is_recovered() {
        let model = fixture::model();
        let identity = [0.8, -1.2, 0.5, 0.3, -0.4, 0.9];
        let mut pose = model.skeleton().rest_pose();
        let (lower, upper) = model.skeleton().pose_limits();
        for (k, angle) in pose.parameters_mut().iter_mut().enumerate().skip(6) {
            *angle = (0.3 * (k as f64).sin()).clamp(lower[k], upper[k]);
        }
        pose.set_root(DQuat::from_rotation_y(2.0), DVec3::new(0.3, -0.2, 5.0));
        let rest = model.rest_vertices(&identity);
        let joints = model.surface().rest_joints(&identity);
        let mesh = model.pose_vertices(&rest, &model.skeleton().pose(&joints, pose.parameters()));
        let settings = SameTopologySettings {
            identity_stiffness: 1e-12,
            steps: 20,
            vertices: 400,
            ..Default::default()
        };
        let found = SameTopologyFitter::new(&model, &settings).fit(&mesh).expect("fits");
        let rest = model.rest_vertices(&found.identity);
        let joints = model.surface().rest_joints(&found.identity);
        let again = model.pose_vertices(&rest, &model.skeleton().pose(&joints, &found.pose));
        for (left, right) in again.iter().zip(&mesh) {
            assert!(left.distance(*right) < 1e-5, "{}", left.distance(*right));
        }
    }
}
