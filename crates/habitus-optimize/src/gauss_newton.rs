//! Damped Gauss–Newton steps that are exact inside the box.

use nalgebra::DVector;

use crate::box_quadratic::{BoxStep, Position, minimize_box_quadratic};
use crate::observer::{Event, Flow, Observer};
use crate::sink::{NormalEquations, ValueSum};
use crate::termination::{SolveReport, StopReason, Tolerances};
use crate::{Bounds, Objective, SolveError};

/// Settings of [`gauss_newton`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GaussNewtonSettings {
    /// Accepted steps at most.
    pub max_iterations: usize,
    /// Damping of the first step, relative to the diagonal of the normal matrix.
    pub initial_damping: f64,
    /// Damping above which the search for a descending step ends.
    pub max_damping: f64,
    /// When to stop.
    pub tolerances: Tolerances,
}

impl Default for GaussNewtonSettings {
    fn default() -> Self {
        Self {
            max_iterations: 50,
            initial_damping: 1e-4,
            max_damping: 1e12,
            tolerances: Tolerances::default(),
        }
    }
}

impl GaussNewtonSettings {
    fn validate(&self) -> Result<(), SolveError> {
        for (name, value) in [("initial_damping", self.initial_damping), ("max_damping", self.max_damping)] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(SolveError::InvalidSetting {
                    name,
                    value,
                    remedy: "use a finite number of at least zero",
                });
            }
        }
        self.tolerances.validate()
    }
}

/// Share of the largest diagonal entry that a parameter without influence is damped by, so that the matrix stays definite.
const DIAGONAL_FLOOR: f64 = 1e-12;
/// Damping below which it no longer matters.
const DAMPING_FLOOR: f64 = 1e-12;
/// Multiples of the rounding unit of the energy below which a predicted decrease cannot be verified.
const VERIFIABLE_DECREASE: f64 = 8.0 * f64::EPSILON;

/// Minimises `objective` inside `bounds`, starting from and writing to `parameters`.
///
/// Each step minimises the Gauss–Newton model with Levenberg damping scaled by its diagonal (Marquardt) over the box
/// itself, and is accepted only if the true energy falls; the damping follows Nielsen (1999). A start outside the box is
/// first moved to its nearest point. On an error `parameters` hold the last accepted point.
pub fn gauss_newton(
    objective: &dyn Objective,
    parameters: &mut [f64],
    bounds: &Bounds,
    settings: &GaussNewtonSettings,
    observer: &mut dyn Observer,
) -> Result<SolveReport, SolveError> {
    settings.validate()?;
    crate::objective::validate_start(objective, parameters, bounds)?;
    bounds.project(parameters);

    let mut solve = Solve::start(objective, parameters, bounds, settings)?;
    solve.report.reason = solve.run(parameters, observer)?;
    Ok(solve.report)
}

/// The state of one solve.
struct Solve<'a> {
    objective: &'a dyn Objective,
    bounds: &'a Bounds,
    settings: &'a GaussNewtonSettings,
    model: NormalEquations,
    damping: Damping,
    trial: Vec<f64>,
    report: SolveReport,
}

impl<'a> Solve<'a> {
    fn start(
        objective: &'a dyn Objective,
        parameters: &[f64],
        bounds: &'a Bounds,
        settings: &'a GaussNewtonSettings,
    ) -> Result<Self, SolveError> {
        let mut model = NormalEquations::new(parameters.len());
        model.evaluate(objective, parameters);
        model.check(1)?;
        let report = SolveReport {
            reason: StopReason::IterationLimit,
            iterations: 0,
            evaluations: 1,
            initial_energy: model.value,
            final_energy: model.value,
        };
        let damping = Damping { value: settings.initial_damping, growth: 2.0 };
        Ok(Self { objective, bounds, settings, model, damping, trial: parameters.to_vec(), report })
    }

    fn run(&mut self, parameters: &mut [f64], observer: &mut dyn Observer) -> Result<StopReason, SolveError> {
        let tolerances = &self.settings.tolerances;
        loop {
            if is_stationary(&self.model, parameters, self.bounds, tolerances) {
                return Ok(StopReason::GradientSmall);
            }
            if self.report.iterations >= self.settings.max_iterations {
                return Ok(StopReason::IterationLimit);
            }
            let (energy, step_norm) = match self.find_descent(parameters)? {
                Descent::Found { energy, step_norm } => (energy, step_norm),
                Descent::Unverifiable => return Ok(StopReason::EnergyFlat),
                Descent::NotFound => return Ok(StopReason::NoDescent),
            };
            let decrease = self.report.final_energy - energy;
            parameters.copy_from_slice(&self.trial);
            self.report.iterations += 1;
            self.report.final_energy = energy;
            let event = Event::Iteration { iteration: self.report.iterations, energy, step_norm };
            let is_stopped = observer.on_parameters(parameters) == Flow::Stop;
            if observer.on_event(&event) == Flow::Stop || is_stopped {
                return Ok(StopReason::Cancelled);
            }
            if tolerances.is_energy_flat(decrease, energy) {
                return Ok(StopReason::EnergyFlat);
            }
            if tolerances.is_step_small(step_norm, norm(parameters)) {
                return Ok(StopReason::StepSmall);
            }
            if self.report.iterations < self.settings.max_iterations {
                self.model.evaluate(self.objective, parameters);
                self.report.evaluations += 1;
                self.model.check(self.report.evaluations)?;
            }
        }
    }

    /// Raises the damping until a step lowers the energy.
    fn find_descent(&mut self, parameters: &[f64]) -> Result<Descent, SolveError> {
        let lower: Vec<f64> = self.bounds.lower.iter().zip(parameters).map(|(l, p)| l - p).collect();
        let upper: Vec<f64> = self.bounds.upper.iter().zip(parameters).map(|(u, p)| u - p).collect();
        let energy = self.report.final_energy;
        while self.damping.value <= self.settings.max_damping {
            let step = match damped_step(&self.model, self.damping.value, &lower, &upper) {
                Ok(step) => step,
                // More damping makes the matrix definite and the active set trivial.
                Err(SolveError::NotPositiveDefinite { .. } | SolveError::ActiveSetUnsettled { .. }) => {
                    self.damping.raise();
                    continue;
                }
                Err(error) => return Err(error),
            };
            let predicted = predicted_decrease(&self.model, &step.step);
            if predicted <= VERIFIABLE_DECREASE * energy {
                return Ok(Descent::Unverifiable);
            }
            move_by(parameters, &step, self.bounds, &mut self.trial);
            let sum = ValueSum::of(self.objective, &self.trial);
            self.report.evaluations += 1;
            sum.check(self.report.evaluations)?;
            if sum.value < energy {
                self.damping.lower((energy - sum.value) / predicted);
                return Ok(Descent::Found { energy: sum.value, step_norm: step.step.norm() });
            }
            self.damping.raise();
        }
        Ok(Descent::NotFound)
    }
}

/// Levenberg damping and how fast the next refusal raises it.
struct Damping {
    value: f64,
    growth: f64,
}

impl Damping {
    fn lower(&mut self, gain: f64) {
        self.value = (self.value * (1.0 - (2.0 * gain - 1.0).powi(3)).max(1.0 / 3.0)).max(DAMPING_FLOOR);
        self.growth = 2.0;
    }

    fn raise(&mut self) {
        self.value = self.value.max(DAMPING_FLOOR) * self.growth;
        self.growth *= 2.0;
    }
}

enum Descent {
    /// A step that lowers the energy, already in the trial parameters.
    Found { energy: f64, step_norm: f64 },
    /// The model promises less than rounding of the energy lets us see.
    Unverifiable,
    /// No damping up to the limit helped.
    NotFound,
}

fn damped_step(
    model: &NormalEquations,
    damping: f64,
    lower: &[f64],
    upper: &[f64],
) -> Result<BoxStep, SolveError> {
    let mut matrix = model.matrix.clone();
    let largest = matrix.diagonal().max();
    let floor = if largest > 0.0 { DIAGONAL_FLOOR * largest } else { 1.0 };
    for i in 0..matrix.nrows() {
        let scale = matrix[(i, i)];
        matrix[(i, i)] += (damping * scale).max(floor);
    }
    minimize_box_quadratic(&matrix, &model.half_gradient, lower, upper)
}

/// By how much the undamped model says the energy falls: −(2 hᵀd + dᵀAd), h half the gradient.
fn predicted_decrease(model: &NormalEquations, step: &DVector<f64>) -> f64 {
    -(2.0 * model.half_gradient.dot(step) + (&model.matrix * step).dot(step))
}

/// Writes the stepped parameters; those at a bound take its exact value, the others differ from the box by rounding at most.
fn move_by(parameters: &[f64], step: &BoxStep, bounds: &Bounds, trial: &mut [f64]) {
    for (i, moved) in trial.iter_mut().enumerate() {
        *moved = match step.positions[i] {
            Position::Free => parameters[i] + step.step[i],
            Position::AtLower => bounds.lower[i],
            Position::AtUpper => bounds.upper[i],
        };
    }
    bounds.project(trial);
}

fn is_stationary(
    model: &NormalEquations,
    parameters: &[f64],
    bounds: &Bounds,
    tolerances: &Tolerances,
) -> bool {
    (0..parameters.len()).all(|i| {
        bounds.projected_component(i, parameters[i], 2.0 * model.half_gradient[i]).abs()
            <= tolerances.gradient
    })
}

fn norm(parameters: &[f64]) -> f64 {
    parameters.iter().map(|p| p * p).sum::<f64>().sqrt()
}
