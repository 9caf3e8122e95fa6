//! Equally long samples, one after the other.

use glam::DVec3;
use habitus_optimize::map_chunks;
use nalgebra::{DMatrix, DMatrixView};
use rayon::prelude::*;

/// Samples of one length: stacked vertex coordinates of bodies, offsets of clothes.
#[derive(Clone, Debug, PartialEq)]
pub struct SampleMatrix {
    length: usize,
    values: Vec<f64>,
}

impl SampleMatrix {
    /// No samples yet, of `length` numbers each.
    pub fn new(length: usize) -> Self {
        Self { length, values: Vec::new() }
    }

    /// Room for `count` samples.
    pub fn with_capacity(length: usize, count: usize) -> Self {
        Self { length, values: Vec::with_capacity(length * count) }
    }

    /// Samples of vertices, stacked as x, y, z of the first vertex, then of the second; all must be as many.
    pub fn of_points<'a>(samples: impl IntoIterator<Item = &'a [DVec3]>) -> Self {
        let mut samples = samples.into_iter().peekable();
        let mut matrix = Self::new(samples.peek().map_or(0, |first| 3 * first.len()));
        samples.for_each(|sample| matrix.push_points(sample));
        matrix
    }

    /// Adds a sample of this matrix's length.
    pub fn push(&mut self, sample: &[f64]) {
        assert_eq!(sample.len(), self.length, "a sample of {} numbers", self.length);
        self.values.extend_from_slice(sample);
    }

    /// Adds a sample of stacked vertices.
    pub fn push_points(&mut self, sample: &[DVec3]) {
        assert_eq!(3 * sample.len(), self.length, "a sample of {} coordinates", self.length);
        self.values.extend(sample.iter().flat_map(|point| point.to_array()));
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.values.len().checked_div(self.length).unwrap_or(0)
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Numbers in each sample.
    pub fn sample_length(&self) -> usize {
        self.length
    }

    /// One sample.
    pub fn sample(&self, index: usize) -> &[f64] {
        &self.values[index * self.length..(index + 1) * self.length]
    }

    /// One sample, to change.
    pub fn sample_mut(&mut self, index: usize) -> &mut [f64] {
        &mut self.values[index * self.length..(index + 1) * self.length]
    }

    /// All samples in order.
    pub fn samples(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.values.chunks_exact(self.length.max(1))
    }

    /// All samples in order, for parallel work.
    pub(super) fn par_samples(&self) -> impl IndexedParallelIterator<Item = &[f64]> {
        self.values.par_chunks_exact(self.length.max(1))
    }

    /// One sample as vertices.
    pub fn points(&self, index: usize) -> Vec<DVec3> {
        self.sample(index).chunks_exact(3).map(DVec3::from_slice).collect()
    }

    /// The given samples only.
    pub fn subset(&self, indices: &[usize]) -> Self {
        let mut matrix = Self::with_capacity(self.length, indices.len());
        indices.iter().for_each(|index| matrix.push(self.sample(*index)));
        matrix
    }

    /// The samples as columns.
    pub fn columns(&self) -> DMatrixView<'_, f64> {
        DMatrixView::from_slice(&self.values, self.length, self.len())
    }

    /// The mean sample.
    pub fn mean(&self) -> Vec<f64> {
        const CHUNK: usize = 1024;
        let scale = 1.0 / self.len().max(1) as f64;
        let chunks = map_chunks(self.length, CHUNK, |range| {
            let mut sum = vec![0.0; range.len()];
            for sample in self.samples() {
                sum.iter_mut().zip(&sample[range.clone()]).for_each(|(sum, value)| *sum += value);
            }
            sum.iter_mut().for_each(|value| *value *= scale);
            sum
        });
        chunks.concat()
    }
}

impl From<DMatrix<f64>> for SampleMatrix {
    /// Each column is a sample.
    fn from(columns: DMatrix<f64>) -> Self {
        Self { length: columns.nrows(), values: columns.as_slice().to_vec() }
    }
}
