//! Box-constrained limited-memory BFGS (Byrd, Lu, Nocedal and Zhu 1995), the solver the papers name.

use basin::{
    BoxBounds, ConstraintDescription, ConstraintSet, ConstraintSolveError, Constraints, CostFunction,
    Executor, FirstOrderState, Lbfgsb, State, StepOutcome, Termination,
};

use crate::observer::{Event, Flow, Observer};
use crate::termination::{SolveReport, StopReason, Tolerances};
use crate::{Bounds, Gradient, Objective, SolveError};

/// Settings of [`lbfgsb`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LbfgsbSettings {
    /// Accepted steps at most.
    pub max_iterations: usize,
    /// Correction pairs kept, the authors advise 3 to 20.
    pub memory: usize,
    /// When to stop.
    pub tolerances: Tolerances,
}

impl Default for LbfgsbSettings {
    fn default() -> Self {
        Self { max_iterations: 1000, memory: 10, tolerances: Tolerances::default() }
    }
}

impl LbfgsbSettings {
    fn validate(&self) -> Result<(), SolveError> {
        if self.memory == 0 {
            return Err(SolveError::InvalidSetting {
                name: "memory",
                value: 0.0,
                remedy: "keep at least one pair",
            });
        }
        self.tolerances.validate()
    }
}

/// Minimises `objective` inside `bounds`, starting from and writing to `parameters`.
///
/// Needs only gradients: use it where the normal matrix would be too large or the residuals too curved for
/// [`gauss_newton`](crate::gauss_newton). A start outside the box is first moved to its nearest point. On an error
/// `parameters` hold the last accepted point.
pub fn lbfgsb(
    objective: &dyn Objective,
    parameters: &mut [f64],
    bounds: &Bounds,
    settings: &LbfgsbSettings,
    observer: &mut dyn Observer,
) -> Result<SolveReport, SolveError> {
    settings.validate()?;
    crate::objective::validate_start(objective, parameters, bounds)?;
    bounds.project(parameters);

    // The library's own flatness test compares with an energy of one, which is large for squared metres: it is off, and
    // the tests of `Tolerances` are made here.
    let solver = Lbfgsb::new()
        .with_m_capacity(settings.memory)
        .with_relative_cost_reduction_tolerance(None)
        .with_absolute_projected_gradient_tolerance(settings.tolerances.gradient);
    let problem = Problem { objective, bounds, evaluations: std::cell::Cell::new(0) };
    let start = FirstOrderState::new(parameters.to_vec());
    let mut stepper = Executor::new(&problem, solver, start).into_stepper().map_err(solve_error)?;
    let initial_energy = stepper.state().cost();
    let mut report = SolveReport {
        reason: StopReason::IterationLimit,
        iterations: 0,
        evaluations: problem.evaluations.get(),
        initial_energy,
        final_energy: initial_energy,
    };
    while report.iterations < settings.max_iterations {
        let outcome = stepper.step().map_err(solve_error)?;
        report.evaluations = problem.evaluations.get();
        let energy = stepper.state().cost();
        let has_moved = stepper.state().param() != parameters && energy < report.final_energy;
        if has_moved {
            let decrease = report.final_energy - energy;
            let step_norm = distance(stepper.state().param(), parameters);
            parameters.copy_from_slice(stepper.state().param());
            report.iterations += 1;
            report.final_energy = energy;
            let event = Event::Iteration { iteration: report.iterations, energy, step_norm };
            let is_stopped = observer.on_parameters(parameters) == Flow::Stop;
            let reason = if observer.on_event(&event) == Flow::Stop || is_stopped {
                Some(StopReason::Cancelled)
            } else if settings.tolerances.is_energy_flat(decrease, energy) {
                Some(StopReason::EnergyFlat)
            } else if settings
                .tolerances
                .is_step_small(step_norm, distance(parameters, &vec![0.0; parameters.len()]))
            {
                Some(StopReason::StepSmall)
            } else {
                None
            };
            if let Some(reason) = reason {
                report.reason = reason;
                return Ok(report);
            }
        }
        if let StepOutcome::Stopped(stop) = outcome {
            report.reason = stop_reason(&stop.termination);
            return Ok(report);
        }
        if !has_moved {
            report.reason = StopReason::NoDescent;
            return Ok(report);
        }
    }
    Ok(report)
}

fn stop_reason(termination: &Termination<f64>) -> StopReason {
    if termination.is_converged() { StopReason::GradientSmall } else { StopReason::NoDescent }
}

fn solve_error(error: ConstraintSolveError<SolveError>) -> SolveError {
    match error {
        ConstraintSolveError::Evaluation(error) => error,
        refusal => SolveError::Refused { reason: refusal.to_string() },
    }
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// An objective in a box, as the quasi-Newton library sees it.
struct Problem<'a> {
    objective: &'a dyn Objective,
    bounds: &'a Bounds,
    evaluations: std::cell::Cell<usize>,
}

impl Problem<'_> {
    fn evaluate(&self, parameters: &[f64]) -> Result<Gradient, SolveError> {
        self.evaluations.set(self.evaluations.get() + 1);
        let sum = Gradient::of(self.objective, parameters);
        sum.check(self.evaluations.get())?;
        Ok(sum)
    }
}

impl Constraints for &Problem<'_> {
    type Set = ConstraintSet<BoxBounds<Vec<f64>>>;

    fn constraints(&self) -> <Self::Set as ConstraintDescription>::Borrowed<'_> {
        ConstraintSet::new().with_bounds(BoxBounds::new(Some(&self.bounds.lower), Some(&self.bounds.upper)))
    }
}

impl CostFunction for &Problem<'_> {
    type Param = Vec<f64>;
    type Output = f64;
    type Error = SolveError;

    fn cost(&self, parameters: &Vec<f64>) -> Result<f64, SolveError> {
        Ok(self.evaluate(parameters)?.value)
    }
}

impl basin::Gradient for &Problem<'_> {
    type Gradient = Vec<f64>;

    fn gradient(&self, parameters: &Vec<f64>) -> Result<Vec<f64>, SolveError> {
        Ok(self.evaluate(parameters)?.gradient)
    }

    fn cost_and_gradient(&self, parameters: &Vec<f64>) -> Result<(f64, Vec<f64>), SolveError> {
        let sum = self.evaluate(parameters)?;
        Ok((sum.value, sum.gradient))
    }
}
