//! How good a result is: data in, numbers out.

pub mod clearance;
pub mod clothing_metrics;
pub mod distribution;
pub mod fit_error;
pub mod layer_reconstruction;
pub mod reconstruction_accuracy;
pub mod registration_accuracy;
pub mod registration_ranking;
pub mod sequence_accuracy;
pub mod sequence_errors;
pub mod sequence_metrics;
pub mod shape_space_quality;
