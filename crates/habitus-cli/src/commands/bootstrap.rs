//! `habitus bootstrap`: rounds of registering all scans and learning a space from the good registrations.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::bail;
use clap::Args;
use habitus::artifacts::template_mesh::read_landmark_vertices;
use habitus::pipeline::{Bootstrap, BootstrapInput, RoundSummary, RunFolder, list_scans};

use crate::Outcome;
use crate::clock::StageClock;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::{RunObserver, StageBar};
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus bootstrap scans/ -o run --rounds 5
  habitus bootstrap scans/ -o run --landmarks landmarks/ --model small.npz
  habitus bootstrap scans/ -o run --rounds 1, then habitus review run, then --rounds 2 and so on

Each round registers all scans with the space of the round before, ranks the registrations and
learns the next space from those that pass: those that a person accepted (see habitus review) and,
of the undecided, those with a small score. A killed run goes on where it stopped when the same
command is given again; what has not changed is not done again. The last space is
RUN/2_learn_shape/model.npz; each round keeps its own under RUN/rounds/.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct BootstrapArguments {
    /// Folders, files or patterns of raw scans
    #[arg(required = true, value_name = "SCAN")]
    pub scans: Vec<PathBuf>,
    /// Run folder for all results
    #[arg(long, short, value_name = "RUN")]
    pub output: PathBuf,
    /// Rounds in all [default: 5]
    #[arg(long, value_name = "N")]
    pub rounds: Option<usize>,
    /// Folder with a file of landmarks for each scan, or one file for one scan
    #[arg(long, value_name = "PATH")]
    pub landmarks: Option<PathBuf>,
    /// Body model that the first round starts from [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Table landmark,vertex of the template [default: the model's own landmarks]
    #[arg(long, value_name = "FILE")]
    pub template_landmarks: Option<PathBuf>,
    /// Registrations that nobody has decided about pass with a smaller score [default: 1]
    #[arg(long, value_name = "SCORE")]
    pub accept_below: Option<f64>,
    /// Settings of the stages
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Bootstraps a space.
pub fn run(arguments: &BootstrapArguments, console: &Console) -> anyhow::Result<Outcome> {
    let mut settings = arguments.settings.load()?;
    if let Some(rounds) = arguments.rounds {
        settings.bootstrap.rounds = rounds;
    }
    if let Some(accept_below) = arguments.accept_below {
        settings.bootstrap.accept_below = accept_below;
    }
    if settings.bootstrap.rounds == 0 {
        bail!("--rounds needs at least 1");
    }
    if settings.bootstrap.accept_below.is_nan() || settings.bootstrap.accept_below < 0.0 {
        bail!("--accept-below needs a score of 0 or more; 1 is where a registration stops being acceptable");
    }
    // Wrong inputs must not leave a run folder behind.
    let scans = list_scans(&arguments.scans, arguments.landmarks.as_deref())?;
    let model = load_model(arguments.model.as_deref())?;
    let read = |path: &PathBuf| read_landmark_vertices(path, model.vertex_count());
    let landmarks = arguments.template_landmarks.as_ref().map(read).transpose()?;
    let run = RunFolder::open(&arguments.output)?;
    let input = BootstrapInput {
        scans: &scans,
        model: &model,
        landmarks: landmarks.as_deref(),
        register: &settings.register,
        learn_shape: &settings.learn_shape,
        review: &settings.review,
        config: &settings.bootstrap,
    };
    let mut bootstrap = Bootstrap::new(&run, input)?;
    let begin = Instant::now();
    for round in 0..settings.bootstrap.rounds {
        let mut clock = StageClock::start();
        let mut observer = RunObserver { bar: StageBar::new(console), clock: &mut clock };
        let finished = bootstrap.next_round(&|| begin.elapsed().as_secs_f64(), &mut observer);
        observer.bar.clear();
        let summary = finished?;
        if round == 0 {
            console.note(HEADER);
        }
        console.note(row(summary));
    }
    let file = bootstrap.finish()?;
    let Some(last) = bootstrap.rounds().last() else { return Ok(Outcome::Fine) };
    for scan in last.failed.iter().take(NAMES_SHOWN) {
        console.warning(format!("{scan}: has no registration; see habitus register"));
    }
    if last.passed < last.scans {
        console.note(format!("see who did not pass: habitus review {}", arguments.output.display()));
    }
    console.result(file.display());
    Ok(if last.passed == last.scans { Outcome::Fine } else { Outcome::Doubtful })
}

/// Scans named one by one at most.
const NAMES_SHOWN: usize = 5;

const HEADER: &str =
    "round   passed  by a person  failed  mean mm  worst patch mm  median score  components  seconds";

/// A row of the table of P1 §4.5.
fn row(round: &RoundSummary) -> String {
    format!(
        "{:>5} {:>4}/{:<4} {:>11} {:>7} {:>8.2} {:>15.2} {:>13.2} {:>11} {:>8.1}",
        round.round,
        round.passed,
        round.scans,
        round.accepted_by_person,
        round.failed.len(),
        round.point_to_surface_mm,
        round.worst_patch_mm,
        round.median_score,
        round.components,
        round.seconds
    )
}
