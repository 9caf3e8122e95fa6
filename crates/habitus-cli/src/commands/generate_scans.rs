//! `habitus generate scans` and `habitus generate depth-pairs`.

use std::path::PathBuf;
use std::sync::Mutex;

use clap::Args;
use habitus::body::BodyModel;
use habitus_synthetic::raw_scan::{subject_names, write_depth_pairs, write_raw_scans};

use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::StageBar;

/// Examples of the help text.
pub const SCANS_EXAMPLES: &str = "\
Examples:
  habitus generate scans -o lab --count 200
  habitus generate scans -o lab --count 10 --points 100000 --seed 7

Writes scans/NAME.ply, landmarks/NAME.csv, truth/NAME.ply (the body in the template's topology, in
the scan's frame), truth/NAME_rest.ply, template.ply and template_landmarks.csv; metres, y up.
A scan depends on seed and name alone, so a larger count adds scans and changes none.";

/// Examples of the help text.
pub const PAIRS_EXAMPLES: &str = "\
Examples:
  habitus generate depth-pairs -o lab --count 20

Writes pairs/NAME/front.png, back.png (16 bit, millimetres), intrinsics.json, the same as clouds
front.ply, back.ply (camera at the origin, y up, looking along -z, metres), landmarks, and truth:
NAME_front.ply, NAME_back.ply, NAME_rest.ply.";

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

/// What [`run`] makes.
#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    /// Raw scans.
    Scans,
    /// Front and back depth images.
    DepthPairs,
}

/// Makes them.
pub fn run(arguments: &ScansArguments, kind: Kind, console: &Console) -> anyhow::Result<Outcome> {
    let model = &BodyModel::default_space()?;
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
