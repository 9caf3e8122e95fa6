//! `fit_sequence` and `measure` in a run folder.
//!
//! The caller keeps the clock: it fits, fills in the seconds that it measured, and then writes.

use std::path::{Path, PathBuf};

use habitus_optimize::Observer;
use rayon::prelude::*;
use thiserror::Error;

use super::input_key::InputKey;
use super::run_folder::{RunFolder, RunFolderError, StageFolder, StageName};
use super::user_landmarks::LandmarkFileError;
use crate::artifacts::fitted_sequence::FittedSequence;
use crate::artifacts::frames::{FrameError, FrameSource};
use crate::artifacts::measurements::{Measurement, write_measurements};
use crate::artifacts::provenance::{InputFile, Provenance, ProvenanceError};
use crate::artifacts::rigged_sequence::{FrameRate, Rig, RiggedSequence};
use crate::artifacts::sequence_files::{FitFileError, read_fit, write_fit, write_landmarks};
use crate::artifacts::skinned_glb::{SkinnedGlbError, write_skinned_glb};
use crate::body::{BodyModel, ModelFileError};
use crate::stages::fit_sequence::{FitSequenceConfig, FitSequenceError, UserLandmark, fit_sequence};
use crate::stages::measure::{
    Definitions, DefinitionsError, MeasureError, measure, measure_with_uncertainty,
};

/// Why a run fails.
#[derive(Debug, Error)]
pub enum RunError {
    /// The run folder cannot be used.
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    /// The captures cannot be read.
    #[error(transparent)]
    Frames(#[from] FrameError),
    /// A folder holds files of several formats.
    #[error("{}: holds files of several formats ({formats}); name one of them with a pattern such as {}", path.display(), path.join("frame_%d.ply").display())]
    MixedFormats {
        /// The folder.
        path: PathBuf,
        /// The formats.
        formats: String,
    },
    /// The first and last frame leave nothing.
    #[error("{}: has {count} frames, counted from 0, and none from {first} to {last}; change --first or --last", path.display())]
    NothingSelected {
        /// The input.
        path: PathBuf,
        /// How many frames it has.
        count: usize,
        /// First frame asked for.
        first: usize,
        /// Last frame asked for.
        last: usize,
    },
    /// The user's landmarks cannot be used.
    #[error(transparent)]
    Landmarks(#[from] LandmarkFileError),
    /// The model cannot be used.
    #[error(transparent)]
    Model(#[from] ModelFileError),
    /// Fitting failed.
    #[error(transparent)]
    Fit(#[from] FitSequenceError),
    /// A result cannot be written or read.
    #[error(transparent)]
    Files(#[from] FitFileError),
    /// The animation cannot be written.
    #[error(transparent)]
    Animation(#[from] SkinnedGlbError),
    /// The provenance cannot be made or written.
    #[error(transparent)]
    Provenance(#[from] ProvenanceError),
    /// The definitions of measurements are broken.
    #[error(transparent)]
    Definitions(#[from] DefinitionsError),
    /// The body cannot be measured.
    #[error(transparent)]
    Measure(#[from] MeasureError),
    /// The fit was made with another model.
    #[error("the fit was made with the body model '{needed}', not with '{found}'; give it with --model")]
    OtherModel {
        /// Name of the fit's model.
        needed: String,
        /// Name of the given model.
        found: String,
    },
    /// There is no fit in the folder.
    #[error("{}: holds no finished fit (no {}); run habitus fit-sequence with -o {} first", path.display(), missing.display(), path.display())]
    NoFit {
        /// The run folder.
        path: PathBuf,
        /// The file that is missing.
        missing: PathBuf,
    },
}

/// Names of the files of the stage.
pub mod file_names {
    /// Identity, poses, rest body, landmarks and codes.
    pub const FIT: &str = "fit.npz";
    /// Skinned animation.
    pub const ANIMATION: &str = "body.glb";
    /// Landmarks of each frame.
    pub const LANDMARKS: &str = "landmarks.csv";
    /// Measurements of the body.
    pub const MEASUREMENTS: &str = "measurements.csv";
    /// Inputs, settings and versions.
    pub const PROVENANCE: &str = "provenance.toml";
    /// Finished frames of a running fit.
    pub const JOURNAL: &str = "frames.journal";
}

/// All that a fit depends on.
pub struct SequenceInput<'a> {
    /// Files of the captures, for the provenance.
    pub files: &'a [PathBuf],
    /// The captures.
    pub source: &'a dyn FrameSource,
    /// The body model.
    pub model: &'a BodyModel,
    /// Settings of the stage.
    pub config: &'a FitSequenceConfig,
    /// Landmarks that the user gives.
    pub landmarks: &'a [UserLandmark],
    /// Captured frames per second, for the animation.
    pub frame_rate: FrameRate,
}

/// A fit and what was measured on its body.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredFit {
    /// Identity and poses.
    pub fit: RiggedSequence,
    /// Measurements with their curves.
    pub measurements: Vec<Measurement>,
}

/// The stage in its run folder.
pub struct SequenceRun<'a> {
    input: SequenceInput<'a>,
    stage: StageFolder,
    provenance: Provenance,
    key: String,
}

impl<'a> SequenceRun<'a> {
    /// Reads the inputs once for the provenance; the key follows from it.
    pub fn prepare(run: &RunFolder, verb: &str, input: SequenceInput<'a>) -> Result<Self, RunError> {
        let stage = run.stage(StageName::FitSequence)?;
        let mut provenance = Provenance::new(verb, input.config, input.config.seed)?.with_model(input.model);
        provenance.inputs = input.files.par_iter().map(|path| input_file(path)).collect();
        let mut key = InputKey::new();
        key.add_text(&toml::to_string(&provenance).map_err(ProvenanceError::from)?);
        key.add_text(&serde_json::to_string(input.landmarks).unwrap_or_default());
        key.add_text(&input.frame_rate.frames_per_second().to_string());
        Ok(Self { input, stage, provenance, key: key.text() })
    }

    /// Whether the results in the folder are those of these inputs.
    pub fn is_finished(&self) -> bool {
        self.stage.is_finished(&self.key)
    }

    /// Folder of the stage.
    pub fn folder(&self) -> &Path {
        self.stage.path()
    }

    /// Throws away what earlier runs have finished.
    pub fn start_afresh(&self) -> Result<(), RunError> {
        self.stage.mark_unfinished()?;
        Ok(self.stage.remove(file_names::JOURNAL)?)
    }

    /// Frames that an earlier, killed run has tracked under the same key.
    pub fn finished_frames(&self) -> Result<usize, RunError> {
        let journal = self.stage.journal(file_names::JOURNAL, &self.key)?;
        // The first entry is the start.
        Ok(journal.finished::<serde_json::Value>().len().saturating_sub(1))
    }

    /// Fits, going on after the frames that an earlier, killed run has finished, and measures.
    pub fn fit(&self, observer: &mut dyn Observer) -> Result<MeasuredFit, RunError> {
        let input = &self.input;
        self.stage.mark_unfinished()?;
        let mut journal = self.stage.journal(file_names::JOURNAL, &self.key)?;
        let mut sequence =
            fit_sequence(input.source, input.model, input.config, input.landmarks, &mut journal, observer)?;
        // No trusted frame, no known clearance; files hold finite numbers only.
        sequence
            .smallest_clearance
            .iter_mut()
            .filter(|value| !value.is_finite())
            .for_each(|value| *value = 0.0);
        let measurements = measure_fit(input.model, &sequence)?;
        Ok(MeasuredFit { fit: RiggedSequence { sequence, rig: Rig::of(input.model) }, measurements })
    }

    /// Writes the files of the stage; only then is it finished, and the journal no longer needed.
    pub fn write(&self, result: &MeasuredFit) -> Result<(), RunError> {
        let MeasuredFit { fit, measurements } = result;
        write_fit(&self.stage.file(file_names::FIT), fit)?;
        write_landmarks(&self.stage.file(file_names::LANDMARKS), fit)?;
        let table = self.stage.file(file_names::MEASUREMENTS);
        write_measurements(&table, measurements)
            .map_err(|source| RunFolderError::Unusable { path: table, source })?;
        write_skinned_glb(&self.stage.file(file_names::ANIMATION), fit, self.input.frame_rate)?;
        self.provenance.write(&self.stage.file(file_names::PROVENANCE))?;
        self.stage.mark_finished(&self.key)?;
        Ok(self.stage.remove(file_names::JOURNAL)?)
    }
}

/// One file that cannot be read must not end a run of thousands: it becomes a failed frame.
pub(super) fn input_file(path: &Path) -> InputFile {
    InputFile::of(path).unwrap_or_else(|_| InputFile {
        name: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        size: 0,
        fingerprint: "unreadable".into(),
    })
}

/// Takes all standard measurements that the model has the names for.
fn measure_fit(model: &BodyModel, sequence: &FittedSequence) -> Result<Vec<Measurement>, RunError> {
    let (definitions, _) = Definitions::standard()?.available_in(model);
    let covariance = &sequence.identity_covariance;
    Ok(measure_with_uncertainty(model, &sequence.rest_vertices, covariance, &definitions)?)
}

/// Measures the body of a fit that was read from its file; `model` must be the one that it was fitted with.
pub fn measure_stored_fit(model: &BodyModel, fit: &RiggedSequence) -> Result<Vec<Measurement>, RunError> {
    if model.metadata().name != fit.rig.model_name || model.vertex_count() != fit.sequence.rest_vertices.len()
    {
        return Err(RunError::OtherModel {
            needed: fit.rig.model_name.clone(),
            found: model.metadata().name.clone(),
        });
    }
    measure_fit(model, &fit.sequence)
}

/// Takes the same measurements of a rest body that need not lie in the model's space; vertices in metres.
pub fn measure_rest_body(
    model: &BodyModel,
    rest_vertices: &[glam::DVec3],
) -> Result<Vec<Measurement>, RunError> {
    let (definitions, _) = Definitions::standard()?.available_in(model);
    Ok(measure(model, rest_vertices, &definitions)?)
}

/// Reads the fit of a run folder, or a fit's own file.
pub fn read_stored_fit(path: &Path) -> Result<RiggedSequence, RunError> {
    if path.is_file() {
        return Ok(read_fit(path)?);
    }
    let file = path.join(StageName::FitSequence.folder()).join(file_names::FIT);
    if !file.is_file() {
        let missing = Path::new(StageName::FitSequence.folder()).join(file_names::FIT);
        return Err(RunError::NoFit { path: path.to_path_buf(), missing });
    }
    Ok(read_fit(&file)?)
}
