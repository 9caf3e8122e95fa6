//! Objectives with known truth, shared by the solver tests.
#![allow(dead_code, reason = "each test file uses its own share")]

use habitus_optimize::{Objective, Sink, Wanted};

/// A small seeded generator, so that a failing case can be named.
pub struct Random(pub u64);

impl Random {
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }

    pub fn vector(&mut self, length: usize) -> Vec<f64> {
        (0..length).map(|_| self.signed()).collect()
    }
}

/// ‖A x + curvature·sin(A x) − b‖², one block per row: linear least squares at zero curvature.
pub struct WavyRows {
    pub rows: Vec<Vec<f64>>,
    pub targets: Vec<f64>,
    pub curvature: f64,
    pub weight: f64,
}

impl WavyRows {
    pub fn random(seed: u64, row_count: usize, parameter_count: usize, curvature: f64) -> Self {
        let mut random = Random(seed);
        let rows = (0..row_count).map(|_| random.vector(parameter_count)).collect();
        Self { rows, targets: random.vector(row_count), curvature, weight: 1.0 }
    }
}

impl Objective for WavyRows {
    fn parameter_count(&self) -> usize {
        self.rows[0].len()
    }

    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
        let columns: Vec<usize> = (0..parameters.len()).collect();
        for (row, target) in self.rows.iter().zip(&self.targets) {
            let line: f64 = row.iter().zip(parameters).map(|(a, x)| a * x).sum();
            let residual = [line + self.curvature * line.sin() - target];
            if sink.wanted() == Wanted::Value {
                sink.add(self.weight, &residual, &[], &[]);
            } else {
                let slope = 1.0 + self.curvature * line.cos();
                let jacobian: Vec<f64> = row.iter().map(|a| slope * a).collect();
                sink.add(self.weight, &residual, &columns, &jacobian);
            }
        }
    }
}

/// The chained Rosenbrock function of the L-BFGS-B reference drivers: (x₀ − 1)² + 4 Σ (xᵢ − xᵢ₋₁²)².
pub struct Rosenbrock {
    pub parameter_count: usize,
    pub chain_weight: f64,
}

impl Objective for Rosenbrock {
    fn parameter_count(&self) -> usize {
        self.parameter_count
    }

    fn add_to(&self, x: &[f64], sink: &mut dyn Sink) {
        sink.begin_part("first");
        sink.add(1.0, &[x[0] - 1.0], &[0], &[1.0]);
        sink.begin_part("chain");
        for i in 1..x.len() {
            let before = x[i - 1];
            sink.add(self.chain_weight, &[x[i] - before * before], &[i - 1, i], &[-2.0 * before, 1.0]);
        }
    }
}
