//! Who listens to a solve.

/// Something that happened during a solve or a longer computation.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A solver accepted a step.
    Iteration {
        /// Iterations so far, the first is 1.
        iteration: usize,
        /// Energy after the step.
        energy: f64,
        /// Euclidean length of the step, in parameter units.
        step_norm: f64,
    },
    /// A round of correspondences and one solve is over.
    Round {
        /// What the rounds belong to.
        name: &'static str,
        /// Index of this round, from 0.
        index: usize,
        /// Number of rounds planned.
        count: usize,
        /// Energy at the end of the round.
        energy: f64,
    },
    /// A part of a longer computation is done.
    Progress {
        /// The stage that works.
        stage: &'static str,
        /// Items done.
        done: usize,
        /// Items in all.
        total: usize,
    },
}

/// Whether to go on after an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    /// Go on.
    Continue,
    /// Stop here and keep what has been reached.
    Stop,
}

/// Hears rounds and iterations, and may stop them.
pub trait Observer {
    /// Called after each event, in order.
    fn on_event(&mut self, event: &Event) -> Flow;

    /// Called with the parameters of each step that a solver accepts, before its [`Event::Iteration`].
    ///
    /// For those who judge the parameters themselves, such as by the error on data that the solver does not see.
    fn on_parameters(&mut self, _parameters: &[f64]) -> Flow {
        Flow::Continue
    }
}

/// An observer that hears nothing and never stops.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Observer for Silent {
    fn on_event(&mut self, _event: &Event) -> Flow {
        Flow::Continue
    }
}
