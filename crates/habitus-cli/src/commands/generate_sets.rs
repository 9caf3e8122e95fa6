//! `habitus generate clothing-data` and `habitus generate benchmark`.

use std::path::PathBuf;
use std::sync::Mutex;

use anyhow::bail;
use clap::{Args, ValueEnum};
use habitus::body::BodyModel;
use habitus_synthetic::benchmark::{self, write_benchmark_sequence, write_index};
use habitus_synthetic::capture::CaptureMode;
use habitus_synthetic::clothing_data::{self, ClothingSet, SetSize, write_clothing_data};

use crate::Outcome;
use crate::console::Console;
use crate::progress::StageBar;

/// Examples of `generate clothing-data`.
pub const CLOTHING_EXAMPLES: &str = "\
Examples:
  habitus generate clothing-data fabrics -o fabrics --preset small
  habitus generate clothing-data sizes -o sizes --preset full --frames 60 --cloth-edge-mm 24
  habitus generate clothing-data motions -o motions --motion-file walk.bvh --motion-file 02_01.amc
  habitus extract-clothing fabrics/denim --aligned -o fabrics/denim

Each sequence is a run folder whose fit is the exact truth and whose captures are the garments in one
topology. parameters.csv holds what varies, summary.json how well the cloth stayed out of the body.
What is finished is not made again.";

/// Examples of `generate benchmark`.
pub const BENCHMARK_EXAMPLES: &str = "\
Examples:
  habitus generate benchmark --preset small -o benchmark
  habitus generate benchmark --preset paper -o benchmark --capture visual-hull --capture scanner
  habitus generate benchmark --preset paper -o benchmark --only female_04_ --only male_01_
  habitus evaluate benchmark benchmark -o results

Each sequence is a folder of frames with truth.npz, as `habitus generate` writes it; benchmark.json
lists them. What is finished is not made again.";

/// What varies over the sequences.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ClothingSetName {
    /// One person, garment and motion in eight fabrics
    Fabrics,
    /// Eight people walking in shorts and T-shirts of different sizes
    Sizes,
    /// One person and garment in several motions
    Motions,
}

/// How large a clothing data set is.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ClothingPreset {
    /// Coarse cloth and short sequences
    Small,
    /// Fine cloth and sequences of five seconds
    Full,
}

/// How large the benchmark is.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum BenchmarkPreset {
    /// Two subjects, six short and coarse sequences
    Small,
    /// Six subjects, three motions and three styles: 54 sequences
    Paper,
}

/// Arguments of `generate clothing-data`.
#[derive(Debug, Args)]
pub struct ClothingDataArguments {
    /// What varies
    #[arg(value_enum)]
    pub set: ClothingSetName,
    /// Folder for the sequences
    #[arg(long, short, value_name = "DIR")]
    pub output: PathBuf,
    /// How large the data set is
    #[arg(long, value_enum, default_value = "small")]
    pub preset: ClothingPreset,
    /// Frames of each sequence [default: the preset's]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub frames: Option<u16>,
    /// Length of the cloth's triangle edges, millimetres [default: the preset's]
    #[arg(long, value_name = "MM", value_parser = cloth_edge)]
    pub cloth_edge_mm: Option<f64>,
    /// Motion capture file (.bvh, .amc or AMASS .npz): a further motion, or that of all sequences; may be repeated
    #[arg(long = "motion-file", value_name = "FILE")]
    pub motion_files: Vec<PathBuf>,
    /// Start of all random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

/// Arguments of `generate benchmark`.
#[derive(Debug, Args)]
pub struct BenchmarkArguments {
    /// Folder for the sequences
    #[arg(long, short, value_name = "DIR")]
    pub output: PathBuf,
    /// How large the benchmark is
    #[arg(long, value_enum, default_value = "small")]
    pub preset: BenchmarkPreset,
    /// How the people are captured; may be repeated
    #[arg(long = "capture", value_enum, default_values = ["visual-hull"])]
    pub captures: Vec<super::generate::CaptureName>,
    /// Motion capture file of a further motion; may be repeated
    #[arg(long = "motion-file", value_name = "FILE")]
    pub motion_files: Vec<PathBuf>,
    /// Frames of each sequence [default: the preset's]
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// Make only sequences whose name holds this text; may be repeated, one of them is enough
    #[arg(long, value_name = "TEXT")]
    pub only: Vec<String>,
    /// Start of all random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

fn cloth_edge(text: &str) -> Result<f64, String> {
    let length = text.parse().ok().filter(|length: &f64| (5.0..=60.0).contains(length));
    length.ok_or_else(|| "must be a number from 5 to 60".into())
}

/// Makes a clothing data set.
pub fn run_clothing_data(arguments: &ClothingDataArguments, console: &Console) -> anyhow::Result<Outcome> {
    let model = BodyModel::default_space()?;
    let set = match arguments.set {
        ClothingSetName::Fabrics => ClothingSet::Fabrics,
        ClothingSetName::Sizes => ClothingSet::Sizes,
        ClothingSetName::Motions => ClothingSet::Motions,
    };
    let size = match arguments.preset {
        ClothingPreset::Small => SetSize::Small,
        ClothingPreset::Full => SetSize::Full,
    };
    let mut sequences = clothing_data::plan(&model, set, size, arguments.seed, &arguments.motion_files)?;
    for settings in sequences.iter_mut().map(|sequence| &mut sequence.settings) {
        settings.frame_count = arguments.frames.map_or(settings.frame_count, usize::from);
        settings.garment.cloth_edge_mm = arguments.cloth_edge_mm.unwrap_or(settings.garment.cloth_edge_mm);
    }
    let bar = Mutex::new((StageBar::new(console), 0));
    let progress = || {
        if let Ok(mut bar) = bar.lock() {
            bar.1 += 1;
            let done = bar.1;
            bar.0.show("make", done, sequences.len());
        }
    };
    let made = write_clothing_data(&model, &sequences, &arguments.output, &progress);
    if let Ok(bar) = bar.lock() {
        bar.0.clear();
    }
    let made = made?;
    for sequence in &made {
        match &sequence.error {
            Some(error) => console.warning(format!("{}: {error}", sequence.name)),
            None => console.note(format!(
                "{}: {} frames of {} vertices, {:.2} % of them simulated inside the body, up to {:.1} mm; written {:.1}",
                sequence.name,
                sequence.frames,
                sequence.clothing_vertices,
                sequence.inside_share * 100.0,
                sequence.deepest_simulated_mm,
                sequence.deepest_mm
            )),
        }
    }
    console.result(arguments.output.display());
    let is_whole = made.iter().all(|sequence| sequence.error.is_none());
    Ok(if is_whole { Outcome::Fine } else { Outcome::Doubtful })
}

/// Makes the benchmark.
pub fn run_benchmark(arguments: &BenchmarkArguments, console: &Console) -> anyhow::Result<Outcome> {
    let model = BodyModel::default_space()?;
    let size = match arguments.preset {
        BenchmarkPreset::Small => SetSize::Small,
        BenchmarkPreset::Paper => SetSize::Full,
    };
    let captures: Vec<CaptureMode> = arguments.captures.iter().map(|capture| capture.mode()).collect();
    let mut sequences = benchmark::plan(size, &captures, arguments.seed, &arguments.motion_files)?;
    if let Some(frames) = arguments.frames {
        sequences.iter_mut().for_each(|sequence| sequence.settings.frame_count = frames);
    }
    let is_wanted = |name: &str| {
        arguments.only.is_empty() || arguments.only.iter().any(|text| name.contains(text.as_str()))
    };
    let chosen: Vec<_> = sequences.iter().filter(|sequence| is_wanted(&sequence.name)).collect();
    if chosen.is_empty() {
        bail!("--only {}: no sequence has such a name; they are such as {}", arguments.only.join(" "), {
            sequences.first().map_or("none", |sequence| sequence.name.as_str())
        });
    }
    write_index(&sequences, &arguments.output)?;
    let mut failed = 0;
    for sequence in chosen {
        let mut bar = StageBar::new(console);
        let made = write_benchmark_sequence(&model, sequence, &arguments.output, &mut |done, total| {
            bar.show("make", done, total);
        });
        bar.clear();
        match made {
            Ok(true) => console.note(format!("{}: {} frames", sequence.name, sequence.settings.frame_count)),
            Ok(false) => console.note(format!("{}: already made", sequence.name)),
            Err(error) => {
                failed += 1;
                console.warning(format!("{}: {error}", sequence.name));
            }
        }
    }
    console.result(arguments.output.display());
    Ok(if failed == 0 { Outcome::Fine } else { Outcome::Doubtful })
}
