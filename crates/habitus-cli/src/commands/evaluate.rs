//! `habitus evaluate`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, Subcommand};
use habitus::artifacts::registered_scan::mesh_file;
use habitus::artifacts::write_atomically;
use habitus::evaluation::registration_accuracy::RegistrationAccuracy;
use habitus::evaluation::sequence_accuracy::SequenceAccuracy;
use habitus::geometry::io::read_mesh;
use habitus::pipeline::{MeasuredFit, RegisterSummary, StageName, measure_stored_fit, read_stored_fit};
use habitus_synthetic::truth::DressedTruth;
use serde::Serialize;

use crate::Outcome;
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
}

const REGISTRATIONS_EXAMPLES: &str = "\
Examples:
  habitus evaluate registrations run --truth lab
  habitus evaluate registrations run_default run_paper --truth lab -o accuracy.json";

/// Arguments for registrations.
#[derive(Debug, Args)]
#[command(after_help = REGISTRATIONS_EXAMPLES)]
pub struct RegistrationsArguments {
    /// Run folders
    #[arg(required = true)]
    pub runs: Vec<PathBuf>,
    /// Folder of the generated scans
    #[arg(long, value_name = "DIR")]
    pub truth: PathBuf,
    /// Write the numbers as JSON too
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
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
        Subject::Sequence(arguments) => compare_sequences(arguments, console),
        Subject::Registrations(arguments) => compare_registrations(arguments, console),
    }
}

/// A registration with its quality, as a table shows it.
fn registrations_table(run: &Path, summary: &RegisterSummary, accuracy: &RegistrationAccuracy) -> String {
    let unfolded = summary.scans.iter().filter_map(|scan| scan.quality.as_ref());
    let unfolded = unfolded.filter(|quality| quality.flipped_faces == 0).count();
    let [to_surface, held_out, to_scan] = summary.means_mm;
    let worst = accuracy.scans.iter().max_by(|a, b| a.vertex_mm.mean.total_cmp(&b.vertex_mm.mean));
    let rows = [
        ("scans registered", format!("{} of {}", accuracy.scans.len(), summary.scan_count)),
        ("vertex error, mean", format!("{:.2} mm", accuracy.vertex_mm.mean)),
        ("vertex error, p95", format!("{:.2} mm", accuracy.vertex_mm.p95)),
        (
            "worst scan, mean",
            worst.map_or_else(String::new, |scan| format!("{:.2} mm ({})", scan.vertex_mm.mean, scan.name)),
        ),
        ("held-out points to surface", format!("{held_out:.2} mm")),
        ("points to surface", format!("{to_surface:.2} mm")),
        ("surface to scan", format!("{to_scan:.2} mm")),
        ("no face folded", format!("{:.1} %", 100.0 * unfolded as f64 / accuracy.scans.len().max(1) as f64)),
        ("doubtful by code", summary.failed_scans.to_string()),
    ];
    let rows = rows.into_iter().map(|(name, value)| format!("  {name:28} {value}"));
    format!("{}\n{}", run.display(), rows.collect::<Vec<_>>().join("\n"))
}

fn compare_registrations(arguments: &RegistrationsArguments, console: &Console) -> anyhow::Result<Outcome> {
    let mut results: BTreeMap<String, RegistrationAccuracy> = BTreeMap::new();
    for run in &arguments.runs {
        let summary = RegisterSummary::read(&run.join("summary.json"))?;
        let folder = run.join(StageName::Register.folder());
        let mut accuracy = RegistrationAccuracy::default();
        for scan in summary.scans.iter().filter(|scan| scan.quality.is_some()) {
            let found = read_mesh(&mesh_file(&folder, &scan.name))?;
            let truth = read_mesh(&arguments.truth.join("truth").join(format!("{}.ply", scan.name)))?;
            accuracy.add(&scan.name, found.positions(), truth.positions())?;
        }
        let accuracy = accuracy.finished();
        console.result(registrations_table(run, &summary, &accuracy));
        results.insert(run.display().to_string(), accuracy);
    }
    write_numbers(arguments.output.as_deref(), &results)?;
    Ok(Outcome::Fine)
}

fn write_numbers(path: Option<&Path>, results: &impl Serialize) -> anyhow::Result<()> {
    let Some(path) = path else { return Ok(()) };
    let text = serde_json::to_string_pretty(results)? + "\n";
    write_atomically(path, text.as_bytes())
        .with_context(|| format!("{}: the numbers cannot be written", path.display()))
}

fn compare_sequences(arguments: &SequenceArguments, console: &Console) -> anyhow::Result<Outcome> {
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
