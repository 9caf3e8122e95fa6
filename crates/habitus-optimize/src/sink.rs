//! What becomes of a residual block: a value, a gradient or normal equations.

use nalgebra::{DMatrix, DVector};

use crate::{Objective, SolveError};

/// What a sink needs of an objective; each level includes the ones before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Wanted {
    /// The energy alone: blocks come without columns.
    Value,
    /// The energy and its gradient.
    Gradient,
    /// The energy, its gradient and the Gauss–Newton matrix.
    NormalEquations,
}

/// Where residual blocks go.
pub trait Sink {
    /// What the objective has to provide.
    fn wanted(&self) -> Wanted;

    /// Names the part of the objective whose blocks follow, so that a number that is not finite is reported by name.
    fn begin_part(&mut self, _name: &'static str) {}

    /// Adds weight·‖residual‖².
    ///
    /// `jacobian` is row-major, `residual.len()` rows by `columns.len()` columns; `columns[k]` is the parameter that column
    /// `k` differentiates by. Columns are distinct, and empty when only the value is wanted.
    fn add(&mut self, weight: f64, residual: &[f64], columns: &[usize], jacobian: &[f64]);

    /// Adds a contribution that was summed elsewhere, by a batched kernel.
    ///
    /// `value` is Σ w‖r‖², `half_gradient` is Jᵀ W r and `normal_matrix` is Jᵀ W J, of which the lower triangle is read;
    /// entry `k` belongs to parameter `columns[k]`. The matrix is required when normal equations are wanted.
    fn add_assembled(
        &mut self,
        value: f64,
        columns: &[usize],
        half_gradient: &[f64],
        normal_matrix: Option<&DMatrix<f64>>,
    );
}

/// The first part of an objective that produced a number that is not finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FinitenessGuard {
    part: &'static str,
    first_fault: Option<(&'static str, &'static str)>,
}

impl Default for FinitenessGuard {
    fn default() -> Self {
        Self { part: "objective", first_fault: None }
    }
}

impl FinitenessGuard {
    pub(crate) fn begin_part(&mut self, name: &'static str) {
        self.part = name;
    }

    pub(crate) fn watch(&mut self, number: f64, quantity: &'static str) {
        if !number.is_finite() && self.first_fault.is_none() {
            self.first_fault = Some((self.part, quantity));
        }
    }

    pub(crate) fn check(&self, evaluation: usize) -> Result<(), SolveError> {
        match self.first_fault {
            None => Ok(()),
            Some((part, quantity)) => Err(SolveError::NonFinite { part, quantity, evaluation }),
        }
    }
}

const ENERGY: &str = "the energy";
const GRADIENT: &str = "the gradient";
const MATRIX: &str = "the normal matrix";

fn squared_norm(residual: &[f64]) -> f64 {
    residual.iter().map(|r| r * r).sum()
}

/// Sums the energy alone.
#[derive(Debug, Clone, Default)]
pub struct ValueSum {
    /// Σ w‖r‖².
    pub value: f64,
    guard: FinitenessGuard,
}

impl ValueSum {
    /// The energy of `objective` at `parameters`.
    pub fn of(objective: &dyn Objective, parameters: &[f64]) -> Self {
        let mut sum = Self::default();
        objective.add_to(parameters, &mut sum);
        sum.guard.watch(sum.value, ENERGY);
        sum
    }

    pub(crate) fn check(&self, evaluation: usize) -> Result<(), SolveError> {
        self.guard.check(evaluation)
    }
}

impl Sink for ValueSum {
    fn wanted(&self) -> Wanted {
        Wanted::Value
    }

    fn begin_part(&mut self, name: &'static str) {
        self.guard.part = name;
    }

    fn add(&mut self, weight: f64, residual: &[f64], _columns: &[usize], _jacobian: &[f64]) {
        let value = weight * squared_norm(residual);
        self.guard.watch(value, ENERGY);
        self.value += value;
    }

    fn add_assembled(&mut self, value: f64, _: &[usize], _: &[f64], _: Option<&DMatrix<f64>>) {
        self.guard.watch(value, ENERGY);
        self.value += value;
    }
}

/// Sums the energy and its gradient.
#[derive(Debug, Clone)]
pub struct Gradient {
    /// Σ w‖r‖².
    pub value: f64,
    /// The full gradient of the value, 2 Jᵀ W r.
    pub gradient: Vec<f64>,
    guard: FinitenessGuard,
}

impl Gradient {
    /// An empty sum over `parameter_count` parameters.
    pub fn new(parameter_count: usize) -> Self {
        Self { value: 0.0, gradient: vec![0.0; parameter_count], guard: FinitenessGuard::default() }
    }

    /// The energy and gradient of `objective` at `parameters`.
    pub fn of(objective: &dyn Objective, parameters: &[f64]) -> Self {
        let mut sum = Self::new(parameters.len());
        objective.add_to(parameters, &mut sum);
        sum.guard.watch(sum.value, ENERGY);
        sum
    }

    pub(crate) fn check(&self, evaluation: usize) -> Result<(), SolveError> {
        self.guard.check(evaluation)
    }
}

impl Sink for Gradient {
    fn wanted(&self) -> Wanted {
        Wanted::Gradient
    }

    fn begin_part(&mut self, name: &'static str) {
        self.guard.part = name;
    }

    fn add(&mut self, weight: f64, residual: &[f64], columns: &[usize], jacobian: &[f64]) {
        let value = weight * squared_norm(residual);
        self.guard.watch(value, ENERGY);
        self.value += value;
        assert_eq!(jacobian.len(), residual.len() * columns.len(), "jacobian is rows × columns");
        if columns.is_empty() {
            return;
        }
        for (&r, row) in residual.iter().zip(jacobian.chunks_exact(columns.len())) {
            let scale = 2.0 * weight * r;
            for (&column, &derivative) in columns.iter().zip(row) {
                let slope = scale * derivative;
                self.guard.watch(slope, GRADIENT);
                self.gradient[column] += slope;
            }
        }
    }

    fn add_assembled(
        &mut self,
        value: f64,
        columns: &[usize],
        half_gradient: &[f64],
        _: Option<&DMatrix<f64>>,
    ) {
        assert_eq!(columns.len(), half_gradient.len(), "one half gradient entry per column");
        self.guard.watch(value, ENERGY);
        self.value += value;
        for (&column, &half) in columns.iter().zip(half_gradient) {
            self.guard.watch(half, GRADIENT);
            self.gradient[column] += 2.0 * half;
        }
    }
}

/// Sums the energy, half its gradient and the Gauss–Newton matrix.
#[derive(Debug, Clone)]
pub struct NormalEquations {
    /// Σ w‖r‖².
    pub value: f64,
    /// Jᵀ W r.
    pub half_gradient: DVector<f64>,
    /// Jᵀ W J; while blocks are added only the lower triangle, after [`fill_upper`](Self::fill_upper) all of it.
    pub matrix: DMatrix<f64>,
    guard: FinitenessGuard,
}

impl NormalEquations {
    /// An empty sum over `parameter_count` parameters.
    pub fn new(parameter_count: usize) -> Self {
        Self {
            value: 0.0,
            half_gradient: DVector::zeros(parameter_count),
            matrix: DMatrix::zeros(parameter_count, parameter_count),
            guard: FinitenessGuard::default(),
        }
    }

    /// The energy and full normal equations of `objective` at `parameters`.
    pub fn of(objective: &dyn Objective, parameters: &[f64]) -> Self {
        let mut sum = Self::new(parameters.len());
        sum.evaluate(objective, parameters);
        sum
    }

    /// Forgets the sums, keeps the storage, and sums `objective` at `parameters`.
    pub fn evaluate(&mut self, objective: &dyn Objective, parameters: &[f64]) {
        self.clear();
        objective.add_to(parameters, self);
        self.guard.part = "objective";
        self.guard.watch(self.value, ENERGY);
        self.fill_upper();
    }

    /// Sets every sum back to zero.
    pub fn clear(&mut self) {
        self.value = 0.0;
        self.half_gradient.fill(0.0);
        self.matrix.fill(0.0);
        self.guard = FinitenessGuard::default();
    }

    /// Copies the lower triangle to the upper one.
    pub fn fill_upper(&mut self) {
        self.matrix.fill_upper_triangle_with_lower_triangle();
    }

    pub(crate) fn check(&self, evaluation: usize) -> Result<(), SolveError> {
        self.guard.check(evaluation)
    }

    /// Adds `weighted`·`derivatives` to the part of matrix column `columns[0]` below and including the diagonal.
    ///
    /// Consecutive columns are one contiguous stretch of memory, which is several times faster than single entries.
    fn add_column(&mut self, weighted: f64, columns: &[usize], derivatives: &[f64], is_consecutive: bool) {
        let first = columns[0];
        if is_consecutive {
            let start = first * self.matrix.nrows() + first;
            let stretch = &mut self.matrix.as_mut_slice()[start..start + columns.len()];
            for (entry, derivative) in stretch.iter_mut().zip(derivatives) {
                *entry += weighted * derivative;
            }
        } else {
            for (&column, derivative) in columns.iter().zip(derivatives) {
                self.matrix[(column.max(first), column.min(first))] += weighted * derivative;
            }
        }
    }
}

impl Sink for NormalEquations {
    fn wanted(&self) -> Wanted {
        Wanted::NormalEquations
    }

    fn begin_part(&mut self, name: &'static str) {
        self.guard.part = name;
    }

    fn add(&mut self, weight: f64, residual: &[f64], columns: &[usize], jacobian: &[f64]) {
        let value = weight * squared_norm(residual);
        self.guard.watch(value, ENERGY);
        self.value += value;
        assert_eq!(jacobian.len(), residual.len() * columns.len(), "jacobian is rows × columns");
        if columns.is_empty() {
            return;
        }
        let is_consecutive = columns.windows(2).all(|pair| pair[1] == pair[0] + 1);
        for (&r, row) in residual.iter().zip(jacobian.chunks_exact(columns.len())) {
            for (k, (&column, &derivative)) in columns.iter().zip(row).enumerate() {
                // Rows of a block are often sparse (one axis of a vertex): skipping zeros costs one comparison.
                if derivative == 0.0 {
                    continue;
                }
                let weighted = weight * derivative;
                let half = weighted * r;
                self.guard.watch(half, GRADIENT);
                self.guard.watch(weighted * derivative, MATRIX);
                self.half_gradient[column] += half;
                self.add_column(weighted, &columns[k..], &row[k..], is_consecutive);
            }
        }
    }

    fn add_assembled(
        &mut self,
        value: f64,
        columns: &[usize],
        half_gradient: &[f64],
        normal_matrix: Option<&DMatrix<f64>>,
    ) {
        assert!(
            normal_matrix.is_some(),
            "an assembled contribution needs its matrix when normal equations are wanted"
        );
        let Some(normal_matrix) = normal_matrix else { return };
        assert_eq!(columns.len(), half_gradient.len(), "one half gradient entry per column");
        assert_eq!(
            normal_matrix.shape(),
            (columns.len(), columns.len()),
            "one matrix row and column per parameter"
        );
        self.guard.watch(value, ENERGY);
        self.value += value;
        let is_consecutive = columns.windows(2).all(|pair| pair[1] == pair[0] + 1);
        for (k, (&column, &half)) in columns.iter().zip(half_gradient).enumerate() {
            self.guard.watch(half, GRADIENT);
            self.guard.watch(normal_matrix[(k, k)], MATRIX);
            self.half_gradient[column] += half;
            let below = &normal_matrix.as_slice()[k * columns.len() + k..(k + 1) * columns.len()];
            self.add_column(1.0, &columns[k..], below, is_consecutive);
        }
    }
}
