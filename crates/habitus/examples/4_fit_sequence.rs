//! The body under the clothes of a captured sequence: one identity, a pose for each frame.
//!
//! `cargo run --release -p habitus --example 4_fit_sequence [-- folder with one mesh for each frame]`
#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::path::Path;

use habitus::artifacts::frames::{FrameFolder, FrameSource};
use habitus::artifacts::journal::Journal;
use habitus::body::BodyModel;
use habitus::optimize::Silent;
use habitus::stages::fit_sequence::{FitSequenceConfig, fit_sequence};
use habitus::stages::measure::{Definitions, measure_with_uncertainty};
use habitus_synthetic::sequence::{DressedSequenceSettings, generate};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let model = BodyModel::default_space()?;

    // Frames are read one at a time. Without a folder, a person in a dress is made up and captured coarsely.
    let frames: Box<dyn FrameSource> = match std::env::args().nth(1) {
        Some(folder) => Box::new(FrameFolder::open(Path::new(&folder))?),
        None => Box::new(generate(&model, &DressedSequenceSettings::tiny(), &mut |_, _| {})?),
    };

    // No landmarks, no unit, no up axis: all are found. A journal would let a killed run continue.
    let config = FitSequenceConfig::default();
    let fitted = fit_sequence(&*frames, &model, &config, &[], &mut Journal::none(), &mut Silent)?;

    for line in &fitted.input_frame.report {
        println!("{line}");
    }
    // A frame that should not be trusted blindly carries codes; `is_ok` tells whether they are failures.
    for frame in &fitted.frames {
        let outside = 100.0 * frame.outside_share_5mm;
        println!("{}: ok {}, {outside:.1} % outside, codes {:?}", frame.name, frame.is_ok(), frame.codes);
    }
    // The curvature of the energy tells how sure the identity is, and so each measure.
    let definitions = Definitions::standard()?;
    let measurements =
        measure_with_uncertainty(&model, &fitted.rest_vertices, &fitted.identity_covariance, &definitions)?;
    for measurement in measurements.iter().take(5) {
        let plus_minus = measurement.plus_minus.unwrap_or(0.0);
        println!("{}: {:.3} ± {plus_minus:.3} m", measurement.name, measurement.value);
    }
    Ok(())
}
