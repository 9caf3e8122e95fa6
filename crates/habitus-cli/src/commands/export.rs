//! `habitus export`.

use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::Args;
use habitus::artifacts::body_export::{FailedFrames, write_bodies};
use habitus::artifacts::motion_bvh::write_bvh;
use habitus::artifacts::skinned_glb::write_skinned_glb;
use habitus::pipeline::{CaptureOrigin, read_stored_fit};

use crate::Outcome;
use crate::console::Console;
use crate::sequence_job::frame_rate;

const EXAMPLES: &str = "\
Examples:
  habitus export run --ply bodies
  habitus export run --glb walk.glb --bvh walk.bvh --frame-rate 25

PLY bodies are in the input's own frame and unit; rest.ply is the same body in its rest pose.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ExportArguments {
    /// Run folder or fit.npz
    pub run: PathBuf,
    /// Write one body a frame, and rest.ply, into this folder
    #[arg(long, value_name = "DIR")]
    pub ply: Option<PathBuf>,
    /// Write the motion of the skeleton
    #[arg(long, value_name = "FILE")]
    pub bvh: Option<PathBuf>,
    /// Write the skinned animated body
    #[arg(long, value_name = "FILE")]
    pub glb: Option<PathBuf>,
    /// Write no PLY for frames that failed
    #[arg(long)]
    pub leave_out_failed: bool,
    /// Frames per second of BVH and GLB [default: that of the run]
    #[arg(long, value_name = "FPS")]
    pub frame_rate: Option<f64>,
}

/// Writes what is asked for.
pub fn run(arguments: &ExportArguments, console: &Console) -> anyhow::Result<Outcome> {
    if arguments.ply.is_none() && arguments.bvh.is_none() && arguments.glb.is_none() {
        bail!("nothing to write: say what with --ply, --glb or --bvh");
    }
    let fit = read_stored_fit(&arguments.run)?;
    let stored = CaptureOrigin::read(&arguments.run).map_or(30.0, |origin| origin.frame_rate);
    let frame_rate = frame_rate(arguments.frame_rate.unwrap_or(stored))?;
    let failed: Vec<&str> =
        fit.sequence.frames.iter().filter(|frame| !frame.is_ok()).map(|frame| frame.name.as_str()).collect();
    if let Some(folder) = &arguments.ply {
        let failed_frames =
            if arguments.leave_out_failed { FailedFrames::LeaveOut } else { FailedFrames::Write };
        let files = write_bodies(folder, &fit, failed_frames)?;
        console.note(format!("{} bodies", files.len()));
        console.result(folder.display());
    }
    if let Some(path) = &arguments.glb {
        write_skinned_glb(path, &fit, frame_rate)?;
        console.result(path.display());
    }
    if let Some(path) = &arguments.bvh {
        write_bvh(path, &fit, frame_rate)
            .with_context(|| format!("{}: the motion cannot be written", path.display()))?;
        console.result(path.display());
    }
    if failed.is_empty() {
        return Ok(Outcome::Fine);
    }
    console.warning(format!("the bodies of these frames must not be used unseen: {}", failed.join(", ")));
    Ok(Outcome::Doubtful)
}
