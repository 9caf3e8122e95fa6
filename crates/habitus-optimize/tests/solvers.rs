//! Both solvers reach the optimum of the box, say why they stopped, and repeat themselves to the bit.
#![allow(clippy::unwrap_used, reason = "a failed solve is a failed test")]

mod problems;

use habitus_optimize::{
    Bounds, Event, Flow, GaussNewtonSettings, Gradient, LbfgsbSettings, Objective, Observer, Silent, Sink,
    SolveError, SolveReport, StopReason, Tolerances, ValueSum, gauss_newton, lbfgsb, map_chunks,
};
use problems::{Random, Rosenbrock, WavyRows};

const EXACT: Tolerances = Tolerances { gradient: 1e-10, step: 0.0, energy: 0.0 };

fn by_gauss_newton(objective: &dyn Objective, start: &[f64], bounds: &Bounds) -> (Vec<f64>, SolveReport) {
    let mut parameters = start.to_vec();
    let settings = GaussNewtonSettings { max_iterations: 500, tolerances: EXACT, ..Default::default() };
    let report = gauss_newton(objective, &mut parameters, bounds, &settings, &mut Silent).unwrap();
    (parameters, report)
}

fn by_lbfgsb(objective: &dyn Objective, start: &[f64], bounds: &Bounds) -> (Vec<f64>, SolveReport) {
    let mut parameters = start.to_vec();
    let settings = LbfgsbSettings { max_iterations: 5000, tolerances: EXACT, ..Default::default() };
    let report = lbfgsb(objective, &mut parameters, bounds, &settings, &mut Silent).unwrap();
    (parameters, report)
}

fn random_box(random: &mut Random, count: usize, size: f64) -> Bounds {
    let lower = (0..count).map(|_| -size * random.unit()).collect();
    let upper = (0..count).map(|_| size * random.unit()).collect();
    Bounds::new(lower, upper).unwrap()
}

#[test]
fn both_solvers_reach_the_same_optimum_of_random_box_problems() {
    let mut held = 0;
    for seed in 0..40 {
        let mut random = Random(100 + seed);
        let count = 2 + seed as usize % 12;
        let objective = WavyRows::random(seed, 3 * count, count, 0.3);
        let bounds = random_box(&mut random, count, 0.4);
        let start = vec![0.0; count];
        let (gn, gn_report) = by_gauss_newton(&objective, &start, &bounds);
        let (qn, qn_report) = by_lbfgsb(&objective, &start, &bounds);
        for (solution, report) in [(&gn, &gn_report), (&qn, &qn_report)] {
            assert!(bounds.contains(solution));
            let sum = Gradient::of(&objective, solution);
            assert_eq!(sum.value, report.final_energy);
            assert!(report.final_energy <= report.initial_energy);
            // Rounding of a sum of squares near one limits the slope that can be reached to about its square root.
            assert!(
                bounds.projected_gradient_norm(solution, &sum.gradient) < 1e-6,
                "seed {seed}: {report:?}"
            );
        }
        let largest = gn.iter().zip(&qn).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(largest < 1e-6, "seed {seed}: {largest}");
        held += (0..count).filter(|&i| gn[i] == bounds.lower[i] || gn[i] == bounds.upper[i]).count();
    }
    assert!(held > 40, "only {held} parameters met a bound: the cases prove little");
}

#[test]
fn linear_least_squares_takes_one_undamped_step() {
    let objective = WavyRows::random(7, 30, 6, 0.0);
    let bounds = random_box(&mut Random(8), 6, 0.1);
    let mut parameters = vec![0.0; 6];
    let settings = GaussNewtonSettings { initial_damping: 0.0, tolerances: EXACT, ..Default::default() };
    let report = gauss_newton(&objective, &mut parameters, &bounds, &settings, &mut Silent).unwrap();
    assert!(report.iterations <= 2, "{report:?}");
    let slope = Gradient::of(&objective, &parameters).gradient;
    assert!(bounds.projected_gradient_norm(&parameters, &slope) < 1e-8);
}

#[test]
fn scaling_the_energy_does_not_change_the_path() {
    let mut objective = WavyRows::random(9, 30, 5, 0.5);
    let bounds = random_box(&mut Random(10), 5, 0.3);
    let (one, _) = by_gauss_newton(&objective, &[0.0; 5], &bounds);
    objective.weight = 2.0_f64.powi(20);
    let (scaled, _) = by_gauss_newton(&objective, &[0.0; 5], &bounds);
    assert!(one.iter().zip(&scaled).all(|(a, b)| (a - b).abs() < 1e-8));
}

#[test]
fn a_parameter_without_influence_stays_where_it_is() {
    struct OnlyFirst;
    impl Objective for OnlyFirst {
        fn parameter_count(&self) -> usize {
            2
        }
        fn add_to(&self, x: &[f64], sink: &mut dyn Sink) {
            sink.add(1.0, &[x[0] - 1.0], &[0], &[1.0]);
        }
    }
    let (solution, report) = by_gauss_newton(&OnlyFirst, &[0.0, 0.7], &Bounds::unbounded(2));
    assert!((solution[0] - 1.0).abs() < 1e-10 && solution[1] == 0.7, "{solution:?} {report:?}");
}

/// Energies of the iterations, in order.
#[derive(Default)]
struct Energies {
    list: Vec<f64>,
    stop_after: usize,
}

impl Observer for Energies {
    fn on_event(&mut self, event: &Event) -> Flow {
        if let Event::Iteration { iteration, energy, step_norm } = event {
            self.list.push(*energy);
            assert_eq!(*iteration, self.list.len());
            assert!(*step_norm > 0.0);
        }
        if self.list.len() == self.stop_after { Flow::Stop } else { Flow::Continue }
    }
}

#[test]
fn the_first_reference_driver_of_lbfgsb_is_reproduced() {
    let objective = Rosenbrock { parameter_count: 25, chain_weight: 4.0 };
    let lower = (0..25).map(|i| if i % 2 == 0 { 1.0 } else { -100.0 }).collect();
    let bounds = Bounds::new(lower, vec![100.0; 25]).unwrap();
    let mut parameters = vec![3.0; 25];
    let settings = LbfgsbSettings {
        memory: 5,
        tolerances: Tolerances { gradient: 1e-5, step: 0.0, energy: 0.0 },
        ..Default::default()
    };
    let mut energies = Energies { list: Vec::new(), stop_after: 23 };
    let report = lbfgsb(&objective, &mut parameters, &bounds, &settings, &mut energies).unwrap();
    // Zhu, Byrd, Lu and Nocedal's driver1: F = 1.083490083518e-9 after 23 iterations and 28 evaluations. The same
    // numbers summed in another order differ in the eleventh digit.
    assert_eq!((report.reason, report.iterations, report.evaluations), (StopReason::Cancelled, 23, 28));
    assert!((report.final_energy - 1.083_490_083_518e-9).abs() < 1e-18, "{:e}", report.final_energy);
}

#[test]
fn a_bounded_rosenbrock_valley_is_followed_to_its_corner() {
    for parameter_count in [2, 60, 300] {
        let objective = Rosenbrock { parameter_count, chain_weight: 100.0 };
        // Holding every parameter below 0.8 cuts off the unbounded minimum at one.
        let bounds = Bounds::new(vec![-2.0; parameter_count], vec![0.8; parameter_count]).unwrap();
        let start: Vec<f64> = (0..parameter_count).map(|i| if i % 2 == 0 { -1.2 } else { 0.5 }).collect();
        let (solution, report) = by_lbfgsb(&objective, &start, &bounds);
        let slope = Gradient::of(&objective, &solution);
        assert!(bounds.contains(&solution));
        assert!(
            bounds.projected_gradient_norm(&solution, &slope.gradient) < 1e-5,
            "{parameter_count}: {report:?}"
        );
    }
    let objective = Rosenbrock { parameter_count: 2, chain_weight: 100.0 };
    let bounds = Bounds::new(vec![-2.0; 2], vec![0.8; 2]).unwrap();
    for (solution, _) in
        [by_lbfgsb(&objective, &[-1.2, 0.5], &bounds), by_gauss_newton(&objective, &[-1.2, 0.5], &bounds)]
    {
        // By hand: x₀ = 0.8 would need x₁ = 0.64, which is inside; the slope in x₀ still points up.
        assert!((solution[0] - 0.8).abs() < 1e-9 && (solution[1] - 0.64).abs() < 1e-6, "{solution:?}");
    }
}

#[test]
fn energies_fall_at_every_iteration() {
    let objective = WavyRows::random(20, 60, 12, 0.9);
    let bounds = random_box(&mut Random(21), 12, 2.0);
    let start = Random(22).vector(12);
    for solver in 0..2 {
        let mut parameters = start.clone();
        let mut energies = Energies::default();
        let report = if solver == 0 {
            gauss_newton(&objective, &mut parameters, &bounds, &Default::default(), &mut energies).unwrap()
        } else {
            lbfgsb(&objective, &mut parameters, &bounds, &Default::default(), &mut energies).unwrap()
        };
        assert!(energies.list.windows(2).all(|pair| pair[1] < pair[0]));
        assert_eq!(energies.list.last(), Some(&report.final_energy));
        assert_eq!(energies.list.len(), report.iterations);
    }
}

#[test]
fn stop_reasons_say_what_happened() {
    let objective = WavyRows::random(30, 40, 8, 0.5);
    let free = Bounds::unbounded(8);
    let start = vec![0.9; 8];
    let reason = |tolerances: Tolerances, max_iterations: usize, stop_after: usize| {
        let mut observer = Energies { list: Vec::new(), stop_after };
        let gn = GaussNewtonSettings { max_iterations, tolerances, ..Default::default() };
        let gn = gauss_newton(&objective, &mut start.clone(), &free, &gn, &mut observer).unwrap().reason;
        let mut observer = Energies { list: Vec::new(), stop_after };
        let qn = LbfgsbSettings { max_iterations, tolerances, ..Default::default() };
        let qn = lbfgsb(&objective, &mut start.clone(), &free, &qn, &mut observer).unwrap().reason;
        assert_eq!(gn, qn);
        gn
    };
    let off = Tolerances { gradient: 0.0, step: 0.0, energy: 0.0 };
    assert_eq!(reason(Tolerances { gradient: 1e-3, ..off }, 100, 0), StopReason::GradientSmall);
    assert_eq!(reason(Tolerances { energy: 1e-3, ..off }, 100, 0), StopReason::EnergyFlat);
    assert_eq!(reason(Tolerances { step: 1e-3, ..off }, 100, 0), StopReason::StepSmall);
    assert_eq!(reason(off, 2, 0), StopReason::IterationLimit);
    assert_eq!(reason(off, 0, 0), StopReason::IterationLimit);
    assert_eq!(reason(off, 100, 1), StopReason::Cancelled);
}

#[test]
fn a_wrong_derivative_ends_without_descent_and_without_moving() {
    struct WrongSign;
    impl Objective for WrongSign {
        fn parameter_count(&self) -> usize {
            1
        }
        fn add_to(&self, x: &[f64], sink: &mut dyn Sink) {
            sink.add(1.0, &[x[0] + 2.0], &[0], &[-1.0]);
        }
    }
    for (solution, report) in [
        by_gauss_newton(&WrongSign, &[0.5], &Bounds::unbounded(1)),
        by_lbfgsb(&WrongSign, &[0.5], &Bounds::unbounded(1)),
    ] {
        assert_eq!(solution, [0.5]);
        assert_eq!(report.final_energy, report.initial_energy);
        assert_eq!(report.reason, StopReason::NoDescent);
    }
}

#[test]
fn an_exact_fit_ends_with_a_small_gradient() {
    let mut objective = WavyRows::random(31, 10, 3, 0.2);
    let truth = [0.2, -0.1, 0.3];
    for (row, target) in objective.rows.iter().zip(&mut objective.targets) {
        let line: f64 = row.iter().zip(&truth).map(|(a, x)| a * x).sum();
        *target = line + 0.2 * line.sin();
    }
    let (solution, report) = by_gauss_newton(&objective, &[0.0; 3], &Bounds::unbounded(3));
    assert_eq!(report.reason, StopReason::GradientSmall);
    assert!(solution.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 1e-9));
}

#[test]
fn a_start_outside_the_box_is_moved_to_its_nearest_point() {
    let objective = WavyRows::random(32, 10, 3, 0.2);
    let bounds = Bounds::new(vec![-0.1; 3], vec![0.1; 3]).unwrap();
    let corner = ValueSum::of(&objective, &[0.1, -0.1, 0.1]).value;
    assert_eq!(by_gauss_newton(&objective, &[5.0, -7.0, 0.2], &bounds).1.initial_energy, corner);
    assert_eq!(by_lbfgsb(&objective, &[5.0, -7.0, 0.2], &bounds).1.initial_energy, corner);
}

/// Finite at the start, not a number beyond the edge.
struct Cliff;

impl Objective for Cliff {
    fn parameter_count(&self) -> usize {
        1
    }
    fn add_to(&self, x: &[f64], sink: &mut dyn Sink) {
        sink.begin_part("calm");
        sink.add(1.0, &[x[0] - 3.0], &[0], &[1.0]);
        sink.begin_part("cliff");
        let root = (1.0 - x[0]).sqrt();
        sink.add(1e-6, &[root], &[0], &[-0.5 / root]);
    }
}

#[test]
fn numbers_that_are_not_finite_are_errors_that_name_their_part() {
    let free = Bounds::unbounded(1);
    let mut parameters = [0.0];
    let error = gauss_newton(&Cliff, &mut parameters, &free, &Default::default(), &mut Silent).unwrap_err();
    assert!(matches!(error, SolveError::NonFinite { part: "cliff", quantity: "the energy", .. }), "{error}");
    assert_eq!(parameters, [0.0], "the last accepted point is kept");
    let error = lbfgsb(&Cliff, &mut [0.0], &free, &Default::default(), &mut Silent).unwrap_err();
    assert!(matches!(error, SolveError::NonFinite { part: "cliff", .. }), "{error}");
    let error = gauss_newton(&Cliff, &mut [1.0], &free, &Default::default(), &mut Silent).unwrap_err();
    assert!(
        matches!(error, SolveError::NonFinite { part: "cliff", quantity: "the gradient", evaluation: 1 }),
        "{error}"
    );
}

#[test]
fn malformed_problems_are_refused() {
    let objective = WavyRows::random(33, 4, 2, 0.0);
    let run = |start: &[f64], bounds: &Bounds| {
        let gn = gauss_newton(&objective, &mut start.to_vec(), bounds, &Default::default(), &mut Silent)
            .unwrap_err();
        let qn =
            lbfgsb(&objective, &mut start.to_vec(), bounds, &Default::default(), &mut Silent).unwrap_err();
        assert_eq!(gn.to_string(), qn.to_string());
        gn
    };
    assert!(matches!(
        run(&[0.0; 3], &Bounds::unbounded(2)),
        SolveError::SizeMismatch { found: 3, expected: 2, .. }
    ));
    assert!(matches!(
        run(&[0.0; 2], &Bounds::unbounded(1)),
        SolveError::SizeMismatch { found: 1, expected: 2, .. }
    ));
    assert!(matches!(
        run(&[0.0, f64::NAN], &Bounds::unbounded(2)),
        SolveError::NonFiniteStart { index: 1, .. }
    ));
    assert!(Bounds::new(vec![0.0], vec![f64::NAN]).is_err());
    assert!(Bounds::new(vec![0.0, 1.0], vec![1.0]).is_err());
    let settings = LbfgsbSettings { memory: 0, ..Default::default() };
    let error = lbfgsb(&objective, &mut [0.0; 2], &Bounds::unbounded(2), &settings, &mut Silent).unwrap_err();
    assert!(matches!(error, SolveError::InvalidSetting { name: "memory", .. }));
}

#[test]
fn fixed_parameters_stay_fixed_in_both_solvers() {
    let objective = WavyRows::random(34, 20, 4, 0.3);
    let bounds = Bounds::new(vec![0.25, -9.0, -9.0, -9.0], vec![0.25, 9.0, 9.0, 9.0]).unwrap();
    let (gn, _) = by_gauss_newton(&objective, &[0.0; 4], &bounds);
    let (qn, _) = by_lbfgsb(&objective, &[0.0; 4], &bounds);
    assert_eq!((gn[0], qn[0]), (0.25, 0.25));
    assert!(gn.iter().zip(&qn).all(|(a, b)| (a - b).abs() < 1e-6));
}

#[test]
fn solves_repeat_bit_for_bit_from_any_thread() {
    let objective = WavyRows::random(35, 80, 20, 0.5);
    let bounds = random_box(&mut Random(36), 20, 0.3);
    let solve =
        |_| (by_gauss_newton(&objective, &[0.0; 20], &bounds), by_lbfgsb(&objective, &[0.0; 20], &bounds));
    let first = solve(0);
    for other in map_chunks(8, 1, |range| solve(range.start)) {
        assert_eq!(other, first);
    }
}

#[test]
fn chunks_cover_every_index_once_and_in_order() {
    for (length, chunk) in [(0, 4), (1, 4), (8, 4), (9, 4), (100, 1)] {
        let indices: Vec<usize> = map_chunks(length, chunk, |range| range.collect::<Vec<_>>()).concat();
        assert_eq!(indices, (0..length).collect::<Vec<_>>());
    }
}
