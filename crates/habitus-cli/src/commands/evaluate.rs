//! `habitus evaluate`.

use std::path::Path;

use anyhow::Context;
use clap::{Args, Subcommand};
use habitus::artifacts::write_atomically;
use serde::Serialize;

use crate::Outcome;
use crate::commands::evaluate_benchmark::BenchmarkArguments;
use crate::commands::evaluate_clothing::ClothingArguments;
use crate::commands::evaluate_reconstructions::ReconstructionsArguments;
use crate::commands::evaluate_registrations::RegistrationsArguments;
use crate::commands::evaluate_sequence::SequenceArguments;
use crate::commands::evaluate_space::ShapeSpaceArguments;
use crate::console::Console;

/// Arguments of the verb.
#[derive(Debug, Args)]
pub struct EvaluateArguments {
    /// What is evaluated
    #[command(subcommand)]
    pub subject: Subject,
}

/// What can be evaluated.
#[derive(Debug, Subcommand)]
pub enum Subject {
    /// Compare fits with the sequences that were made by: habitus generate
    Sequence(SequenceArguments),
    /// Fit all sequences that were made by: habitus generate benchmark, and compare them with the truth
    Benchmark(BenchmarkArguments),
    /// Compare registrations with the scans that were made by: habitus generate scans
    Registrations(RegistrationsArguments),
    /// Compare reconstructions with the pairs that were made by: habitus generate depth-pairs
    Reconstructions(ReconstructionsArguments),
    /// Measure how good a shape space is: compactness, generalization, specificity
    ShapeSpace(ShapeSpaceArguments),
    /// Measure how well clothes are learnt from layers: components, splits, baselines, penetration
    Clothing(ClothingArguments),
}

/// Compares.
pub fn run(arguments: &EvaluateArguments, console: &Console) -> anyhow::Result<Outcome> {
    match &arguments.subject {
        Subject::Sequence(arguments) => super::evaluate_sequence::run(arguments, console),
        Subject::Benchmark(arguments) => super::evaluate_benchmark::run(arguments, console),
        Subject::Registrations(arguments) => super::evaluate_registrations::run(arguments, console),
        Subject::Reconstructions(arguments) => super::evaluate_reconstructions::run(arguments, console),
        Subject::ShapeSpace(arguments) => super::evaluate_space::run(arguments, console),
        Subject::Clothing(arguments) => super::evaluate_clothing::run(arguments, console),
    }
}

/// Writes numbers as JSON, if a path is given.
pub fn write_numbers(path: Option<&Path>, results: &impl Serialize) -> anyhow::Result<()> {
    let Some(path) = path else { return Ok(()) };
    let text = serde_json::to_string_pretty(results)? + "\n";
    write_atomically(path, text.as_bytes())
        .with_context(|| format!("{}: the numbers cannot be written", path.display()))
}
