//! One file for each verb.

pub mod completions;
pub mod config;
pub mod demo;
pub mod evaluate;
pub mod export;
pub mod extract_clothing;
pub mod fit_sequence;
pub mod generate;
pub mod measure;
pub mod register;
pub mod render;
pub mod report;
pub mod review;
