//! `habitus evaluate reconstructions`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, bail};
use clap::Args;
use habitus::artifacts::write_atomically;
use habitus::body::BodyModel;
use habitus::evaluation::reconstruction_accuracy::ReconstructionAccuracy;
use habitus::geometry::io::read_mesh;
use habitus::pipeline::{KnownPair, SubjectGroup, by_components, by_training_samples};
use habitus::stages::reconstruct::{ReconstructConfig, Side};
use habitus_report::shape_space::{Figure, HeatMap, LineChart, Series, Table, figures_page, heat_map_figure};
use serde::Serialize;

use super::learn_shape::{BarObserver, read_folder};
use super::reconstruct::read_view;
use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::StageBar;
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus evaluate reconstructions lab -o accuracy
  habitus evaluate reconstructions lab -o accuracy --registrations run --count 8 \\
      --set 'evaluate_reconstructions.training_samples=[10, 30, 100]'

LAB is a folder of: habitus generate depth-pairs. Registrations should be of other people: give
the pairs another --seed than their scans. Writes metrics.json, figures as SVG, and
reconstructions.html with all of them.";

/// Arguments for reconstructions.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ReconstructionsArguments {
    /// Folder of generated depth pairs with their truth
    pub lab: PathBuf,
    /// Folder for numbers, figures and page
    #[arg(long, short, value_name = "OUT")]
    pub output: PathBuf,
    /// Body model whose space is cut [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Folder of registrations, or run folder: spaces of more and more of them are compared, too
    #[arg(long, value_name = "DIR")]
    pub registrations: Option<PathBuf>,
    /// People at most [default: all]
    #[arg(long, value_name = "N")]
    pub count: Option<usize>,
    /// Take the clouds beside the depth images
    #[arg(long)]
    pub clouds: bool,
    /// Settings of the stage and of the measures
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// The contents of `metrics.json`. The names of its keys are a contract.
#[derive(Serialize)]
struct Metrics {
    model: String,
    people: usize,
    by_components: Vec<ReconstructionAccuracy>,
    by_training_samples: Vec<ReconstructionAccuracy>,
}

/// Reconstructs all pairs with all spaces.
pub fn run(arguments: &ReconstructionsArguments, console: &Console) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let settings = arguments.settings.load()?;
    let model = load_model(arguments.model.as_deref())?;
    let pairs = read_pairs(arguments, &settings.reconstruct)?;
    let measures = &settings.evaluate_reconstructions;
    let mut observer = BarObserver(StageBar::new(console));
    let cut = by_components(&pairs, &model, &settings.reconstruct, measures, &mut observer);
    observer.0.clear();
    let by_components = cut?;
    let mut outcome = Outcome::Fine;
    let mut by_samples = Vec::new();
    if let Some(path) = &arguments.registrations {
        let (folder, read) = read_folder(path, &model, SubjectGroup::Everyone, console)?;
        outcome = read;
        let learn = &settings.learn_shape;
        let config = &settings.reconstruct;
        let found = by_training_samples(
            &pairs,
            &folder.registrations,
            &model,
            learn,
            config,
            measures,
            &mut observer,
        );
        observer.0.clear();
        by_samples = found?;
    }
    let name = model.metadata().name.clone();
    let metrics =
        Metrics { model: name, people: pairs.len(), by_components, by_training_samples: by_samples };
    write_results(&arguments.output, &model, &metrics)?;
    if metrics.by_components.last().is_some_and(|all| all.failed > 0) {
        outcome = Outcome::Doubtful;
    }
    console.note(format!("{:.1} s", start.elapsed().as_secs_f64()));
    console.result(arguments.output.join("reconstructions.html").display());
    Ok(outcome)
}

fn read_pairs(
    arguments: &ReconstructionsArguments,
    config: &ReconstructConfig,
) -> anyhow::Result<Vec<KnownPair>> {
    let folder = arguments.lab.join("pairs");
    let entries = std::fs::read_dir(&folder).with_context(|| {
        format!("{}: holds no pairs; make some with habitus generate depth-pairs", folder.display())
    })?;
    let mut names: Vec<String> = entries
        .filter_map(Result::ok)
        .filter(|entry| entry.path().is_dir())
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort_unstable();
    names.truncate(arguments.count.unwrap_or(usize::MAX));
    if names.is_empty() {
        bail!("{}: holds no pairs", folder.display());
    }
    names.into_iter().map(|name| read_pair(arguments, config, name)).collect()
}

fn read_pair(
    arguments: &ReconstructionsArguments,
    config: &ReconstructConfig,
    name: String,
) -> anyhow::Result<KnownPair> {
    let own = arguments.lab.join("pairs").join(&name);
    let truth = |part: &str| -> anyhow::Result<Vec<_>> {
        let path = arguments.lab.join("truth").join(format!("{name}_{part}.ply"));
        Ok(read_mesh(&path)?.positions().to_vec())
    };
    let ending = if arguments.clouds { "ply" } else { "png" };
    let mut views = Vec::with_capacity(2);
    let mut posed = Vec::with_capacity(2);
    for side in [Side::Front, Side::Back] {
        let file: PathBuf = own.join(format!("{}.{ending}", side.name()));
        views.push(read_view(&file, side, None, config)?);
        posed.push(truth(side.name())?);
    }
    Ok(KnownPair { views, posed, rest: truth("rest")?, name })
}

/// End of the colour scale, millimetres (P1 Fig. 6).
const RANGE_MM: f64 = 30.0;

fn write_results(folder: &Path, model: &BodyModel, metrics: &Metrics) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    write(&folder.join("metrics.json"), &(serde_json::to_string_pretty(metrics)? + "\n"))?;
    let component_name = |accuracy: &ReconstructionAccuracy| format!("{} components", accuracy.components);
    let sample_name =
        |accuracy: &ReconstructionAccuracy| format!("{} samples", accuracy.training_samples.unwrap_or(0));
    let mut figures = figures_of("components", &metrics.by_components, &component_name, model)?;
    figures.extend(figures_of("training_samples", &metrics.by_training_samples, &sample_name, model)?);
    for figure in &figures {
        write(&folder.join(format!("{}.svg", figure.name)), &figure.svg)?;
    }
    let tables = [
        table("By number of components", &metrics.by_components, &component_name),
        table("By number of training samples", &metrics.by_training_samples, &sample_name),
    ];
    let tables: Vec<Table> = tables.into_iter().filter(|table| !table.rows.is_empty()).collect();
    let subtitle = format!("{} people from a front and a back view", metrics.people);
    let page = figures_page(&format!("Reconstructions with {}", metrics.model), &subtitle, &figures, &tables);
    write(&folder.join("reconstructions.html"), &page)
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    write_atomically(path, text.as_bytes()).with_context(|| format!("{}: cannot be written", path.display()))
}

type NameOf<'a> = &'a dyn Fn(&ReconstructionAccuracy) -> String;

fn figures_of(
    what: &str,
    accuracies: &[ReconstructionAccuracy],
    name_of: NameOf<'_>,
    model: &BodyModel,
) -> anyhow::Result<Vec<Figure>> {
    let (Some(first), Some(last)) = (accuracies.first(), accuracies.last()) else { return Ok(Vec::new()) };
    let words = what.replace('_', " ");
    let series = accuracies.iter().map(|accuracy| {
        let points = accuracy.thresholds_mm.iter().zip(&accuracy.share);
        Series { name: name_of(accuracy), points: points.map(|(x, share)| [*x, 100.0 * share]).collect() }
    });
    let curves = LineChart {
        title: format!("Vertex error by {words}"),
        x_label: "vertex error, mm".into(),
        y_label: "vertices below, %".into(),
        series: series.collect(),
    };
    let count = |accuracy: &ReconstructionAccuracy| accuracy.training_samples.unwrap_or(accuracy.components);
    let line = |name: &str, error: fn(&ReconstructionAccuracy) -> f64| Series {
        name: name.into(),
        points: accuracies.iter().map(|accuracy| [count(accuracy) as f64, error(accuracy)]).collect(),
    };
    let means = LineChart {
        title: format!("Mean vertex error by {words}"),
        x_label: words.clone(),
        y_label: "mean vertex error, mm".into(),
        series: vec![
            line("as seen", |accuracy| accuracy.posed_mm),
            line("at rest", |accuracy| accuracy.rest_mm),
        ],
    };
    let shown = if accuracies.len() > 1 { vec![first, last] } else { vec![last] };
    let maps: Vec<HeatMap<'_>> = shown
        .into_iter()
        .map(|accuracy| HeatMap {
            name: name_of(accuracy),
            vertices: model.mean_vertices(),
            faces: model.faces(),
            values_mm: &accuracy.vertex_mean_mm,
        })
        .collect();
    Ok(vec![
        Figure {
            name: format!("vertex_error_by_{what}"),
            caption: "Vertices of the posed bodies that are nearer to the truth (P1 Fig. 5).".into(),
            svg: curves.svg(),
        },
        Figure {
            name: format!("mean_error_by_{what}"),
            caption: "Mean over people and vertices: of the bodies as the views saw them, and of the rest bodies after rigid alignment.".into(),
            svg: means.svg(),
        },
        Figure {
            name: format!("error_map_by_{what}"),
            caption: "Mean error at each vertex (P1 Fig. 6).".into(),
            svg: heat_map_figure(&maps, RANGE_MM)?,
        },
    ])
}

fn table(title: &str, accuracies: &[ReconstructionAccuracy], name_of: NameOf<'_>) -> Table {
    let head = ["space", "posed mm", "rest mm", "worst rest mm", "people", "not found"];
    let rows = accuracies.iter().map(|accuracy| {
        let counts = [accuracy.people as f64, accuracy.failed as f64];
        let errors = [accuracy.posed_mm, accuracy.rest_mm, accuracy.worst_rest_mm];
        (name_of(accuracy), errors.into_iter().chain(counts).collect())
    });
    Table { title: title.into(), head: head.map(String::from).to_vec(), rows: rows.collect() }
}
