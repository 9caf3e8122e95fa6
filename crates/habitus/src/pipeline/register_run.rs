//! `register` over many scans in a run folder: each scan's result is kept as soon as it is there.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use habitus_geometry::io::Format;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::input_key::InputKey;
use super::run_folder::{RunFolder, RunFolderError, StageFolder, StageName};
use crate::artifacts::codes::Code;
use crate::artifacts::frames::{FrameError, FrameFolder};
use crate::artifacts::provenance::{InputFile, Provenance, ProvenanceError};
use crate::artifacts::registered_scan::{
    RegisteredScan, RegistrationFileError, RegistrationQuality, RegistrationRecord, mesh_file,
};
use crate::artifacts::scan::{Scan, ScanError, ScanLandmarks, scan_name};
use crate::artifacts::write_atomically;
use crate::stages::register::{PreparedTemplate, RegisterConfig, RegisterError, Template, register};

/// Why registrations cannot be begun or summed up.
#[derive(Debug, Error)]
pub enum RegisterRunError {
    /// The run folder cannot be used.
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    /// The scans cannot be listed.
    #[error(transparent)]
    Scans(#[from] FrameError),
    /// Two scans have one name.
    #[error("{} and {} have the same name '{name}'; results are named after scans: rename one", first.display(), second.display())]
    SameName {
        /// The name.
        name: String,
        /// One file.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// One file of landmarks cannot belong to several scans.
    #[error("{}: is one file of landmarks for {scans} scans; give a folder with a file for each", path.display())]
    OneLandmarkFile {
        /// The file.
        path: PathBuf,
        /// Number of scans.
        scans: usize,
    },
    /// The template cannot be prepared.
    #[error(transparent)]
    Template(#[from] RegisterError),
    /// The provenance cannot be made or written.
    #[error(transparent)]
    Provenance(#[from] ProvenanceError),
    /// The summary cannot be written or read.
    #[error("{}: {reason}", path.display())]
    Summary {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// Why one scan has no registration.
#[derive(Debug, Error)]
enum ScanFailure {
    #[error(transparent)]
    Scan(#[from] ScanError),
    #[error(transparent)]
    Register(#[from] RegisterError),
    #[error(transparent)]
    Provenance(#[from] ProvenanceError),
    #[error(transparent)]
    File(#[from] RegistrationFileError),
}

/// One scan to be registered.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanInput {
    /// Name of the scan, and of its results.
    pub name: String,
    /// The scan.
    pub scan: PathBuf,
    /// Its landmarks, if there are any.
    pub landmarks: Option<PathBuf>,
}

/// Lists scans (files, folders, patterns) and the landmarks that belong to them.
pub fn list_scans(inputs: &[PathBuf], landmarks: Option<&Path>) -> Result<Vec<ScanInput>, RegisterRunError> {
    let mut by_name: BTreeMap<String, PathBuf> = BTreeMap::new();
    let mut scans = Vec::new();
    for input in inputs {
        for file in FrameFolder::open(input)?.files().iter().filter(|file| Format::of_path(file).is_some()) {
            let name = scan_name(file);
            if let Some(first) = by_name.insert(name.clone(), file.clone()) {
                return Err(RegisterRunError::SameName { name, first, second: file.clone() });
            }
            scans.push(ScanInput { name, scan: file.clone(), landmarks: None });
        }
    }
    match landmarks {
        Some(path) if path.is_dir() => {
            for scan in &mut scans {
                scan.landmarks = ScanLandmarks::find_in(path, &scan.name);
            }
        }
        Some(path) => {
            if let [only] = scans.as_mut_slice() {
                only.landmarks = Some(path.to_path_buf());
            } else {
                return Err(RegisterRunError::OneLandmarkFile {
                    path: path.to_path_buf(),
                    scans: scans.len(),
                });
            }
        }
        None => {}
    }
    Ok(scans)
}

/// What became of one scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanSummary {
    /// Name of the scan.
    pub name: String,
    /// How well the registration lies, if there is one.
    #[serde(flatten)]
    pub quality: Option<RegistrationQuality>,
    /// All codes that fired.
    #[serde(default)]
    pub codes: Vec<Code>,
    /// Why there is no registration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

impl ScanSummary {
    /// Whether the registration may be used unseen.
    pub fn is_ok(&self) -> bool {
        self.error.is_none() && !self.codes.iter().any(|code| code.is_failure())
    }
}

/// The contents of `summary.json` of a run of `register`. The names of its keys are a contract.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegisterSummary {
    /// The verb that made the run.
    pub verb: String,
    /// Version of the program.
    pub version: String,
    /// The recipe.
    pub recipe: String,
    /// Name of the template.
    pub template: String,
    /// Number of scans.
    pub scan_count: usize,
    /// Number of scans without a registration that may be used unseen.
    pub failed_scans: usize,
    /// Means over the registered scans, millimetres: point to surface, held out, surface to point.
    pub means_mm: [f64; 3],
    /// Seconds from the first scan read to the last result written.
    pub total_seconds: f64,
    /// Largest memory in use, where the system tells.
    pub peak_memory_mb: Option<f64>,
    /// Each scan in order.
    pub scans: Vec<ScanSummary>,
}

impl RegisterSummary {
    /// Whether every registration may be used unseen.
    pub fn is_ok(&self) -> bool {
        self.failed_scans == 0
    }

    /// Writes the file.
    pub fn write(&self, path: &Path) -> Result<(), RegisterRunError> {
        let failed = |reason: String| RegisterRunError::Summary { path: path.to_path_buf(), reason };
        let text = serde_json::to_string_pretty(self).map_err(|error| failed(error.to_string()))?;
        write_atomically(path, (text + "\n").as_bytes()).map_err(|error| failed(error.to_string()))
    }

    /// Reads the file.
    pub fn read(path: &Path) -> Result<Self, RegisterRunError> {
        let failed = |reason: String| RegisterRunError::Summary { path: path.to_path_buf(), reason };
        let text = std::fs::read_to_string(path).map_err(|error| failed(error.to_string()))?;
        serde_json::from_str(&text).map_err(|error| failed(error.to_string()))
    }
}

/// The stage in its run folder.
pub struct RegisterRun<'a> {
    stage: StageFolder,
    template: PreparedTemplate<'a>,
    config: &'a RegisterConfig,
    provenance: Provenance,
    template_name: String,
}

impl<'a> RegisterRun<'a> {
    /// Prepares the template; `template_files` are those it was read from, for the provenance, and `landmark_table`
    /// replaces its own landmarks.
    pub fn prepare(
        run: &RunFolder,
        template: Template<'a>,
        template_files: &[PathBuf],
        landmark_table: Option<Vec<(String, u32)>>,
        config: &'a RegisterConfig,
    ) -> Result<Self, RegisterRunError> {
        Self::prepare_in(run.stage(StageName::Register)?, template, template_files, landmark_table, config)
    }

    /// The same in a folder of the caller's choice.
    pub fn prepare_in(
        stage: StageFolder,
        template: Template<'a>,
        template_files: &[PathBuf],
        landmark_table: Option<Vec<(String, u32)>>,
        config: &'a RegisterConfig,
    ) -> Result<Self, RegisterRunError> {
        let mut provenance = Provenance::new("register", config, config.seed)?.with_inputs(template_files)?;
        if let Template::Model(model) = template {
            provenance = provenance.with_model(model);
        }
        let template_name = template.name().to_string();
        let template = PreparedTemplate::new(template, landmark_table, config)?;
        Ok(Self { stage, template, config, provenance, template_name })
    }

    /// Folder of the stage.
    pub fn folder(&self) -> &Path {
        self.stage.path()
    }

    /// What the registration of a scan depends on.
    fn key(&self, scan: &ScanInput) -> Result<String, ProvenanceError> {
        let mut key = InputKey::new();
        key.add_text(&toml::to_string(&self.provenance)?);
        for (name, vertex) in self.template.landmarks() {
            key.add_text(&format!("{name} {vertex}"));
        }
        for file in [Some(&scan.scan), scan.landmarks.as_ref()].into_iter().flatten() {
            let input = InputFile::of(file)?;
            key.add_text(&input.name);
            key.add_text(&input.fingerprint);
        }
        Ok(key.text())
    }

    /// Registers every scan that is not registered already, in parallel. `clock` gives seconds; `progress` is called once
    /// for each scan.
    pub fn run(
        &self,
        scans: &[ScanInput],
        is_forced: bool,
        clock: &(dyn Fn() -> f64 + Sync),
        progress: &(dyn Fn(&ScanSummary) + Sync),
    ) -> Vec<ScanSummary> {
        scans
            .par_iter()
            .with_max_len(1)
            .map(|scan| {
                let summary = match self.register_one(scan, is_forced, clock) {
                    Ok(record) => ScanSummary {
                        name: scan.name.clone(),
                        quality: Some(record.quality),
                        codes: record.codes,
                        error: None,
                    },
                    Err(failure) => ScanSummary {
                        name: scan.name.clone(),
                        quality: None,
                        codes: vec![Code::UnreadableFrame],
                        error: Some(failure.to_string()),
                    },
                };
                progress(&summary);
                summary
            })
            .collect()
    }

    fn register_one(
        &self,
        input: &ScanInput,
        is_forced: bool,
        clock: &(dyn Fn() -> f64 + Sync),
    ) -> Result<RegistrationRecord, ScanFailure> {
        let key = self.key(input)?;
        let folder = self.stage.path();
        if !is_forced
            && let Ok(record) = RegistrationRecord::read(folder, &input.name)
            && record.key == key
            && mesh_file(folder, &input.name).is_file()
        {
            return Ok(record);
        }
        let begin = clock();
        let scan = Scan::read(&input.scan, input.landmarks.as_deref())?;
        let mut registered: RegisteredScan = register(&scan, &self.template)?;
        registered.record.key = key;
        registered.record.quality.seconds = clock() - begin;
        registered.write(folder)?;
        Ok(registered.record)
    }

    /// Sums up and writes the provenance; time and memory are the caller's to measure.
    pub fn finish(
        &self,
        scans: Vec<ScanSummary>,
        total_seconds: f64,
        peak_memory_mb: Option<f64>,
    ) -> Result<RegisterSummary, RegisterRunError> {
        self.provenance.write(&self.stage.file("provenance.toml"))?;
        let qualities: Vec<&RegistrationQuality> =
            scans.iter().filter_map(|scan| scan.quality.as_ref()).collect();
        let count = qualities.len().max(1) as f64;
        let mean = |value: fn(&RegistrationQuality) -> f64| {
            qualities.iter().map(|quality| value(quality)).sum::<f64>() / count
        };
        let recipe = serde_json::to_value(self.config.recipe).ok();
        Ok(RegisterSummary {
            verb: "register".into(),
            version: env!("CARGO_PKG_VERSION").into(),
            recipe: recipe.and_then(|name| name.as_str().map(String::from)).unwrap_or_default(),
            template: self.template_name.clone(),
            scan_count: scans.len(),
            failed_scans: scans.iter().filter(|scan| !scan.is_ok()).count(),
            means_mm: [
                mean(|quality| quality.point_to_surface_mm.mean),
                mean(|quality| quality.held_out_mm.mean),
                mean(|quality| quality.surface_to_point_mm.mean),
            ],
            total_seconds,
            peak_memory_mb,
            scans,
        })
    }
}
