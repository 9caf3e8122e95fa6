//! Landmarks of single scans: the automatic start and fit of one frame, and what they say of the landmarks.

use std::path::{Path, PathBuf};

use habitus_optimize::Silent;

use super::input_key::InputKey;
use super::run_folder::RunFolderError;
use super::sequence_run::{RunError, input_file};
use crate::artifacts::frames::{FrameError, FrameFolder};
use crate::artifacts::journal::Journal;
use crate::artifacts::provenance::{Provenance, ProvenanceError};
use crate::artifacts::rigged_sequence::{Rig, RiggedSequence};
use crate::artifacts::scan_landmarks::{LandmarksFound, ScanLandmark, ScanLandmarks, write_scan_landmarks};
use crate::body::BodyModel;
use crate::stages::fit_sequence::{FitSequenceConfig, fit_sequence};

/// Name of the file that holds what is finished.
const JOURNAL: &str = ".landmarks.journal";

/// Finds landmarks scan by scan into a folder; what is finished for an unchanged scan is not done again.
pub struct LandmarkRun<'a> {
    model: &'a BodyModel,
    config: &'a FitSequenceConfig,
    folder: PathBuf,
    journal: Journal,
    finished: Vec<ScanLandmarks>,
}

impl<'a> LandmarkRun<'a> {
    /// Opens the folder for results of this model and these settings.
    pub fn open(
        folder: &Path,
        model: &'a BodyModel,
        config: &'a FitSequenceConfig,
    ) -> Result<Self, RunError> {
        let unusable = |source| RunFolderError::Unusable { path: folder.to_path_buf(), source };
        std::fs::create_dir_all(folder).map_err(unusable)?;
        let provenance = Provenance::new("landmarks", config, config.seed)?.with_model(model);
        let mut key = InputKey::new();
        key.add_text(&toml::to_string(&provenance).map_err(ProvenanceError::from)?);
        let journal = Journal::open(&folder.join(JOURNAL), &key.text()).map_err(unusable)?;
        let finished = journal.finished();
        Ok(Self { model, config, folder: folder.to_path_buf(), journal, finished })
    }

    /// Finds the landmarks of one scan; a scan that cannot be fitted says why. The fit comes with them unless an earlier
    /// run has finished the scan.
    pub fn scan(&mut self, path: &Path) -> Result<(ScanLandmarks, Option<RiggedSequence>), RunError> {
        let scan = input_file(path);
        if let Some(found) = self.finished.iter().find(|found| found.scan == scan) {
            return Ok((found.clone(), None));
        }
        let (result, fit) = match self.fit(path) {
            Ok(fit) => (ScanLandmarks { scan, found: Some(found(&fit)), error: None }, Some(fit)),
            Err(error) => (ScanLandmarks { scan, found: None, error: Some(error.to_string()) }, None),
        };
        self.journal
            .append(&result)
            .map_err(|source| RunFolderError::Unusable { path: self.folder.clone(), source })?;
        Ok((result, fit))
    }

    fn fit(&self, path: &Path) -> Result<RiggedSequence, RunError> {
        // A folder would be a sequence, and its frames would share their identity.
        if !path.is_file() {
            let reason = "a file is needed, one for each person".into();
            return Err(FrameError::Folder { path: path.to_path_buf(), reason }.into());
        }
        let frames = FrameFolder::open(path)?;
        let sequence =
            fit_sequence(&frames, self.model, self.config, &[], &mut Journal::none(), &mut Silent)?;
        Ok(RiggedSequence { sequence, rig: Rig::of(self.model) })
    }

    /// Writes the table and the JSON of these scans.
    pub fn write(&self, scans: &[ScanLandmarks]) -> Result<(), RunError> {
        let unusable = |source| RunFolderError::Unusable { path: self.folder.clone(), source };
        Ok(write_scan_landmarks(&self.folder, scans).map_err(unusable)?)
    }
}

fn found(fit: &RiggedSequence) -> LandmarksFound {
    let sequence = &fit.sequence;
    let frames = || sequence.frames.iter();
    let landmarks = frames().take(1).flat_map(|frame| {
        fit.rig.landmarks.iter().zip(&frame.landmarks).map(|(name, landmark)| ScanLandmark {
            name: name.clone(),
            position: (sequence.input_frame.to_input(landmark.position) * frame.capture_scale).to_array(),
            confidence: landmark.confidence,
        })
    });
    let mut codes = sequence.codes.clone();
    codes.extend(frames().flat_map(|frame| frame.codes.iter().copied()));
    codes.sort_unstable();
    codes.dedup();
    LandmarksFound {
        is_ok: !codes.iter().any(|code| code.is_failure()),
        codes,
        metres_per_unit: sequence.input_frame.metres_per_unit,
        landmarks: landmarks.collect(),
    }
}
