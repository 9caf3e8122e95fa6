//! `habitus synthesize`.

mod dressing_pages;
mod room;

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use habitus::artifacts::clothing_layer::ClothingLayer;
use habitus::artifacts::clothing_model::ClothingModel;
use habitus::artifacts::fabric::find_fabric_table;
use habitus::artifacts::rigged_sequence::FrameRate;
use habitus::artifacts::synthesized_sequence::MeshFiles;
use habitus::pipeline::{
    ClothingSource, RunFolder, StageName, SynthesisInput, SynthesisSummary, finished_synthesis, read_motion,
    synthesis_journal, write_synthesis,
};
use habitus::stages::synthesize::{Motion, change_body, replay_layer, synthesize};
use habitus_report::dressed_report::{ClipSource, synthesis_report};

use crate::Outcome;
use crate::clock::StageClock;
use crate::commands::measure::read_identity;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::{RunObserver, StageBar};
use crate::sequence_job::load_model;
use crate::side_page::{REPORT_FILE, title_of, write_side_page};

const EXAMPLES: &str = "\
Examples:
  habitus synthesize model.npz -o new
  habitus synthesize model.npz --motion run -o new
  habitus synthesize model.npz --motion run --identity coefficients.txt -o new --meshes ply
  habitus synthesize model.npz --motion run --material silk --fit hem_width=1.4 -o new
  habitus synthesize model.npz --motion walk.bvh --material felt.json -o new
  habitus synthesize run --identity coefficients.txt -o new
  habitus synthesize model.npz --interactive --motion walk.bvh --motion run

Writes 6_synthesize/sequence.npz, dressed.glb, summary.json and report.html. A run with a layer, in
place of a model, is replayed as it was captured, over another body.

--interactive writes nothing: it serves a page with the dressed person in motion and sliders for
build, motion, fabric and size, to this machine alone (127.0.0.1). Open the address that it prints.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct SynthesizeArguments {
    /// Clothing model, or a run with a clothing layer
    pub source: PathBuf,
    /// Run folder for the result
    #[arg(long, short, value_name = "DIR", required_unless_present = "interactive")]
    pub output: Option<PathBuf>,
    /// Serve a page with sliders, and write nothing
    #[arg(long, conflicts_with_all = ["output", "meshes"])]
    pub interactive: bool,
    /// Port of 127.0.0.1 for the page [default: a free one]
    #[arg(
        long,
        value_name = "PORT",
        default_value_t = 0,
        hide_default_value = true,
        requires = "interactive"
    )]
    pub port: u16,
    /// Identity coefficients of another body, numbers in a text file [default: the body of the clothes]
    #[arg(long, value_name = "FILE")]
    pub identity: Option<PathBuf>,
    /// Motion: a run with a fit, a motion file (.bvh, .amc, AMASS .npz), or the name of a sequence that was
    /// learnt from [default: the first]; with --interactive, several to choose from
    #[arg(long, value_name = "FILE")]
    pub motion: Vec<PathBuf>,
    /// Frames per second of the motion [default: those of the clothes]
    #[arg(long, value_name = "N")]
    pub frame_rate: Option<f64>,
    /// Fabric: the name of a sequence that was learnt from, one of our own, or a file with the 39-number form (.json)
    #[arg(long, value_name = "NAME|FILE")]
    pub material: Option<String>,
    /// Ratios of garment to body and other controls, by name: NAME=VALUE, several with commas
    #[arg(long, value_name = "NAME=VALUE", value_delimiter = ',')]
    pub fit: Vec<String>,
    /// Do finished work again
    #[arg(long)]
    pub force: bool,
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

/// Synthesizes and writes, or serves the page.
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
    let Some(output) = &arguments.output else {
        let ClothingSource::Model(model) = source else {
            bail!(
                "{}: is a layer; the page needs a model: habitus learn-clothing",
                arguments.source.display()
            )
        };
        return room::serve(arguments, ClothingModel { dressed, ..*model }, console);
    };
    let motion = match arguments.motion.as_slice() {
        [] => None,
        [motion] => Some(motion.as_path()),
        _ => bail!("give one --motion, or several with --interactive"),
    };
    let asked = match &source {
        ClothingSource::Layer(_) => {
            if motion.is_some() || arguments.material.is_some() || !arguments.fit.is_empty() {
                bail!(
                    "{}: is a layer, which is replayed as it is; motion, material and fit need a model: habitus \
                     learn-clothing",
                    arguments.source.display()
                );
            }
            None
        }
        ClothingSource::Model(model) => {
            Some((find_motion(arguments, model, &dressed, motion)?, controls_of(arguments, model)?))
        }
    };
    let input = SynthesisInput {
        source_file: &arguments.source,
        dressed: &dressed,
        motion: asked.as_ref().map(|(motion, controls)| (motion, controls.as_slice())),
        meshes: arguments.meshes.map(|form| match form {
            MeshFormat::Ply => MeshFiles::Ply,
            MeshFormat::Obj => MeshFiles::Obj,
        }),
        config: &config,
    };
    let run = RunFolder::open(output)?;
    let summary = match finished_synthesis(&run, &input.key()?)? {
        Some(summary) if !arguments.force => {
            console.note(format!(
                "{}: already finished with these inputs and settings; --force does it again",
                output.display()
            ));
            summary
        }
        _ => make(&run, &source, &input, arguments.force, console)?,
    };
    tell(output, &summary, console);
    Ok(Outcome::Fine)
}

/// Synthesizes, going on after the frames of an earlier, killed run unless `afresh`; writes all files and the page.
fn make(
    run: &RunFolder,
    source: &ClothingSource,
    input: &SynthesisInput<'_>,
    afresh: bool,
    console: &Console,
) -> anyhow::Result<SynthesisSummary> {
    let mut clock = StageClock::start();
    let mut observer = RunObserver { bar: StageBar::new(console), clock: &mut clock };
    let mut journal = synthesis_journal(run, &input.key()?, afresh)?;
    let (sequence, clip_source) = match (source, input.motion) {
        (ClothingSource::Model(model), Some((motion, controls))) => {
            let (dressed, config) = (input.dressed, input.config);
            let sequence = synthesize(model, dressed, motion, controls, config, &mut journal, &mut observer)?;
            (sequence, ClipSource::Model(model))
        }
        (ClothingSource::Layer(layer), _) => (
            replay_layer(input.dressed, input.config, &mut journal, &mut observer)?,
            ClipSource::Layer(layer),
        ),
        (ClothingSource::Model(_), None) => bail!("a model needs a motion"),
    };
    observer.bar.clear();
    let seconds = clock.seconds().total;
    let report = synthesis_report(&title_of(run.path()), &sequence, input.dressed, clip_source);
    let summary = write_synthesis(run, source, input, sequence, seconds)?;
    write_side_page(&run.stage(StageName::Synthesize)?.file(REPORT_FILE), &report.html(), console);
    Ok(summary)
}

fn tell(output: &Path, summary: &SynthesisSummary, console: &Console) {
    let inside = |what: &str, found: Option<habitus::artifacts::synthesized_sequence::Penetration>| {
        found.map_or(String::new(), |found| {
            format!(
                "\ninside the body, {what}: {:5.2} % of the vertices, {:.1} mm deep at most; {:.2} % pinched between its parts",
                100.0 * found.inside_share,
                found.deepest_mm,
                100.0 * found.pinched_share
            )
        })
    };
    console.result(format!(
        "{}: {} frames, {:.0} frames/s{}{}",
        output.display(),
        summary.frames,
        summary.frames_per_second,
        inside("before", summary.penetration_before),
        inside("after ", summary.penetration_after),
    ));
}

/// A motion that the model was learnt from, by its name, or that of a file.
fn find_motion(
    arguments: &SynthesizeArguments,
    model: &ClothingModel,
    dressed: &ClothingLayer,
    asked: Option<&Path>,
) -> anyhow::Result<Motion> {
    let Some(path) = asked else {
        let first = model.motions.first().and_then(|(name, _)| Motion::of_model(model, name));
        return first.context("the model has no motion of its own: give a run with a fit as --motion");
    };
    if let Some(motion) = Motion::of_model(model, &path.to_string_lossy()) {
        return Ok(motion);
    }
    if !path.exists() {
        let known: Vec<&str> = model.motions.iter().map(|(name, _)| name.as_str()).collect();
        bail!("--motion {}: there is no such file, and the model knows {}", path.display(), known.join(", "));
    }
    let body = load_model(arguments.model.as_deref())?;
    let rate = frame_rate(arguments.frame_rate, model.frame_rate())?;
    Ok(read_motion(path, &body, dressed, rate)?)
}

/// The model's controls with fabric and sizes as asked for.
fn controls_of(arguments: &SynthesizeArguments, model: &ClothingModel) -> anyhow::Result<Vec<f64>> {
    let mut controls = model.controls.defaults();
    if let Some(name) = &arguments.material {
        if model.controls.fabric_component_count() == 0 || model.controls.of_sequence(name).is_some() {
            model.controls.set_known_fabric(&mut controls, name)?;
        } else {
            let table = find_fabric_table(name).with_context(|| {
                let known: Vec<&str> = model.controls.known.iter().map(|(name, _)| name.as_str()).collect();
                format!("the model was learnt from {}", known.join(", "))
            })?;
            model.controls.set_fabric(&mut controls, &table)?;
        }
    }
    for assignment in &arguments.fit {
        let (name, value) = assignment
            .split_once('=')
            .and_then(|(name, value)| Some((name.trim(), value.trim().parse().ok()?)))
            .filter(|(_, value): &(_, f64)| value.is_finite())
            .with_context(|| format!("--fit {assignment}: write it as NAME=NUMBER"))?;
        model.controls.set(&mut controls, name, value)?;
    }
    Ok(controls)
}

fn frame_rate(asked: Option<f64>, of_model: FrameRate) -> anyhow::Result<FrameRate> {
    match asked {
        None => Ok(of_model),
        Some(value) => {
            FrameRate::new(value).with_context(|| format!("--frame-rate {value}: must be positive"))
        }
    }
}
