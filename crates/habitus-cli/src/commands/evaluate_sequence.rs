//! `habitus evaluate sequence`: fits against the truth, as a table, numbers, figures and a page.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use habitus::artifacts::frames::FrameSource;
use habitus::artifacts::rigged_sequence::RiggedSequence;
use habitus::artifacts::write_atomically;
use habitus::body::BodyModel;
use habitus::evaluation::sequence_errors::{SequenceErrors, SequenceLabel, sequence_errors};
use habitus::evaluation::sequence_metrics::{BenchmarkMetrics, SequenceMetricsSettings, benchmark_metrics};
use habitus::pipeline::{CaptureOrigin, measure_rest_body, measure_stored_fit, read_stored_fit};
use habitus_report::benchmark::{
    MeanBody, Overlay, Variant, benchmark_figures, benchmark_page, overlays_figure,
};
use habitus_report::shape_space::Figure;
use habitus_synthetic::benchmark::Style;
use habitus_synthetic::source_bodies::source_body_names;
use habitus_synthetic::truth::{DressedTruth, TRUTH_FILE};
use serde::Serialize;

use crate::Outcome;
use crate::commands::generate::{sequence_truth, truth_of_frames};
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::StageBar;
use crate::sequence_job::{accuracy_table, load_model};

const EXAMPLES: &str = "\
Examples:
  habitus evaluate sequence run --truth dressed
  habitus evaluate sequence run_default run_paper --truth dressed -o comparison
  habitus evaluate sequence results/runs/default/* --truth benchmark -o results

--truth is the folder of one generated sequence, or a benchmark: then each run is compared with the
sequence that it was made from. Runs of the same sequence are compared with one another: in a benchmark
those in one folder belong together, otherwise each run stands for itself.";

/// Arguments for sequences.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct SequenceArguments {
    /// Run folders or fit.npz files
    #[arg(required = true)]
    pub runs: Vec<PathBuf>,
    /// Folder of the generated sequence, or of a benchmark
    #[arg(long, value_name = "DIR")]
    pub truth: PathBuf,
    /// Body model that the runs were fitted with [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Folder for metrics.json, the figures as SVG, and benchmark.html with all of them
    #[arg(long, short, value_name = "OUT")]
    pub output: Option<PathBuf>,
    /// Settings of the evaluation
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// A run and the sequence that it was made from.
pub struct EvaluatedRun {
    /// Way to fit that the run belongs to.
    pub variant: String,
    /// The run folder or fit file.
    pub run: PathBuf,
    /// Folder of the captures with their truth.
    pub truth: PathBuf,
}

/// Compares.
pub fn run(arguments: &SequenceArguments, console: &Console) -> anyhow::Result<Outcome> {
    let settings = arguments.settings.load()?.evaluate_sequence;
    let model = load_model(arguments.model.as_deref())?;
    let is_single = arguments.truth.join(TRUTH_FILE).is_file();
    let runs = arguments
        .runs
        .iter()
        .map(|run| {
            let (variant, truth) = if is_single {
                (run.display().to_string(), arguments.truth.clone())
            } else {
                (variant_of(run), truth_in(&arguments.truth, run)?)
            };
            Ok(EvaluatedRun { variant, run: run.clone(), truth })
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    let evaluation = Evaluation::of(&model, &runs, &settings, console)?;
    if is_single {
        for (name, variant) in evaluation.variants() {
            for errors in &variant.errors {
                console.result(format!("{name}\n{}", accuracy_table(&errors.accuracy)));
            }
        }
    } else {
        evaluation.tell(console);
    }
    if let Some(folder) = &arguments.output {
        evaluation.write(&model, folder)?;
        console.result(folder.join(PAGE).display());
    }
    Ok(Outcome::Fine)
}

/// The folder that a run lies in names the way to fit.
fn variant_of(run: &Path) -> String {
    let folder = std::path::absolute(run)
        .ok()
        .and_then(|run| Some(run.parent()?.file_name()?.to_string_lossy().into_owned()));
    folder.unwrap_or_else(|| "runs".into())
}

/// The sequence of a benchmark that a run was made from: by the run's own name, or by where its captures were.
fn truth_in(benchmark: &Path, run: &Path) -> anyhow::Result<PathBuf> {
    let own = run.file_name().map(|name| benchmark.join(name));
    let origin = CaptureOrigin::read(run);
    let of_captures = origin.as_ref().and_then(|origin| Some(benchmark.join(origin.input.file_name()?)));
    [own, of_captures].into_iter().flatten().find(|folder| folder.join(TRUTH_FILE).is_file()).with_context(
        || {
            format!(
                "{}: no sequence of {} has its name or its captures; --truth needs a folder with {TRUTH_FILE} in it or in its folders",
                run.display(),
                benchmark.display()
            )
        },
    )
}

/// All runs of one way to fit.
pub struct EvaluatedVariant {
    /// Errors of each sequence.
    pub errors: Vec<SequenceErrors>,
    /// What they add up to.
    pub metrics: BenchmarkMetrics,
    runs: Vec<PathBuf>,
}

/// Runs compared with their truth, by way to fit.
pub struct Evaluation {
    order: Vec<String>,
    variants: BTreeMap<String, EvaluatedVariant>,
}

/// `metrics.json`: the first way to fit at the top, all of them below `variants`.
#[derive(Serialize)]
struct MetricsFile<'a> {
    format: &'static str,
    version: &'static str,
    variant: &'a str,
    #[serde(flatten)]
    first: &'a BenchmarkMetrics,
    variants: BTreeMap<&'a str, &'a BenchmarkMetrics>,
}

const FORMAT: &str = "habitus-sequence-metrics";
const METRICS: &str = "metrics.json";
const PAGE: &str = "benchmark.html";

impl Evaluation {
    /// Reads and compares all runs.
    pub fn of(
        model: &BodyModel,
        runs: &[EvaluatedRun],
        settings: &SequenceMetricsSettings,
        console: &Console,
    ) -> anyhow::Result<Self> {
        let names = source_body_names()?;
        let mut order: Vec<String> = Vec::new();
        let mut found: BTreeMap<String, (Vec<SequenceErrors>, Vec<PathBuf>)> = BTreeMap::new();
        let mut bar = StageBar::new(console);
        for (place, run) in runs.iter().enumerate() {
            let errors = errors_of(model, &names, run)?;
            if !order.contains(&run.variant) {
                order.push(run.variant.clone());
            }
            let entry = found.entry(run.variant.clone()).or_default();
            if entry.0.iter().any(|other| other.label.name == errors.label.name) {
                bail!(
                    "{}: the sequence {} is there twice in {}; keep the runs of one way to fit in a folder of their own",
                    run.run.display(),
                    errors.label.name,
                    run.variant
                );
            }
            entry.0.push(errors);
            entry.1.push(run.run.clone());
            bar.show("compare", place + 1, runs.len());
        }
        bar.clear();
        let variants = found
            .into_iter()
            .map(|(name, (errors, runs))| {
                let metrics = benchmark_metrics(&errors, settings);
                (name, EvaluatedVariant { errors, metrics, runs })
            })
            .collect();
        Ok(Self { order, variants })
    }

    /// The ways to fit in the order in which they were named.
    pub fn variants(&self) -> impl Iterator<Item = (&str, &EvaluatedVariant)> {
        self.order.iter().filter_map(|name| Some((name.as_str(), self.variants.get(name)?)))
    }

    /// Prints the few numbers that a benchmark is about.
    pub fn tell(&self, console: &Console) {
        for (name, variant) in self.variants() {
            console.result(style_table(name, &variant.metrics));
        }
    }

    /// Writes numbers, figures and page.
    pub fn write(&self, model: &BodyModel, folder: &Path) -> anyhow::Result<()> {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
        let (name, first) = self.variants().next().context("there is no run to compare")?;
        let numbers = MetricsFile {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            variant: name,
            first: &first.metrics,
            variants: self.variants().map(|(name, variant)| (name, &variant.metrics)).collect(),
        };
        write(&folder.join(METRICS), &(serde_json::to_string_pretty(&numbers)? + "\n"))?;
        let variants: Vec<Variant<'_>> = self
            .variants()
            .map(|(name, variant)| Variant { name, errors: &variant.errors, metrics: &variant.metrics })
            .collect();
        let mean = model.mean_vertices();
        let mut figures = benchmark_figures(&variants, MeanBody { vertices: mean, faces: model.faces() })?;
        figures.extend(self.overlays()?);
        for figure in &figures {
            write(&folder.join(format!("{}.svg", figure.name)), &figure.svg)?;
        }
        write(&folder.join(PAGE), &benchmark_page(&variants, &figures))
    }

    /// The middle frames of one sequence of each style and motion (P2 Fig. 7), and the worst frames of all.
    fn overlays(&self) -> anyhow::Result<Vec<Figure>> {
        let mut figures = Vec::new();
        for (name, variant) in self.variants() {
            let mut seen: Vec<(&str, &str)> = Vec::new();
            let mut typical = Vec::new();
            for (place, errors) in variant.errors.iter().enumerate() {
                let kind = (errors.label.style.as_str(), errors.label.motion.as_str());
                if !seen.contains(&kind) {
                    seen.push(kind);
                    typical.push((place, errors.frames.len() / 2));
                }
            }
            let mut worst: Vec<(usize, usize)> = variant
                .errors
                .iter()
                .enumerate()
                .filter_map(|(place, errors)| {
                    let frames = errors.frames.iter().enumerate();
                    let worst = frames.max_by(|a, b| a.1.mpjpe_mm.total_cmp(&b.1.mpjpe_mm))?;
                    Some((place, worst.0))
                })
                .collect();
            let joints = |(place, frame): &(usize, usize)| variant.errors[*place].frames[*frame].mpjpe_mm;
            worst.sort_by(|a, b| joints(b).total_cmp(&joints(a)));
            worst.truncate(WORST_SHOWN);
            let slug: String =
                name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
            figures.push(figure(
                &format!("overlays_{slug}"),
                &format!("Bodies inside their captures, {name}"),
                "The middle frame of one sequence of each style and motion (P2 Fig. 7).",
                variant,
                &typical,
            )?);
            figures.push(figure(
                &format!("worst_{slug}"),
                &format!("Worst frames, {name}"),
                "The frame with the largest joint error of each of the worst sequences.",
                variant,
                &worst,
            )?);
        }
        Ok(figures)
    }
}

/// Sequences whose worst frame is shown.
const WORST_SHOWN: usize = 6;

fn figure(
    name: &str,
    title: &str,
    caption: &str,
    variant: &EvaluatedVariant,
    chosen: &[(usize, usize)],
) -> anyhow::Result<Figure> {
    let fits: Vec<RiggedSequence> = chosen
        .iter()
        .map(|(place, _)| Ok(read_stored_fit(&variant.runs[*place])?))
        .collect::<anyhow::Result<_>>()?;
    let overlays: Vec<Overlay<'_>> = chosen
        .iter()
        .zip(&fits)
        .map(|((place, frame), fit)| {
            let errors = &variant.errors[*place];
            let captures = CaptureOrigin::read(&variant.runs[*place])
                .and_then(|origin| origin.frames().ok())
                .filter(|frames| frames.len() == errors.frames.len());
            Overlay {
                fit,
                frame: *frame,
                capture: captures.and_then(|frames| frames.surface(*frame).ok()),
                caption: format!("{} {frame}: {:.0} mm", errors.label.name, errors.frames[*frame].mpjpe_mm),
            }
        })
        .collect();
    Ok(overlays_figure(name, title, caption, &overlays)?)
}

fn errors_of(model: &BodyModel, people: &[String], run: &EvaluatedRun) -> anyhow::Result<SequenceErrors> {
    let truth = DressedTruth::read(&run.truth)?;
    let fit = read_stored_fit(&run.run)?;
    let label = label(&truth, people, &run.truth);
    let measured = measure_stored_fit(model, &fit)?;
    let names = fit.sequence.frames.iter().map(|frame| frame.name.as_str());
    let together = || format!("{} and {}", run.run.display(), run.truth.display());
    let truth = truth_of_frames(&sequence_truth(model, &truth), names).with_context(together)?;
    let true_measures = measure_rest_body(model, &truth.rest_vertices)?;
    sequence_errors(label, &fit, &truth, [&measured, &true_measures]).with_context(together)
}

fn label(truth: &DressedTruth, people: &[String], folder: &Path) -> SequenceLabel {
    let settings = &truth.settings;
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf());
    let motion = match &settings.motion_file {
        Some(path) => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        None => settings.motion.name().into(),
    };
    SequenceLabel {
        name: absolute.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        subject: people.get(settings.source_body).cloned().unwrap_or_default(),
        style: Style::of(settings.outfit).name().into(),
        motion,
    }
}

/// The few numbers that a benchmark is about, one line for each style.
fn style_table(name: &str, metrics: &BenchmarkMetrics) -> String {
    let mut lines = vec![format!(
        "{name}\n  {:10} {:>6} {:>8} {:>8} {:>9} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8}",
        "",
        "frames",
        "rest mm",
        "<10 mm",
        "from root",
        "posed mm",
        "joints",
        "girths",
        "outside",
        "failed",
        "missed"
    )];
    let all = std::iter::once(("all", &metrics.overall));
    for (style, numbers) in metrics.styles.iter().map(|(style, numbers)| (style.as_str(), numbers)).chain(all)
    {
        lines.push(format!(
            "  {style:10} {:6} {:8.1} {:6.1} % {:9.1} {:8.1} {:8.1} {:8.1} {:6.1} % {:6.1} % {:6.1} %",
            numbers.frames,
            numbers.rest_mean_mm,
            100.0 * numbers.rest_under_10mm,
            numbers.rest_from_root_mean_mm,
            numbers.posed_mean_mm,
            numbers.mpjpe_mm,
            numbers.girth_mean_error_mm,
            100.0 * numbers.outside_share_5mm,
            100.0 * numbers.failure_rate,
            100.0 * numbers.miss_rate,
        ));
    }
    lines.join("\n")
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    write_atomically(path, text.as_bytes()).with_context(|| format!("{}: cannot be written", path.display()))
}
