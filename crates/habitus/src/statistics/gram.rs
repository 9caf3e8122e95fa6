//! Inner products of all pairs of samples: all that principal components need when samples are fewer than coordinates.

use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::centred::{Centred, Scalar, transposed_product};
use super::sample_matrix::SampleMatrix;

/// Samples of one tile of the matrix; a tile of products stays in the cache.
const TILE: usize = 256;

/// How products of samples are formed; sums over slabs of coordinates are always f64.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GramPrecision {
    /// In f32: twice as fast, entries right to about 1e-7 of the samples' squared lengths.
    Single,
    /// In f64.
    Double,
}

/// `G_ij = Σ_c weight_c (x_ic − mean_c)(x_jc − mean_c)`.
#[derive(Clone, Debug, PartialEq)]
pub struct GramMatrix {
    values: DMatrix<f64>,
}

impl GramMatrix {
    /// Of samples about their mean, all coordinates counting one.
    pub fn of(samples: &SampleMatrix, precision: GramPrecision) -> Self {
        Self::of_centred(&Centred { samples, mean: &samples.mean(), scales: &[] }, precision)
    }

    /// Of samples as they are, about the origin.
    pub fn about_origin(samples: &SampleMatrix, precision: GramPrecision) -> Self {
        let mean = vec![0.0; samples.sample_length()];
        Self::of_centred(&Centred { samples, mean: &mean, scales: &[] }, precision)
    }

    pub(super) fn of_centred(centred: &Centred<'_>, precision: GramPrecision) -> Self {
        let values = match precision {
            GramPrecision::Single => products::<f32>(centred),
            GramPrecision::Double => products::<f64>(centred),
        };
        Self { values }
    }

    /// Number of samples.
    pub fn sample_count(&self) -> usize {
        self.values.nrows()
    }

    /// The symmetric matrix.
    pub fn values(&self) -> &DMatrix<f64> {
        &self.values
    }

    /// The same for some of the samples about the mean of these alone.
    pub fn of_subset(&self, samples: &[usize]) -> Self {
        let picked = DMatrix::from_fn(samples.len(), samples.len(), |row, column| {
            self.values[(samples[row], samples[column])]
        });
        Self { values: doubly_centred(picked) }
    }
}

/// `H G H` with `H = I − 1/n`: moves the origin of the samples to their mean.
fn doubly_centred(mut matrix: DMatrix<f64>) -> DMatrix<f64> {
    let count = matrix.nrows().max(1) as f64;
    let means: Vec<f64> = matrix.column_iter().map(|column| column.sum() / count).collect();
    let mean = means.iter().sum::<f64>() / count;
    for (j, mut column) in matrix.column_iter_mut().enumerate() {
        for (value, row_mean) in column.iter_mut().zip(&means) {
            *value += mean - row_mean - means[j];
        }
    }
    matrix
}

/// Products tile by tile of the lower triangle, slab after slab: neither the tiles nor the order depend on threads.
fn products<T: Scalar>(centred: &Centred<'_>) -> DMatrix<f64> {
    struct Tile {
        rows: std::ops::Range<usize>,
        columns: std::ops::Range<usize>,
        sum: DMatrix<f64>,
    }
    let count = centred.sample_count();
    let ranges: Vec<_> =
        (0..count.div_ceil(TILE)).map(|tile| tile * TILE..count.min((tile + 1) * TILE)).collect();
    let mut tiles = Vec::new();
    for (index, rows) in ranges.iter().enumerate() {
        for columns in &ranges[..=index] {
            let sum = DMatrix::zeros(rows.len(), columns.len());
            tiles.push(Tile { rows: rows.clone(), columns: columns.clone(), sum });
        }
    }
    for range in centred.slabs() {
        let slab: DMatrix<T> = centred.slab(range);
        tiles.par_iter_mut().for_each(|tile| {
            let right = slab.columns_range(tile.columns.clone());
            let product = transposed_product(&slab, tile.rows.clone(), &right);
            tile.sum.iter_mut().zip(product.iter()).for_each(|(sum, value)| *sum += value.wide());
        });
    }
    let mut values = DMatrix::zeros(count, count);
    for tile in tiles {
        for (j, column) in tile.columns.clone().enumerate() {
            for (i, row) in tile.rows.clone().enumerate() {
                values[(row, column)] = tile.sum[(i, j)];
                values[(column, row)] = tile.sum[(i, j)];
            }
        }
    }
    values
}
