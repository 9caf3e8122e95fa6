//! Columns of a table brought to mean zero and deviation one.

use nalgebra::DMatrix;

/// Mean and deviation of each column.
#[derive(Clone, Debug, PartialEq)]
pub struct Standardization {
    /// Means.
    pub means: Vec<f64>,
    /// Deviations; 1 for a column that does not vary, so that it becomes zero.
    pub deviations: Vec<f64>,
}

/// A column that varies by less than this share of its size is constant up to rounding.
const CONSTANT: f64 = 1e-9;

impl Standardization {
    /// Means and population deviations of the columns of `rows`.
    pub fn of(rows: &DMatrix<f64>) -> Self {
        let count = rows.nrows().max(1) as f64;
        let means: Vec<f64> = rows.column_iter().map(|column| column.sum() / count).collect();
        let deviations = rows
            .column_iter()
            .zip(&means)
            .map(|(column, mean)| {
                let variance = column.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
                let deviation = variance.sqrt();
                if deviation > CONSTANT * (1.0 + mean.abs()) { deviation } else { 1.0 }
            })
            .collect();
        Self { means, deviations }
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.means.len()
    }

    /// Standardised rows.
    pub fn apply(&self, rows: &DMatrix<f64>) -> DMatrix<f64> {
        assert_eq!(rows.ncols(), self.width(), "one mean for each column");
        DMatrix::from_fn(rows.nrows(), rows.ncols(), |row, k| {
            (rows[(row, k)] - self.means[k]) / self.deviations[k]
        })
    }

    /// Rows in their own unit again.
    pub fn undo(&self, rows: &DMatrix<f64>) -> DMatrix<f64> {
        assert_eq!(rows.ncols(), self.width(), "one mean for each column");
        DMatrix::from_fn(rows.nrows(), rows.ncols(), |row, k| {
            rows[(row, k)] * self.deviations[k] + self.means[k]
        })
    }
}
