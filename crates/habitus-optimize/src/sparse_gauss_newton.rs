//! Damped Gauss–Newton for many unknowns that hardly meet: the pattern is analysed once, each step is a sparse Cholesky.

use nalgebra::DMatrix;

use crate::sink::FinitenessGuard;
use crate::{
    Objective, Sink, SolveError, SolveReport, SparseCholesky, StopReason, SymmetricMatrix, ValueSum, Wanted,
};

/// Sums the energy, half its gradient and the Gauss–Newton matrix, at the places of a fixed pattern.
#[derive(Debug, Clone)]
pub struct SparseNormalEquations {
    /// Σ w‖r‖².
    pub value: f64,
    /// Jᵀ W r.
    pub half_gradient: Vec<f64>,
    /// Jᵀ W J.
    pub matrix: SymmetricMatrix,
    guard: FinitenessGuard,
    /// One column's products, to allocate once.
    row: Vec<f64>,
}

impl SparseNormalEquations {
    /// Empty sums with the places of a matrix.
    pub fn new(pattern: &SymmetricMatrix) -> Self {
        let mut matrix = pattern.clone();
        matrix.clear();
        let half_gradient = vec![0.0; matrix.size()];
        Self { value: 0.0, half_gradient, matrix, guard: FinitenessGuard::default(), row: Vec::new() }
    }

    /// The sums of `objective` at `parameters`.
    pub fn evaluate(&mut self, objective: &dyn Objective, parameters: &[f64]) {
        self.value = 0.0;
        self.half_gradient.fill(0.0);
        self.matrix.clear();
        self.guard = FinitenessGuard::default();
        objective.add_to(parameters, self);
    }
}

impl Sink for SparseNormalEquations {
    fn wanted(&self) -> Wanted {
        Wanted::NormalEquations
    }

    fn begin_part(&mut self, name: &'static str) {
        self.guard.begin_part(name);
    }

    fn add(&mut self, weight: f64, residual: &[f64], columns: &[usize], jacobian: &[f64]) {
        let width = columns.len();
        assert_eq!(jacobian.len(), residual.len() * width, "jacobian is rows × columns");
        let value = weight * residual.iter().map(|r| r * r).sum::<f64>();
        self.guard.watch(value, "the energy");
        self.value += value;
        for (i, column) in columns.iter().enumerate() {
            let derivative = |row: usize, k: usize| jacobian[row * width + k];
            let slope: f64 = residual.iter().enumerate().map(|(row, r)| r * derivative(row, i)).sum();
            self.guard.watch(weight * slope, "the gradient");
            self.half_gradient[*column] += weight * slope;
            self.row.clear();
            self.row.extend((0..=i).map(|j| {
                let rows = 0..residual.len();
                weight * rows.map(|row| derivative(row, i) * derivative(row, j)).sum::<f64>()
            }));
            for (other, product) in columns.iter().zip(&self.row) {
                self.matrix.add(*column, *other, *product);
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
        self.guard.watch(value, "the energy");
        self.value += value;
        for (column, half) in columns.iter().zip(half_gradient) {
            self.guard.watch(*half, "the gradient");
            self.half_gradient[*column] += half;
        }
        if let Some(matrix) = normal_matrix {
            for (i, column) in columns.iter().enumerate() {
                for (j, other) in columns[..=i].iter().enumerate() {
                    self.matrix.add(*column, *other, matrix[(i, j)]);
                }
            }
        }
    }
}

/// When a sparse solve stops, and how much it dares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SparseGaussNewtonSettings {
    /// Most steps that lower the energy.
    pub max_iterations: usize,
    /// Stops when a step lowers the energy by less than this share.
    pub relative_decrease: f64,
    /// Damping of the first step, as a share of the matrix' diagonal.
    pub initial_damping: f64,
}

impl Default for SparseGaussNewtonSettings {
    fn default() -> Self {
        Self { max_iterations: 10, relative_decrease: 1e-3, initial_damping: 1e-6 }
    }
}

/// Steps are refused at most this often in a row.
const MOST_REFUSALS: usize = 12;

/// Minimises without bounds; `pattern` and `cholesky` belong to all objectives of the same structure.
///
/// # Errors
/// When a number is not finite, or no damping makes the matrix definite.
pub fn sparse_gauss_newton(
    objective: &dyn Objective,
    parameters: &mut [f64],
    sums: &mut SparseNormalEquations,
    cholesky: &SparseCholesky,
    settings: &SparseGaussNewtonSettings,
) -> Result<SolveReport, SolveError> {
    let mut report = SolveReport {
        reason: StopReason::IterationLimit,
        iterations: 0,
        evaluations: 0,
        initial_energy: 0.0,
        final_energy: 0.0,
    };
    let mut damping = settings.initial_damping;
    let mut trial = parameters.to_vec();
    for iteration in 0..settings.max_iterations {
        sums.evaluate(objective, parameters);
        report.evaluations += 1;
        sums.guard.check(report.evaluations)?;
        if iteration == 0 {
            report.initial_energy = sums.value;
        }
        report.final_energy = sums.value;
        let mut refusals = 0;
        let lower = loop {
            let step = damped_step(sums, cholesky, damping);
            if let Ok(step) = &step {
                trial.iter_mut().zip(parameters.iter().zip(step)).for_each(|(t, (p, s))| *t = p + s);
                let sum = ValueSum::of(objective, &trial);
                report.evaluations += 1;
                if sum.value < sums.value {
                    break Some(sum.value);
                }
            }
            refusals += 1;
            if refusals == MOST_REFUSALS {
                step?;
                break None;
            }
            damping = damping.max(settings.initial_damping) * 10.0;
        };
        let Some(energy) = lower else {
            report.reason = StopReason::NoDescent;
            return Ok(report);
        };
        parameters.copy_from_slice(&trial);
        report.iterations += 1;
        report.final_energy = energy;
        damping = (damping * 0.1).max(settings.initial_damping);
        if sums.value - energy < settings.relative_decrease * energy {
            report.reason = StopReason::EnergyFlat;
            return Ok(report);
        }
    }
    Ok(report)
}

/// −(A + damping · diag A)⁻¹ h.
fn damped_step(
    sums: &SparseNormalEquations,
    cholesky: &SparseCholesky,
    damping: f64,
) -> Result<Vec<f64>, SolveError> {
    let mut matrix = sums.matrix.clone();
    for (place, value) in sums.matrix.diagonal().into_iter().enumerate() {
        matrix.add(place, place, damping * value + f64::MIN_POSITIVE.sqrt());
    }
    let mut step: Vec<f64> = sums.half_gradient.iter().map(|half| -half).collect();
    cholesky.factorize(&matrix)?.solve(&mut step);
    Ok(step)
}
