//! `habitus landmarks`.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use habitus::artifacts::rigged_sequence::RiggedSequence;
use habitus::artifacts::scan_landmarks::ScanLandmarks;
use habitus::geometry::io::read_surface;
use habitus::pipeline::LandmarkRun;
use habitus_report::landmark_stills::landmark_sheet;

use crate::Outcome;
use crate::commands::fit_sequence::{UnitName, UpName};
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::StageBar;
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus landmarks scan.ply -o marks
  habitus landmarks scans/*.obj -o marks --pictures --unit mm --up z
  habitus fit-sequence captures/ -o run --landmarks marks/landmarks.csv

Writes landmarks.csv (frame,landmark,x,y,z,confidence) and landmarks.json (the same with codes) in each
scan's own frame and unit. Each scan is one person, dressed or not, in any pose. What is finished for an
unchanged scan is not done again.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct LandmarksArguments {
    /// Mesh or point cloud files, one person each
    #[arg(required = true)]
    pub scans: Vec<PathBuf>,
    /// Folder for the table, the JSON and the pictures
    #[arg(long, short, value_name = "OUT")]
    pub output: PathBuf,
    /// Draw each scan with its landmarks, green where they are sure
    #[arg(long)]
    pub pictures: bool,
    /// Body model [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Unit of the scans
    #[arg(long, value_enum)]
    pub unit: Option<UnitName>,
    /// Axis of the scans that points up
    #[arg(long, value_enum)]
    pub up: Option<UpName>,
    /// Settings of the fit
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Finds landmarks.
pub fn run(arguments: &LandmarksArguments, console: &Console) -> anyhow::Result<Outcome> {
    let mut config = arguments.settings.load()?.fit_sequence;
    if let Some(unit) = arguments.unit {
        config.unit = unit.choice();
    }
    if let Some(up) = arguments.up {
        config.up = up.choice();
    }
    let mut names = BTreeSet::new();
    for scan in &arguments.scans {
        if !names.insert(scan.file_name().unwrap_or_default()) {
            bail!("{}: another scan has the same file name, which the table tells them by", scan.display());
        }
    }
    let model = load_model(arguments.model.as_deref())?;
    let mut run = LandmarkRun::open(&arguments.output, &model, &config)?;
    let mut results = Vec::new();
    let mut bar = StageBar::new(console);
    for (place, scan) in arguments.scans.iter().enumerate() {
        let (result, fit) = run.scan(scan)?;
        if let (true, Some(fit)) = (arguments.pictures, &fit) {
            draw(&arguments.output, scan, fit)?;
        }
        results.push(result);
        bar.show("scan", place + 1, arguments.scans.len());
    }
    bar.clear();
    run.write(&results)?;
    let doubtful = results.iter().filter(|result| tell(result, console)).count();
    console.result(arguments.output.join("landmarks.csv").display());
    Ok(if doubtful == 0 { Outcome::Fine } else { Outcome::Doubtful })
}

fn draw(folder: &Path, scan: &Path, fit: &RiggedSequence) -> anyhow::Result<()> {
    let name = scan.file_name().unwrap_or_default().to_string_lossy();
    let surface = read_surface(scan).ok();
    let sheet = landmark_sheet(&name, fit, surface.as_ref())?;
    let path = folder.join(format!("{name}.png"));
    sheet.save_png(&path).with_context(|| format!("{}: cannot be drawn", path.display()))
}

/// Says what is doubtful about a scan, and whether something is.
fn tell(result: &ScanLandmarks, console: &Console) -> bool {
    let name = &result.scan.name;
    let Some(found) = &result.found else {
        let error = result.error.as_deref().unwrap_or("nothing was found");
        // Messages of readers name the file already.
        console.warning(if error.contains(name) { error.to_string() } else { format!("{name}: {error}") });
        return true;
    };
    for code in &found.codes {
        let text = format!("{name}: {code}. {} What to do: {}.", code.meaning(), code.remedy());
        if code.is_failure() { console.warning(text) } else { console.note(text) }
    }
    !found.is_ok
}
