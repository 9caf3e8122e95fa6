//! What is minimised: a sum of weighted, squared residual blocks.

use crate::{Bounds, Sink, SolveError};

/// Energy of the free parameters, Σ weight·‖residual‖² (there is no ½).
///
/// Anything frozen during a solve (correspondences, gates, robust weights) belongs to the objective, so that it is smooth
/// and its derivatives can be checked.
pub trait Objective {
    /// Number of free parameters.
    fn parameter_count(&self) -> usize;

    /// Adds every residual block at `parameters` to `sink`, with derivatives if [`Sink::wanted`] asks for them.
    ///
    /// The blocks, their order and their shapes must not depend on what is wanted.
    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink);
}

/// Checks that sizes agree and that the start is finite.
pub(crate) fn validate_start(
    objective: &dyn Objective,
    parameters: &[f64],
    bounds: &Bounds,
) -> Result<(), SolveError> {
    let expected = objective.parameter_count();
    if parameters.len() != expected {
        return Err(SolveError::SizeMismatch {
            quantity: "list of start parameters",
            found: parameters.len(),
            expected,
        });
    }
    bounds.validate(expected)?;
    match parameters.iter().position(|parameter| !parameter.is_finite()) {
        Some(index) => Err(SolveError::NonFiniteStart { index, value: parameters[index] }),
        None => Ok(()),
    }
}
