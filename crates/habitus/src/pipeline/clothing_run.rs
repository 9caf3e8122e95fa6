//! `extract_clothing` in a run folder.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use habitus_optimize::Observer;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::capture_origin::CaptureOrigin;
use super::input_key::InputKey;
use super::run_folder::{RunFolder, RunFolderError, StageFolder, StageName};
use super::sequence_run::{RunError, file_names, input_file};
use crate::artifacts::clothing_layer::{
    AlignmentQuality, AssociationOrigin, ClothingLayer, LayerFileError, read_layer, write_layer,
};
use crate::artifacts::frames::FrameSource;
use crate::artifacts::provenance::{Provenance, ProvenanceError};
use crate::artifacts::rigged_sequence::{FrameRate, RiggedSequence};
use crate::artifacts::write_atomically;
use crate::stages::extract_clothing::{
    ClothingTemplate, DressedSurfaces, ExtractClothingConfig, ExtractClothingError, ExtractedClothing,
    LeftOutFrame, align_clothing, extract_clothing,
};

/// Name of the layer's file in the folder of the stage.
pub const LAYER_FILE: &str = "layer.npz";
/// Name of the summary in the folder of the stage.
const SUMMARY_FILE: &str = "summary.json";

/// Why the clothing of a run cannot be extracted.
#[derive(Debug, Error)]
pub enum ClothingRunError {
    /// The fit or the captures cannot be used.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The run folder cannot be used.
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    /// The captures of the fit are not known or not there.
    #[error("{}: does not say where its captures are; name them with --captures", path.display())]
    NoCaptures {
        /// The run of the fit.
        path: PathBuf,
    },
    /// The captures are others than those of the fit.
    #[error(
        "frame {index} of the captures is '{found}', that of the fit is '{needed}'; name the captures that were fitted with --captures"
    )]
    OtherCaptures {
        /// Place in the sequence, counted from 0.
        index: usize,
        /// Name in the captures.
        found: String,
        /// Name in the fit.
        needed: String,
    },
    /// Extraction failed.
    #[error(transparent)]
    Extract(#[from] ExtractClothingError),
    /// The layer cannot be written or read.
    #[error(transparent)]
    Layer(#[from] LayerFileError),
    /// The provenance cannot be made or written.
    #[error(transparent)]
    Provenance(#[from] ProvenanceError),
}

/// What is known about the vertices of the captures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Connectivity {
    /// The same vertices and faces in every frame: a simulation, or a capture that was tracked.
    One,
    /// Each frame has its own.
    Many,
}

/// All that a layer depends on.
pub struct ClothingInput<'a> {
    /// File of the fit, for the provenance.
    pub fit_file: PathBuf,
    /// The fit.
    pub fit: &'a RiggedSequence,
    /// Files of the captures, for the provenance.
    pub files: &'a [PathBuf],
    /// The captures, one for each fitted frame.
    pub source: &'a dyn FrameSource,
    /// Whether the captures have one connectivity.
    pub connectivity: Connectivity,
    /// Another layer, whose vertices and association this one gets; with its file, for the provenance.
    pub like: Option<(PathBuf, &'a ClothingLayer)>,
    /// Captured frames per second.
    pub frame_rate: FrameRate,
    /// Settings of the stage.
    pub config: &'a ExtractClothingConfig,
}

/// What other programs read of an extracted layer. The names of its keys are a contract.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClothingSummary {
    /// The verb that made the layer.
    pub verb: String,
    /// Version of the program.
    pub version: String,
    /// Frames in the layer.
    pub frames: usize,
    /// Frames that could not be used, with reasons.
    pub left_out: Vec<LeftOutFrame>,
    /// Vertices of the dressed surface.
    pub clothing_vertices: usize,
    /// Clothing vertices with a pair of their own (P3's sparse association).
    pub paired_vertices: usize,
    /// Clothing vertices that no pair reached and that follow their neighbours.
    pub completed_vertices: usize,
    /// Largest share of clothing vertices in a frame whose blended transform was nearly singular.
    pub limited_share: f64,
    /// Largest distance between a clothing vertex and its reconstruction from the layer, over all vertices and frames.
    pub round_trip_mm: f64,
    /// Mean distance of the aligned surface from its capture, over all frames.
    pub mean_to_capture_mm: f64,
    /// Mean distance of the capture from the aligned surface, over all frames.
    pub mean_from_capture_mm: f64,
    /// Share of frames with no more faces turned over than `alignment.largest_folded_share`: real cloth crumples.
    pub frames_without_folds: f64,
    /// How many frames each code fired in.
    pub codes: BTreeMap<String, usize>,
    /// Mean distance of the clothing from its anchor on the body, over all vertices and frames.
    pub mean_offset_mm: f64,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// The stage in its run folder.
pub struct ClothingRun<'a> {
    input: ClothingInput<'a>,
    stage: StageFolder,
    provenance: Provenance,
    key: String,
}

impl<'a> ClothingRun<'a> {
    /// Reads the inputs once for the provenance; the key follows from it.
    pub fn prepare(run: &RunFolder, verb: &str, input: ClothingInput<'a>) -> Result<Self, ClothingRunError> {
        check_names(input.fit, input.source)?;
        let stage = run.stage(StageName::ExtractClothing)?;
        let mut provenance = Provenance::new(verb, input.config, 0)?;
        provenance.inputs = std::iter::once(&input.fit_file)
            .chain(input.like.as_ref().map(|(path, _)| path))
            .chain(input.files)
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|path| input_file(path))
            .collect();
        let mut key = InputKey::new();
        key.add_text(&toml::to_string(&provenance).map_err(ProvenanceError::from)?);
        key.add_text(&format!("{:?}", input.connectivity));
        key.add_text(&input.frame_rate.frames_per_second().to_string());
        Ok(Self { input, stage, provenance, key: key.text() })
    }

    /// The summary, if the results in the folder are those of these inputs.
    pub fn finished(&self) -> Option<ClothingSummary> {
        let text = std::fs::read_to_string(self.stage.file(SUMMARY_FILE)).ok()?;
        self.stage.is_finished(&self.key).then(|| serde_json::from_str(&text).ok())?
    }

    /// Throws away what earlier runs have finished.
    pub fn start_afresh(&self) -> Result<(), ClothingRunError> {
        self.stage.mark_unfinished()?;
        Ok(self.stage.remove(file_names::JOURNAL)?)
    }

    /// The layer's file.
    pub fn layer_file(&self) -> PathBuf {
        self.stage.file(LAYER_FILE)
    }

    /// Extracts the layer, going on after the frames that an earlier, killed run has aligned.
    pub fn extract(&self, observer: &mut dyn Observer) -> Result<ExtractedClothing, ClothingRunError> {
        self.stage.mark_unfinished()?;
        let input = &self.input;
        let like = input.like.as_ref().map(|(_, layer)| *layer);
        let (rate, config) = (input.frame_rate, input.config);
        match input.connectivity {
            Connectivity::One => {
                let surfaces = DressedSurfaces::Captured(input.source);
                let association = like.map(|layer| &layer.association);
                Ok(extract_clothing(input.fit, surfaces, association, rate, config, observer)?)
            }
            Connectivity::Many => {
                let mut journal = self.stage.journal(file_names::JOURNAL, &self.key)?;
                let template = match like {
                    None => ClothingTemplate::from_captures(input.fit, input.source, config)?,
                    Some(layer) => ClothingTemplate::from_layer(layer)?,
                };
                let alignment = &config.alignment;
                let aligned =
                    align_clothing(input.fit, input.source, &template, alignment, &mut journal, observer)?;
                let surfaces = DressedSurfaces::Aligned(&aligned);
                let association = like.map(|_| template.association());
                let mut extracted =
                    extract_clothing(input.fit, surfaces, association, rate, config, observer)?;
                extracted.name_reasons(&aligned.left_out);
                Ok(extracted)
            }
        }
    }

    /// Writes the files of the stage.
    pub fn write(
        &self,
        extracted: &ExtractedClothing,
        seconds: f64,
    ) -> Result<ClothingSummary, ClothingRunError> {
        write_layer(&self.layer_file(), &extracted.layer)?;
        let summary = self.summarise(extracted, seconds);
        let path = self.stage.file(SUMMARY_FILE);
        let text = serde_json::to_string_pretty(&summary).unwrap_or_default() + "\n";
        write_atomically(&path, text.as_bytes())
            .map_err(|source| RunFolderError::Unusable { path, source })?;
        self.provenance.write(&self.stage.file(file_names::PROVENANCE))?;
        self.stage.mark_finished(&self.key)?;
        self.stage.remove(file_names::JOURNAL)?;
        Ok(summary)
    }

    fn summarise(&self, extracted: &ExtractedClothing, seconds: f64) -> ClothingSummary {
        let layer = &extracted.layer;
        let completed =
            layer.association.origins.iter().filter(|origin| **origin == AssociationOrigin::Completed);
        let lengths =
            layer.offsets.as_chunks::<3>().0.iter().map(|[x, y, z]| f64::from(x * x + y * y + z * z).sqrt());
        let count = layer.frames.len().max(1) as f64;
        let mean = |of: fn(&AlignmentQuality) -> f64| {
            layer.frames.iter().map(|frame| of(&frame.quality)).sum::<f64>() / count
        };
        let mut codes = BTreeMap::new();
        for code in layer.frames.iter().flat_map(|frame| &frame.codes) {
            *codes.entry(code.name().to_string()).or_default() += 1;
        }
        ClothingSummary {
            verb: self.provenance.verb.clone(),
            version: self.provenance.version.clone(),
            frames: layer.frames.len(),
            left_out: extracted.left_out.clone(),
            clothing_vertices: layer.clothing_vertex_count(),
            paired_vertices: extracted.paired_vertices,
            completed_vertices: completed.count(),
            limited_share: extracted.limited_share,
            round_trip_mm: extracted.round_trip * 1000.0,
            mean_to_capture_mm: mean(|quality| quality.mean_to_capture) * 1000.0,
            mean_from_capture_mm: mean(|quality| quality.mean_from_capture) * 1000.0,
            frames_without_folds: layer
                .frames
                .iter()
                .filter(|frame| {
                    frame.quality.folded_share <= self.input.config.alignment.largest_folded_share
                })
                .count() as f64
                / count,
            codes,
            mean_offset_mm: 1000.0 * lengths.sum::<f64>() / (layer.offsets.len() / 3).max(1) as f64,
            seconds,
        }
    }
}

fn check_names(fit: &RiggedSequence, source: &dyn FrameSource) -> Result<(), ClothingRunError> {
    let names = fit.sequence.frames.iter().map(|frame| &frame.name);
    for (index, needed) in names.enumerate().take(source.len()) {
        let found = source.name(index);
        if found != *needed {
            return Err(ClothingRunError::OtherCaptures { index, found, needed: needed.clone() });
        }
    }
    Ok(())
}

/// The captures of a fitted run, or others that the user names, with the same selection of frames.
pub fn captures_of_fit(run: &Path, named: Option<&Path>) -> Result<CaptureOrigin, ClothingRunError> {
    match (CaptureOrigin::read(run), named) {
        (Some(origin), None) => Ok(origin),
        (Some(origin), Some(input)) => Ok(CaptureOrigin { input: input.to_path_buf(), ..origin }),
        (None, Some(input)) => {
            Ok(CaptureOrigin { input: input.to_path_buf(), first: 0, last: None, step: 1, frame_rate: 30.0 })
        }
        (None, None) => Err(ClothingRunError::NoCaptures { path: run.to_path_buf() }),
    }
}

/// Reads the layer of a run folder, or a layer's own file.
pub fn read_stored_layer(path: &Path) -> Result<ClothingLayer, ClothingRunError> {
    let in_run = path.join(StageName::ExtractClothing.folder()).join(LAYER_FILE);
    let file = if path.is_file() { path } else { in_run.as_path() };
    Ok(read_layer(file)?)
}
