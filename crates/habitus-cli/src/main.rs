//! The `habitus` command: arguments to settings, progress, messages and exit codes. All computing is the library's.

mod arguments;
mod clock;
mod commands;
mod config_file;
mod console;
mod local_server;
mod machine;
mod progress;
mod sequence_job;
mod side_page;

use std::process::ExitCode;

use anyhow::Context;
use clap::Parser;
use clap::error::ErrorKind;

use arguments::{Arguments, Verb};
use console::Console;

/// How a verb ended when nothing kept it from ending.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All is fine.
    Fine,
    /// Finished, but some bodies must not be used unseen.
    Doubtful,
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // A closed pipe (`habitus --help | head`) is no failure.
            let _ = error.print();
            let is_answer = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
            return ExitCode::from(if is_answer { 0 } else { 2 });
        }
    };
    let console = Console::new(arguments.quiet);
    match run(arguments, &console) {
        Ok(Outcome::Fine) => ExitCode::SUCCESS,
        Ok(Outcome::Doubtful) => ExitCode::from(3),
        Err(error) => {
            console.error(&error);
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments, console: &Console) -> anyhow::Result<Outcome> {
    if let Some(jobs) = arguments.jobs {
        rayon::ThreadPoolBuilder::new()
            .num_threads(jobs.get())
            .build_global()
            .context("the threads cannot be started; give a smaller --jobs")?;
    }
    match arguments.verb {
        Verb::Demo(arguments) => commands::demo::run(&arguments, console),
        Verb::FitSequence(arguments) => commands::fit_sequence::run(&arguments, console),
        Verb::ExtractClothing(arguments) => commands::extract_clothing::run(&arguments, console),
        Verb::LearnShape(arguments) => commands::learn_shape::run(&arguments, console),
        Verb::Register(arguments) => commands::register::run(&arguments, console),
        Verb::Reconstruct(arguments) => commands::reconstruct::run(&arguments, console),
        Verb::Landmarks(arguments) => commands::landmarks::run(&arguments, console),
        Verb::Measure(arguments) => commands::measure::run(&arguments, console),
        Verb::Bootstrap(arguments) => commands::bootstrap::run(&arguments, console),
        Verb::Review(arguments) => commands::review::run(&arguments, console),
        Verb::Report(arguments) => commands::report::run(&arguments, console),
        Verb::Render(arguments) => commands::render::run(&arguments, console),
        Verb::Export(arguments) => commands::export::run(&arguments, console),
        Verb::Generate(arguments) => commands::generate::run(&arguments, console),
        Verb::LearnClothing(arguments) => commands::learn_clothing::run(&arguments, console),
        Verb::Synthesize(arguments) => commands::synthesize::run(&arguments, console),
        Verb::Evaluate(arguments) => commands::evaluate::run(&arguments, console),
        Verb::Config(arguments) => commands::config::run(&arguments, console),
        Verb::Completions(arguments) => commands::completions::run(&arguments, console),
    }
}
