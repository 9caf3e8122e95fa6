//! Why a solve could not be carried out.

/// A solve that cannot start or cannot go on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SolveError {
    /// A residual block produced NaN or an infinite number.
    #[error(
        "{quantity} of `{part}` is not finite at evaluation {evaluation}: look for NaN or infinite numbers in its \
         inputs, or for a division by zero"
    )]
    NonFinite {
        /// The part of the objective, as named by [`Sink::begin_part`](crate::Sink::begin_part).
        part: &'static str,
        /// Which of its numbers: the energy, the gradient or the normal matrix.
        quantity: &'static str,
        /// Count of evaluations up to and including this one.
        evaluation: usize,
    },
    /// A start parameter is NaN or infinite.
    #[error("start parameter {index} is {value}: start from finite numbers")]
    NonFiniteStart {
        /// Index of the parameter.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// Parameters, bounds and objective disagree on the number of parameters.
    #[error("the {quantity} has {found} entries but the objective has {expected} parameters")]
    SizeMismatch {
        /// What has the wrong length.
        quantity: &'static str,
        /// Its length.
        found: usize,
        /// The objective's parameter count.
        expected: usize,
    },
    /// A lower bound above its upper bound, or a bound that is NaN or excludes every number.
    #[error("bounds of parameter {index} are [{lower}, {upper}]: the lower must not exceed the upper")]
    InvalidBounds {
        /// Index of the parameter.
        index: usize,
        /// Its lower bound.
        lower: f64,
        /// Its upper bound.
        upper: f64,
    },
    /// A matrix that must be positive definite is not.
    #[error(
        "the matrix of the quadratic is not positive definite on {free_count} free variables: add damping"
    )]
    NotPositiveDefinite {
        /// Number of variables that were free.
        free_count: usize,
    },
    /// The factor of a sparse matrix does not fit into memory.
    #[error("the factor of a sparse matrix of {size} rows does not fit into memory: use a coarser surface")]
    FactorTooLarge {
        /// Rows of the matrix.
        size: usize,
    },
    /// The active set did not settle, which only rounding can cause.
    #[error(
        "the active set of {variable_count} bounded variables did not settle in {rounds} rounds: add damping"
    )]
    ActiveSetUnsettled {
        /// Number of variables.
        variable_count: usize,
        /// Rounds tried.
        rounds: usize,
    },
    /// A solver setting outside its range.
    #[error("setting `{name}` is {value}: {remedy}")]
    InvalidSetting {
        /// Name of the setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What would be accepted.
        remedy: &'static str,
    },
    /// The quasi-Newton library refused the problem.
    #[error("the quasi-Newton solver refused the problem: {reason}")]
    Refused {
        /// Its own words.
        reason: String,
    },
}
