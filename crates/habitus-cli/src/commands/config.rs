//! `habitus config`.

use clap::Args;

use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;

const EXAMPLES: &str = "\
Examples:
  habitus config > all.toml
  habitus config --set fit_sequence.recipe=paper2016

A settings file need only hold what differs from the defaults. Lengths are metres and angles
radians.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ConfigArguments {
    /// Settings to show instead of the defaults
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Prints all settings.
pub fn run(arguments: &ConfigArguments, console: &Console) -> anyhow::Result<Outcome> {
    console.result(toml::to_string_pretty(&arguments.settings.load()?)?.trim_end());
    Ok(Outcome::Fine)
}
