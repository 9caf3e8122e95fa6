//! `habitus synthesize`.

use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use habitus::artifacts::rigged_sequence::FrameRate;
use habitus::artifacts::synthesized_sequence::MeshFiles;
use habitus::pipeline::{ClothingSource, RunFolder, read_motion, write_synthesis};
use habitus::stages::synthesize::{Motion, change_body, replay_layer, synthesize};

use crate::Outcome;
use crate::clock::StageClock;
use crate::commands::measure::read_identity;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::{RunObserver, StageBar};
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus synthesize model.npz -o new
  habitus synthesize model.npz --motion run -o new
  habitus synthesize model.npz --motion run --identity coefficients.txt -o new --meshes ply
  habitus synthesize model.npz --motion run --material silk --fit hem_width=1.4 -o new
  habitus synthesize run --identity coefficients.txt -o new

Writes 6_synthesize/sequence.npz, dressed.glb and summary.json. A run with a layer, in place of a
model, is replayed as it was captured, over another body.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct SynthesizeArguments {
    /// Clothing model, or a run with a clothing layer
    pub source: PathBuf,
    /// Run folder for the result
    #[arg(long, short, value_name = "DIR")]
    pub output: PathBuf,
    /// Identity coefficients of another body, numbers in a text file [default: the body of the clothes]
    #[arg(long, value_name = "FILE")]
    pub identity: Option<PathBuf>,
    /// Motion: a run with a fit, a motion file (.bvh, .amc, AMASS .npz), or the name of a sequence that was
    /// learnt from [default: the first]
    #[arg(long, value_name = "FILE")]
    pub motion: Option<PathBuf>,
    /// Frames per second of the motion [default: those of the clothes]
    #[arg(long, value_name = "N")]
    pub frame_rate: Option<f64>,
    /// Fabric: the name of a sequence that was learnt from
    #[arg(long, value_name = "NAME")]
    pub material: Option<String>,
    /// Controls such as sizes, by name: NAME=VALUE, several with commas
    #[arg(long, value_name = "NAME=VALUE", value_delimiter = ',')]
    pub fit: Vec<String>,
    /// Write the clothing of each frame as a mesh file too
    #[arg(long, value_enum)]
    pub meshes: Option<MeshFormat>,
    /// Body model of the clothes [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Settings of the stage
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Forms of the meshes.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum MeshFormat {
    /// PLY
    Ply,
    /// OBJ
    Obj,
}

/// Synthesizes and writes.
pub fn run(arguments: &SynthesizeArguments, console: &Console) -> anyhow::Result<Outcome> {
    let config = arguments.settings.load()?.synthesize;
    let source = ClothingSource::read(&arguments.source)?;
    let dressed = match &arguments.identity {
        None => source.dressed().clone(),
        Some(path) => {
            let model = load_model(arguments.model.as_deref())?;
            change_body(source.dressed(), &model, &read_identity(path, model.component_count())?)?
        }
    };
    let run = RunFolder::open(&arguments.output)?;
    let mut clock = StageClock::start();
    let mut observer = RunObserver { bar: StageBar::new(console), clock: &mut clock };
    let sequence = match &source {
        ClothingSource::Layer(_) => {
            if arguments.motion.is_some() || arguments.material.is_some() || !arguments.fit.is_empty() {
                bail!(
                    "{}: is a layer, which is replayed as it is; motion, material and fit need a model: habitus \
                     learn-clothing",
                    arguments.source.display()
                );
            }
            replay_layer(&dressed, &config, &mut observer)?
        }
        ClothingSource::Model(model) => {
            let first = model.motions.first().map_or("", |(name, _)| name);
            let asked = arguments.motion.as_ref().map_or(first.into(), |path| path.to_string_lossy());
            let motion = match (Motion::of_model(model, &asked), &arguments.motion) {
                (Some(motion), _) => motion,
                (None, Some(path)) => {
                    let body = load_model(arguments.model.as_deref())?;
                    let rate = frame_rate(arguments.frame_rate, model.frame_rate())?;
                    read_motion(path, &body, &dressed, rate)?
                }
                (None, None) => {
                    bail!("the model has no motion of its own: give a run with a fit as --motion")
                }
            };
            let mut controls = model.controls.defaults();
            if let Some(name) = &arguments.material {
                model.controls.set_known_fabric(&mut controls, name)?;
            }
            for assignment in &arguments.fit {
                let (name, value) = assignment
                    .split_once('=')
                    .and_then(|(name, value)| Some((name.trim(), value.trim().parse().ok()?)))
                    .with_context(|| format!("--fit {assignment}: write it as NAME=NUMBER"))?;
                model.controls.set(&mut controls, name, value)?;
            }
            synthesize(model, &dressed, &motion, &controls, &config, &mut observer)?
        }
    };
    observer.bar.clear();
    let seconds = clock.seconds().total;
    let meshes = arguments.meshes.map(|form| match form {
        MeshFormat::Ply => MeshFiles::Ply,
        MeshFormat::Obj => MeshFiles::Obj,
    });
    let summary = write_synthesis(&run, &source, &dressed, sequence, meshes, &config, seconds)?;
    let inside = |what: &str, found: habitus::artifacts::synthesized_sequence::Penetration| {
        format!(
            "inside the body, {what}: {:5.2} % of the vertices, {:.1} mm deep at most",
            100.0 * found.inside_share,
            found.deepest_mm
        )
    };
    console.result(format!(
        "{}: {} frames, {:.0} frames/s\n{}\n{}",
        arguments.output.display(),
        summary.frames,
        summary.frames_per_second,
        inside("before", summary.penetration_before),
        inside("after ", summary.penetration_after),
    ));
    Ok(Outcome::Fine)
}

fn frame_rate(asked: Option<f64>, of_model: FrameRate) -> anyhow::Result<FrameRate> {
    match asked {
        None => Ok(of_model),
        Some(value) => {
            FrameRate::new(value).with_context(|| format!("--frame-rate {value}: must be positive"))
        }
    }
}
