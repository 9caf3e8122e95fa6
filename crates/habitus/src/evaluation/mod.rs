//! How good a result is: data in, numbers out.

pub mod clearance;
pub mod registration_accuracy;
pub mod registration_ranking;
pub mod sequence_accuracy;
