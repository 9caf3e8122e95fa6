//! The sparse factorisation against dense algebra.

use habitus_optimize::{SolveError, SparseCholesky, SymmetricMatrix};
use nalgebra::{DMatrix, DVector};

/// A ring of springs with a few long ones, grounded by `ground`; entries are given on both sides and repeatedly.
fn springs(size: usize, ground: f64) -> (SymmetricMatrix, DMatrix<f64>) {
    let pairs: Vec<(usize, usize)> =
        (0..size).flat_map(|k| [(k, (k + 1) % size), ((7 * k + 3) % size, k)]).collect();
    let mut sparse = SymmetricMatrix::with_places(size, pairs.iter().copied());
    let mut dense = DMatrix::zeros(size, size);
    for (place, (a, b)) in pairs.into_iter().enumerate().filter(|(_, (a, b))| a != b) {
        let stiffness = 1.0 + (place % 5) as f64;
        sparse.add_block(&[a, b], &[stiffness, f64::NAN, -stiffness, stiffness]);
        for (row, column, sign) in [(a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)] {
            dense[(row, column)] += sign * stiffness;
        }
    }
    for k in 0..size {
        sparse.add(k, k, ground);
        dense[(k, k)] += ground;
    }
    (sparse, dense)
}

#[test]
fn solutions_are_those_of_dense_algebra() {
    let (sparse, dense) = springs(60, 0.5);
    let right: Vec<f64> = (0..120).map(|k| (k as f64).sin()).collect();
    let mut solved = right.clone();
    SparseCholesky::analyse(&sparse).unwrap().factorize(&sparse).unwrap().solve(&mut solved);
    for (right, solved) in right.chunks(60).zip(solved.chunks(60)) {
        let expected = dense.clone().lu().solve(&DVector::from_column_slice(right)).unwrap();
        // The condition number is below 100, so rounding leaves far more than ten digits.
        assert!((expected - DVector::from_column_slice(solved)).amax() < 1e-12);
    }
}

#[test]
fn a_product_is_that_of_dense_algebra() {
    let (sparse, dense) = springs(23, 0.1);
    let vector: Vec<f64> = (0..23).map(|k| (1.7 * k as f64).cos()).collect();
    let expected = dense * DVector::from_column_slice(&vector);
    assert!((expected - DVector::from_column_slice(&sparse.times(&vector))).amax() < 1e-12);
}

#[test]
fn one_analysis_serves_all_values_at_the_same_places() {
    let (mut matrix, _) = springs(40, 1.0);
    let cholesky = SparseCholesky::analyse(&matrix).unwrap();
    let vector = vec![1.0; 40];
    for scale in [1.0, 3.0] {
        matrix.clear();
        (0..40).for_each(|k| matrix.add(k, k, scale));
        let mut solved = vector.clone();
        cholesky.factorize(&matrix).unwrap().solve(&mut solved);
        assert!(solved.iter().all(|value| (value * scale - 1.0).abs() < 1e-15));
    }
}

#[test]
fn a_matrix_that_is_not_positive_definite_is_refused() {
    let (matrix, _) = springs(10, -20.0);
    let refused = SparseCholesky::analyse(&matrix).unwrap().factorize(&matrix);
    assert_eq!(refused.err(), Some(SolveError::NotPositiveDefinite { free_count: 10 }));
}

#[test]
fn an_empty_system_has_an_empty_solution() {
    let matrix = SymmetricMatrix::with_places(0, []);
    SparseCholesky::analyse(&matrix).unwrap().factorize(&matrix).unwrap().solve(&mut []);
}
