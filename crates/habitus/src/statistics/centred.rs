//! Samples minus their mean, scaled by the roots of the coordinates' weights, made slab by slab so that no second copy
//! of all samples is ever held.

use std::ops::Range;

use nalgebra::{DMatrix, DMatrixView, Dyn, RealField};
use rayon::prelude::*;

use super::sample_matrix::SampleMatrix;

/// Coordinates of one slab: with a few thousand samples a slab of f32 is some 30 MB.
pub(super) const SLAB: usize = 4096;

/// A number that products of samples are formed in.
pub(super) trait Scalar: RealField + Copy {
    fn narrow(value: f64) -> Self;
    fn wide(self) -> f64;
}

impl Scalar for f32 {
    fn narrow(value: f64) -> Self {
        value as f32
    }
    fn wide(self) -> f64 {
        f64::from(self)
    }
}

impl Scalar for f64 {
    fn narrow(value: f64) -> Self {
        value
    }
    fn wide(self) -> f64 {
        self
    }
}

/// Samples with what is taken from them.
pub(super) struct Centred<'a> {
    pub samples: &'a SampleMatrix,
    pub mean: &'a [f64],
    /// Root of each coordinate's weight; all one if empty.
    pub scales: &'a [f64],
}

impl Centred<'_> {
    pub fn sample_count(&self) -> usize {
        self.samples.len()
    }

    pub fn length(&self) -> usize {
        self.samples.sample_length()
    }

    /// Ranges of coordinates in order.
    pub fn slabs(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let length = self.length();
        (0..length.div_ceil(SLAB)).map(move |slab| slab * SLAB..length.min((slab + 1) * SLAB))
    }

    /// The coordinates `range` of all samples, one column for each sample.
    pub fn slab<T: Scalar>(&self, range: Range<usize>) -> DMatrix<T> {
        let mean = &self.mean[range.clone()];
        let mut values = vec![T::zero(); range.len() * self.sample_count()];
        values.par_chunks_mut(range.len()).zip(self.samples.par_samples()).for_each(|(column, sample)| {
            let differences = sample[range.clone()].iter().zip(mean).map(|(value, mean)| value - mean);
            if self.scales.is_empty() {
                column.iter_mut().zip(differences).for_each(|(value, d)| *value = T::narrow(d));
            } else {
                let scaled = differences.zip(&self.scales[range.clone()]);
                column.iter_mut().zip(scaled).for_each(|(value, (d, scale))| *value = T::narrow(d * scale));
            }
        });
        DMatrix::from_vec(range.len(), self.sample_count(), values)
    }
}

/// The transpose of the given columns of `left`, times `right`.
pub(super) fn transposed_product<T: Scalar>(
    left: &DMatrix<T>,
    columns: Range<usize>,
    right: &DMatrixView<'_, T>,
) -> DMatrix<T> {
    /// Up to here nalgebra (0.35.0) multiplies by plain loops, which read strided rows out of bounds.
    const PLAIN_LOOPS: usize = 5;
    let (inner, rows) = (left.nrows(), columns.len());
    if inner.min(rows).min(right.ncols()) <= PLAIN_LOOPS {
        return left.columns_range(columns).tr_mul(right);
    }
    // The transpose without a copy: rows and columns change their strides.
    let turned: DMatrixView<'_, T, Dyn, Dyn> = DMatrixView::from_slice_with_strides_generic(
        &left.as_slice()[columns.start * inner..columns.end * inner],
        Dyn(rows),
        Dyn(inner),
        Dyn(inner),
        Dyn(1),
    );
    let mut product = DMatrix::from_element(rows, right.ncols(), T::zero());
    product.gemm(T::one(), &turned, right, T::zero());
    product
}
