//! `habitus extract-clothing`.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use habitus::artifacts::rigged_sequence::FrameRate;
use habitus::optimize::{Event, Flow, Observer};
use habitus::pipeline::{
    ClothingInput, ClothingRun, ClothingSummary, Connectivity, RunFolder, StageName, captures_of_fit,
    file_names, read_stored_fit, read_stored_layer,
};
use habitus_report::clothing_stills::association_sheet;
use habitus_report::dressed_report::extraction_report;

use crate::Outcome;
use crate::config_file::SettingsArguments;
use crate::console::Console;
use crate::progress::StageBar;
use crate::sequence_job;
use crate::side_page::{REPORT_FILE, title_of, write_side_page};

const EXAMPLES: &str = "\
Examples:
  habitus extract-clothing run -o run
  habitus extract-clothing simulated --aligned -o simulated
  habitus extract-clothing second --like run/4_extract_clothing/layer.npz -o second
  habitus extract-clothing run --aligned -o layers --captures moved/captures/
  habitus extract-clothing run --aligned -o run --set extract_clothing.association.body_vertices_per_clothing_vertex=9

RUN of the fit is a folder made by: habitus fit-sequence. The clothing is the whole dressed surface,
as offsets from the fitted body; the layer is written to RUN/4_extract_clothing/layer.npz. Beside it
report.html shows the dressed person in motion.";

/// What hangs on what, for a person to look at.
const PICTURE_FILE: &str = "association.png";
/// Width and height of each of its panels in pixels.
const PICTURE_SIZE: (usize, usize) = (300, 560);

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ExtractClothingArguments {
    /// Run folder of the fit
    pub fit: PathBuf,
    /// The captures have one connectivity already: the same vertices and faces in every frame
    #[arg(long)]
    pub aligned: bool,
    /// Layer whose vertices this one gets, so that both can be learnt from together
    #[arg(long, value_name = "LAYER")]
    pub like: Option<PathBuf>,
    /// Run folder for the layer; it may be that of the fit
    #[arg(long, short, value_name = "RUN")]
    pub output: PathBuf,
    /// Where the captures are now [default: where they were]
    #[arg(long, value_name = "INPUT")]
    pub captures: Option<PathBuf>,
    /// Do finished work again
    #[arg(long)]
    pub force: bool,
    /// Settings of the stage
    #[command(flatten)]
    pub settings: SettingsArguments,
}

/// Moves the bar.
struct BarObserver {
    bar: StageBar,
}

impl Observer for BarObserver {
    fn on_event(&mut self, event: &Event) -> Flow {
        if let Event::Progress { stage, done, total } = event {
            self.bar.show(stage, *done, *total);
        }
        Flow::Continue
    }
}

/// Extracts the layer.
pub fn run(arguments: &ExtractClothingArguments, console: &Console) -> anyhow::Result<Outcome> {
    let begin = Instant::now();
    let config = arguments.settings.load()?.extract_clothing;
    let fit = read_stored_fit(&arguments.fit)?;
    let origin = captures_of_fit(&arguments.fit, arguments.captures.as_deref())?;
    let frames = origin.frames()?;
    let rate: FrameRate = sequence_job::frame_rate(origin.frame_rate / origin.step.max(1) as f64)?;
    let like = arguments.like.as_deref().map(read_stored_layer).transpose()?;
    let run = RunFolder::open(&arguments.output)?;
    let input = ClothingInput {
        fit_file: match arguments.fit.is_file() {
            true => arguments.fit.clone(),
            false => arguments.fit.join(StageName::FitSequence.folder()).join(file_names::FIT),
        },
        fit: &fit,
        files: frames.files(),
        source: &frames,
        connectivity: if arguments.aligned { Connectivity::One } else { Connectivity::Many },
        like: arguments.like.clone().zip(like.as_ref()),
        frame_rate: rate,
        config: &config,
    };
    let stage = ClothingRun::prepare(&run, "extract-clothing", input)?;
    let summary = match stage.finished() {
        Some(summary) if !arguments.force => {
            let run = run.path().display();
            console.note(format!(
                "{run}: already finished with these inputs and settings; --force does it again"
            ));
            summary
        }
        _ => {
            if arguments.force {
                stage.start_afresh()?;
            }
            let mut observer = BarObserver { bar: StageBar::new(console) };
            let extracted = stage.extract(&mut observer);
            observer.bar.clear();
            let extracted = extracted?;
            let summary = stage.write(&extracted, begin.elapsed().as_secs_f64())?;
            // A picture that cannot be drawn must not cost the layer.
            let picture = stage.layer_file().with_file_name(PICTURE_FILE);
            let drawn = association_sheet(&extracted.layer, 0, PICTURE_SIZE.0, PICTURE_SIZE.1)
                .and_then(|sheet| sheet.save_png(&picture));
            if let Err(error) = drawn {
                console.warning(error);
            }
            let title = title_of(&arguments.output);
            match extraction_report(&title, &extracted.layer) {
                Ok(report) => {
                    let page = stage.layer_file().with_file_name(REPORT_FILE);
                    write_side_page(&page, &report.html(), console);
                }
                Err(error) => console.warning(error),
            }
            summary
        }
    };
    tell(&summary, console);
    console.result(stage.layer_file().display());
    Ok(if summary.left_out.is_empty() { Outcome::Fine } else { Outcome::Doubtful })
}

/// Frames named one by one at most.
const NAMES_SHOWN: usize = 5;

fn tell(summary: &ClothingSummary, console: &Console) {
    console.note(format!(
        "{} frames of {} clothing vertices in {:.1} s; {} vertices with a pair of their own, {} completed",
        summary.frames,
        summary.clothing_vertices,
        summary.seconds,
        summary.paired_vertices,
        summary.completed_vertices,
    ));
    for frame in summary.left_out.iter().take(NAMES_SHOWN) {
        console.warning(format!("{} is left out: {}", frame.name, frame.reason));
    }
    if summary.left_out.len() > NAMES_SHOWN {
        let more = summary.left_out.len() - NAMES_SHOWN;
        console.warning(format!("{more} more frames are left out; the summary of the stage names them"));
    }
}
