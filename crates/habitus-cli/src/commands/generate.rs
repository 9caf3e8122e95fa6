//! `habitus generate`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::{Context, bail};
use clap::{Args, Subcommand, ValueEnum};
use habitus::body::BodyModel;
use habitus::evaluation::sequence_accuracy::SequenceTruth;
use habitus_synthetic::capture::CaptureMode;
use habitus_synthetic::garment::Outfit;
use habitus_synthetic::motion::Motion;
use habitus_synthetic::raw_scan::{subject_names, write_depth_pairs, write_raw_scans};
use habitus_synthetic::sequence::DressedSequenceSettings;
use habitus_synthetic::source_bodies::source_body_names;
use habitus_synthetic::truth::{DressedTruth, TRUTH_FILE, capture_file, write_sequence};

use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::StageBar;

const EXAMPLES: &str = "\
Examples:
  habitus generate -o dressed
  habitus generate -o dressed --outfit shirt-and-trousers --motion knee-pulls --subject 3
  habitus generate scans -o lab --count 200
  habitus generate depth-pairs -o lab --count 20

Without a kind it writes frame_0000.ply … and truth.npz: rest body, poses, joints and posed bodies in metres, y up.
The bodies are not instances of the body model that is fitted.";

const SCANS_EXAMPLES: &str = "\
Examples:
  habitus generate scans -o lab --count 200
  habitus generate scans -o lab --count 10 --points 100000 --seed 7

Writes scans/NAME.ply, landmarks/NAME.csv, truth/NAME.ply (the body in the template's topology, in
the scan's frame), truth/NAME_rest.ply, template.ply and template_landmarks.csv; metres, y up.
A scan depends on seed and name alone, so a larger count adds scans and changes none.";

const PAIRS_EXAMPLES: &str = "\
Examples:
  habitus generate depth-pairs -o lab --count 20

Writes pairs/NAME/front.png, back.png (16 bit, millimetres), intrinsics.json, the same as clouds
front.ply, back.ply (camera at the origin, y up, looking along -z, metres), landmarks, and truth:
NAME_front.ply, NAME_back.ply, NAME_rest.ply.";

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
    #[command(after_help = SCANS_EXAMPLES)]
    Scans(ScansArguments),
    /// Front and back depth images of standing people
    #[command(after_help = PAIRS_EXAMPLES)]
    DepthPairs(ScansArguments),
}

/// Arguments of raw scans and depth pairs.
#[derive(Debug, Args)]
pub struct ScansArguments {
    /// Folder for captures and truth
    #[arg(long, short, value_name = "DIR")]
    pub output: PathBuf,
    /// Number of people
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub count: usize,
    /// Start of all random numbers
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Points of a scan, about
    #[arg(long, value_name = "N")]
    pub points: Option<usize>,
    /// Settings of the captures
    #[command(flatten)]
    pub settings: SettingsArguments,
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

/// Makes a sequence.
pub fn run(arguments: &GenerateArguments, console: &Console) -> anyhow::Result<Outcome> {
    let model = BodyModel::default_space()?;
    match &arguments.kind {
        Some(GenerateKind::Scans(scans)) => return make_scans(&model, scans, Kind::Scans, console),
        Some(GenerateKind::DepthPairs(pairs)) => return make_scans(&model, pairs, Kind::DepthPairs, console),
        None => {}
    }
    let settings = settings(arguments)?;
    let folder = arguments.output.as_ref().context("--output DIR is needed")?;
    let truth = make_sequence(&model, &settings, folder, arguments.force, console)?;
    console.note(format!("{} frames with truth", truth.posed_vertices.len()));
    console.result(folder.display());
    Ok(Outcome::Fine)
}

/// What [`make_scans`] makes.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Scans,
    DepthPairs,
}

fn make_scans(
    model: &BodyModel,
    arguments: &ScansArguments,
    kind: Kind,
    console: &Console,
) -> anyhow::Result<Outcome> {
    let settings = arguments.settings.load()?;
    let mut scans = settings.generate_scans;
    scans.seed = arguments.seed.unwrap_or(scans.seed);
    scans.point_count = arguments.points.unwrap_or(scans.point_count);
    let names = subject_names(arguments.count);
    let bar = Mutex::new((StageBar::new(console), 0));
    let progress = || {
        if let Ok(mut bar) = bar.lock() {
            bar.1 += 1;
            let done = bar.1;
            bar.0.show("make", done, names.len());
        }
    };
    let folder = &arguments.output;
    let made = match kind {
        Kind::Scans => write_raw_scans(model, &scans, &names, folder, &progress),
        Kind::DepthPairs => {
            write_depth_pairs(model, &scans, &settings.generate_depth_pairs, &names, folder, &progress)
        }
    };
    if let Ok(bar) = bar.lock() {
        bar.0.clear();
    }
    made?;
    console.note(format!("{} people with truth", names.len()));
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
    if let Some(capture) = arguments.capture {
        settings.capture.mode = match capture {
            CaptureName::Scanner => CaptureMode::Scanner,
            CaptureName::VisualHull => CaptureMode::VisualHull,
        };
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
    }
}

/// The truth of those frames that a fit has, by the names of their captures.
pub fn truth_of_frames<'a>(
    truth: &SequenceTruth,
    names: impl IntoIterator<Item = &'a str>,
) -> anyhow::Result<SequenceTruth> {
    let number_of: BTreeMap<String, usize> =
        (0..truth.joints.len()).map(|frame| (capture_file(frame), frame)).collect();
    let mut chosen = SequenceTruth { posed_vertices: Vec::new(), joints: Vec::new(), ..truth.clone() };
    for name in names {
        let frame = number_of.get(name).with_context(|| {
            format!("frame {name} is none of the {} that the truth knows", number_of.len())
        })?;
        chosen.posed_vertices.push(truth.posed_vertices[*frame].clone());
        chosen.joints.push(truth.joints[*frame].clone());
    }
    Ok(chosen)
}
