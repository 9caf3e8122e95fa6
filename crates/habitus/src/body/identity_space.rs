//! A body model with the same topology and rig over another identity space, such as one learnt from registrations.

use glam::DVec3;

use super::file::joint_map;
use super::model::{BodyModel, ModelMetadata};
use super::surface::BodySurface;
use crate::statistics::{LinearSpace, LinearSpaceError};

/// What a new identity space is called and where it comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct SpaceOrigin {
    /// Name of the model.
    pub name: String,
    /// Licence of the model's data.
    pub license: String,
    /// How the space was made.
    pub provenance: serde_json::Value,
}

impl BodyModel {
    /// This model's topology, skeleton, skin weights, joint regressor and names over another identity space (P1 §2.2).
    ///
    /// The space lies in this model's rest pose: vertices in metres, stacked x, y, z of the first, then of the second.
    pub fn with_identity_space(
        &self,
        space: &LinearSpace,
        origin: SpaceOrigin,
    ) -> Result<Self, LinearSpaceError> {
        let expected = 3 * self.vertex_count();
        if space.sample_length() != expected {
            let found = space.sample_length();
            return Err(LinearSpaceError::LengthMismatch { what: "mean", expected, found });
        }
        let component_count = space.component_count();
        let mean: Vec<DVec3> = space.mean().chunks_exact(3).map(DVec3::from_slice).collect();
        let mut basis = vec![0.0_f32; expected * component_count];
        // A model's deviations count metres of the plain stacked vector, whatever the space was weighted with.
        let mut standard_deviations = Vec::with_capacity(component_count);
        for (component, (column, deviation)) in
            space.basis().column_iter().zip(space.standard_deviations()).enumerate()
        {
            standard_deviations.push(deviation * column.norm());
            for (coordinate, value) in column.iter().enumerate() {
                basis[coordinate * component_count + component] = (value * deviation) as f32;
            }
        }
        let joints = joint_map(&self.joint_regressor, &mean, &basis, component_count);
        Ok(Self {
            metadata: ModelMetadata {
                name: origin.name,
                license: origin.license,
                provenance: origin.provenance,
                ..self.metadata.clone()
            },
            surface: BodySurface {
                skeleton: self.surface.skeleton.clone(),
                mean,
                basis,
                component_count,
                skin: self.surface.skin.clone(),
                joints,
            },
            standard_deviations,
            ..self.clone()
        })
    }

    /// The model's identity space as stacked vertices: mean, unit directions, deviations in metres of the stacked vector.
    pub fn identity_space(&self) -> Result<LinearSpace, LinearSpaceError> {
        let count = self.component_count();
        let mean = self.mean_vertices().iter().flat_map(|vertex| vertex.to_array()).collect();
        let basis = nalgebra::DMatrix::from_fn(3 * self.vertex_count(), count, |coordinate, component| {
            let deviation = self.standard_deviations[component].max(f64::MIN_POSITIVE);
            f64::from(self.surface.basis[coordinate * count + component]) / deviation
        });
        let total = self.standard_deviations.iter().map(|deviation| deviation * deviation).sum();
        LinearSpace::from_parts(mean, basis, self.standard_deviations.clone(), Vec::new(), total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::fixture;

    #[test]
    fn the_model_over_its_own_space_is_the_same_body() {
        let model = fixture::model();
        let origin = SpaceOrigin {
            name: "again".into(),
            license: "CC0-1.0".into(),
            provenance: serde_json::Value::Null,
        };
        let space = model.identity_space().expect("is consistent");
        let again = model.with_identity_space(&space, origin).expect("is the same topology");
        let identity = [1.5, -2.0, 0.5, 1.0];
        let mut pose = model.skeleton().rest_pose();
        pose.parameters_mut().iter_mut().enumerate().for_each(|(k, angle)| *angle = 0.02 * k as f64);
        let posed = |model: &BodyModel| {
            let rest = model.rest_vertices(&identity);
            let joints = model.surface().rest_joints(&identity);
            model.pose_vertices(&rest, &model.skeleton().pose(&joints, pose.parameters()))
        };
        for (left, right) in posed(&model).iter().zip(posed(&again)) {
            // The basis is kept in f32.
            assert!(left.distance(right) < 1e-6);
        }
        assert_eq!(again.metadata().name, "again");
        assert_eq!(again.metadata().landmarks, model.metadata().landmarks);
        for (left, right) in again.standard_deviations().iter().zip(model.standard_deviations()) {
            // A file's directions are unit vectors up to their 16 bits; a deviation takes over what they lack.
            assert!((left - right).abs() < 1e-3 * right);
        }
    }

    #[test]
    fn a_space_of_another_topology_is_refused() {
        let model = fixture::model();
        let small =
            LinearSpace::from_parts(vec![0.0; 6], nalgebra::DMatrix::zeros(6, 0), vec![], vec![], 0.0)
                .expect("is consistent");
        let origin = SpaceOrigin { name: String::new(), license: String::new(), provenance: ().into() };
        let error = model.with_identity_space(&small, origin).expect_err("is refused");
        assert!(matches!(error, LinearSpaceError::LengthMismatch { found: 6, .. }));
    }
}
