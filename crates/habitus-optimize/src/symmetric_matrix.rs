//! A sparse symmetric matrix whose places are fixed once and whose values are summed many times.

/// The lower triangle of a sparse symmetric matrix, column by column.
///
/// The pattern is given once; rounds that only change values keep it, and with it the analysis of
/// [`SparseCholesky`](crate::SparseCholesky).
#[derive(Debug, Clone, PartialEq)]
pub struct SymmetricMatrix {
    column_starts: Vec<usize>,
    rows: Vec<usize>,
    values: Vec<f64>,
}

impl SymmetricMatrix {
    /// A zero matrix of `size` rows with room at the given places and on the diagonal; order, side and repetition of places
    /// do not matter.
    ///
    /// # Panics
    /// When a place lies outside the matrix.
    pub fn with_places(size: usize, places: impl IntoIterator<Item = (usize, usize)>) -> Self {
        let mut lower: Vec<(usize, usize)> = (0..size).map(|k| (k, k)).collect();
        lower.extend(places.into_iter().map(|(row, column)| {
            assert!(row.max(column) < size, "place ({row}, {column}) in a matrix of {size} rows");
            (row.min(column), row.max(column))
        }));
        lower.sort_unstable();
        lower.dedup();
        let mut column_starts = vec![0; size + 1];
        for (column, _) in &lower {
            column_starts[column + 1] += 1;
        }
        for column in 0..size {
            column_starts[column + 1] += column_starts[column];
        }
        let values = vec![0.0; lower.len()];
        Self { column_starts, rows: lower.into_iter().map(|(_, row)| row).collect(), values }
    }

    /// Number of rows.
    pub fn size(&self) -> usize {
        self.column_starts.len() - 1
    }

    /// Sets every value to zero and keeps the places.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Adds to the entry at (`row`, `column`) and, as the matrix is symmetric, to its mirror image.
    ///
    /// # Panics
    /// When the matrix has no such place.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        let slot = self.slot(row.max(column), row.min(column));
        self.values[slot] += value;
    }

    /// Adds a block: entry (`i`, `j`) of the row-major `block` belongs to parameters `places[i]` and `places[j]`; its lower
    /// triangle is read.
    ///
    /// # Panics
    /// When the matrix lacks one of the places.
    pub fn add_block(&mut self, places: &[usize], block: &[f64]) {
        assert_eq!(block.len(), places.len() * places.len(), "a square block");
        for (i, row) in places.iter().enumerate() {
            for (j, column) in places[..=i].iter().enumerate() {
                self.add(*row, *column, block[i * places.len() + j]);
            }
        }
    }

    /// The diagonal.
    pub fn diagonal(&self) -> Vec<f64> {
        // The lower triangle column by column: the diagonal comes first in each.
        self.column_starts[..self.size()].iter().map(|start| self.values[*start]).collect()
    }

    /// The matrix times a vector.
    pub fn times(&self, vector: &[f64]) -> Vec<f64> {
        assert_eq!(vector.len(), self.size(), "one entry for each column");
        let mut product = vec![0.0; vector.len()];
        for column in 0..self.size() {
            for slot in self.column_starts[column]..self.column_starts[column + 1] {
                let (row, value) = (self.rows[slot], self.values[slot]);
                product[row] += value * vector[column];
                if row != column {
                    product[column] += value * vector[row];
                }
            }
        }
        product
    }

    pub(crate) fn column_starts(&self) -> &[usize] {
        &self.column_starts
    }

    pub(crate) fn rows(&self) -> &[usize] {
        &self.rows
    }

    pub(crate) fn values(&self) -> &[f64] {
        &self.values
    }

    pub(crate) fn has_places_of(&self, other: &Self) -> bool {
        self.column_starts == other.column_starts && self.rows == other.rows
    }

    fn slot(&self, row: usize, column: usize) -> usize {
        let start = self.column_starts[column];
        let found = self.rows[start..self.column_starts[column + 1]].binary_search(&row);
        assert!(found.is_ok(), "the matrix has no place ({row}, {column})");
        start + found.unwrap_or_default()
    }
}
