//! When and why a solve ends.

use crate::SolveError;

/// Why a solver stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StopReason {
    /// The projected gradient is within its tolerance: a local minimum of the box.
    GradientSmall,
    /// The last step was within its tolerance.
    StepSmall,
    /// The last step changed the energy by less than its tolerance.
    EnergyFlat,
    /// The allowed iterations are used up; the energy may still be falling.
    IterationLimit,
    /// No step that lowers the energy was found.
    NoDescent,
    /// The observer asked to stop.
    Cancelled,
}

impl StopReason {
    /// Whether one of the three tolerances was met.
    pub fn is_converged(self) -> bool {
        matches!(self, Self::GradientSmall | Self::StepSmall | Self::EnergyFlat)
    }
}

/// Tolerances of the stop tests; zero asks for exact stationarity, so that in practice rounding ends the solve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerances {
    /// Largest projected gradient component that counts as zero, in energy per parameter unit.
    pub gradient: f64,
    /// Step length that counts as zero, relative to the length of the parameter vector.
    pub step: f64,
    /// Decrease of the energy by an accepted step that counts as none, relative to the energy.
    pub energy: f64,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self { gradient: 1e-12, step: 1e-10, energy: 1e-9 }
    }
}

impl Tolerances {
    pub(crate) fn validate(&self) -> Result<(), SolveError> {
        let named = [
            ("tolerances.gradient", self.gradient),
            ("tolerances.step", self.step),
            ("tolerances.energy", self.energy),
        ];
        for (name, value) in named {
            if !(value.is_finite() && value >= 0.0) {
                return Err(SolveError::InvalidSetting {
                    name,
                    value,
                    remedy: "use a finite number of at least zero",
                });
            }
        }
        Ok(())
    }

    pub(crate) fn is_step_small(&self, step_norm: f64, parameter_norm: f64) -> bool {
        step_norm <= self.step * (parameter_norm + self.step)
    }

    pub(crate) fn is_energy_flat(&self, decrease: f64, energy: f64) -> bool {
        decrease <= self.energy * energy.abs()
    }
}

/// What a solve did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolveReport {
    /// Why it stopped.
    pub reason: StopReason,
    /// Accepted steps.
    pub iterations: usize,
    /// Evaluations of the objective, with or without derivatives.
    pub evaluations: usize,
    /// Energy at the start, after moving it into the box.
    pub initial_energy: f64,
    /// Energy at the returned parameters.
    pub final_energy: f64,
}
