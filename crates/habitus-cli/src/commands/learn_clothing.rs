//! `habitus learn-clothing`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use habitus::pipeline::learn_clothing_files;
use habitus::stages::learn_clothing::{ClothingRecipe, ClothingSplit};
use habitus_report::dressed_report::model_report;

use crate::Outcome;
use crate::clock::StageClock;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::{RunObserver, StageBar};
use crate::side_page::{title_of, write_side_page};

const EXAMPLES: &str = "\
Examples:
  habitus learn-clothing run -o model.npz
  habitus learn-clothing run_walk run_turn -o model.npz --components 100
  habitus learn-clothing fabrics/* -o model.npz --parameters fabrics/parameters.csv
  habitus learn-clothing run -o model.npz --recipe paper2018 --split block

The errors that are printed are those of frames that were set aside. Beside the model a page of the
same name (model.html) shows it in motion.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct LearnClothingArguments {
    /// Runs with a clothing layer, or layer files; of one outfit
    #[arg(required = true, value_name = "LAYER")]
    pub layers: Vec<PathBuf>,
    /// The model's file
    #[arg(long, short, value_name = "FILE")]
    pub output: PathBuf,
    /// Components of the layer [default: 40 for one sequence, 100 for several]
    #[arg(long, value_name = "N")]
    pub components: Option<usize>,
    /// Table of fabrics or sizes: one row a sequence, its name first
    #[arg(long, value_name = "FILE")]
    pub parameters: Option<PathBuf>,
    /// How the motion is learnt
    #[arg(long, value_enum)]
    pub recipe: Option<RecipeName>,
    /// Which frames are set aside to measure the prediction
    #[arg(long, value_enum)]
    pub split: Option<SplitName>,
    /// Settings of the stage
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// The recipes.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum RecipeName {
    /// Kernel regression for each part of the body
    Default,
    /// The network of the paper
    Paper2018,
}

/// The splits.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum SplitName {
    /// Frames drawn at random
    Paper,
    /// The last frames of each sequence
    Block,
}

/// Learns and writes the model.
pub fn run(arguments: &LearnClothingArguments, console: &Console) -> anyhow::Result<Outcome> {
    let mut config = arguments.settings.load()?.learn_clothing;
    match arguments.recipe {
        Some(RecipeName::Default) => config.recipe = ClothingRecipe::Default,
        Some(RecipeName::Paper2018) => config.recipe = ClothingRecipe::Paper2018,
        None => {}
    }
    match arguments.split {
        Some(SplitName::Paper) => config.split = ClothingSplit::Paper,
        Some(SplitName::Block) => config.split = ClothingSplit::Block,
        None => {}
    }
    if let Some(components) = arguments.components {
        config.components = components;
        config.components_of_several = components;
    }
    let mut clock = StageClock::start();
    let mut observer = RunObserver { bar: StageBar::new(console), clock: &mut clock };
    let model = learn_clothing_files(
        &arguments.layers,
        arguments.parameters.as_deref(),
        &arguments.output,
        &config,
        &mut observer,
    )?;
    observer.bar.clear();
    let page = model_report(&title_of(&arguments.output), &model).html();
    write_side_page(&arguments.output.with_extension("html"), &page, console);
    let record = &model.record;
    console.result(format!(
        "{}: {} frames of {} sequences, {:.1} s\nerror of the frames learnt from  {:6.2} mm\nerror of the frames \
         set aside    {:6.2} mm",
        arguments.output.display(),
        record.frames,
        record.sequences.len(),
        clock.seconds().total,
        record.train_mm,
        record.prediction_mm,
    ));
    Ok(Outcome::Fine)
}
