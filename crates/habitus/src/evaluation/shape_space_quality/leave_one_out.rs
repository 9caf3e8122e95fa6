//! Cross validation of a shape space without learning it anew for each left-out body.
//!
//! Alignment, components and scores of any subset follow from the 3 × 3 products `X_aᵀ X_b` of all pairs of centred
//! samples. They are formed once. A fold then aligns its training samples among themselves (the left-out body takes no
//! part), takes the components from its own matrix of products, and touches vertices once, for the residuals.

use std::ops::Range;

use glam::{DMat3, DVec3};
use habitus_geometry::best_rotation;
use habitus_optimize::{map_chunks, symmetric_eigen};
use nalgebra::DMatrix;

use crate::statistics::{GramMatrix, GramPrecision, SampleMatrix};

/// Rounds of alignment at most; each takes off some orders of magnitude, as bodies differ little from their mean.
const ALIGNMENT_ROUNDS: usize = 30;
/// Turn of a sample, in radians, below which an alignment has settled: some nanometres on a body.
const SETTLED_TURN: f64 = 1e-9;
/// Training samples up to which all eigenvectors are computed anew.
const SMALL_FOLD: usize = 256;
/// Eigenvectors of all samples, beyond the wanted, in whose span those of a fold are sought.
const SPARE_VECTORS: usize = 100;
/// Residual of an eigenvector, over the largest eigenvalue, that is good enough.
const SETTLED_RESIDUAL: f64 = 1e-8;

/// A body to be reconstructed and the bodies to learn from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fold {
    /// The left-out sample.
    pub test: usize,
    /// The training samples.
    pub training: Vec<usize>,
}

/// Vertices that are turned at a time: of a thousand samples they fit into a cache.
const TURNED_VERTICES: usize = 64;

/// Samples with the products of all pairs.
pub struct CrossValidation {
    vertex_count: usize,
    count: usize,
    /// Centred coordinates: columns x, y, z of the first sample, then of the second.
    columns: SampleMatrix,
    products: DMatrix<f64>,
    /// The alignment of all samples, from which folds start.
    turns: Vec<DMat3>,
    /// `Σ_l R_l X_lᵀ X_j` for each sample j.
    sums: Vec<DMat3>,
    /// Leading eigenvectors of the products of all samples.
    vectors: DMatrix<f64>,
}

impl CrossValidation {
    /// Forms the products of stacked vertices.
    pub fn new(samples: &SampleMatrix) -> Self {
        let (count, vertex_count) = (samples.len(), samples.sample_length() / 3);
        let mut columns = SampleMatrix::with_capacity(vertex_count, 3 * count);
        for sample in samples.samples() {
            for axis in 0..3 {
                let column: Vec<f64> = sample.iter().skip(axis).step_by(3).copied().collect();
                let mean = column.iter().sum::<f64>() / vertex_count as f64;
                columns.push(&column.iter().map(|value| value - mean).collect::<Vec<_>>());
            }
        }
        let products = GramMatrix::about_origin(&columns, GramPrecision::Double).values().clone();
        let mut validation = Self {
            vertex_count,
            count,
            columns,
            products,
            turns: vec![DMat3::IDENTITY; count],
            sums: Vec::new(),
            vectors: DMatrix::zeros(count, 0),
        };
        let all: Vec<usize> = (0..count).collect();
        let sums = validation.turned_sums(&all, &validation.turns);
        validation.turns = validation.aligned(&all, validation.turns.clone(), sums);
        validation.sums = validation.turned_sums(&all, &validation.turns);
        if count > SMALL_FOLD {
            let products = doubly_centred(&validation.turned_products(&all, &validation.turns));
            validation.vectors = symmetric_eigen(&products).1;
        }
        validation
    }

    /// One fold for each sample, learnt from all others.
    pub fn leave_one_out_folds(&self) -> Vec<Fold> {
        (0..self.count)
            .map(|test| Fold { test, training: (0..self.count).filter(|other| *other != test).collect() })
            .collect()
    }

    /// For each fold, and each number of components (rising), the mean vertex distance in metres between the left-out body
    /// and its closest body of the space.
    pub fn errors(&self, folds: &[Fold], components: &[usize]) -> Vec<Vec<f64>> {
        map_chunks(folds.len(), 1, |range| self.fold_errors(&folds[range.start], components))
    }

    fn fold_errors(&self, fold: &Fold, components: &[usize]) -> Vec<f64> {
        let training = &fold.training;
        let start: Vec<DMat3> = training.iter().map(|sample| self.turns[*sample]).collect();
        let turns = self.aligned(training, start.clone(), self.fold_sums(fold, &start));
        let covariance = training
            .iter()
            .zip(&turns)
            .fold(DMat3::ZERO, |sum, (sample, turn)| sum + *turn * self.product(*sample, fold.test));
        let test_turn = best_rotation(&covariance).unwrap_or(DMat3::IDENTITY);
        let raw = self.turned_products(training, &turns);
        let test_products: Vec<f64> = training
            .iter()
            .zip(&turns)
            .map(|(sample, turn)| trace_of_turned(test_turn, self.product(fold.test, *sample), *turn))
            .collect();
        let weights = reconstruction_weights(&raw, &test_products, components, &self.start_vectors(fold));
        self.mean_distances(fold, &turns, test_turn, &weights)
    }

    /// The sums that the first round of a fold's alignment needs: those of all samples without those left out.
    fn fold_sums(&self, fold: &Fold, turns: &[DMat3]) -> Vec<DMat3> {
        let is_training = |sample: &usize| fold.training.binary_search(sample).is_ok();
        let left_out: Vec<usize> = (0..self.count).filter(|sample| !is_training(sample)).collect();
        if left_out.len() * 4 > self.count || !fold.training.is_sorted() {
            return self.turned_sums(&fold.training, turns);
        }
        let without = |sample: &usize| {
            left_out.iter().fold(self.sums[*sample], |sum, other| {
                sum - self.turns[*other] * self.product(*other, *sample)
            })
        };
        fold.training.iter().map(without).collect()
    }

    /// Generalized Procrustes among these samples, starting with these turns and their sums.
    fn aligned(&self, samples: &[usize], mut turns: Vec<DMat3>, mut sums: Vec<DMat3>) -> Vec<DMat3> {
        for round in 0..ALIGNMENT_ROUNDS {
            let mut largest = 0.0_f64;
            for (turn, sum) in turns.iter_mut().zip(&sums) {
                let next = best_rotation(sum).unwrap_or(*turn);
                largest = largest.max((next - *turn).to_cols_array().iter().fold(0.0, |m, v| v.abs().max(m)));
                *turn = next;
            }
            if largest < SETTLED_TURN || round + 1 == ALIGNMENT_ROUNDS {
                break;
            }
            sums = self.turned_sums(samples, &turns);
        }
        turns
    }

    fn product(&self, left: usize, right: usize) -> DMat3 {
        let column = |axis: usize| {
            let start = (3 * right + axis) * self.products.nrows() + 3 * left;
            DVec3::from_slice(&self.products.as_slice()[start..start + 3])
        };
        DMat3::from_cols(column(0), column(1), column(2))
    }

    /// `Σ_l R_l X_lᵀ X_j` for each j: the covariance that turns j onto the sum of all.
    fn turned_sums(&self, samples: &[usize], turns: &[DMat3]) -> Vec<DMat3> {
        let sum = |right: &usize| {
            samples
                .iter()
                .zip(turns)
                .fold(DMat3::ZERO, |sum, (left, turn)| sum + *turn * self.product(*left, *right))
        };
        samples.iter().map(sum).collect()
    }

    /// `⟨R_a X_a, R_b X_b⟩` of all pairs.
    fn turned_products(&self, samples: &[usize], turns: &[DMat3]) -> DMatrix<f64> {
        let count = samples.len();
        let mut products = DMatrix::zeros(count, count);
        for column in 0..count {
            for row in column..count {
                let product = self.product(samples[row], samples[column]);
                products[(row, column)] = trace_of_turned(turns[row], product, turns[column]);
            }
        }
        products.fill_upper_triangle_with_lower_triangle();
        products
    }

    /// Eigenvectors of all samples, at the training samples only.
    fn start_vectors(&self, fold: &Fold) -> DMatrix<f64> {
        if fold.training.len() <= SMALL_FOLD {
            DMatrix::zeros(0, 0)
        } else {
            self.vectors.select_rows(&fold.training)
        }
    }

    /// Folds compute all their eigenvectors anew from here on.
    #[cfg(test)]
    pub(super) fn forget_vectors(&mut self) {
        self.vectors = DMatrix::zeros(self.count, 0);
    }

    /// Mean length of `R_t X_t − Σ_a weight_a R_a X_a` for each column of weights.
    fn mean_distances(
        &self,
        fold: &Fold,
        turns: &[DMat3],
        test_turn: DMat3,
        weights: &DMatrix<f64>,
    ) -> Vec<f64> {
        let mut sums = vec![0.0; weights.ncols()];
        // Turned once, samples serve all numbers of components.
        let mut turned: [_; 3] = std::array::from_fn(|_| DMatrix::zeros(TURNED_VERTICES, turns.len()));
        let mut residuals: [_; 3] = std::array::from_fn(|_| DMatrix::zeros(TURNED_VERTICES, weights.ncols()));
        for start in (0..self.vertex_count).step_by(TURNED_VERTICES) {
            let vertices = start..(start + TURNED_VERTICES).min(self.vertex_count);
            let rows = vertices.len();
            let [x, y, z] =
                turned.each_mut().map(|block| block.as_mut_slice().chunks_exact_mut(TURNED_VERTICES));
            for (((sample, turn), x), (y, z)) in fold.training.iter().zip(turns).zip(x).zip(y.zip(z)) {
                self.turn_vertices(*sample, turn, vertices.clone(), [x, y, z]);
            }
            let mut test = [[0.0; TURNED_VERTICES]; 3];
            self.turn_vertices(
                fold.test,
                &test_turn,
                vertices,
                test.each_mut().map(|axis| axis.as_mut_slice()),
            );
            for ((residual, turned), test) in residuals.iter_mut().zip(&turned).zip(&test) {
                residual.column_iter_mut().for_each(|mut column| column.copy_from_slice(test));
                residual.gemm(-1.0, turned, weights, 1.0);
            }
            for (place, sum) in sums.iter_mut().enumerate() {
                let [x, y, z] = [0, 1, 2].map(|axis| residuals[axis].column(place));
                for ((x, y), z) in x.iter().zip(y.iter()).zip(z.iter()).take(rows) {
                    *sum += (x * x + y * y + z * z).sqrt();
                }
            }
        }
        sums.iter().map(|sum| sum / self.vertex_count as f64).collect()
    }

    /// Writes the coordinates of these vertices of a sample after its turn.
    fn turn_vertices(&self, sample: usize, turn: &DMat3, vertices: Range<usize>, targets: [&mut [f64]; 3]) {
        let [x, y, z] = [0, 1, 2].map(|axis| &self.columns.sample(3 * sample + axis)[vertices.clone()]);
        let [to_x, to_y, to_z] = targets.map(|target| &mut target[..vertices.len()]);
        for (k, ((x, y), z)) in x.iter().zip(y).zip(z).enumerate() {
            let turned = turn.x_axis * *x + turn.y_axis * *y + turn.z_axis * *z;
            (to_x[k], to_y[k], to_z[k]) = (turned.x, turned.y, turned.z);
        }
    }
}

/// `tr(R_a P R_bᵀ)`.
fn trace_of_turned(left: DMat3, product: DMat3, right: DMat3) -> f64 {
    let turned = left * product;
    (0..3).map(|axis| turned.col(axis).dot(right.col(axis))).sum()
}

/// For each number of components the weights (summing to one) of the training samples in the closest body of the space.
fn reconstruction_weights(
    products: &DMatrix<f64>,
    test_products: &[f64],
    components: &[usize],
    start: &DMatrix<f64>,
) -> DMatrix<f64> {
    let count = products.nrows();
    let size = count as f64;
    let row_means: Vec<f64> = products.column_iter().map(|column| column.sum() / size).collect();
    let mean = row_means.iter().sum::<f64>() / size;
    let test_mean = test_products.iter().sum::<f64>() / size;
    let scores: Vec<f64> =
        test_products.iter().zip(&row_means).map(|(value, row)| value - test_mean - row + mean).collect();
    let scores = nalgebra::DVector::from_vec(scores);
    let centred = doubly_centred(products);
    let most = components.last().copied().unwrap_or(0).min(count.saturating_sub(1));
    let (values, vectors) = leading_eigenpairs(&centred, start, &scores, most);
    let smallest = 1e-12 * values.first().copied().unwrap_or(0.0);
    let mut weights = DMatrix::from_element(count, components.len(), 1.0 / size);
    let mut sum = nalgebra::DVector::zeros(count);
    let mut done = 0;
    for (place, wanted) in components.iter().enumerate() {
        for (component, value) in values.iter().enumerate().take((*wanted).min(most)).skip(done) {
            if *value > smallest {
                let vector = vectors.column(component);
                sum.axpy(vector.dot(&scores) / value, &vector, 1.0);
            }
        }
        done = *wanted;
        let rest = (1.0 - sum.sum()) / size;
        weights.column_mut(place).zip_apply(&sum, |weight, value| *weight = value + rest);
    }
    weights
}

/// At least `wanted` leading eigenpairs. The matrix of a fold differs from that of all samples by one body and tiny turns:
/// its eigenvectors lie almost in the span of the old ones and of what the body `direction` adds to them.
fn leading_eigenpairs(
    matrix: &DMatrix<f64>,
    start: &DMatrix<f64>,
    direction: &nalgebra::DVector<f64>,
    wanted: usize,
) -> (Vec<f64>, DMatrix<f64>) {
    let width = (wanted + SPARE_VECTORS).min(start.ncols());
    if start.nrows() != matrix.nrows() || width <= wanted || width + 3 >= matrix.nrows() {
        return symmetric_eigen(matrix);
    }
    let mut basis = start.columns(0, width).into_owned().resize_horizontally(width + 3, 0.0);
    let mut next = direction.normalize();
    for place in 0..3 {
        basis.set_column(width + place, &next);
        next = (matrix * &next).normalize();
    }
    let basis = basis.qr().q();
    let image = matrix * &basis;
    let (values, rotation) = symmetric_eigen(&basis.tr_mul(&image));
    let kept = rotation.columns(0, wanted.max(1));
    let (vectors, images) = (&basis * kept, &image * kept);
    let is_settled = (0..wanted).all(|place| {
        let residual = images.column(place) - vectors.column(place) * values[place];
        residual.norm() <= SETTLED_RESIDUAL * values[0]
    });
    if is_settled { (values, vectors) } else { symmetric_eigen(matrix) }
}

fn doubly_centred(products: &DMatrix<f64>) -> DMatrix<f64> {
    let size = products.nrows() as f64;
    let means: Vec<f64> = products.column_iter().map(|column| column.sum() / size).collect();
    let mean = means.iter().sum::<f64>() / size;
    DMatrix::from_fn(products.nrows(), products.ncols(), |row, column| {
        products[(row, column)] - means[row] - means[column] + mean
    })
}
