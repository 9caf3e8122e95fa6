//! `habitus evaluate registrations`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;
use habitus::artifacts::registered_scan::mesh_file;
use habitus::evaluation::registration_accuracy::RegistrationAccuracy;
use habitus::geometry::io::read_mesh;
use habitus::pipeline::{RegisterSummary, StageName};

use crate::Outcome;
use crate::commands::evaluate::write_numbers;
use crate::console::Console;

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
        ("surface to true surface, mean", format!("{:.2} mm", accuracy.surface_mm.mean)),
        ("surface to true surface, p95", format!("{:.2} mm", accuracy.surface_mm.p95)),
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
    let rows = rows.into_iter().map(|(name, value)| format!("  {name:30} {value}"));
    format!("{}\n{}", run.display(), rows.collect::<Vec<_>>().join("\n"))
}

/// Compares registrations with the truth.
pub fn run(arguments: &RegistrationsArguments, console: &Console) -> anyhow::Result<Outcome> {
    let mut results: BTreeMap<String, RegistrationAccuracy> = BTreeMap::new();
    for run in &arguments.runs {
        let summary = RegisterSummary::read(&run.join("summary.json"))?;
        let folder = run.join(StageName::Register.folder());
        let mut accuracy = RegistrationAccuracy::default();
        for scan in summary.scans.iter().filter(|scan| scan.quality.is_some()) {
            let found = read_mesh(&mesh_file(&folder, &scan.name))?;
            let truth = read_mesh(&arguments.truth.join("truth").join(format!("{}.ply", scan.name)))?;
            accuracy.add(&scan.name, found.positions(), &truth)?;
        }
        let accuracy = accuracy.finished();
        console.result(registrations_table(run, &summary, &accuracy));
        results.insert(run.display().to_string(), accuracy);
    }
    write_numbers(arguments.output.as_deref(), &results)?;
    Ok(Outcome::Fine)
}
