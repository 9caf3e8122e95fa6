//! `habitus evaluate shape-space`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use habitus::artifacts::write_atomically;
use habitus::body::BodyModel;
use habitus::evaluation::shape_space_quality::ShapeSpaceQuality;
use habitus::pipeline::{
    EvaluationScope, NamedFitError, NamedQuality, ShapeSpaceMetrics, SubjectGroup, evaluate_run,
    evaluate_shape_space,
};
use habitus_report::shape_space::{
    Figure, HeatMap, LineChart, Series, Table, figures_page, heat_map_figure, modes_figure,
};

use super::learn_shape::{BarObserver, read_folder};
use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::machine::peak_memory_mb;
use crate::progress::StageBar;

const EXAMPLES: &str = "\
Examples:
  habitus evaluate shape-space --model mine.npz --registrations registrations -o quality
  habitus evaluate shape-space --model mine.npz --registrations registrations -o quality \\
      --pose-normalizations --beside other.npz --set evaluate_shape_space.specificity_samples=1000

Writes metrics.json, figures as SVG, and shape_space.html with all of them.";

/// Arguments for shape spaces.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ShapeSpaceArguments {
    /// Model that was learnt with: habitus learn-shape
    #[arg(long, value_name = "MODEL")]
    pub model: PathBuf,
    /// Folder of registrations, or run folder: then also how far registrations are from their scans, and each round
    #[arg(long, value_name = "DIR")]
    pub registrations: PathBuf,
    /// Folder for numbers, figures and page
    #[arg(long, short, value_name = "OUT")]
    pub output: PathBuf,
    /// Measure the space under every pose normalization too
    #[arg(long)]
    pub pose_normalizations: bool,
    /// Another model whose components are drawn beside the first's; may be repeated
    #[arg(long, value_name = "MODEL")]
    pub beside: Vec<PathBuf>,
    /// Settings of the measures
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Components that the figure of modes shows. P1 Fig. 4: five.
const SHOWN_MODES: usize = 5;

/// Evaluates a space.
pub fn run(arguments: &ShapeSpaceArguments, console: &Console) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let settings = arguments.settings.load()?.evaluate_shape_space;
    let model = BodyModel::load(&arguments.model)?;
    let (folder, outcome) = read_folder(&arguments.registrations, &model, SubjectGroup::Everyone, console)?;
    let scope = if arguments.pose_normalizations {
        EvaluationScope::PoseNormalizations
    } else {
        EvaluationScope::Space
    };
    let mut observer = BarObserver(StageBar::new(console));
    let metrics = evaluate_shape_space(&folder.registrations, &model, &settings, scope, &mut observer)
        .and_then(|mut metrics| {
            evaluate_run(&arguments.registrations, &model, &settings, &mut metrics, &mut observer)?;
            Ok(metrics)
        });
    observer.0.clear();
    let metrics = metrics?;
    write_results(arguments, &model, &metrics)?;
    let memory = peak_memory_mb().map(|megabytes| format!(", {megabytes:.0} MB at most")).unwrap_or_default();
    console.note(format!("{:.1} s{memory}", start.elapsed().as_secs_f64()));
    console.result(arguments.output.join("shape_space.html").display());
    Ok(outcome)
}

fn write_results(
    arguments: &ShapeSpaceArguments,
    model: &BodyModel,
    metrics: &ShapeSpaceMetrics,
) -> anyhow::Result<()> {
    let folder = &arguments.output;
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    write(&folder.join("metrics.json"), &(serde_json::to_string_pretty(metrics)? + "\n"))?;
    let mut figures = measure_figures(metrics);
    let others: Vec<BodyModel> =
        arguments.beside.iter().map(|path| BodyModel::load(path)).collect::<Result<_, _>>()?;
    let rows: Vec<(String, &BodyModel)> =
        std::iter::once(model).chain(&others).map(|model| (model.metadata().name.clone(), model)).collect();
    figures.push(Figure {
        name: "modes".into(),
        caption: "The first components at three standard deviations below and above the mean (P1 Fig. 4)."
            .into(),
        svg: modes_figure(&rows, SHOWN_MODES)?,
    });
    figures.extend(fit_error_figures(metrics, model)?);
    for figure in &figures {
        write(&folder.join(format!("{}.svg", figure.name)), &figure.svg)?;
    }
    let subtitle = format!(
        "{} registrations, pose normalization: {}",
        metrics.registrations,
        metrics.pose_normalization.replace('_', " ")
    );
    let page = figures_page(&format!("Shape space {}", metrics.model), &subtitle, &figures, &tables(metrics));
    write(&folder.join("shape_space.html"), &page)
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    write_atomically(path, text.as_bytes()).with_context(|| format!("{}: cannot be written", path.display()))
}

/// P1 Fig. 1 and 2: share of vertices within a distance of the scan, and the mean at each vertex.
fn fit_error_figures(metrics: &ShapeSpaceMetrics, model: &BodyModel) -> anyhow::Result<Vec<Figure>> {
    let errors = &metrics.fit_errors;
    if errors.is_empty() {
        return Ok(Vec::new());
    }
    let curve = |named: &NamedFitError| {
        let points = named.error.thresholds_mm.iter().zip(&named.error.share);
        Series { name: named.name.clone(), points: points.map(|(x, share)| [*x, 100.0 * share]).collect() }
    };
    let chart = LineChart {
        title: "Fit error".into(),
        x_label: "distance to the nearest vertex of the scan, mm".into(),
        y_label: "vertices within, %".into(),
        series: errors.iter().map(curve).collect(),
    };
    // The first and the last, as P1 Fig. 2b.
    let shown = if errors.len() > 1 { vec![&errors[0], &errors[errors.len() - 1]] } else { vec![&errors[0]] };
    let maps: Vec<HeatMap<'_>> = shown
        .into_iter()
        .map(|named| HeatMap {
            name: named.name.clone(),
            vertices: model.mean_vertices(),
            faces: model.faces(),
            values_mm: &named.error.vertex_mean_mm,
        })
        .collect();
    Ok(vec![
        Figure {
            name: "fit_error".into(),
            caption: "Registered vertices within a distance of the nearest vertex of the scan, of those that have one within 50 mm and 60° (P1 Fig. 1a, 2a).".into(),
            svg: chart.svg(),
        },
        Figure {
            name: "fit_error_per_vertex".into(),
            caption: "The same, averaged over all registrations at each vertex (P1 Fig. 1b, 2b); grey where the scans have holes.".into(),
            svg: heat_map_figure(&maps, FIT_ERROR_RANGE_MM)?,
        },
    ])
}

/// End of the colour scale of the fit error, millimetres.
const FIT_ERROR_RANGE_MM: f64 = 10.0;

type Measure = fn(&ShapeSpaceQuality) -> &[f64];

/// Measure, name of its file, title, axis, and what P1 shows it in.
const MEASURES: [(Measure, &str, &str, &str, &str); 3] = [
    (
        |quality| &quality.compactness,
        "compactness",
        "Compactness",
        "share of the variance",
        "Share of the variance that the first components carry.",
    ),
    (
        |quality| &quality.generalization_mm,
        "generalization",
        "Generalization",
        "mean vertex distance, mm",
        "Left-out bodies to what the others' space makes of them (P1 Fig. 3, top).",
    ),
    (
        |quality| &quality.specificity_mm,
        "specificity",
        "Specificity",
        "mean vertex distance, mm",
        "Random bodies of the space to the nearest registration (P1 Fig. 3, bottom).",
    ),
];

fn measure_figures(metrics: &ShapeSpaceMetrics) -> Vec<Figure> {
    let all =
        NamedQuality { name: format!("all {}", metrics.registrations), quality: metrics.quality.clone() };
    let mut by_samples: Vec<NamedQuality> = metrics
        .by_training_samples
        .iter()
        .map(|quality| NamedQuality {
            name: format!("{} samples", quality.samples),
            quality: quality.clone(),
        })
        .collect();
    by_samples.push(all.clone());
    let mut figures = Vec::new();
    let groups = [
        ("", "", vec![all]),
        ("_by_training_samples", " by number of training samples", by_samples),
        ("_by_pose_normalization", " by pose normalization", metrics.by_pose_normalization.clone()),
        ("_by_round", " by bootstrapping round", metrics.by_round.clone()),
    ];
    for (suffix, addition, qualities) in groups.iter().filter(|(_, _, qualities)| !qualities.is_empty()) {
        // Alone, the space of all is a line in the next group already.
        if suffix.is_empty() && !metrics.by_training_samples.is_empty() {
            continue;
        }
        for (measure, name, title, label, caption) in MEASURES {
            let chart = LineChart {
                title: format!("{title}{addition}"),
                x_label: "components".into(),
                y_label: label.into(),
                series: qualities.iter().map(|named| series(named, measure)).collect(),
            };
            figures.push(Figure {
                name: format!("{name}{suffix}"),
                caption: caption.into(),
                svg: chart.svg(),
            });
        }
    }
    figures
}

fn series(named: &NamedQuality, measure: Measure) -> Series {
    let components = named.quality.components.iter().map(|count| *count as f64);
    let points = components.zip(measure(&named.quality)).map(|(x, y)| [x, *y]).collect();
    Series { name: named.name.replace('_', " "), points }
}

fn tables(metrics: &ShapeSpaceMetrics) -> Vec<Table> {
    let quality = &metrics.quality;
    let rows = (0..quality.components.len())
        .map(|place| {
            let numbers = vec![
                quality.compactness[place],
                quality.generalization_mm[place],
                quality.generalization_error_mm[place],
                quality.specificity_mm[place],
                metrics.model_reconstruction_mm[place],
            ];
            (quality.components[place].to_string(), numbers)
        })
        .collect();
    let head = ["components", "compactness", "generalization mm", "± mm", "specificity mm", "model mm"];
    let mut tables =
        vec![Table { title: "All registrations".into(), head: head.map(String::from).to_vec(), rows }];
    if !metrics.fit_errors.is_empty() {
        let head =
            ["fit error", "registrations", "compared, %", "mean mm", "held out, mean mm", "held out, p95 mm"];
        let row = |named: &NamedFitError| {
            let error = &named.error;
            let (held_out, count) = (&error.held_out_mm, error.registrations as f64);
            (
                named.name.clone(),
                vec![count, 100.0 * error.compared_share, error.mean_mm, held_out.mean, held_out.p95],
            )
        };
        let rows = metrics.fit_errors.iter().map(row).collect();
        let title = "Registrations and their scans".into();
        tables.push(Table { title, head: head.map(String::from).to_vec(), rows });
    }
    tables
}
