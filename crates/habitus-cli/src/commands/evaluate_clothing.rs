//! `habitus evaluate clothing`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use habitus::artifacts::clothing_controls::ParameterTable;
use habitus::artifacts::write_atomically;
use habitus::evaluation::clothing_metrics::{ClothingMetrics, Course};
use habitus::pipeline::{ClothingEvaluation, EvaluatedClothing, read_layers};
use habitus_report::clothing::clothing_page;

use crate::Outcome;
use crate::clock::StageClock;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::{RunObserver, StageBar};

const CLOTHING_EXAMPLES: &str = "\
Examples:
  habitus evaluate clothing run -o clothing
  habitus evaluate clothing fabrics/* --parameters fabrics/parameters.csv -o clothing

Writes metrics.json and report.html. With several sequences each in turn is not learnt from: with
fabric_00 … in the parameters that leaves one material out, with ratios of garment to body one size.
Where the poses are exact (generate clothing-data), keep them:
--set learn_clothing.settle.rounds=0";

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

/// Measures how well clothes are learnt.
pub fn run(arguments: &ClothingArguments, console: &Console) -> anyhow::Result<Outcome> {
    let config = arguments.settings.load()?.learn_clothing;
    let (names, layers) = read_layers(&arguments.layers)?;
    let parameters = arguments.parameters.as_deref().map(ParameterTable::read).transpose()?;
    let mut clock = StageClock::start();
    let begin = Instant::now();
    let mut observer = RunObserver { bar: StageBar::new(console), clock: &mut clock };
    let evaluation = ClothingEvaluation { names, layers, parameters: parameters.as_ref(), config: &config };
    let EvaluatedClothing { metrics, maps } =
        evaluation.run(&mut observer, &|| begin.elapsed().as_secs_f64())?;
    observer.bar.clear();
    std::fs::create_dir_all(&arguments.output)
        .with_context(|| format!("{}: the folder cannot be made", arguments.output.display()))?;
    let text = serde_json::to_string_pretty(&metrics)? + "\n";
    let page = clothing_page(&metrics, &maps)?;
    for (name, contents) in [("metrics.json", text), ("report.html", page)] {
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
    for (name, found) in &metrics.left_out {
        let errors: Vec<String> =
            found.iter().map(|(method, error)| format!("{method}: {error:.2}")).collect();
        lines.push(format!("left out {name:16} {}", errors.join("  ")));
    }
    for (control, response) in &metrics.hem_response {
        let changes = [("border of", response.length_change()), ("height of", response.height_change())];
        for (what, change) in changes {
            let Some(change) = change else { continue };
            let (border, millimetres, course) = (change.border, change.change_mm, course_text(change.course));
            lines.push(format!("{control:18} {what} {border}: {millimetres:+.0} mm, {course}"));
        }
    }
    lines.join("\n")
}

fn course_text(course: Course) -> &'static str {
    match course {
        Course::Grows => "grows all the way",
        Course::Falls => "falls all the way",
        Course::Turns => "grows and falls",
    }
}
