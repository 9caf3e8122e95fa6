//! `habitus evaluate`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, Subcommand};
use habitus::artifacts::write_atomically;
use habitus::evaluation::sequence_accuracy::SequenceAccuracy;
use habitus::pipeline::{MeasuredFit, measure_stored_fit, read_stored_fit};
use habitus_synthetic::truth::DressedTruth;
use serde::Serialize;

use crate::Outcome;
use crate::commands::evaluate_clothing::ClothingArguments;
use crate::commands::evaluate_reconstructions::ReconstructionsArguments;
use crate::commands::evaluate_registrations::RegistrationsArguments;
use crate::commands::evaluate_space::ShapeSpaceArguments;
use crate::commands::generate::{sequence_truth, truth_of_frames};
use crate::console::Console;
use crate::sequence_job::{accuracy, accuracy_table, load_model};

const EXAMPLES: &str = "\
Examples:
  habitus evaluate sequence run --truth dressed
  habitus evaluate sequence run_default run_paper --truth dressed -o accuracy.json";

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
    /// Compare fits with the sequence that was made by: habitus generate
    Sequence(SequenceArguments),
    /// Compare registrations with the scans that were made by: habitus generate scans
    Registrations(RegistrationsArguments),
    /// Compare reconstructions with the pairs that were made by: habitus generate depth-pairs
    Reconstructions(ReconstructionsArguments),
    /// Measure how good a shape space is: compactness, generalization, specificity
    ShapeSpace(ShapeSpaceArguments),
    /// Measure how well clothes are learnt from layers: components, splits, baselines, penetration
    Clothing(ClothingArguments),
}

/// Arguments for sequences.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct SequenceArguments {
    /// Run folders or fit.npz files
    #[arg(required = true)]
    pub runs: Vec<PathBuf>,
    /// Folder of the generated sequence
    #[arg(long, value_name = "DIR")]
    pub truth: PathBuf,
    /// Body model that the runs were fitted with [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Write the numbers as JSON too
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// Compares.
pub fn run(arguments: &EvaluateArguments, console: &Console) -> anyhow::Result<Outcome> {
    match &arguments.subject {
        Subject::Sequence(arguments) => evaluate_sequence(arguments, console),
        Subject::Registrations(arguments) => super::evaluate_registrations::run(arguments, console),
        Subject::Reconstructions(arguments) => super::evaluate_reconstructions::run(arguments, console),
        Subject::ShapeSpace(arguments) => super::evaluate_space::run(arguments, console),
        Subject::Clothing(arguments) => super::evaluate_clothing::run(arguments, console),
    }
}

fn evaluate_sequence(arguments: &SequenceArguments, console: &Console) -> anyhow::Result<Outcome> {
    let model = load_model(arguments.model.as_deref())?;
    let truth = sequence_truth(&model, &DressedTruth::read(&arguments.truth)?);
    let mut results: BTreeMap<String, SequenceAccuracy> = BTreeMap::new();
    for run in &arguments.runs {
        let fit = read_stored_fit(run)?;
        let measurements = measure_stored_fit(&model, &fit)?;
        let name = run.display().to_string();
        let names: Vec<String> = fit.sequence.frames.iter().map(|frame| frame.name.clone()).collect();
        let found = truth_of_frames(&truth, names.iter().map(String::as_str))
            .and_then(|truth| accuracy(&model, &MeasuredFit { fit, measurements }, &truth))
            .with_context(|| format!("{name} and {}", arguments.truth.display()))?;
        console.result(format!("{name}\n{}", accuracy_table(&found)));
        results.insert(name, found);
    }
    write_numbers(arguments.output.as_deref(), &results)?;
    Ok(Outcome::Fine)
}

/// Writes numbers as JSON, if a path is given.
pub fn write_numbers(path: Option<&Path>, results: &impl Serialize) -> anyhow::Result<()> {
    let Some(path) = path else { return Ok(()) };
    let text = serde_json::to_string_pretty(results)? + "\n";
    write_atomically(path, text.as_bytes())
        .with_context(|| format!("{}: the numbers cannot be written", path.display()))
}
