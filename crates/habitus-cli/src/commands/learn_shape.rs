//! `habitus learn-shape`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::bail;
use clap::{Args, ValueEnum};
use habitus::body::BodyModel;
use habitus::optimize::{Event, Flow, Observer};
use habitus::pipeline::{RegistrationFolder, SubjectGroup, learn_shape_to_file};
use habitus::stages::learn_shape::{LearntShape, PoseNormalization};

use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::StageBar;
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus learn-shape run/1_register -o mine.npz
  habitus learn-shape registrations -o mine.npz --components 50 --pose-normalization local-laplacian
  habitus learn-shape registrations -o women.npz --subjects female

DIR holds registered meshes (PLY) in the topology of the base model, or is a run folder of
habitus register. Registrations that decisions.toml rejects are left out. The result is a whole
body model that every other verb takes with --model.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct LearnShapeArguments {
    /// Folder of registrations, or run folder
    #[arg(value_name = "DIR")]
    pub registrations: PathBuf,
    /// Model file to write
    #[arg(long, short, value_name = "MODEL")]
    pub output: PathBuf,
    /// Components at most
    #[arg(long, value_name = "K")]
    pub components: Option<usize>,
    /// How differences of pose are taken out
    #[arg(long, value_enum)]
    pub pose_normalization: Option<PoseNormalizationName>,
    /// Body model whose topology and rig are carried over [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub base: Option<PathBuf>,
    /// Whose registrations; a sex needs a table subjects.csv with lines scan,sex in DIR
    #[arg(long, value_enum, default_value = "everyone")]
    pub subjects: SubjectName,
    /// Replace the model file
    #[arg(long)]
    pub force: bool,
    /// Settings of the stage
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Names of the pose normalizations.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PoseNormalizationName {
    /// Not at all
    None,
    /// Localized Laplacian coordinates on the mean body (WSX)
    LocalLaplacian,
    /// Skeleton and Laplacian coordinates (NH)
    SkeletonLaplacian,
    /// The base model's skinning is undone
    Unpose,
}

impl From<PoseNormalizationName> for PoseNormalization {
    fn from(name: PoseNormalizationName) -> Self {
        match name {
            PoseNormalizationName::None => Self::None,
            PoseNormalizationName::LocalLaplacian => Self::LocalLaplacian,
            PoseNormalizationName::SkeletonLaplacian => Self::SkeletonLaplacian,
            PoseNormalizationName::Unpose => Self::Unpose,
        }
    }
}

/// Names of the groups of subjects.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum SubjectName {
    /// All
    Everyone,
    /// Women
    Female,
    /// Men
    Male,
}

impl From<SubjectName> for SubjectGroup {
    fn from(name: SubjectName) -> Self {
        match name {
            SubjectName::Everyone => Self::Everyone,
            SubjectName::Female => Self::Female,
            SubjectName::Male => Self::Male,
        }
    }
}

/// Shows progress alone.
pub(super) struct BarObserver(pub StageBar);

impl Observer for BarObserver {
    fn on_event(&mut self, event: &Event) -> Flow {
        if let Event::Progress { stage, done, total } = event {
            self.0.show(stage, *done, *total);
        }
        Flow::Continue
    }
}

/// Learns a model.
pub fn run(arguments: &LearnShapeArguments, console: &Console) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let mut config = arguments.settings.load()?.learn_shape;
    config.space.components = arguments.components.unwrap_or(config.space.components);
    if let Some(name) = arguments.pose_normalization {
        config.pose_normalization = name.into();
    }
    if arguments.output.exists() && !arguments.force {
        bail!("{}: is there already; --force replaces it", arguments.output.display());
    }
    let base = load_model(arguments.base.as_deref())?;
    let (folder, mut outcome) =
        read_folder(&arguments.registrations, &base, arguments.subjects.into(), console)?;
    let mut observer = BarObserver(StageBar::new(console));
    let learnt = learn_shape_to_file(&folder, &base, &config, &arguments.output, &mut observer);
    observer.0.clear();
    let learnt = learnt?;
    tell(&learnt, folder.registrations.len(), start.elapsed().as_secs_f64(), console);
    console.result(arguments.output.display());
    if learnt.model.component_count() == 0 {
        outcome = Outcome::Doubtful;
    }
    Ok(outcome)
}

/// Reads registrations and names those that cannot be used.
pub(super) fn read_folder(
    path: &std::path::Path,
    base: &BodyModel,
    group: SubjectGroup,
    console: &Console,
) -> anyhow::Result<(RegistrationFolder, Outcome)> {
    let mut bar = StageBar::new(console);
    let folder = RegistrationFolder::read(path, base, group, |done, total| bar.show("read", done, total));
    bar.clear();
    let folder = folder?;
    for (name, reason) in &folder.unusable {
        console.warning(format!("{name}: left out, {reason}"));
    }
    if !folder.left_out.is_empty() {
        console.note(format!("{} registrations left out by decisions or sex", folder.left_out.len()));
    }
    let outcome = if folder.unusable.is_empty() { Outcome::Fine } else { Outcome::Doubtful };
    Ok((folder, outcome))
}

fn tell(learnt: &LearntShape, registrations: usize, seconds: f64, console: &Console) {
    let kept: f64 = learnt.space.standard_deviations().iter().map(|deviation| deviation * deviation).sum();
    console.note(format!(
        "{} components of {registrations} registrations carry {:.2} % of the variance; {seconds:.1} s",
        learnt.model.component_count(),
        100.0 * kept / learnt.space.total_variance().max(f64::MIN_POSITIVE),
    ));
}
