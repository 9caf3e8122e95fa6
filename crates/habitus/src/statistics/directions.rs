//! The computing behind [`super::LinearSpace::learn`]: leading directions of the samples, exactly or by power iteration,
//! then one Rayleigh–Ritz step in f64.

use habitus_optimize::{map_chunks, symmetric_eigen};
use nalgebra::DMatrix;

use super::centred::{Centred, SLAB, transposed_product};
use super::gram::{GramMatrix, GramPrecision};
use super::linear_space::LinearSpaceSettings;
use super::random_stream::RandomStream;

/// Components whose variance is below this share of the first one's are rounding, not data.
const SMALLEST_VARIANCE_RATIO: f64 = 1e-12;
/// f32 products are trusted while the last wanted variance is above this share of the first one's: their noise lies
/// near 1e-8 of it, and what is left after the Rayleigh–Ritz step is its square.
const SMALLEST_SINGLE_PRECISION_RATIO: f64 = 1e-6;

/// Orthonormal directions, largest variance first, with the standard deviations along them.
pub(super) struct Directions {
    pub basis: DMatrix<f64>,
    pub standard_deviations: Vec<f64>,
    pub total_variance: f64,
}

/// Finds the leading directions; `None` if the samples do not vary.
pub(super) fn leading_directions(
    centred: &Centred<'_>,
    settings: &LinearSpaceSettings,
) -> Option<Directions> {
    let (start, trace) = if centred.sample_count() <= settings.exact_up_to_samples {
        exact_directions(centred, settings)
    } else {
        power_directions(centred, settings)
    };
    if start.ncols() == 0 {
        return None;
    }
    let (basis, standard_deviations) = rayleigh_ritz(centred, &start, settings.components);
    let total_variance = trace / (centred.sample_count() - 1) as f64;
    Some(Directions { basis, standard_deviations, total_variance })
}

/// Leading eigenvectors of the Gram matrix as columns, and its trace.
fn exact_directions(centred: &Centred<'_>, settings: &LinearSpaceSettings) -> (DMatrix<f64>, f64) {
    let count = centred.sample_count();
    let wanted = settings.components.min(count - 1);
    if count > settings.double_precision_up_to_samples {
        let gram = GramMatrix::of_centred(centred, GramPrecision::Single);
        let (vectors, last_ratio) = leading_eigenvectors(&gram, wanted);
        if last_ratio > SMALLEST_SINGLE_PRECISION_RATIO {
            return (vectors, gram.values().trace());
        }
    }
    let gram = GramMatrix::of_centred(centred, GramPrecision::Double);
    (leading_eigenvectors(&gram, wanted).0, gram.values().trace())
}

/// At most `wanted` leading eigenvectors that are not rounding, and the last one's share of the first eigenvalue.
fn leading_eigenvectors(gram: &GramMatrix, wanted: usize) -> (DMatrix<f64>, f64) {
    let (values, vectors) = symmetric_eigen(gram.values());
    let largest = values.first().copied().unwrap_or(0.0);
    let is_data = |value: &&f64| **value > SMALLEST_VARIANCE_RATIO * largest && **value > 0.0;
    let kept = values.iter().take(wanted).take_while(is_data).count();
    let last_ratio = if kept == wanted && kept > 0 { values[kept - 1] / largest } else { 0.0 };
    (vectors.columns(0, kept).into_owned(), last_ratio)
}

/// Halko, Martinsson and Tropp 2011, Alg. 4.4, on the side of the samples: `V ← orth(G V)` without ever forming G.
fn power_directions(centred: &Centred<'_>, settings: &LinearSpaceSettings) -> (DMatrix<f64>, f64) {
    let count = centred.sample_count();
    let width = (settings.components + settings.oversampling).min(count - 1);
    let mut stream = RandomStream::named(settings.seed, "linear space");
    let mut vectors = DMatrix::from_fn(count, width, |_, _| stream.normal());
    let mut trace = 0.0;
    for _ in 0..settings.power_iterations.max(1) {
        let (product, sum_of_squares) = gram_times(centred, &vectors);
        trace = sum_of_squares;
        vectors = product.qr().q();
    }
    let image = gram_times(centred, &vectors).0;
    let (values, rotation) = symmetric_eigen(&vectors.tr_mul(&image));
    let largest = values.first().copied().unwrap_or(0.0);
    let kept = values.iter().take_while(|v| **v > SMALLEST_VARIANCE_RATIO * largest && **v > 0.0).count();
    (vectors * rotation.columns(0, kept), trace)
}

/// `G V` and the trace of G, slab by slab.
fn gram_times(centred: &Centred<'_>, vectors: &DMatrix<f64>) -> (DMatrix<f64>, f64) {
    const COLUMNS: usize = 32;
    let mut product = DMatrix::zeros(vectors.nrows(), vectors.ncols());
    let mut trace = 0.0;
    for range in centred.slabs() {
        let slab: DMatrix<f64> = centred.slab(range);
        trace += slab.norm_squared();
        let blocks = map_chunks(vectors.ncols(), COLUMNS, |columns| {
            let image = &slab * vectors.columns_range(columns);
            transposed_product(&slab, 0..slab.ncols(), &image.as_view())
        });
        for (block, start) in blocks.iter().zip((0..).step_by(COLUMNS)) {
            let mut target = product.columns_mut(start, block.ncols());
            target += block;
        }
    }
    (product, trace)
}

/// Makes the images of `start` orthonormal and turns them to the principal directions of the samples inside their span.
fn rayleigh_ritz(centred: &Centred<'_>, start: &DMatrix<f64>, components: usize) -> (DMatrix<f64>, Vec<f64>) {
    let mut basis = images(centred, start);
    for mut column in basis.column_iter_mut() {
        let length = column.norm();
        column /= length.max(f64::MIN_POSITIVE);
    }
    // Once would leave the error of the condition number; twice is enough.
    for _ in 0..2 {
        basis = orthonormalized(basis);
    }
    let coefficients = coordinates(centred, &basis);
    let (values, rotation) = symmetric_eigen(&coefficients.tr_mul(&coefficients));
    let kept = components.min(values.len());
    let degrees = (centred.sample_count() - 1) as f64;
    let deviations = values[..kept].iter().map(|value| (value.max(0.0) / degrees).sqrt()).collect();
    (times(&basis, &rotation.columns(0, kept).into_owned()), deviations)
}

/// The centred samples, combined by each column of `combination`.
fn images(centred: &Centred<'_>, combination: &DMatrix<f64>) -> DMatrix<f64> {
    const ROWS: usize = 512;
    let mut result = DMatrix::zeros(centred.length(), combination.ncols());
    for range in centred.slabs() {
        let slab: DMatrix<f64> = centred.slab(range.clone());
        let blocks = map_chunks(range.len(), ROWS, |rows| slab.rows_range(rows) * combination);
        for (block, start) in blocks.iter().zip((range.start..).step_by(ROWS)) {
            result.rows_mut(start, block.nrows()).copy_from(block);
        }
    }
    result
}

/// Inner products of each centred sample with each column of `basis`: one row for each sample.
fn coordinates(centred: &Centred<'_>, basis: &DMatrix<f64>) -> DMatrix<f64> {
    const SAMPLES: usize = 128;
    let mut result = DMatrix::zeros(centred.sample_count(), basis.ncols());
    for range in centred.slabs() {
        let slab: DMatrix<f64> = centred.slab(range.clone());
        let part = basis.rows_range(range);
        let blocks =
            map_chunks(centred.sample_count(), SAMPLES, |samples| transposed_product(&slab, samples, &part));
        for (block, start) in blocks.iter().zip((0..).step_by(SAMPLES)) {
            let mut target = result.rows_mut(start, block.nrows());
            target += block;
        }
    }
    result
}

/// Cholesky QR: `B ← B R⁻¹` with `RᵀR = BᵀB`.
fn orthonormalized(basis: DMatrix<f64>) -> DMatrix<f64> {
    let width = basis.ncols();
    let parts = map_chunks(basis.nrows(), SLAB, |rows| {
        let part = basis.rows_range(rows);
        part.transpose() * part
    });
    let mut gram = DMatrix::zeros(width, width);
    parts.iter().for_each(|part| gram += part);
    let Some(factor) = nalgebra::Cholesky::new(gram) else {
        // Columns that depend on one another: slower, but safe.
        return basis.qr().q();
    };
    let identity = DMatrix::identity(width, width);
    match factor.l().solve_lower_triangular(&identity) {
        Some(inverse) => times(&basis, &inverse.transpose()),
        None => basis.qr().q(),
    }
}

/// A tall matrix times a small one, in parallel over blocks of rows.
fn times(tall: &DMatrix<f64>, small: &DMatrix<f64>) -> DMatrix<f64> {
    let mut result = DMatrix::zeros(tall.nrows(), small.ncols());
    let blocks = map_chunks(tall.nrows(), SLAB, |rows| tall.rows_range(rows) * small);
    for (block, start) in blocks.iter().zip((0..).step_by(SLAB)) {
        result.rows_mut(start, block.nrows()).copy_from(block);
    }
    result
}
