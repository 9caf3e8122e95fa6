//! `habitus evaluate`.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use clap::{Args, Subcommand};
use habitus::artifacts::clothing_controls::ParameterTable;
use habitus::artifacts::write_atomically;
use habitus::evaluation::clothing_metrics::ClothingMetrics;
use habitus::evaluation::sequence_accuracy::SequenceAccuracy;
use habitus::pipeline::{ClothingEvaluation, MeasuredFit, measure_stored_fit, read_layers, read_stored_fit};
use habitus_report::clothing::clothing_page;
use habitus_synthetic::truth::DressedTruth;

use crate::Outcome;
use crate::clock::StageClock;
use crate::commands::evaluate_space::ShapeSpaceArguments;
use crate::commands::generate::{sequence_truth, truth_of_frames};
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::{RunObserver, StageBar};
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

const CLOTHING_EXAMPLES: &str = "\
Examples:
  habitus evaluate clothing run -o clothing
  habitus evaluate clothing fabrics/* --parameters fabrics/parameters.csv -o clothing

Writes metrics.json and report.html.";

/// Arguments for clothing.
#[derive(Debug, Args)]
#[command(after_help = CLOTHING_EXAMPLES)]
pub struct ClothingArguments {
    /// Runs with a clothing layer, or layer files; of one outfit
    #[arg(required = true, value_name = "LAYER_RUN")]
    pub layers: Vec<PathBuf>,
    /// Folder for the numbers and the page
    #[arg(long, short, value_name = "DIR")]
    pub output: PathBuf,
    /// Table of fabrics or sizes: one row a sequence, its name first
    #[arg(long, value_name = "FILE")]
    pub parameters: Option<PathBuf>,
    /// Settings of learn-clothing
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Compares.
pub fn run(arguments: &EvaluateArguments, console: &Console) -> anyhow::Result<Outcome> {
    match &arguments.subject {
        Subject::Sequence(arguments) => evaluate_sequence(arguments, console),
        Subject::ShapeSpace(arguments) => super::evaluate_space::run(arguments, console),
        Subject::Clothing(arguments) => evaluate_clothing(arguments, console),
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
    if let Some(path) = &arguments.output {
        let text = serde_json::to_string_pretty(&results)? + "\n";
        write_atomically(path, text.as_bytes())
            .with_context(|| format!("{}: the numbers cannot be written", path.display()))?;
    }
    Ok(Outcome::Fine)
}

fn evaluate_clothing(arguments: &ClothingArguments, console: &Console) -> anyhow::Result<Outcome> {
    let config = arguments.settings.load()?.learn_clothing;
    let (names, layers) = read_layers(&arguments.layers)?;
    let parameters = arguments.parameters.as_deref().map(ParameterTable::read).transpose()?;
    let mut clock = StageClock::start();
    let begin = Instant::now();
    let mut observer = RunObserver { bar: StageBar::new(console), clock: &mut clock };
    let evaluation = ClothingEvaluation { names, layers, parameters: parameters.as_ref(), config: &config };
    let metrics = evaluation.run(&mut observer, &|| begin.elapsed().as_secs_f64())?;
    observer.bar.clear();
    std::fs::create_dir_all(&arguments.output)
        .with_context(|| format!("{}: the folder cannot be made", arguments.output.display()))?;
    let text = serde_json::to_string_pretty(&metrics)? + "\n";
    for (name, contents) in [("metrics.json", text), ("report.html", clothing_page(&metrics))] {
        let path = arguments.output.join(name);
        write_atomically(&path, contents.as_bytes())
            .with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    console.result(clothing_table(&metrics));
    Ok(Outcome::Fine)
}

/// The errors as a person reads them.
fn clothing_table(metrics: &ClothingMetrics) -> String {
    let mut lines =
        vec![format!("{} frames of {} sequences, errors in mm", metrics.frames, metrics.sequences.len())];
    let components: Vec<String> =
        metrics.pca_error_mm.iter().map(|(count, error)| format!("{count}: {error:.2}")).collect();
    lines.push(format!("components     {}", components.join("  ")));
    for (recipe, splits) in &metrics.regression {
        for (split, errors) in splits {
            let (train, prediction) = (errors.train_mm, errors.prediction_mm);
            lines.push(format!("{recipe:18} {split:14} train {train:6.2}  prediction {prediction:6.2}"));
        }
    }
    for (split, baselines) in &metrics.baselines {
        for (name, error) in baselines {
            lines.push(format!("{name:18} {split:14}               prediction {error:6.2}"));
        }
    }
    lines.join("\n")
}
