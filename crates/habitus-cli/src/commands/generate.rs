//! `habitus generate`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::{Args, Subcommand, ValueEnum};
use habitus::body::BodyModel;
use habitus::evaluation::sequence_accuracy::SequenceTruth;
use habitus_synthetic::capture::CaptureMode;
use habitus_synthetic::garment::Outfit;
use habitus_synthetic::motion::Motion;
use habitus_synthetic::sequence::DressedSequenceSettings;
use habitus_synthetic::source_bodies::source_body_names;
use habitus_synthetic::truth::{DressedTruth, TRUTH_FILE, capture_file, write_sequence};

use crate::Outcome;
use crate::commands::{generate_scans, generate_sets};
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::StageBar;

const EXAMPLES: &str = "\
Examples:
  habitus generate -o dressed
  habitus generate -o dressed --outfit shirt-and-trousers --motion knee-pulls --subject 3
  habitus generate -o dressed --motion-file walk.bvh --fabric silk-satin
  habitus generate scans -o lab --count 200
  habitus generate depth-pairs -o lab --count 20
  habitus generate clothing-data fabrics -o fabrics
  habitus generate benchmark --preset small -o benchmark

Without a kind it writes frame_0000.ply … and truth.npz: rest body, poses, joints and posed bodies in metres, y up.
The bodies are not instances of the body model that is fitted.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct GenerateArguments {
    /// Another kind of captures than a dressed sequence
    #[command(subcommand)]
    pub kind: Option<GenerateKind>,
    /// Folder for captures and truth
    #[arg(long, short, value_name = "DIR", required = true)]
    pub output: Option<PathBuf>,
    /// Start of all random numbers
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Number of frames
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// What the person wears
    #[arg(long, value_enum)]
    pub outfit: Option<OutfitName>,
    /// What the person does
    #[arg(long, value_enum)]
    pub motion: Option<MotionName>,
    /// Motion capture file that the person follows instead: .bvh, .amc with its .asf, or an AMASS .npz
    #[arg(long, value_name = "FILE", conflicts_with = "motion")]
    pub motion_file: Option<PathBuf>,
    /// Fabric of the clothes: a name such as denim, or a .json file of the 39-number form
    #[arg(long, value_name = "FABRIC")]
    pub fabric: Option<String>,
    /// Which person: a number from 0, or a name
    #[arg(long, value_name = "SUBJECT")]
    pub subject: Option<String>,
    /// How the person is captured
    #[arg(long, value_enum)]
    pub capture: Option<CaptureName>,
    /// Replace an earlier sequence in the folder
    #[arg(long)]
    pub force: bool,
    /// Settings of the sequence
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Other kinds of captures.
#[derive(Debug, Subcommand)]
pub enum GenerateKind {
    /// Raw scans of standing people with known correspondence
    #[command(after_help = generate_scans::SCANS_EXAMPLES)]
    Scans(generate_scans::ScansArguments),
    /// Front and back depth images of standing people
    #[command(after_help = generate_scans::PAIRS_EXAMPLES)]
    DepthPairs(generate_scans::ScansArguments),
    /// Sequences with truth for clothing models
    #[command(after_help = generate_sets::CLOTHING_EXAMPLES)]
    ClothingData(generate_sets::ClothingDataArguments),
    /// Subjects × motions × styles with truth, for fits under clothing
    #[command(after_help = generate_sets::BENCHMARK_EXAMPLES)]
    Benchmark(generate_sets::BenchmarkArguments),
}

/// Names of the outfits.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum OutfitName {
    /// A wide dress
    Dress,
    /// A loose shirt over wide trousers
    ShirtAndTrousers,
    /// A suit like a second skin
    Tight,
    /// Shorts and a T-shirt
    ShortsAndTShirt,
    /// Wide trousers under a T-shirt
    TShirtAndTrousers,
}

/// Names of the motions.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum MotionName {
    /// Straight ahead
    Walk,
    /// Along a circle
    WalkAndTurn,
    /// On the spot
    TurnOnSpot,
    /// One knee after the other
    KneePulls,
}

/// Names of the captures.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum CaptureName {
    /// Depth from all sides
    Scanner,
    /// Silhouettes from all sides
    VisualHull,
}

impl CaptureName {
    /// The library's word.
    pub fn mode(self) -> CaptureMode {
        match self {
            Self::Scanner => CaptureMode::Scanner,
            Self::VisualHull => CaptureMode::VisualHull,
        }
    }
}

/// Makes a sequence.
pub fn run(arguments: &GenerateArguments, console: &Console) -> anyhow::Result<Outcome> {
    match &arguments.kind {
        Some(GenerateKind::Scans(scans)) => {
            return generate_scans::run(scans, generate_scans::Kind::Scans, console);
        }
        Some(GenerateKind::DepthPairs(pairs)) => {
            return generate_scans::run(pairs, generate_scans::Kind::DepthPairs, console);
        }
        Some(GenerateKind::ClothingData(data)) => return generate_sets::run_clothing_data(data, console),
        Some(GenerateKind::Benchmark(benchmark)) => return generate_sets::run_benchmark(benchmark, console),
        None => {}
    }
    let settings = settings(arguments)?;
    let model = BodyModel::default_space()?;
    let folder = arguments.output.as_ref().context("--output DIR is needed")?;
    let truth = make_sequence(&model, &settings, folder, arguments.force, console)?;
    console.note(format!("{} frames with truth", truth.posed_vertices.len()));
    console.result(folder.display());
    Ok(Outcome::Fine)
}

fn settings(arguments: &GenerateArguments) -> anyhow::Result<DressedSequenceSettings> {
    let mut settings = arguments.settings.load()?.generate;
    settings.seed = arguments.seed.unwrap_or(settings.seed);
    settings.frame_count = arguments.frames.unwrap_or(settings.frame_count);
    if let Some(outfit) = arguments.outfit {
        settings.outfit = match outfit {
            OutfitName::Dress => Outfit::Dress,
            OutfitName::ShirtAndTrousers => Outfit::ShirtAndTrousers,
            OutfitName::Tight => Outfit::Tight,
            OutfitName::ShortsAndTShirt => Outfit::ShortsAndTShirt,
            OutfitName::TShirtAndTrousers => Outfit::TShirtAndTrousers,
        };
    }
    if let Some(motion) = arguments.motion {
        settings.motion = match motion {
            MotionName::Walk => Motion::Walk,
            MotionName::WalkAndTurn => Motion::WalkAndTurn,
            MotionName::TurnOnSpot => Motion::TurnOnSpot,
            MotionName::KneePulls => Motion::KneePulls,
        };
    }
    if arguments.motion_file.is_some() {
        settings.motion_file.clone_from(&arguments.motion_file);
    }
    if arguments.fabric.is_some() {
        settings.fabric.clone_from(&arguments.fabric);
    }
    if let Some(capture) = arguments.capture {
        settings.capture.mode = capture.mode();
    }
    if let Some(subject) = &arguments.subject {
        let names = source_body_names()?;
        let number = subject.parse().ok().filter(|number| *number < names.len());
        settings.source_body =
            number.or_else(|| names.iter().position(|name| name == subject)).with_context(|| {
                format!("--subject {subject}: there are 0 to {}: {}", names.len() - 1, names.join(", "))
            })?;
    }
    Ok(settings)
}

/// Makes a sequence in a folder, unless it is there already.
pub fn make_sequence(
    model: &BodyModel,
    settings: &DressedSequenceSettings,
    folder: &Path,
    is_forced: bool,
    console: &Console,
) -> anyhow::Result<SequenceTruth> {
    if folder.join(TRUTH_FILE).is_file() {
        let found = DressedTruth::read(folder);
        if let (Ok(found), false) = (&found, is_forced)
            && found.settings == *settings
        {
            console.note(format!("{}: already made with these settings", folder.display()));
            return Ok(sequence_truth(model, found));
        }
    }
    make_room(folder)?;
    let mut bar = StageBar::new(console);
    let made = write_sequence(model, settings, folder, &mut |done, total| bar.show("make", done, total));
    bar.clear();
    Ok(sequence_truth(model, &made?))
}

/// Removes an earlier sequence, finished or not, and refuses a folder with anything else in it.
fn make_room(folder: &Path) -> anyhow::Result<()> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(()) };
    let mut old = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| format!("{}: cannot be listed", folder.display()))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let is_capture = name.strip_prefix("frame_").is_some_and(|rest| {
            let digits = rest.split('.').next().unwrap_or_default();
            digits.len() >= 4 && digits.bytes().all(|byte| byte.is_ascii_digit())
        });
        if !(is_capture || name.starts_with(TRUTH_FILE)) {
            bail!(
                "{}: holds {name}, which is no part of a generated sequence; name an empty folder",
                folder.display()
            );
        }
        old.push(path);
    }
    for path in old {
        std::fs::remove_file(&path).with_context(|| format!("{}: cannot be removed", path.display()))?;
    }
    Ok(())
}

/// What a fit is compared with.
pub fn sequence_truth(model: &BodyModel, truth: &DressedTruth) -> SequenceTruth {
    SequenceTruth {
        rest_vertices: truth.rest_vertices.clone(),
        rest_joints: model.joints(&truth.rest_vertices),
        posed_vertices: truth.posed_vertices.clone(),
        joints: truth.joints.clone(),
        landmarks: truth.landmarks.clone(),
    }
}

/// The truth of those frames that a fit has, by the names of their captures.
pub fn truth_of_frames<'a>(
    truth: &SequenceTruth,
    names: impl IntoIterator<Item = &'a str>,
) -> anyhow::Result<SequenceTruth> {
    let number_of: BTreeMap<String, usize> =
        (0..truth.joints.len()).map(|frame| (capture_file(frame), frame)).collect();
    let mut chosen = SequenceTruth {
        rest_vertices: truth.rest_vertices.clone(),
        rest_joints: truth.rest_joints.clone(),
        ..SequenceTruth::default()
    };
    for name in names {
        let frame = number_of.get(name).with_context(|| {
            format!("frame {name} is none of the {} that the truth knows", number_of.len())
        })?;
        chosen.posed_vertices.push(truth.posed_vertices[*frame].clone());
        chosen.joints.push(truth.joints[*frame].clone());
        chosen.landmarks.extend(truth.landmarks.get(*frame).cloned());
    }
    Ok(chosen)
}
