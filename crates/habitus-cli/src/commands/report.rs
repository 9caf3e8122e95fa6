//! `habitus report`.

use std::path::{Path, PathBuf};

use clap::Args;
use habitus::artifacts::frames::{FrameSource, FramesInMemory};
use habitus::pipeline::{
    CaptureOrigin, MeasuredFit, RunFolder, StageName, Summary, file_names, measure_stored_fit,
    read_stored_fit,
};
use habitus_report::report::{ReportOptions, Timing, write_report};
use habitus_report::run::{FinishedRun, report_of_run};

use crate::Outcome;
use crate::console::Console;
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus report run
  habitus report run --captures moved/captures/";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ReportArguments {
    /// Run folder
    pub run: PathBuf,
    /// Where the captures are now [default: where they were]
    #[arg(long, value_name = "INPUT")]
    pub captures: Option<PathBuf>,
    /// Body model that the run was fitted with [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
}

/// Writes the report again.
pub fn run(arguments: &ReportArguments, console: &Console) -> anyhow::Result<Outcome> {
    let fit = read_stored_fit(&arguments.run)?;
    let run = RunFolder::open(&arguments.run)?;
    let model = load_model(arguments.model.as_deref())?;
    let measurements = measure_stored_fit(&model, &fit)?;
    let summary = Summary::read(&run.path().join("summary.json"))?;
    let mut origin = CaptureOrigin::read(run.path());
    if let Some(captures) = &arguments.captures {
        let input = captures.clone();
        origin = Some(match origin {
            Some(origin) => CaptureOrigin { input, ..origin },
            None => CaptureOrigin { input, first: 0, last: None, step: 1, frame_rate: 30.0 },
        });
    }
    if origin.as_ref().is_none_or(|origin| origin.frames().is_err()) {
        console.warning("the captures are not where they were, so the report shows the body alone; name them with --captures");
    }
    let result = MeasuredFit { fit, measurements };
    write_run_report(run.path(), &result, &summary, origin.as_ref())?;
    console.result(run.path().join("report.html").display());
    Ok(Outcome::Fine)
}

/// Writes `report.html` of a run.
pub fn write_run_report(
    run: &Path,
    result: &MeasuredFit,
    summary: &Summary,
    origin: Option<&CaptureOrigin>,
) -> anyhow::Result<()> {
    let frame_count = result.fit.sequence.frames.len();
    let none = FramesInMemory { surfaces: Vec::new() };
    let captures =
        origin.and_then(|origin| origin.frames().ok()).filter(|frames| frames.len() == frame_count);
    let stage = run.join(StageName::FitSequence.folder());
    let seconds = summary.seconds;
    let timings = [
        ("Start", seconds.start),
        ("Track", seconds.track),
        ("Refine", seconds.refine),
        ("Read and write", seconds.io),
    ];
    let name = std::path::absolute(run).unwrap_or_else(|_| run.to_path_buf());
    let contents = FinishedRun {
        title: name.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        subtitle: format!("habitus {}: the body under the clothes of {frame_count} frames", summary.verb),
        version: summary.version.clone(),
        fit: &result.fit,
        captures: captures.as_ref().map_or(&none as &dyn FrameSource, |frames| frames),
        measurements: &result.measurements,
        timings: timings.map(|(stage, seconds)| Timing { stage: stage.into(), seconds }).to_vec(),
        provenance: std::fs::read_to_string(stage.join(file_names::PROVENANCE)).unwrap_or_default(),
        accuracy: summary.truth.as_ref(),
        frames_per_second: origin.map_or(30.0, |origin| origin.frame_rate),
    };
    let options = ReportOptions::default();
    let data = report_of_run(&contents, &options);
    Ok(write_report(&run.join("report.html"), &data, &options)?)
}
