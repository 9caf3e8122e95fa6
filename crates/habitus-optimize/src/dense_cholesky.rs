//! Dense symmetric positive definite systems.

use faer::linalg::solvers::{Llt, Solve};
use faer::{MatMut, MatRef, Side};
use nalgebra::{DMatrix, DVector};

/// Below this size a thread of its own would cost more than the work.
const SMALL: usize = 200;

/// Solves `matrix · x = right` in place; the lower triangle is read. Says whether the matrix was positive definite; if it
/// was not, `right` is as it was.
///
/// Large matrices go to faer's blocked kernels on a thread of their own, see [`crate::symmetric_eigen`].
pub(crate) fn solve_positive_definite(matrix: DMatrix<f64>, right: &mut DVector<f64>) -> bool {
    if matrix.nrows() < SMALL {
        return matrix.cholesky().map(|factor| factor.solve_mut(right)).is_some();
    }
    std::thread::scope(|scope| scope.spawn(|| solve_large(&matrix, right)).join().unwrap_or(false))
}

fn solve_large(matrix: &DMatrix<f64>, right: &mut DVector<f64>) -> bool {
    let size = matrix.nrows();
    let view = MatRef::from_column_major_slice(matrix.as_slice(), size, size);
    let Ok(factor) = Llt::new(view, Side::Lower) else { return false };
    factor.solve_in_place(MatMut::from_column_major_slice_mut(right.as_mut_slice(), size, 1));
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_and_large_systems_are_solved_and_indefinite_ones_refused() {
        for size in [1, 5, SMALL - 1, SMALL, 333] {
            let factor = DMatrix::from_fn(size, size, |i, j| ((3 * i + 7 * j) as f64 * 0.61).sin());
            let mut matrix = &factor * factor.transpose() + DMatrix::identity(size, size);
            let truth = DVector::from_fn(size, |i, _| (i as f64 * 0.3).cos());
            let mut found = &matrix * &truth;
            assert!(solve_positive_definite(matrix.clone(), &mut found));
            // The smallest eigenvalue is one and the largest about the size squared.
            assert!((found - truth).amax() < 1e-10 * size as f64);
            matrix[(size - 1, size - 1)] = -1.0;
            let mut untouched = DVector::from_element(size, 2.0);
            assert!(!solve_positive_definite(matrix, &mut untouched));
            assert_eq!(untouched, DVector::from_element(size, 2.0));
        }
    }
}
