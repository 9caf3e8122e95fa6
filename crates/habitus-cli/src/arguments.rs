//! The command line as a whole; each verb's own arguments stand with the verb.

use std::num::NonZeroUsize;

use clap::{Parser, Subcommand};

use crate::commands::{
    bootstrap, completions, config, demo, evaluate, export, extract_clothing, fit_sequence, generate,
    landmarks, learn_clothing, learn_shape, measure, reconstruct, register, render, report, review,
    synthesize,
};

const EXAMPLES: &str = "\
Examples:
  habitus demo                            make a dressed sequence, fit it, compare with the truth
  habitus fit-sequence captures/ -o run   fit a folder of meshes; then open run/report.html
  habitus measure run                     show the body's measurements
  habitus export run --ply bodies         write one body mesh a frame

Exit codes:
  0  all is fine
  1  an error
  2  wrong usage
  3  finished, but some bodies must not be used unseen";

/// Finds the body under the clothes in 3D captures of people in motion.
#[derive(Debug, Parser)]
#[command(name = "habitus", version, after_help = EXAMPLES, max_term_width = 110)]
pub struct Arguments {
    /// Print nothing but results and errors
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Threads to work with; results do not depend on it [default: all cores]
    #[arg(long, short, value_name = "N", global = true)]
    pub jobs: Option<NonZeroUsize>,
    /// What to do
    #[command(subcommand)]
    pub verb: Verb,
}

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Make a dressed sequence, fit it and compare the fit with the truth
    Demo(demo::DemoArguments),
    /// Find one body and its motion in a folder of dressed captures
    FitSequence(fit_sequence::FitSequenceArguments),
    /// Take the clothes off a fitted sequence as a layer of offsets
    ExtractClothing(extract_clothing::ExtractClothingArguments),
    /// Learn a body model from registered scans
    LearnShape(learn_shape::LearnShapeArguments),
    /// Bring a template onto raw scans
    Register(register::RegisterArguments),
    /// Find the body of a person seen from the front and from the back
    Reconstruct(reconstruct::ReconstructArguments),
    /// Find the landmarks of single scans
    Landmarks(landmarks::LandmarksArguments),
    /// Show a body's measurements
    Measure(measure::MeasureArguments),
    /// Accept and reject registrations, worst first, on a local page
    Review(review::ReviewArguments),
    /// Learn a body space from raw scans in rounds of registering and learning
    Bootstrap(bootstrap::BootstrapArguments),
    /// Write the report of a run folder again
    Report(report::ReportArguments),
    /// Draw meshes or runs as a picture
    Render(render::RenderArguments),
    /// Write a run as mesh files, animation or motion
    Export(export::ExportArguments),
    /// Make captures of a dressed person with exact truth
    Generate(generate::GenerateArguments),
    /// Learn how clothes move from clothing layers
    LearnClothing(learn_clothing::LearnClothingArguments),
    /// Dress another body, motion, fabric or size
    Synthesize(synthesize::SynthesizeArguments),
    /// Compare results with the truth
    Evaluate(evaluate::EvaluateArguments),
    /// Print all settings with their defaults
    Config(config::ConfigArguments),
    /// Print a completion script for a shell
    Completions(completions::CompletionsArguments),
}
