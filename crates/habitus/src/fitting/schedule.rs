//! Term weights round by round, as data.

use serde::{Deserialize, Serialize};

/// How a weight changes over rounds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum RoundSchedule {
    /// P2 §4.5: falls linearly from one to zero and stays zero in the last rounds.
    LinearToZero {
        /// Rounds at the end with weight zero.
        zero_rounds: usize,
    },
    /// Multiplied by a factor after each round.
    Geometric {
        /// Weight of the first round.
        start: f64,
        /// Factor between rounds.
        factor: f64,
    },
}

impl RoundSchedule {
    /// The weight of round `index` of `count`.
    pub fn weight(&self, index: usize, count: usize) -> f64 {
        match *self {
            Self::LinearToZero { zero_rounds } => {
                let falling = count.saturating_sub(zero_rounds);
                if index >= falling { 0.0 } else { 1.0 - index as f64 / falling as f64 }
            }
            Self::Geometric { start, factor } => start * factor.powi(index as i32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_landmark_weight_of_six_rounds_falls_from_one_and_is_zero_in_the_last_two() {
        let schedule = RoundSchedule::LinearToZero { zero_rounds: 2 };
        let weights: Vec<f64> = (0..6).map(|round| schedule.weight(round, 6)).collect();
        assert_eq!(weights, [1.0, 0.75, 0.5, 0.25, 0.0, 0.0]);
    }

    #[test]
    fn a_geometric_schedule_multiplies() {
        let schedule = RoundSchedule::Geometric { start: 1e6, factor: 0.25 };
        assert_eq!(schedule.weight(2, 6), 62500.0);
    }
}
