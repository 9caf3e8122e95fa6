//! One file for each verb.

pub mod bootstrap;
pub mod completions;
pub mod config;
pub mod demo;
pub mod evaluate;
pub mod evaluate_benchmark;
pub mod evaluate_clothing;
pub mod evaluate_reconstructions;
mod evaluate_registrations;
pub mod evaluate_sequence;
pub mod evaluate_space;
pub mod export;
pub mod extract_clothing;
pub mod fit_sequence;
pub mod generate;
pub mod generate_scans;
pub mod generate_sets;
pub mod landmarks;
pub mod learn_clothing;
pub mod learn_shape;
pub mod measure;
pub mod reconstruct;
pub mod register;
pub mod render;
pub mod report;
pub mod review;
pub mod synthesize;
