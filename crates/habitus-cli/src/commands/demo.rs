//! `habitus demo`.

use std::path::PathBuf;

use clap::Args;
use habitus::body::BodyModel;
use habitus::pipeline::{CaptureOrigin, RunFolder, StageName};
use habitus_synthetic::sequence::DressedSequenceSettings;

use crate::Outcome;
use crate::commands::fit_sequence::tell_summary;
use crate::commands::generate::make_sequence;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::sequence_job::{self, RunReport, SequenceJob};

const EXAMPLES: &str = "\
Examples:
  habitus demo
  habitus demo -o trial --set generate.outfit=shirt_and_trousers";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct DemoArguments {
    /// Run folder for all results
    #[arg(long, short, value_name = "RUN", default_value = "habitus-demo")]
    pub output: PathBuf,
    /// Do finished work again
    #[arg(long)]
    pub force: bool,
    /// Settings of the sequence and of the fit
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Makes, fits and compares.
pub fn run(arguments: &DemoArguments, console: &Console) -> anyhow::Result<Outcome> {
    let settings = arguments.settings.load()?;
    let model = BodyModel::default_space()?;
    let run = RunFolder::open(&arguments.output)?;
    let scans = run.stage(StageName::Scans)?;
    let truth = make_sequence(&model, &settings.generate, scans.path(), arguments.force, console)?;
    let job = SequenceJob {
        verb: "demo",
        run: &run,
        origin: origin(&scans, &settings.generate),
        model: &model,
        config: &settings.fit_sequence,
        landmarks: None,
        truth: Some(truth),
        report: RunReport::Written,
        is_forced: arguments.force,
    };
    let (summary, outcome) = sequence_job::run(&job, console)?;
    if let Some(truth) = summary.truth {
        console.note(sequence_job::accuracy_table(&truth));
    }
    tell_summary(&summary, &run, console);
    Ok(outcome)
}

fn origin(scans: &habitus::pipeline::StageFolder, settings: &DressedSequenceSettings) -> CaptureOrigin {
    CaptureOrigin {
        input: scans.path().to_path_buf(),
        first: 0,
        last: None,
        step: 1,
        frame_rate: settings.frames_per_second,
    }
}
