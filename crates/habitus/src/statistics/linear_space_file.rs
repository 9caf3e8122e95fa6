//! The arrays of a space in an `.npz` file.

use nalgebra::DMatrix;

use super::linear_space::LinearSpace;
use crate::artifacts::npz::{NpzError, NpzReader, NpzWriter};

impl LinearSpace {
    /// Adds the space's arrays to a file, their names starting with `prefix`. The basis is stored component by component.
    pub fn add_to(&self, file: &mut NpzWriter, prefix: &str) {
        let (length, components) = (self.sample_length(), self.component_count());
        file.add(&format!("{prefix}mean"), &[length], &self.mean);
        file.add(&format!("{prefix}basis"), &[components, length], self.basis.as_slice());
        file.add(&format!("{prefix}standard_deviations"), &[components], &self.standard_deviations);
        file.add(&format!("{prefix}weights"), &[self.weights.len()], &self.weights);
        file.add(&format!("{prefix}total_variance"), &[1], &[self.total_variance]);
    }

    /// Reads the arrays that [`LinearSpace::add_to`] wrote.
    pub fn read_from(file: &mut NpzReader, prefix: &str) -> Result<Self, NpzError> {
        let mean = file.floats(&format!("{prefix}mean"))?.values;
        let deviations_key = format!("{prefix}standard_deviations");
        let standard_deviations = file.floats(&deviations_key)?.values;
        if standard_deviations.iter().any(|deviation| *deviation < 0.0) {
            return Err(file.invalid(&deviations_key, "holds a negative deviation".into()));
        }
        let basis_key = format!("{prefix}basis");
        let basis = file.floats(&basis_key)?;
        file.expect_shape(&basis_key, &basis, &[Some(standard_deviations.len()), Some(mean.len())])?;
        let basis = DMatrix::from_vec(mean.len(), standard_deviations.len(), basis.values);
        let weights_key = format!("{prefix}weights");
        let weights = file.floats(&weights_key)?.values;
        if weights.iter().any(|weight| *weight <= 0.0) {
            return Err(file.invalid(&weights_key, "holds a weight that is not positive".into()));
        }
        let variance_key = format!("{prefix}total_variance");
        let total_variance = file.floats(&variance_key)?;
        file.expect_shape(&variance_key, &total_variance, &[Some(1)])?;
        Self::from_parts(mean, basis, standard_deviations, weights, total_variance.values[0])
            .map_err(|error| file.invalid(&basis_key, error.to_string()))
    }
}
