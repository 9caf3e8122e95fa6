//! One fitted sequence from captures to report: the same path for `fit-sequence` and `demo`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use habitus::artifacts::codes::Code;
use habitus::artifacts::fitted_sequence::FittedSequence;
use habitus::artifacts::frames::{FrameFolder, FrameSource};
use habitus::artifacts::rigged_sequence::FrameRate;
use habitus::body::BodyModel;
use habitus::evaluation::sequence_accuracy::{SequenceAccuracy, SequenceTruth, sequence_accuracy};
use habitus::pipeline::{
    CaptureOrigin, MeasuredFit, RunFolder, SequenceInput, SequenceRun, Summary, measure_rest_body,
    read_user_landmarks,
};
use habitus::stages::fit_sequence::{FitSequenceConfig, UserLandmark};

use crate::Outcome;
use crate::clock::{StageClock, TimedFrames};
use crate::commands::report::write_run_report;
use crate::console::Console;
use crate::machine::peak_memory_mb;
use crate::progress::{RunObserver, StageBar};

/// Whether a run gets a page of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunReport {
    /// It does.
    Written,
    /// It does not: one of many runs that are reported together.
    None,
}

/// What is to be fitted, and how.
pub struct SequenceJob<'a> {
    /// The verb that asked.
    pub verb: &'static str,
    /// The run folder.
    pub run: &'a RunFolder,
    /// The captures.
    pub origin: CaptureOrigin,
    /// The body model.
    pub model: &'a BodyModel,
    /// Settings of the stage.
    pub config: &'a FitSequenceConfig,
    /// Table of landmarks.
    pub landmarks: Option<PathBuf>,
    /// What the fit is compared with.
    pub truth: Option<SequenceTruth>,
    /// Whether a page is written.
    pub report: RunReport,
    /// Whether finished work is done again.
    pub is_forced: bool,
}

/// The model of a file, or the default space.
pub fn load_model(path: Option<&Path>) -> anyhow::Result<BodyModel> {
    Ok(match path {
        Some(path) => BodyModel::load(path)?,
        None => BodyModel::default_space()?,
    })
}

/// A frame rate that can be one.
pub fn frame_rate(frames_per_second: f64) -> anyhow::Result<FrameRate> {
    FrameRate::new(frames_per_second)
        .with_context(|| format!("--frame-rate {frames_per_second}: must be positive and finite"))
}

/// Fits, writes all files of the run and says what is doubtful.
pub fn run(job: &SequenceJob<'_>, console: &Console) -> anyhow::Result<(Summary, Outcome)> {
    let mut clock = StageClock::start();
    let frames = job.origin.frames()?;
    let landmarks = user_landmarks(job, &frames)?;
    let source = TimedFrames::new(&frames);
    let input = SequenceInput {
        files: frames.files(),
        source: &source,
        model: job.model,
        config: job.config,
        landmarks: &landmarks,
        frame_rate: frame_rate(job.origin.frame_rate)?,
    };
    let reading = Instant::now();
    let stage = SequenceRun::prepare(job.run, job.verb, input)?;
    clock.add_io(reading.elapsed());
    let summary_file = job.run.path().join("summary.json");
    if job.is_forced {
        stage.start_afresh()?;
    } else if let (true, Ok(summary)) = (stage.is_finished(), Summary::read(&summary_file)) {
        let run = job.run.path().display();
        console
            .note(format!("{run}: already finished with these inputs and settings; --force does it again"));
        return Ok((summary.clone(), outcome(&summary)));
    }
    let finished_before = stage.finished_frames()?;
    if finished_before > 0 {
        console.note(format!("going on after {finished_before} frames that an earlier run has tracked"));
    }
    let mut result = fit(&stage, finished_before, &mut clock, console)?;
    for (frame, seconds) in result.fit.sequence.frames.iter_mut().zip(clock.frame_seconds()) {
        frame.seconds = *seconds;
    }
    let writing = Instant::now();
    stage.write(&result)?;
    job.origin.write(job.run.path())?;
    clock.add_io(source.reading_time() + writing.elapsed());
    let summary = summarise(job, &result, &mut clock)?;
    summary.write(&summary_file)?;
    tell_codes(&result.fit.sequence, &source, console);
    Ok((summary.clone(), outcome(&summary)))
}

fn user_landmarks(job: &SequenceJob<'_>, frames: &FrameFolder) -> anyhow::Result<Vec<UserLandmark>> {
    let Some(path) = &job.landmarks else { return Ok(Vec::new()) };
    let names: Vec<String> = (0..frames.len()).map(|frame| frames.name(frame)).collect();
    Ok(read_user_landmarks(path, &names)?)
}

fn fit(
    stage: &SequenceRun<'_>,
    finished_before: usize,
    clock: &mut StageClock,
    console: &Console,
) -> anyhow::Result<MeasuredFit> {
    clock.skip();
    clock.skip_frames(finished_before);
    let mut observer = RunObserver { bar: StageBar::new(console), clock };
    let result = stage.fit(&mut observer);
    observer.bar.clear();
    Ok(result?)
}

/// Summary and report; the time that the report takes counts in the total.
fn summarise(job: &SequenceJob<'_>, result: &MeasuredFit, clock: &mut StageClock) -> anyhow::Result<Summary> {
    let sequence = &result.fit.sequence;
    let mut summary =
        Summary::new(job.verb, sequence, &result.measurements, clock.seconds(), peak_memory_mb());
    summary.truth = job.truth.as_ref().map(|truth| accuracy(job.model, result, truth)).transpose()?;
    let writing = Instant::now();
    if job.report == RunReport::Written {
        write_run_report(job.run.path(), result, &summary, Some(&job.origin))?;
    }
    clock.add_io(writing.elapsed());
    let truth = summary.truth;
    let whole = Summary::new(job.verb, sequence, &result.measurements, clock.seconds(), peak_memory_mb());
    Ok(Summary { truth, ..whole })
}

/// Compares a fit with the truth.
pub fn accuracy(
    model: &BodyModel,
    result: &MeasuredFit,
    truth: &SequenceTruth,
) -> anyhow::Result<SequenceAccuracy> {
    let measured = measure_rest_body(model, &truth.rest_vertices)?;
    Ok(sequence_accuracy(&result.fit, truth, [&result.measurements, &measured])?)
}

fn outcome(summary: &Summary) -> Outcome {
    if summary.is_ok() { Outcome::Fine } else { Outcome::Doubtful }
}

/// Frames named one by one for each code at most.
const NAMES_SHOWN: usize = 5;

/// A short list of what fired: where, what it means and what to do. Codes that spoil nothing only count.
fn tell_codes(sequence: &FittedSequence, source: &TimedFrames<'_>, console: &Console) {
    for line in &sequence.input_frame.report {
        console.note(line);
    }
    for code in &sequence.codes {
        console.warning(format!("the sequence: {code}. {} What to do: {}.", code.meaning(), code.remedy()));
    }
    let mut frames_by_code: BTreeMap<Code, Vec<usize>> = BTreeMap::new();
    for (frame, fitted) in sequence.frames.iter().enumerate() {
        for code in &fitted.codes {
            frames_by_code.entry(*code).or_default().push(frame);
        }
    }
    for (code, frames) in frames_by_code {
        let mut names: Vec<&str> =
            frames.iter().take(NAMES_SHOWN).map(|frame| sequence.frames[*frame].name.as_str()).collect();
        if frames.len() > NAMES_SHOWN {
            names.push("…");
        }
        let count = frames.len();
        let text = format!("{code} in {count} of {} frames ({})", sequence.frames.len(), names.join(", "));
        if code.is_failure() {
            console.warning(format!("{text}. {} What to do: {}.", code.meaning(), code.remedy()));
        } else {
            console.note(format!("{text}: {}", code.remedy()));
        }
        if code == Code::UnreadableFrame {
            frames.iter().take(NAMES_SHOWN).filter_map(|frame| source.error(*frame)).for_each(|error| {
                console.warning(error);
            });
        }
    }
}

/// The errors as a small table.
pub fn accuracy_table(accuracy: &SequenceAccuracy) -> String {
    let mut rows = vec![
        ("posed body, mean", format!("{:6.1} mm", accuracy.posed_mean_mm)),
        ("rest body, mean", format!("{:6.1} mm", accuracy.rest_mean_mm)),
        ("rest body, within 10 mm", format!("{:6.1} %", accuracy.rest_under_10mm * 100.0)),
        ("joints, mean", format!("{:6.1} mm", accuracy.mpjpe_mm)),
        ("stature", format!("{:6.1} mm", accuracy.stature_error_mm)),
        ("girths, mean", format!("{:6.1} mm", accuracy.girth_mean_error_mm)),
    ];
    if let Some(ratio) = accuracy.jitter_ratio {
        rows.push(("jitter over the truth's", format!("{ratio:6.2}")));
    }
    let rows = rows.into_iter().map(|(name, value)| format!("  {name:24} {value}"));
    format!("errors against the truth\n{}", rows.collect::<Vec<_>>().join("\n"))
}
