//! All eigenpairs of a dense symmetric matrix.

use faer::{MatRef, Side};
use nalgebra::DMatrix;

/// Below this size a thread of its own would cost more than the work.
const SMALL: usize = 48;

/// Eigenvalues, largest first, with unit eigenvectors as columns; the lower triangle is read.
///
/// Large matrices go to faer, whose kernels leave the vector registers in a state that slows the mathematical functions of
/// the calling thread twentyfold and more (faer 0.24). They therefore run on a thread that ends with them.
pub fn symmetric_eigen(matrix: &DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    assert_eq!(matrix.nrows(), matrix.ncols(), "a square matrix");
    let found = if matrix.nrows() < SMALL {
        None
    } else {
        std::thread::scope(|scope| scope.spawn(|| large_eigen(matrix)).join().unwrap_or(None))
    };
    // faer gives up on some matrices (and on those that are not finite); nalgebra is slower and does not.
    found.unwrap_or_else(|| small_eigen(matrix))
}

fn small_eigen(matrix: &DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let eigen = matrix.clone().symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let values = order.iter().map(|index| eigen.eigenvalues[*index]).collect();
    (values, eigen.eigenvectors.select_columns(&order))
}

fn large_eigen(matrix: &DMatrix<f64>) -> Option<(Vec<f64>, DMatrix<f64>)> {
    let size = matrix.nrows();
    let view = MatRef::from_column_major_slice(matrix.as_slice(), size, size);
    let eigen = view.self_adjoint_eigen(Side::Lower).ok()?;
    let values: Vec<f64> = (0..size).rev().map(|k| eigen.S()[k]).collect();
    let vectors = DMatrix::from_fn(size, size, |row, column| eigen.U()[(row, size - 1 - column)]);
    values.iter().all(|value| value.is_finite()).then_some((values, vectors))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenpairs_rebuild_the_matrix_and_fall() {
        for size in [1, 3, 47, 48, 130] {
            let entry =
                |i: usize, j: usize| ((i * j + i + j) as f64 * 0.37).sin() + f64::from(u8::from(i == j));
            let matrix = DMatrix::from_fn(size, size, |i, j| entry(i.min(j), i.max(j)));
            let (values, vectors) = symmetric_eigen(&matrix);
            assert!(values.windows(2).all(|pair| pair[0] >= pair[1]));
            let scaled = &vectors * DMatrix::from_diagonal(&values.into());
            assert!((scaled * vectors.transpose() - &matrix).amax() < 1e-12 * size as f64);
            assert!((vectors.transpose() * &vectors - DMatrix::identity(size, size)).amax() < 1e-12);
        }
    }
}
