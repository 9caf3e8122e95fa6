//! `habitus render`.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use habitus::artifacts::frames::FrameSource;
use habitus::artifacts::rigged_sequence::RiggedSequence;
use habitus::geometry::Surface;
use habitus::geometry::glam::DVec3;
use habitus::geometry::io::{Format, read_surface};
use habitus::pipeline::{CaptureOrigin, measure_stored_fit, read_stored_fit};
use habitus_report::render::{
    Camera, Color, ColorScale, Curve, Dot, Layer, Paint, Panel, Scene, View, contact_sheet, render,
};
use habitus_report::stills::{FrameStill, StillContent};

use crate::Outcome;
use crate::commands::fit_sequence::UpName;
use crate::console::Console;
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus render run -o overlay.png
  habitus render run -o frames.png --frames 0,20,40 --views front,side --content all
  habitus render run -o girths.png --measurements
  habitus render scan.ply body.obj -o meshes.png --up z

Runs are drawn as the person faces in each frame; meshes as they lie, front towards +z (+x for
z up).";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct RenderArguments {
    /// Mesh files, run folders or fit.npz files
    #[arg(required = true)]
    pub inputs: Vec<PathBuf>,
    /// Picture to write
    #[arg(long, short, value_name = "PNG")]
    pub output: PathBuf,
    /// Frames of runs, counted from 0 [default: six, evenly spread]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub frames: Vec<usize>,
    /// Sides to look from
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [ViewName::Front, ViewName::Side])]
    pub views: Vec<ViewName>,
    /// What is drawn of runs
    #[arg(long, value_enum, default_value_t = ContentName::Overlay)]
    pub content: ContentName,
    /// Draw the rest body of runs with the curves of its measurements
    #[arg(long)]
    pub measurements: bool,
    /// Axis of mesh files that points up
    #[arg(long, value_enum, default_value_t = UpName::Y)]
    pub up: UpName,
    /// Height of each picture in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 480)]
    pub height: usize,
    /// Body model that runs were fitted with [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
}

/// Names of the views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ViewName {
    /// From the front
    Front,
    /// From the person's left
    Side,
    /// From behind
    Back,
    /// From above
    Top,
}

/// Names of what a picture of a run shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ContentName {
    /// Body inside the translucent capture
    Overlay,
    /// Capture alone
    Capture,
    /// Body alone
    Body,
    /// Body coloured by its distance to the capture
    Clearance,
    /// All of these
    All,
}

impl ViewName {
    fn view(self, front: DVec3, up: DVec3) -> View {
        let (yaw, pitch) = match self {
            Self::Front => (0.0, 4.0),
            Self::Side => (90.0, 4.0),
            Self::Back => (180.0, 4.0),
            Self::Top => (0.0, 80.0),
        };
        View { front, up, ..View::from_degrees(yaw, pitch) }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Side => "side",
            Self::Back => "back",
            Self::Top => "top",
        }
    }
}

/// Frames of a run that are drawn when none are named.
const FRAMES: usize = 6;
/// Width of a picture over its height: a standing person with arms a little apart.
const ASPECT: f64 = 0.62;

/// Draws.
pub fn run(arguments: &RenderArguments, console: &Console) -> anyhow::Result<Outcome> {
    let mut panels = Vec::new();
    for input in &arguments.inputs {
        let is_mesh = input.is_file() && Format::of_path(input).is_some();
        if is_mesh {
            mesh_panels(arguments, input, &mut panels)?;
        } else {
            let fit = read_stored_fit(input)?;
            if arguments.measurements {
                measurement_panels(arguments, &fit, &mut panels)?;
            } else {
                run_panels(arguments, input, &fit, &mut panels)?;
            }
        }
    }
    // Each row shows one frame's views, or several whole frames when they are narrow.
    let row = arguments.views.len() * arguments.content.contents().len();
    let columns = (12 / row).max(1) * row;
    let sheet = contact_sheet(&panels, columns.min(panels.len()))?;
    sheet.save_png(&arguments.output)?;
    console.result(arguments.output.display());
    Ok(Outcome::Fine)
}

impl ContentName {
    fn contents(self) -> Vec<StillContent> {
        match self {
            Self::Overlay => vec![StillContent::Overlay],
            Self::Capture => vec![StillContent::Capture],
            Self::Body => vec![StillContent::Body],
            Self::Clearance => vec![StillContent::Clearance],
            Self::All => StillContent::ALL.to_vec(),
        }
    }
}

fn width(arguments: &RenderArguments) -> usize {
    (arguments.height as f64 * ASPECT).round() as usize
}

fn run_panels(
    arguments: &RenderArguments,
    input: &Path,
    fit: &RiggedSequence,
    panels: &mut Vec<Panel>,
) -> anyhow::Result<()> {
    let count = fit.sequence.frames.len();
    let chosen: Vec<usize> = match arguments.frames.is_empty() {
        false => arguments.frames.clone(),
        true => (0..FRAMES.min(count)).map(|k| k * (count - 1) / (FRAMES.min(count) - 1).max(1)).collect(),
    };
    if let Some(frame) = chosen.iter().find(|frame| **frame >= count) {
        bail!("{}: has no frame {frame}; there are {count}, counted from 0", input.display());
    }
    let captures = CaptureOrigin::read(input)
        .and_then(|origin| origin.frames().ok())
        .filter(|frames| frames.len() == count);
    for frame in chosen {
        let capture = captures.as_ref().and_then(|frames| frames.surface(frame).ok());
        let still = FrameStill::new(fit, frame, capture.as_ref(), ColorScale::CLEARANCE);
        let front = fit.posed_skeleton(frame).rotations[0] * DVec3::Z;
        for view in &arguments.views {
            for content in arguments.content.contents() {
                let image =
                    still.draw(content, view.view(front, DVec3::Y), width(arguments), arguments.height)?;
                let name = &fit.sequence.frames[frame].name;
                panels.push(Panel { caption: format!("{name} {}", view.name()), image });
            }
        }
    }
    Ok(())
}

fn measurement_panels(
    arguments: &RenderArguments,
    fit: &RiggedSequence,
    panels: &mut Vec<Panel>,
) -> anyhow::Result<()> {
    let measurements = measure_stored_fit(&load_model(arguments.model.as_deref())?, fit)?;
    let skin = Paint::Uniform(Color::from_srgb(214, 190, 172));
    let mut scene = Scene::default();
    scene.layers.push(Layer::translucent(
        fit.sequence.rest_vertices.clone(),
        fit.rig.faces.clone(),
        skin,
        0.75,
    ));
    let drawable = measurements.iter().filter(|measurement| measurement.curve.len() > 1);
    scene.curves = drawable
        .map(|measurement| Curve {
            points: measurement.curve.clone(),
            is_closed: false,
            color: Color::from_srgb(190, 40, 60),
            radius: 0.0035,
        })
        .collect();
    for view in &arguments.views {
        let aspect = width(arguments) as f64 / arguments.height as f64;
        let camera = Camera::framing(scene.bounds(), view.view(DVec3::Z, DVec3::Y), aspect);
        let image = render(&scene, &camera, width(arguments), arguments.height)?;
        panels.push(Panel { caption: format!("measurements {}", view.name()), image });
    }
    Ok(())
}

/// Radius of a cloud's point over the height of the cloud.
const POINT_SHARE: f64 = 0.002;

fn mesh_panels(arguments: &RenderArguments, path: &Path, panels: &mut Vec<Panel>) -> anyhow::Result<()> {
    let (up, front) = match arguments.up {
        UpName::X => (DVec3::X, DVec3::Z),
        UpName::Auto | UpName::Y => (DVec3::Y, DVec3::Z),
        UpName::Z => (DVec3::Z, DVec3::X),
    };
    let mut scene = Scene::default();
    let color = Color::from_srgb(176, 186, 200);
    match read_surface(path)? {
        Surface::Mesh(mesh) => {
            let (positions, faces) = mesh.into_parts();
            scene.layers.push(Layer::opaque(positions, faces, Paint::Uniform(color)));
        }
        Surface::Cloud(cloud) => {
            scene.dots =
                cloud.positions().iter().map(|point| Dot { position: *point, color, radius: 0.0 }).collect();
            let bounds = scene.bounds();
            let radius = POINT_SHARE * (bounds.high - bounds.low).length();
            scene.dots.iter_mut().for_each(|dot| dot.radius = radius);
        }
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    for view in &arguments.views {
        let aspect = width(arguments) as f64 / arguments.height as f64;
        let camera = Camera::framing(scene.bounds(), view.view(front, up), aspect);
        let image = render(&scene, &camera, width(arguments), arguments.height)
            .with_context(|| format!("{}: cannot be drawn", path.display()))?;
        panels.push(Panel { caption: format!("{name} {}", view.name()), image });
    }
    Ok(())
}
