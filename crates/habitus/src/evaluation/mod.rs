//! How good a result is: data in, numbers out.

pub mod clearance;
pub mod sequence_accuracy;
