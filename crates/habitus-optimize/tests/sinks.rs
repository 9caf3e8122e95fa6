//! The three sinks agree, and the derivative check finds what is wrong.

mod problems;

use habitus_optimize::{
    Gradient, NormalEquations, Objective, Sink, ValueSum, Wanted, assert_derivatives_match,
    assert_same_contributions, derivative_mismatch,
};
use nalgebra::DMatrix;
use problems::{Random, Rosenbrock, WavyRows};

#[test]
fn the_three_sinks_agree() {
    let objective = WavyRows::random(3, 40, 9, 0.3);
    let at = Random(4).vector(9);
    let value = ValueSum::of(&objective, &at).value;
    let gradient = Gradient::of(&objective, &at);
    let normal = NormalEquations::of(&objective, &at);
    assert_eq!(value, gradient.value);
    assert_eq!(value, normal.value);
    for (full, half) in gradient.gradient.iter().zip(normal.half_gradient.iter()) {
        assert!((full - 2.0 * half).abs() <= 1e-13 * full.abs().max(1.0));
    }
    assert_eq!(normal.matrix, normal.matrix.transpose());
}

#[test]
fn correct_derivatives_pass() {
    assert_derivatives_match(&WavyRows::random(5, 30, 7, 0.4), &Random(6).vector(7));
    assert_derivatives_match(&Rosenbrock { parameter_count: 50, chain_weight: 4.0 }, &Random(7).vector(50));
}

#[test]
fn doubling_the_weight_doubles_energy_gradient_and_matrix() {
    let mut objective = WavyRows::random(8, 20, 6, 0.2);
    let at = Random(9).vector(6);
    let (one, slope) = (NormalEquations::of(&objective, &at), Gradient::of(&objective, &at));
    objective.weight = 2.0;
    let (two, steeper) = (NormalEquations::of(&objective, &at), Gradient::of(&objective, &at));
    assert_eq!(two.value, 2.0 * one.value);
    assert_eq!(two.matrix, 2.0 * one.matrix);
    assert!(slope.gradient.iter().zip(&steeper.gradient).all(|(a, b)| *b == 2.0 * a));
}

/// What may go wrong in a hand-written derivative.
#[derive(Clone, Copy)]
enum Slip {
    Halved,
    WrongSign,
    ForgottenColumn,
    /// Adds a Jacobian component orthogonal to the residual, which no gradient can show.
    OrthogonalToResidual,
    WeightOnlyInValue,
}

struct Slipped(WavyRows, Slip);

impl Objective for Slipped {
    fn parameter_count(&self) -> usize {
        self.0.parameter_count() + 1
    }

    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
        let (rest, extra) = parameters.split_at(parameters.len() - 1);
        let mut sums = (0.0, vec![0.0; rest.len()]);
        for (row, target) in self.0.rows.iter().zip(&self.0.targets) {
            let line: f64 = row.iter().zip(rest).map(|(a, x)| a * x).sum();
            sums.0 += line * line - target;
            sums.1.iter_mut().zip(row).for_each(|(s, a)| *s += 2.0 * line * a);
        }
        let residual = [sums.0, extra[0]];
        let count = parameters.len();
        let mut jacobian = vec![0.0; 2 * count];
        jacobian[..count - 1].copy_from_slice(&sums.1);
        jacobian[2 * count - 1] = 1.0;
        let mut weight = 1.0;
        match self.1 {
            Slip::Halved => jacobian.iter_mut().for_each(|j| *j *= 0.5),
            Slip::WrongSign => jacobian[0] = -jacobian[0],
            Slip::ForgottenColumn => jacobian[2] = 0.0,
            Slip::OrthogonalToResidual => {
                jacobian[0] += 0.1 * residual[1];
                jacobian[count] -= 0.1 * residual[0];
            }
            Slip::WeightOnlyInValue => weight = if sink.wanted() == Wanted::Value { 2.0 } else { 1.0 },
        }
        let columns: Vec<usize> = (0..count).collect();
        sink.add(weight, &residual, &columns, &jacobian);
    }
}

#[test]
fn slips_are_rejected_by_the_law_they_break() {
    let cases = [
        (Slip::Halved, "slope of the energy"),
        (Slip::WrongSign, "slope of the energy"),
        (Slip::ForgottenColumn, "slope of the energy"),
        (Slip::OrthogonalToResidual, "slope of the residual"),
        (Slip::WeightOnlyInValue, "energy of the value sink"),
    ];
    for (slip, law) in cases {
        let objective = Slipped(WavyRows::random(10, 12, 5, 0.0), slip);
        let mismatch = derivative_mismatch(&objective, &Random(11).vector(6));
        assert!(mismatch.as_ref().is_some_and(|m| m.law.contains(law)), "{law}: {mismatch:?}");
    }
}

#[test]
#[should_panic(expected = "the gradient is the slope of the energy")]
fn a_halved_derivative_panics() {
    let objective = Slipped(WavyRows::random(10, 12, 5, 0.0), Slip::Halved);
    assert_derivatives_match(&objective, &Random(11).vector(6));
}

#[test]
fn an_error_of_a_millionth_is_the_limit() {
    struct Scaled(f64);
    impl Objective for Scaled {
        fn parameter_count(&self) -> usize {
            1
        }
        fn add_to(&self, x: &[f64], sink: &mut dyn Sink) {
            sink.add(1.0, &[x[0].exp()], &[0], &[self.0 * x[0].exp()]);
        }
    }
    assert!(derivative_mismatch(&Scaled(1.0 + 1e-5), &[0.3]).is_some());
    assert!(derivative_mismatch(&Scaled(1.0 + 1e-8), &[0.3]).is_none());
}

#[test]
fn a_hinge_beside_its_kink_passes() {
    /// Σ max(0, x − kink)², as in an energy that only acts on one side.
    struct Hinges(Vec<f64>);
    impl Objective for Hinges {
        fn parameter_count(&self) -> usize {
            1
        }
        fn add_to(&self, x: &[f64], sink: &mut dyn Sink) {
            for kink in &self.0 {
                if x[0] > *kink {
                    sink.add(1.0, &[x[0] - kink], &[0], &[1.0]);
                }
            }
        }
    }
    assert_derivatives_match(&Hinges(vec![-1.0, 0.2, 0.5002, 0.9]), &[0.5]);
}

/// The rows of [`WavyRows`], summed in one matrix product instead of block by block.
struct Batched(WavyRows);

impl Objective for Batched {
    fn parameter_count(&self) -> usize {
        self.0.parameter_count()
    }

    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
        let mut normal = NormalEquations::new(parameters.len());
        self.0.add_to(parameters, &mut normal);
        // Columns in another order, and nothing but the lower triangle: both must be understood.
        let columns: Vec<usize> = (0..parameters.len()).rev().collect();
        normal.fill_upper();
        let half: Vec<f64> = columns.iter().map(|&c| normal.half_gradient[c]).collect();
        let matrix = DMatrix::from_fn(columns.len(), columns.len(), |r, c| {
            if r >= c { normal.matrix[(columns[r], columns[c])] } else { f64::MAX }
        });
        match sink.wanted() {
            Wanted::Value => sink.add_assembled(normal.value, &[], &[], None),
            Wanted::Gradient => sink.add_assembled(normal.value, &columns, &half, None),
            Wanted::NormalEquations => sink.add_assembled(normal.value, &columns, &half, Some(&matrix)),
        }
    }
}

#[test]
fn an_assembled_contribution_equals_its_blocks() {
    let at = Random(12).vector(8);
    let batched = Batched(WavyRows::random(13, 25, 8, 0.3));
    assert_same_contributions(&batched, &batched.0, &at);
    assert_derivatives_match(&batched, &at);
}

#[test]
#[should_panic(expected = "same energy")]
fn unequal_contributions_are_told_apart() {
    let at = Random(12).vector(8);
    assert_same_contributions(&WavyRows::random(13, 25, 8, 0.3), &WavyRows::random(14, 25, 8, 0.3), &at);
}
