//! Sparse linear least squares: analyse the pattern once, factorise for each round, solve for many right-hand sides.

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{MatMut, Side};

use crate::{SolveError, SymmetricMatrix};

/// The fill-reducing order and the shape of the factor of all matrices with the same places.
#[derive(Debug, Clone)]
pub struct SparseCholesky {
    analysed: SymmetricMatrix,
    symbolic: SymbolicLlt<usize>,
}

impl SparseCholesky {
    /// Analyses the places of a matrix; its values do not matter.
    ///
    /// # Errors
    /// When the factor does not fit into memory.
    pub fn analyse(matrix: &SymmetricMatrix) -> Result<Self, SolveError> {
        let symbolic = SymbolicLlt::try_new(places(matrix), Side::Lower)
            .map_err(|_| SolveError::FactorTooLarge { size: matrix.size() })?;
        Ok(Self { analysed: matrix.clone(), symbolic })
    }

    /// Factorises a positive definite matrix with the places that were analysed.
    ///
    /// # Errors
    /// When the matrix is not positive definite or the factor does not fit into memory.
    ///
    /// # Panics
    /// When the places differ from the analysed ones.
    pub fn factorize(&self, matrix: &SymmetricMatrix) -> Result<CholeskyFactor, SolveError> {
        assert!(matrix.has_places_of(&self.analysed), "the matrix has the places that were analysed");
        let size = matrix.size();
        let numeric = SparseColMatRef::new(places(matrix), matrix.values());
        let factor = Llt::try_new_with_symbolic(self.symbolic.clone(), numeric, Side::Lower)
            .map_err(|_| SolveError::NotPositiveDefinite { free_count: size })?;
        Ok(CholeskyFactor { size, factor })
    }
}

fn places(matrix: &SymmetricMatrix) -> SymbolicSparseColMatRef<'_, usize> {
    SymbolicSparseColMatRef::new_checked(
        matrix.size(),
        matrix.size(),
        matrix.column_starts(),
        None,
        matrix.rows(),
    )
}

/// A factorised matrix.
#[derive(Debug, Clone)]
pub struct CholeskyFactor {
    size: usize,
    factor: Llt<usize, f64>,
}

impl CholeskyFactor {
    /// Replaces right-hand sides, stored one after the other, by their solutions.
    ///
    /// # Panics
    /// When the length is not a multiple of the matrix' size.
    pub fn solve(&self, right_hand_sides: &mut [f64]) {
        if self.size == 0 {
            return;
        }
        assert_eq!(right_hand_sides.len() % self.size, 0, "whole right-hand sides");
        let count = right_hand_sides.len() / self.size;
        self.factor.solve_in_place(MatMut::from_column_major_slice_mut(right_hand_sides, self.size, count));
    }
}
