//! The benchmark of bodies under clothing: subjects × motions × styles, each with exact truth (P2 §6.1).
//!
//! Three women and three men of clearly different builds, none an instance of the fitted space, walk, turn and pull
//! their knees up in tight, layered and wide clothing. Each sequence is a folder as `generate` writes it.

use std::path::{Path, PathBuf};

use habitus::artifacts::write_atomically;
use habitus::body::BodyModel;
use serde::{Deserialize, Serialize};

use crate::capture::{CaptureMode, CaptureSettings};
use crate::clothing_data::SetSize;
use crate::error::SyntheticError;
use crate::garment::{GarmentSettings, Outfit};
use crate::motion::Motion;
use crate::sequence::{DressedSequenceSettings, Progress};
use crate::source_bodies::source_body_names;
use crate::truth::{DressedTruth, TRUTH_FILE, capture_file, write_sequence};

/// How people are dressed (P2 §6.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Style {
    /// Like a second skin.
    Tight,
    /// A long-sleeved shirt over trousers, both with room.
    Layered,
    /// A dress (women) or wide trousers (men).
    Wide,
}

impl Style {
    /// All styles, from the closest to the loosest.
    pub const ALL: [Self; 3] = [Self::Tight, Self::Layered, Self::Wide];

    /// The style that an outfit counts as.
    pub fn of(outfit: Outfit) -> Self {
        match outfit {
            Outfit::Tight => Self::Tight,
            Outfit::ShirtAndTrousers | Outfit::ShortsAndTShirt => Self::Layered,
            Outfit::Dress | Outfit::TShirtAndTrousers => Self::Wide,
        }
    }

    /// The style as it stands in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tight => "tight",
            Self::Layered => "layered",
            Self::Wide => "wide",
        }
    }
}

/// One sequence of the benchmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchmarkSequence {
    /// Name of its folder: subject, style, motion and, unless it is the visual hull, how it was captured.
    pub name: String,
    /// Name of the source body.
    pub subject: String,
    /// How the person is dressed.
    pub style: Style,
    /// What the person does.
    pub motion: String,
    /// How the person is captured.
    pub capture: CaptureMode,
    /// What the sequence is made with.
    pub settings: DressedSequenceSettings,
}

/// Subjects by the names of their source bodies: short and slight, tall, heavy; each sex.
const SUBJECTS: [&str; 6] = ["female_04", "female_02", "female_06", "male_07", "male_03", "male_01"];
/// P2 §6.1: walking, rotating the body, pulling the knees up.
const MOTIONS: [Motion; 3] = [Motion::Walk, Motion::TurnOnSpot, Motion::KneePulls];
/// P2 §6.1: 68 cameras.
const CAMERA_COUNT: usize = 68;
/// Voxels of visual hulls, millimetres: wider ones lose fingers and toes, so that a true body would lie outside its hull.
const HULL_VOXEL_MM: f64 = 8.0;
/// Name of the list of sequences in the benchmark's folder.
pub const INDEX_FILE: &str = "benchmark.json";

/// The sequences of the benchmark. The small one takes each style and each motion once for a woman and a man; the full
/// one is the whole product. `motion_files` are further motions of everybody.
pub fn plan(
    size: SetSize,
    captures: &[CaptureMode],
    seed: u64,
    motion_files: &[PathBuf],
) -> Result<Vec<BenchmarkSequence>, SyntheticError> {
    let names = source_body_names()?;
    let motions: Vec<(Motion, String, Option<&PathBuf>)> = MOTIONS
        .iter()
        .map(|motion| (*motion, motion.name().to_string(), None))
        .chain(motion_files.iter().map(|path| {
            (Motion::Walk, path.file_stem().unwrap_or_default().to_string_lossy().into_owned(), Some(path))
        }))
        .collect();
    let mut sequences = Vec::new();
    for (number, subject) in SUBJECTS.iter().enumerate() {
        let Some(source_body) = names.iter().position(|name| name == subject) else { continue };
        for (place, style) in Style::ALL.into_iter().enumerate() {
            for (turn, (motion, motion_name, motion_file)) in motions.iter().enumerate() {
                let is_in_small = (number % 3 == 1) && turn == (place + number) % MOTIONS.len();
                if size == SetSize::Small && !is_in_small {
                    continue;
                }
                for capture in captures {
                    let mut settings = settings(size, style, *capture, subject.starts_with("female"));
                    settings.seed = seed;
                    settings.source_body = source_body;
                    settings.motion = *motion;
                    settings.motion_file = motion_file.cloned();
                    let suffix = if *capture == CaptureMode::VisualHull { "" } else { "_scanner" };
                    sequences.push(BenchmarkSequence {
                        name: format!("{subject}_{}_{motion_name}{suffix}", style.name()),
                        subject: (*subject).into(),
                        style,
                        motion: motion_name.clone(),
                        capture: *capture,
                        settings,
                    });
                }
            }
        }
    }
    Ok(sequences)
}

fn settings(size: SetSize, style: Style, mode: CaptureMode, is_woman: bool) -> DressedSequenceSettings {
    let defaults = DressedSequenceSettings::default();
    let layered = GarmentSettings {
        shirt_ease_mm: 22.0,
        trouser_ease_mm: 12.0,
        trouser_hem_radius_mm: 90.0,
        ..GarmentSettings::default()
    };
    let wide_trousers =
        GarmentSettings { trouser_ease_mm: 30.0, trouser_hem_radius_mm: 170.0, ..GarmentSettings::default() };
    let (outfit, garment) = match (style, is_woman) {
        (Style::Tight, _) => (Outfit::Tight, GarmentSettings::default()),
        (Style::Layered, _) => (Outfit::ShirtAndTrousers, layered),
        (Style::Wide, true) => (Outfit::Dress, GarmentSettings::default()),
        (Style::Wide, false) => (Outfit::TShirtAndTrousers, wide_trousers),
    };
    let mut capture = CaptureSettings { mode, ..CaptureSettings::default() };
    if mode == CaptureMode::VisualHull {
        capture.camera_count = CAMERA_COUNT;
        capture.voxel_mm = HULL_VOXEL_MM;
    }
    let mut settings = DressedSequenceSettings { outfit, garment, capture, frame_count: 120, ..defaults };
    if size == SetSize::Small {
        // A short while must hold half a step and a part of a knee pull.
        settings.frame_count = 8;
        settings.frames_per_second = 15.0;
        settings.settle_seconds = 0.7;
        settings.garment.cloth_edge_mm = 30.0;
        settings.cloth.substeps_per_second = 900.0;
        settings.capture.voxel_mm = 12.0;
        settings.capture.image_height = 360;
        settings.capture.camera_count = settings.capture.camera_count.min(34);
    }
    settings
}

/// Makes one sequence in its folder, unless it is there already with the same settings; says whether it was made.
pub fn write_benchmark_sequence(
    model: &BodyModel,
    sequence: &BenchmarkSequence,
    folder: &Path,
    progress: Progress<'_>,
) -> Result<bool, SyntheticError> {
    let own = folder.join(&sequence.name);
    // The truth is written last: where it is, all captures are.
    if own.join(TRUTH_FILE).is_file()
        && DressedTruth::read(&own).is_ok_and(|truth| truth.settings == sequence.settings)
    {
        return Ok(false);
    }
    clear(&own).map_err(|error| SyntheticError::File { path: own.clone(), reason: error.to_string() })?;
    write_sequence(model, &sequence.settings, &own, progress)?;
    Ok(true)
}

/// Removes the truth and then the captures of other settings: a longer sequence would leave frames behind.
fn clear(folder: &Path) -> std::io::Result<()> {
    let truth = folder.join(TRUTH_FILE);
    if truth.is_file() {
        std::fs::remove_file(truth)?;
    }
    for frame in (0..).map(|frame| folder.join(capture_file(frame))).take_while(|path| path.is_file()) {
        std::fs::remove_file(frame)?;
    }
    Ok(())
}

/// Writes the list of sequences.
pub fn write_index(sequences: &[BenchmarkSequence], folder: &Path) -> Result<(), SyntheticError> {
    let path = folder.join(INDEX_FILE);
    let failed = |reason: String| SyntheticError::File { path: path.clone(), reason };
    let text = serde_json::to_string_pretty(sequences).map_err(|error| failed(error.to_string()))?;
    std::fs::create_dir_all(folder).map_err(|error| failed(error.to_string()))?;
    write_atomically(&path, (text + "\n").as_bytes()).map_err(|error| failed(error.to_string()))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_full_benchmark_is_the_whole_product() {
        let sequences = plan(SetSize::Full, &[CaptureMode::VisualHull], 1, &[]).unwrap();
        assert_eq!(sequences.len(), 54);
        let names: BTreeSet<&String> = sequences.iter().map(|sequence| &sequence.name).collect();
        assert_eq!(names.len(), 54);
        let women = sequences.iter().filter(|sequence| sequence.subject.starts_with("female")).count();
        assert_eq!(women, 27);
        assert!(sequences.iter().all(|sequence| sequence.settings.capture.camera_count == 68));
        assert!(sequences.iter().all(|sequence| Style::of(sequence.settings.outfit) == sequence.style));
        for sequence in sequences.iter().filter(|sequence| sequence.style == Style::Wide) {
            let is_dress = sequence.settings.outfit == Outfit::Dress;
            assert_eq!(is_dress, sequence.subject.starts_with("female"));
        }
    }

    #[test]
    fn the_small_benchmark_has_every_style_and_every_motion_for_both_sexes() {
        let sequences = plan(SetSize::Small, &[CaptureMode::VisualHull], 1, &[]).unwrap();
        assert_eq!(sequences.len(), 6);
        for sex in ["female", "male"] {
            let own = || sequences.iter().filter(|sequence| sequence.subject.starts_with(sex));
            assert_eq!(own().map(|sequence| sequence.style).collect::<BTreeSet<_>>().len(), 3);
            assert_eq!(own().map(|sequence| &sequence.motion).collect::<BTreeSet<_>>().len(), 3);
        }
    }
}
