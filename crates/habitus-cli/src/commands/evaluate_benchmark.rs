//! `habitus evaluate benchmark`: fits every sequence of a benchmark in one or more ways and compares with the truth.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use habitus::body::BodyModel;
use habitus::pipeline::{CaptureOrigin, RunFolder};
use habitus::stages::fit_sequence::FitSequenceConfig;
use habitus::stages::fit_sequence::config::Recipe;
use habitus_synthetic::truth::{DressedTruth, TRUTH_FILE};

use super::evaluate_sequence::{EvaluatedRun, Evaluation};
use crate::Outcome;
use crate::commands::fit_sequence::RecipeName;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::sequence_job::{self, RunReport, SequenceJob, load_model};

const EXAMPLES: &str = "\
Examples:
  habitus generate benchmark --preset small -o benchmark
  habitus evaluate benchmark benchmark -o results
  habitus evaluate benchmark benchmark -o results --recipe default --recipe paper2016
  habitus evaluate benchmark benchmark -o results --recipe paper2016 \\
      --variant configs/paper2016_without_clothing.toml --variant configs/paper2016_symmetric.toml

Runs stay in OUT/runs/NAME/SEQUENCE. What is finished is not fitted again, so that a killed evaluation goes
on where it stopped, and one that is named more sequences or variants later adds only those. Writes
metrics.json, figures as SVG, and benchmark.html with all of them.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct BenchmarkArguments {
    /// Folder of the benchmark (see: habitus generate benchmark)
    pub benchmark: PathBuf,
    /// Folder for runs, numbers, figures and page
    #[arg(long, short, value_name = "OUT")]
    pub output: PathBuf,
    /// How to fit; may be repeated [default: default]
    #[arg(long = "recipe", value_enum)]
    pub recipes: Vec<RecipeName>,
    /// A further way to fit: a file of settings, instead of --config and named by its stem; may be repeated
    #[arg(long = "variant", value_name = "FILE")]
    pub variants: Vec<PathBuf>,
    /// Only sequences whose name holds this text; may be repeated, one of them is enough
    #[arg(long, value_name = "TEXT")]
    pub only: Vec<String>,
    /// Compare what is finished, and fit nothing
    #[arg(long)]
    pub no_fit: bool,
    /// Body model [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Settings of the stage: --config for the recipes, --set for all ways to fit
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// A way to fit.
struct Variant {
    name: String,
    config: FitSequenceConfig,
}

/// Fits and compares.
pub fn run(arguments: &BenchmarkArguments, console: &Console) -> anyhow::Result<Outcome> {
    let settings = arguments.settings.load()?;
    let model = load_model(arguments.model.as_deref())?;
    let sequences = sequences(&arguments.benchmark, &arguments.only)?;
    let variants = variants(arguments)?;
    let mut runs = Vec::new();
    let mut failed = 0;
    for variant in &variants {
        for (place, sequence) in sequences.iter().enumerate() {
            let name = sequence.file_name().unwrap_or_default();
            let folder = arguments.output.join("runs").join(&variant.name).join(name);
            console.note(format!(
                "{} {} of {}: {}",
                variant.name,
                place + 1,
                sequences.len(),
                name.to_string_lossy()
            ));
            match fit(arguments, &model, variant, sequence, &folder, console) {
                Ok(true) => runs.push(EvaluatedRun {
                    variant: variant.name.clone(),
                    run: folder,
                    truth: sequence.clone(),
                }),
                Ok(false) => {}
                Err(error) => {
                    failed += 1;
                    console.warning(format!("{}: {error:#}", folder.display()));
                }
            }
        }
    }
    if runs.is_empty() {
        bail!("{}: no sequence is fitted", arguments.output.display());
    }
    let evaluation = Evaluation::of(&model, &runs, &settings.evaluate_sequence, console)?;
    evaluation.tell(console);
    evaluation.write(&model, &arguments.output)?;
    console.result(arguments.output.join("benchmark.html").display());
    Ok(if failed == 0 { Outcome::Fine } else { Outcome::Doubtful })
}

/// Fits one sequence; false where it is not fitted and was not to be.
fn fit(
    arguments: &BenchmarkArguments,
    model: &BodyModel,
    variant: &Variant,
    sequence: &Path,
    folder: &Path,
    console: &Console,
) -> anyhow::Result<bool> {
    if arguments.no_fit {
        return Ok(habitus::pipeline::read_stored_fit(folder).is_ok());
    }
    let frame_rate = DressedTruth::read_settings(sequence)?.frames_per_second;
    let run = RunFolder::open(folder)?;
    let job = SequenceJob {
        verb: "evaluate-benchmark",
        run: &run,
        origin: CaptureOrigin { input: sequence.to_path_buf(), first: 0, last: None, step: 1, frame_rate },
        model,
        config: &variant.config,
        landmarks: None,
        truth: None,
        report: RunReport::None,
        is_forced: false,
    };
    sequence_job::run(&job, console)?;
    Ok(true)
}

/// Folders of the benchmark that hold a truth, by name.
fn sequences(benchmark: &Path, only: &[String]) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(benchmark).with_context(|| {
        format!(
            "{}: cannot be listed; name a folder that habitus generate benchmark made",
            benchmark.display()
        )
    })?;
    let mut found: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.join(TRUTH_FILE).is_file())
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            only.is_empty() || only.iter().any(|text| name.contains(text.as_str()))
        })
        .collect();
    found.sort();
    if found.is_empty() {
        let which =
            if only.is_empty() { String::new() } else { format!(" named like {}", only.join(" or ")) };
        bail!(
            "{}: holds no finished sequence{which}; make them with habitus generate benchmark -o {}",
            benchmark.display(),
            benchmark.display()
        );
    }
    Ok(found)
}

fn variants(arguments: &BenchmarkArguments) -> anyhow::Result<Vec<Variant>> {
    let with = |config: Option<PathBuf>| -> anyhow::Result<FitSequenceConfig> {
        let assignments = arguments.settings.assignments.clone();
        let config = config.or_else(|| arguments.settings.config.clone());
        Ok(SettingsArguments { config, assignments }.load()?.fit_sequence)
    };
    let mut recipes: Vec<Recipe> = arguments.recipes.iter().map(|recipe| recipe.recipe()).collect();
    if recipes.is_empty() && arguments.variants.is_empty() {
        recipes.push(with(None)?.recipe);
    }
    let mut variants: Vec<Variant> = Vec::new();
    for recipe in recipes {
        let name = match recipe {
            Recipe::Default => "default",
            Recipe::Paper2016 => "paper2016",
        };
        variants.push(Variant { name: name.into(), config: FitSequenceConfig { recipe, ..with(None)? } });
    }
    for path in &arguments.variants {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        variants.push(Variant { name, config: with(Some(path.clone()))? });
    }
    let mut names: Vec<&str> = variants.iter().map(|variant| variant.name.as_str()).collect();
    names.sort_unstable();
    if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        bail!("two ways to fit are named {}; rename a --variant file or name a recipe once", twice[0]);
    }
    Ok(variants)
}
