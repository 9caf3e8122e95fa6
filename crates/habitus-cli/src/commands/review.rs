//! `habitus review`: accept and reject registrations, worst first, on a local page or without it.

mod pages;

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use habitus::artifacts::frames::FrameFolder;
use habitus::artifacts::review_decisions::{ReviewDecisions, Verdict};
use habitus::evaluation::registration_ranking::{RankedRegistration, RankingConfig};
use habitus::pipeline::{RegisteredRun, RunFolder, ScanPlaces, decide_by_score, registration_folder};

use crate::Outcome;
use crate::clock::StageClock;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::local_server::LocalServer;
use crate::progress::{RunObserver, StageBar};
use crate::sequence_job::load_model;
use pages::ReviewPages;

const EXAMPLES: &str = "\
Examples:
  habitus review run                       open the address that it prints in a browser
  habitus review run --list                print the ranking, worst first
  habitus review run --accept-below 1.0    decide by the score what nobody has decided
  habitus review run --port 8642

The page is served to this machine alone (127.0.0.1), and nothing but the run's registrations.
Decisions are in RUN/decisions.toml, written at each click, yours to edit, and read by bootstrap
and learn-shape. A score of 1 is where a registration stops being acceptable.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ReviewArguments {
    /// Run folder with registrations
    pub run: PathBuf,
    /// Where the scans are now [default: where they were]
    #[arg(long, value_name = "INPUT")]
    pub scans: Option<PathBuf>,
    /// Body model that the registrations started from [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Print the ranking and open no page
    #[arg(long)]
    pub list: bool,
    /// Accept undecided registrations with a smaller score, reject the others, and open no page
    #[arg(long, value_name = "SCORE")]
    pub accept_below: Option<f64>,
    /// Port of 127.0.0.1 for the page [default: a free one]
    #[arg(long, value_name = "PORT", default_value_t = 0, hide_default_value = true)]
    pub port: u16,
    /// Settings of the stage
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Reviews a run.
pub fn run(arguments: &ReviewArguments, console: &Console) -> anyhow::Result<Outcome> {
    if arguments.accept_below.is_some_and(|score| !score.is_finite() || score < 0.0) {
        bail!("--accept-below needs a score of 0 or more; 1 is where a registration stops being acceptable");
    }
    if !arguments.run.is_dir() {
        bail!("{}: there is no such run folder", arguments.run.display());
    }
    let config = arguments.settings.load()?.review;
    let model = load_model(arguments.model.as_deref())?;
    let folder = registration_folder(&arguments.run);
    let scans = scan_files(arguments)?;
    // Two reviews, or a review and a bootstrapping, would write over one another.
    let run = RunFolder::open(&arguments.run)?;
    let registered = RegisteredRun::open(&folder, &scans, &model)?;
    let ranking = ranked(&registered, &config, console)?;
    let decisions_file = run.path().join(ReviewDecisions::FILE);
    if let Some(accept_below) = arguments.accept_below {
        let mut decisions = ReviewDecisions::read(&decisions_file)?;
        let (accepted, rejected) = decide_by_score(&mut decisions, &ranking, &config, accept_below);
        decisions.write(&decisions_file)?;
        console.note(format!("{accepted} accepted and {rejected} rejected by their score"));
    }
    if arguments.list {
        tell_ranking(&ranking, &config, &ReviewDecisions::read(&decisions_file)?, console);
    }
    if !arguments.list && arguments.accept_below.is_none() {
        let server = LocalServer::bind(arguments.port)?;
        let pages = ReviewPages::new(run.path(), &registered, &ranking, &config)?;
        console.note("open this address in a browser; Ctrl-C or the button Finish ends:");
        console.result(server.address());
        server.serve(&|request| pages.answer(request))?;
    }
    tell_decisions(&ranking, &ReviewDecisions::read(&decisions_file)?, console);
    Ok(Outcome::Fine)
}

fn scan_files(arguments: &ReviewArguments) -> anyhow::Result<Vec<PathBuf>> {
    if let Some(input) = &arguments.scans {
        return Ok(FrameFolder::open(input)?.files().to_vec());
    }
    match ScanPlaces::read(&arguments.run) {
        Some(places) => Ok(places.scans),
        None => {
            bail!("{}: does not say where its scans are; name them with --scans", arguments.run.display())
        }
    }
}

fn ranked(
    registered: &RegisteredRun,
    config: &RankingConfig,
    console: &Console,
) -> anyhow::Result<Vec<RankedRegistration>> {
    let mut clock = StageClock::start();
    let mut observer = RunObserver { bar: StageBar::new(console), clock: &mut clock };
    let ranking = registered.rank(config, &mut observer);
    observer.bar.clear();
    Ok(ranking?)
}

fn verdict_on(ranked: &RankedRegistration, decisions: &ReviewDecisions) -> Option<Verdict> {
    decisions.of(&ranked.name).and_then(|decision| decision.verdict_on(&ranked.registration))
}

/// The ranking as a table that other programs can cut.
fn tell_ranking(
    ranking: &[RankedRegistration],
    config: &RankingConfig,
    decisions: &ReviewDecisions,
    console: &Console,
) {
    let number = |value: Option<f64>, decimals: usize| {
        value.map_or("-".to_string(), |value| format!("{value:.decimals$}"))
    };
    console.result("score\tpatch_mm\tflipped\tedges\tmahalanobis\tlandmark_mm\tmean_mm\tverdict\tscan");
    for ranked in ranking {
        let parts = &ranked.parts;
        let verdict = match verdict_on(ranked, decisions) {
            Some(Verdict::Accept) => "accept",
            Some(Verdict::Reject) => "reject",
            None => "-",
        };
        console.result(format!(
            "{:.2}\t{}\t{}\t{:.2}\t{}\t{}\t{:.2}\t{verdict}\t{}",
            parts.score(config),
            number(parts.worst_patch_mm, 1),
            parts.flipped_faces,
            parts.edge_factor,
            number(parts.mahalanobis, 2),
            number(parts.landmark_mm, 1),
            ranked.mean_mm,
            ranked.name
        ));
    }
}

fn tell_decisions(ranking: &[RankedRegistration], decisions: &ReviewDecisions, console: &Console) {
    let count = |verdict| ranking.iter().filter(|ranked| verdict_on(ranked, decisions) == verdict).count();
    console.note(format!(
        "{} scans: {} accepted, {} rejected, {} to decide",
        ranking.len(),
        count(Some(Verdict::Accept)),
        count(Some(Verdict::Reject)),
        count(None)
    ));
}
