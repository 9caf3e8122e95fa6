//! `habitus evaluate shape-space`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use habitus::artifacts::write_atomically;
use habitus::body::BodyModel;
use habitus::evaluation::shape_space_quality::ShapeSpaceQuality;
use habitus::pipeline::{
    EvaluationScope, NamedQuality, ShapeSpaceMetrics, SubjectGroup, evaluate_shape_space,
};
use habitus_report::shape_space::{Figure, LineChart, Series, Table, figures_page, modes_figure};

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
    /// Folder of registrations, or run folder
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
    let metrics = evaluate_shape_space(&folder.registrations, &model, &settings, scope, &mut observer);
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
    vec![Table { title: "All registrations".into(), head: head.map(String::from).to_vec(), rows }]
}
