//! `habitus register`.

use std::path::PathBuf;
use std::sync::Mutex;
use std::time::Instant;

use clap::{Args, ValueEnum};
use habitus::artifacts::template_mesh::{TemplateMesh, read_landmark_vertices};
use habitus::body::BodyModel;
use habitus::pipeline::{
    RegisterRun, RegisterSummary, RunFolder, ScanInput, ScanPlaces, ScanSummary, list_scans,
};
use habitus::stages::register::{RegisterConfig, RegisterRecipe, Template};

use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::machine::peak_memory_mb;
use crate::progress::StageBar;
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus register scans/ -o run
  habitus register scans/ -o run --landmarks landmarks/
  habitus register one.obj -o run --landmarks one.lnd --recipe paper
  habitus register scans/ -o run --landmarks landmarks/ --template template.ply

SCAN is a file, a folder or a pattern; PLY, OBJ, STL, OFF and GLB are read, meshes or clouds.
Landmarks are .csv (landmark,x,y,z), .json (name to [x, y, z]) or CAESAR .lnd, in the scan's own
frame; none are needed with a body model. Writes RUN/1_register/NAME.ply in the scan's own frame
and unit, NAME.json and RUN/summary.json. A killed run goes on where it stopped.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct RegisterArguments {
    /// Scans: files, folders or patterns
    #[arg(required = true, value_name = "SCAN")]
    pub scans: Vec<PathBuf>,
    /// Run folder for all results
    #[arg(long, short, value_name = "RUN")]
    pub output: PathBuf,
    /// Folder with a file of landmarks for each scan, or one file for one scan
    #[arg(long, value_name = "DIR|FILE")]
    pub landmarks: Option<PathBuf>,
    /// Body model [default: the one inside the program]
    #[arg(long, value_name = "FILE", conflicts_with = "template")]
    pub model: Option<PathBuf>,
    /// Mesh to bring onto the scans instead of a body model; needs landmarks
    #[arg(long, value_name = "FILE")]
    pub template: Option<PathBuf>,
    /// Table landmark,vertex of the template or model [default: TEMPLATE_landmarks.csv, or the model's own]
    #[arg(long, value_name = "FILE")]
    pub template_landmarks: Option<PathBuf>,
    /// How to register
    #[arg(long, value_enum)]
    pub recipe: Option<RegisterRecipeName>,
    /// Do finished work again
    #[arg(long)]
    pub force: bool,
    /// Settings of the stage
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Names of the recipes.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RegisterRecipeName {
    /// Model fit, then displacements along the normals
    Default,
    /// The published method of 2017 as printed
    Paper,
}

/// What was read as the template.
enum LoadedTemplate {
    Model(Box<BodyModel>),
    Mesh(Box<TemplateMesh>),
}

/// Registers scans.
pub fn run(arguments: &RegisterArguments, console: &Console) -> anyhow::Result<Outcome> {
    let mut config = arguments.settings.load()?.register;
    match arguments.recipe {
        Some(RegisterRecipeName::Default) => config.recipe = RegisterRecipe::Default,
        Some(RegisterRecipeName::Paper) => config.recipe = RegisterRecipe::Paper,
        None => {}
    }
    // Wrong inputs must not leave a run folder behind.
    let scans = list_scans(&arguments.scans, arguments.landmarks.as_deref())?;
    let (template, table, files) = load_template(arguments)?;
    let template = match &template {
        LoadedTemplate::Model(model) => Template::Model(model),
        LoadedTemplate::Mesh(mesh) => Template::Mesh(mesh),
    };
    let run = RunFolder::open(&arguments.output)?;
    ScanPlaces { scans: scans.iter().map(|scan| scan.scan.clone()).collect() }.write(run.path())?;
    let stage = RegisterRun::prepare(&run, template, &files, table, &config)?;
    let summary = register_all(&stage, &scans, arguments.force, console)?;
    summary.write(&run.path().join("summary.json"))?;
    tell(&summary, &config, console);
    console.result(stage.folder().display());
    Ok(if summary.is_ok() { Outcome::Fine } else { Outcome::Doubtful })
}

/// Template, landmark table that replaces its own, and the files that both were read from.
type TemplateParts = (LoadedTemplate, Option<Vec<(String, u32)>>, Vec<PathBuf>);

fn load_template(arguments: &RegisterArguments) -> anyhow::Result<TemplateParts> {
    if let Some(path) = &arguments.template {
        let table = arguments.template_landmarks.clone();
        let table = table.unwrap_or_else(|| TemplateMesh::default_landmarks_file(path));
        let mesh = TemplateMesh::read(path, &table)?;
        return Ok((LoadedTemplate::Mesh(Box::new(mesh)), None, vec![path.clone(), table]));
    }
    let model = load_model(arguments.model.as_deref())?;
    let read = |path: &PathBuf| read_landmark_vertices(path, model.vertex_count());
    let table = arguments.template_landmarks.as_ref().map(read).transpose()?;
    let files = arguments.template_landmarks.iter().cloned().collect();
    Ok((LoadedTemplate::Model(Box::new(model)), table, files))
}

fn register_all(
    stage: &RegisterRun<'_>,
    scans: &[ScanInput],
    is_forced: bool,
    console: &Console,
) -> anyhow::Result<RegisterSummary> {
    let begin = Instant::now();
    let clock = || begin.elapsed().as_secs_f64();
    let bar = Mutex::new((StageBar::new(console), 0));
    let progress = |_: &ScanSummary| {
        if let Ok(mut bar) = bar.lock() {
            bar.1 += 1;
            let done = bar.1;
            bar.0.show("register", done, scans.len());
        }
    };
    let found = stage.run(scans, is_forced, &clock, &progress);
    if let Ok(bar) = bar.lock() {
        bar.0.clear();
    }
    Ok(stage.finish(found, clock(), peak_memory_mb())?)
}

/// Scans named one by one at most.
const NAMES_SHOWN: usize = 10;

fn tell(summary: &RegisterSummary, config: &RegisterConfig, console: &Console) {
    let doubtful = || summary.scans.iter().filter(|scan| !scan.is_ok());
    for scan in doubtful().take(NAMES_SHOWN) {
        match (&scan.error, scan.codes.iter().find(|code| code.is_failure())) {
            (Some(error), _) => console.warning(format!("{}: {error}", scan.name)),
            (None, Some(code)) => console.warning(format!(
                "{}: {code}. {} What to do: {}.",
                scan.name,
                code.meaning(),
                code.remedy()
            )),
            (None, None) => {}
        }
    }
    let more = doubtful().count().saturating_sub(NAMES_SHOWN);
    if more > 0 {
        console.warning(format!("{more} more scans are doubtful; see summary.json"));
    }
    let [to_surface, held_out, to_scan] = summary.means_mm;
    console.note(format!(
        "{} scans in {:.1} s, {} doubtful; scan to surface {to_surface:.2} mm, held out ({:.0} %) {held_out:.2} mm, surface to scan {to_scan:.2} mm",
        summary.scan_count,
        summary.total_seconds,
        summary.failed_scans,
        config.held_out_share * 100.0
    ));
}
