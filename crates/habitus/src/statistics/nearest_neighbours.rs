//! The plainest regressor that knows its data: the output of the most similar row that was seen.

use nalgebra::DMatrix;

use super::standardization::Standardization;

/// All seen rows.
#[derive(Clone, Debug, PartialEq)]
pub struct NearestNeighbour {
    inputs: Standardization,
    seen: DMatrix<f64>,
    outputs: DMatrix<f64>,
}

impl NearestNeighbour {
    /// Remembers rows; inputs are compared in deviations of each column.
    pub fn learn(inputs: &DMatrix<f64>, outputs: &DMatrix<f64>) -> Self {
        assert_eq!(inputs.nrows(), outputs.nrows(), "as many rows of inputs as of outputs");
        let scale = Standardization::of(inputs);
        Self { seen: scale.apply(inputs), inputs: scale, outputs: outputs.clone() }
    }

    /// For each row of inputs the output of the nearest seen row; the first of equals.
    pub fn predict(&self, inputs: &DMatrix<f64>) -> DMatrix<f64> {
        let asked = self.inputs.apply(inputs);
        let nearest: Vec<usize> = asked
            .row_iter()
            .map(|row| {
                let distances = self.seen.row_iter().map(|seen| (seen - row).norm_squared());
                let nearest = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
                nearest.map_or(0, |(index, _)| index)
            })
            .collect();
        self.outputs.select_rows(&nearest)
    }
}

#[cfg(test)]
mod tests {
    use super::NearestNeighbour;
    use nalgebra::DMatrix;

    #[test]
    fn seen_rows_come_back_and_scales_do_not_matter() {
        let inputs = DMatrix::from_row_slice(3, 2, &[0.0, 0.0, 1.0, 5000.0, 2.0, -5000.0]);
        let outputs = DMatrix::from_row_slice(3, 1, &[1.0, 2.0, 3.0]);
        let regressor = NearestNeighbour::learn(&inputs, &outputs);
        assert_eq!(regressor.predict(&inputs), outputs);
        let near = DMatrix::from_row_slice(1, 2, &[1.9, -2500.0]);
        assert_eq!(regressor.predict(&near)[(0, 0)], 3.0);
    }
}
