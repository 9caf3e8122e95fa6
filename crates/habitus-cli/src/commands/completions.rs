//! `habitus completions`.

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use crate::Outcome;
use crate::arguments::Arguments;
use crate::console::Console;

const EXAMPLES: &str = "\
Examples:
  habitus completions bash > ~/.local/share/bash-completion/completions/habitus
  habitus completions fish > ~/.config/fish/completions/habitus.fish";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct CompletionsArguments {
    /// Shell
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Prints the script.
pub fn run(arguments: &CompletionsArguments, console: &Console) -> anyhow::Result<Outcome> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Arguments::command(), "habitus", &mut script);
    console.result(String::from_utf8_lossy(&script).trim_end());
    Ok(Outcome::Fine)
}
