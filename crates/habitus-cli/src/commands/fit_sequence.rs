//! `habitus fit-sequence`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use habitus::pipeline::{CaptureOrigin, RunFolder, Summary};
use habitus::stages::fit_sequence::config::{Recipe, StartMethod, UnitChoice, UpChoice};

use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::sequence_job::{self, RunReport, SequenceJob, load_model};

const EXAMPLES: &str = "\
Examples:
  habitus fit-sequence captures/ -o run
  habitus fit-sequence 'scan_%04d.obj' -o run --unit mm --up z
  habitus fit-sequence captures/ -o run --first 10 --last 99 --step 3
  habitus fit-sequence captures/ -o run --landmarks marks.csv --set fit_sequence.components=40

INPUT is a folder, one file, or a pattern such as scan_%04d.ply. PLY, OBJ, STL, OFF and GLB are
read, and each frame may have its own connectivity. Results are in the input's own frame and unit.
A killed run goes on where it stopped when the same command is given again.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct FitSequenceArguments {
    /// Folder, file or pattern of captures
    pub input: PathBuf,
    /// Run folder for all results
    #[arg(long, short, value_name = "RUN")]
    pub output: PathBuf,
    /// Body model [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// How to fit
    #[arg(long, value_enum)]
    pub recipe: Option<RecipeName>,
    /// What finds the first pose [default: search]
    #[arg(long, value_enum)]
    pub start: Option<StartName>,
    /// Table frame,landmark,x,y,z of landmarks that you know, in the input's own coordinates
    #[arg(long, value_name = "FILE")]
    pub landmarks: Option<PathBuf>,
    /// Unit of the input
    #[arg(long, value_enum)]
    pub unit: Option<UnitName>,
    /// Axis of the input that points up
    #[arg(long, value_enum)]
    pub up: Option<UpName>,
    /// First frame, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub first: usize,
    /// Last frame
    #[arg(long, value_name = "N")]
    pub last: Option<usize>,
    /// Take every N-th frame only
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub step: u32,
    /// Captured frames per second, for animation and report
    #[arg(long, value_name = "FPS", default_value_t = 30.0)]
    pub frame_rate: f64,
    /// Do finished work again
    #[arg(long)]
    pub force: bool,
    /// Settings of the stage
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Names of the recipes.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RecipeName {
    /// Robust tracking and joint refinement
    Default,
    /// The published method of 2016 as printed
    Paper2016,
}

impl RecipeName {
    /// The library's word.
    pub fn recipe(self) -> Recipe {
        match self {
            Self::Default => Recipe::Default,
            Self::Paper2016 => Recipe::Paper2016,
        }
    }
}

/// Names of the starts.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum StartName {
    /// Poses in all headings, fitted and halved
    Search,
    /// The part-based puppet (experimental)
    Puppet,
    /// The landmarks of --landmarks on the first frame, four at least
    Landmarks,
}

impl StartName {
    /// The library's word.
    pub fn method(self) -> StartMethod {
        match self {
            Self::Search => StartMethod::Search,
            Self::Puppet => StartMethod::Puppet,
            Self::Landmarks => StartMethod::Landmarks,
        }
    }
}

/// Names of the units.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum UnitName {
    /// Guess from the stature
    Auto,
    /// Metres
    M,
    /// Centimetres
    Cm,
    /// Millimetres
    Mm,
}

impl UnitName {
    /// The library's word.
    pub fn choice(self) -> UnitChoice {
        match self {
            Self::Auto => UnitChoice::Auto,
            Self::M => UnitChoice::M,
            Self::Cm => UnitChoice::Cm,
            Self::Mm => UnitChoice::Mm,
        }
    }
}

/// Names of the axes.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum UpName {
    /// Decide from the capture
    Auto,
    /// x
    X,
    /// y
    Y,
    /// z
    Z,
}

impl UpName {
    /// The library's word.
    pub fn choice(self) -> UpChoice {
        match self {
            Self::Auto => UpChoice::Auto,
            Self::X => UpChoice::X,
            Self::Y => UpChoice::Y,
            Self::Z => UpChoice::Z,
        }
    }
}

/// Fits a sequence.
pub fn run(arguments: &FitSequenceArguments, console: &Console) -> anyhow::Result<Outcome> {
    let mut config = arguments.settings.load()?.fit_sequence;
    if let Some(recipe) = arguments.recipe {
        config.recipe = recipe.recipe();
    }
    if let Some(start) = arguments.start {
        config.start.method = start.method();
    }
    if let Some(unit) = arguments.unit {
        config.unit = unit.choice();
    }
    if let Some(up) = arguments.up {
        config.up = up.choice();
    }
    let origin = CaptureOrigin {
        input: arguments.input.clone(),
        first: arguments.first,
        last: arguments.last,
        step: arguments.step as usize,
        frame_rate: arguments.frame_rate,
    };
    // Wrong inputs must not leave a run folder behind.
    origin.frames()?;
    sequence_job::frame_rate(arguments.frame_rate)?;
    let model = load_model(arguments.model.as_deref())?;
    let run = RunFolder::open(&arguments.output)?;
    let job = SequenceJob {
        verb: "fit-sequence",
        run: &run,
        origin,
        model: &model,
        config: &config,
        landmarks: arguments.landmarks.clone(),
        truth: None,
        report: RunReport::Written,
        is_forced: arguments.force,
    };
    let (summary, outcome) = sequence_job::run(&job, console)?;
    tell_summary(&summary, &run, console);
    Ok(outcome)
}

/// The few numbers that one wants at the end, and where the rest is.
pub fn tell_summary(summary: &Summary, run: &RunFolder, console: &Console) {
    let seconds = summary.seconds;
    console.note(format!(
        "{} frames in {:.1} s ({:.1} a second), {} failed; body {:.1} % outside the capture by more than 5 mm",
        summary.frames,
        seconds.total,
        summary.frames_per_second,
        summary.failed_frames,
        summary.outside_share_5mm * 100.0
    ));
    console.result(run.path().join("report.html").display());
}
