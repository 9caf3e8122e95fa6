//! The box that parameters stay in.

use crate::SolveError;

/// A lower and an upper bound for each parameter; infinite where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Bounds {
    /// Lower bounds, −∞ where free.
    pub lower: Vec<f64>,
    /// Upper bounds, +∞ where free.
    pub upper: Vec<f64>,
}

impl Bounds {
    /// Bounds from two equally long lists; equal bounds hold a parameter fixed.
    pub fn new(lower: Vec<f64>, upper: Vec<f64>) -> Result<Self, SolveError> {
        let bounds = Self { lower, upper };
        bounds.validate(bounds.lower.len())?;
        Ok(bounds)
    }

    /// No bounds on any of `parameter_count` parameters.
    pub fn unbounded(parameter_count: usize) -> Self {
        Self { lower: vec![f64::NEG_INFINITY; parameter_count], upper: vec![f64::INFINITY; parameter_count] }
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.lower.len()
    }

    /// Whether there is no parameter at all.
    pub fn is_empty(&self) -> bool {
        self.lower.is_empty()
    }

    /// Moves `parameters` to the nearest point of the box.
    pub fn project(&self, parameters: &mut [f64]) {
        for ((parameter, &lower), &upper) in parameters.iter_mut().zip(&self.lower).zip(&self.upper) {
            *parameter = parameter.max(lower).min(upper);
        }
    }

    /// Whether every parameter lies in its interval, ends included.
    pub fn contains(&self, parameters: &[f64]) -> bool {
        parameters.len() == self.len()
            && parameters.iter().zip(&self.lower).zip(&self.upper).all(|((p, l), u)| l <= p && p <= u)
    }

    /// Largest component of the gradient that a step inside the box can still follow, in energy per parameter unit.
    ///
    /// A component that pushes against a bound it touches counts as zero: the result is zero exactly where the first-order
    /// conditions of the box-constrained problem hold.
    pub fn projected_gradient_norm(&self, parameters: &[f64], gradient: &[f64]) -> f64 {
        (0..parameters.len())
            .map(|i| self.projected_component(i, parameters[i], gradient[i]).abs())
            .fold(0.0, f64::max)
    }

    pub(crate) fn projected_component(&self, index: usize, parameter: f64, gradient: f64) -> f64 {
        let blocked = (gradient > 0.0 && parameter <= self.lower[index])
            || (gradient < 0.0 && parameter >= self.upper[index]);
        if blocked { 0.0 } else { gradient }
    }

    pub(crate) fn validate(&self, parameter_count: usize) -> Result<(), SolveError> {
        for (quantity, found) in
            [("list of lower bounds", self.lower.len()), ("list of upper bounds", self.upper.len())]
        {
            if found != parameter_count {
                return Err(SolveError::SizeMismatch { quantity, found, expected: parameter_count });
            }
        }
        for (index, (&lower, &upper)) in self.lower.iter().zip(&self.upper).enumerate() {
            let is_ordered = lower <= upper && lower < f64::INFINITY && upper > f64::NEG_INFINITY;
            if !is_ordered {
                return Err(SolveError::InvalidBounds { index, lower, upper });
            }
        }
        Ok(())
    }
}
