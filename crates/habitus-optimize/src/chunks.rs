//! Parallel work whose result does not depend on the number of threads.

use std::ops::Range;

use rayon::prelude::*;

/// Applies `work` to consecutive index ranges of `chunk_length` (the last may be shorter) and returns the results in order.
///
/// The ranges depend on the length alone: a caller that sums the results in order gets the same bits on one thread and on
/// many. `chunk_length` must not be zero.
pub fn map_chunks<T: Send>(
    length: usize,
    chunk_length: usize,
    work: impl Fn(Range<usize>) -> T + Sync,
) -> Vec<T> {
    assert!(chunk_length > 0, "a chunk must hold at least one item");
    (0..length.div_ceil(chunk_length))
        .into_par_iter()
        .map(|chunk| work(chunk * chunk_length..length.min((chunk + 1) * chunk_length)))
        .collect()
}
