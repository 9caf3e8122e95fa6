//! Settings from a file and from `--set`; the library's structs hold the defaults.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use clap::Args;
use habitus::evaluation::reconstruction_accuracy::ReconstructionAccuracySettings;
use habitus::evaluation::registration_ranking::RankingConfig;
use habitus::evaluation::sequence_metrics::SequenceMetricsSettings;
use habitus::evaluation::shape_space_quality::ShapeSpaceQualitySettings;
use habitus::pipeline::BootstrapConfig;
use habitus::stages::extract_clothing::ExtractClothingConfig;
use habitus::stages::fit_sequence::FitSequenceConfig;
use habitus::stages::learn_clothing::LearnClothingConfig;
use habitus::stages::learn_shape::LearnShapeConfig;
use habitus::stages::reconstruct::ReconstructConfig;
use habitus::stages::register::RegisterConfig;
use habitus::stages::synthesize::SynthesizeConfig;
use habitus_synthetic::raw_scan::{DepthPairSettings, RawScanSettings};
use habitus_synthetic::sequence::DressedSequenceSettings;
use serde::{Deserialize, Serialize};

/// Settings of all stages, one section each.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Section of `fit-sequence`.
    pub fit_sequence: FitSequenceConfig,
    /// Section of `bootstrap`.
    pub bootstrap: BootstrapConfig,
    /// Section of `review`: how registrations are ranked, also by `bootstrap`.
    pub review: RankingConfig,
    /// Section of `extract-clothing`.
    pub extract_clothing: ExtractClothingConfig,
    /// Section of `learn-shape`.
    pub learn_shape: LearnShapeConfig,
    /// Section of `evaluate sequence` and `evaluate benchmark`.
    pub evaluate_sequence: SequenceMetricsSettings,
    /// Section of `evaluate shape-space`.
    pub evaluate_shape_space: ShapeSpaceQualitySettings,
    /// Section of `evaluate reconstructions`.
    pub evaluate_reconstructions: ReconstructionAccuracySettings,
    /// Section of `learn-clothing`.
    pub learn_clothing: LearnClothingConfig,
    /// Section of `synthesize`.
    pub synthesize: SynthesizeConfig,
    /// Section of `register`.
    pub register: RegisterConfig,
    /// Section of `reconstruct`.
    pub reconstruct: ReconstructConfig,
    /// Section of `generate` and of the sequence of `demo`.
    pub generate: DressedSequenceSettings,
    /// Section of `generate scans`, and of the people of `generate depth-pairs`.
    pub generate_scans: RawScanSettings,
    /// Section of the cameras of `generate depth-pairs`.
    pub generate_depth_pairs: DepthPairSettings,
}

/// Where settings come from.
#[derive(Clone, Debug, Default, Args)]
pub struct SettingsArguments {
    /// TOML file of settings that differ from the defaults (see: habitus config)
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One setting, such as fit_sequence.track.fine_rounds=3; may be repeated and wins over the file
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub assignments: Vec<String>,
}

impl SettingsArguments {
    /// The defaults, changed by the file, then by the assignments.
    pub fn load(&self) -> anyhow::Result<Settings> {
        let mut table = match &self.config {
            Some(path) => read_table(path)?,
            None => toml::Table::new(),
        };
        if let Some(path) = &self.config {
            // The file alone first, so that a fault of the file is not blamed on an assignment.
            table
                .clone()
                .try_into::<Settings>()
                .map_err(|error| anyhow!("{}: {}; see: habitus config", path.display(), one_line(&error)))?;
        }
        for assignment in &self.assignments {
            assign(&mut table, assignment)?;
            table
                .clone()
                .try_into::<Settings>()
                .map_err(|error| anyhow!("--set {assignment}: {}; see: habitus config", one_line(&error)))?;
        }
        Ok(table.try_into()?)
    }
}

fn one_line(error: &toml::de::Error) -> String {
    error.message().split_whitespace().collect::<Vec<_>>().join(" ")
}

fn read_table(path: &Path) -> anyhow::Result<toml::Table> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("{}: the settings cannot be read", path.display()))?;
    let start = |error: &toml::de::Error| error.span().map_or(0, |span| span.start.min(text.len()));
    text.parse().map_err(|error| {
        let line = text.as_bytes()[..start(&error)].iter().filter(|byte| **byte == b'\n').count() + 1;
        anyhow!("{}, line {line}: {}", path.display(), one_line(&error))
    })
}

fn assign(table: &mut toml::Table, assignment: &str) -> anyhow::Result<()> {
    let Some((key, word)) = assignment.split_once('=') else {
        bail!("--set {assignment}: write it as KEY=VALUE, for example fit_sequence.components=40");
    };
    // What is no TOML value, such as a bare word, is a string.
    let value = format!("value = {word}")
        .parse::<toml::Table>()
        .ok()
        .and_then(|mut parsed| parsed.remove("value"))
        .unwrap_or_else(|| toml::Value::String(word.trim().to_string()));
    let mut place = table;
    let mut parts: Vec<&str> = key.trim().split('.').collect();
    let last = parts.pop().unwrap_or_default();
    for part in parts {
        let entry = place.entry(part).or_insert_with(|| toml::Value::Table(toml::Table::new()));
        let toml::Value::Table(inner) = entry else {
            bail!("--set {assignment}: {part} is a value, not a section; see: habitus config");
        };
        place = inner;
    }
    place.insert(last.to_string(), value);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{Settings, SettingsArguments};

    fn with(assignments: &[&str]) -> Result<Settings, String> {
        let assignments = assignments.iter().map(|text| text.to_string()).collect();
        let arguments = SettingsArguments { config: None, assignments };
        arguments.load().map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn assignments_change_only_what_they_name() {
        let mut expected = Settings::default();
        assert_eq!(with(&[]).expect("the defaults"), expected);
        expected.fit_sequence.components = 12;
        expected.fit_sequence.surface.outside_weight = 2.0;
        let set = ["fit_sequence.components=12", "fit_sequence.surface.outside_weight=2.0"];
        assert_eq!(with(&set).expect("is valid"), expected);
        let recipe = with(&["fit_sequence.recipe=paper2016"]).expect("a bare word is a string");
        assert_eq!(recipe.fit_sequence.recipe, habitus::stages::fit_sequence::config::Recipe::Paper2016);
    }

    #[test]
    fn a_misspelt_setting_is_refused_by_name() {
        for (set, needle) in [
            ("fit_sequence.componets=3", "componets"),
            ("fit_sequense.components=3", "fit_sequense"),
            ("fit_sequence.components=many", "--set"),
            ("fit_sequence.components.more=3", "--set"),
            ("nonsense", "KEY=VALUE"),
        ] {
            let message = with(&[set]).expect_err(set);
            assert!(message.contains(needle), "{message}");
        }
    }
}
