//! Where a result comes from: program, settings, inputs, model and seed, written beside every artifact.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::write_atomically;
use crate::body::BodyModel;

/// Why a provenance cannot be made, written or read.
#[derive(Debug, Error)]
pub enum ProvenanceError {
    /// A file cannot be read.
    #[error("{}: cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The provenance cannot be written.
    #[error("{}: cannot be written ({source})", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The settings have no form in TOML, for example a whole number above 2⁶³.
    #[error("the settings cannot be written as TOML ({0})")]
    Settings(#[from] toml::ser::Error),
    /// The file is not a provenance.
    #[error("{}: is not a provenance file ({source})", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: toml::de::Error,
    },
}

/// How a result was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Always `habitus`.
    pub program: String,
    /// Version of the program.
    pub version: String,
    /// What was asked for, for example `fit-sequence`.
    pub verb: String,
    /// Seed of every random step.
    pub seed: u64,
    /// The body model, if one was used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelOrigin>,
    /// Every setting with its effective value.
    pub config: toml::Table,
    /// The inputs in order.
    #[serde(default)]
    pub inputs: Vec<InputFile>,
}

/// Which body model was used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelOrigin {
    /// Its name.
    pub name: String,
    /// Licence of its data.
    pub license: String,
    /// Fingerprint of its numbers, independent of how its file was packed.
    pub fingerprint: String,
}

/// One input file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputFile {
    /// Its name without folders.
    pub name: String,
    /// Bytes.
    pub size: u64,
    /// Fingerprint of its contents.
    pub fingerprint: String,
}

impl Provenance {
    /// A provenance of this version of the program; `config` is the whole effective configuration.
    pub fn new(verb: &str, config: &impl Serialize, seed: u64) -> Result<Self, ProvenanceError> {
        Ok(Self {
            program: "habitus".into(),
            version: env!("CARGO_PKG_VERSION").into(),
            verb: verb.into(),
            seed,
            model: None,
            config: toml::Table::try_from(config)?,
            inputs: Vec::new(),
        })
    }

    /// Notes the model.
    pub fn with_model(mut self, model: &BodyModel) -> Self {
        self.model = Some(ModelOrigin::of(model));
        self
    }

    /// Reads and notes input files.
    pub fn with_inputs(mut self, paths: &[PathBuf]) -> Result<Self, ProvenanceError> {
        for path in paths {
            self.inputs.push(InputFile::of(path)?);
        }
        Ok(self)
    }

    /// Writes `provenance.toml`.
    pub fn write(&self, path: &Path) -> Result<(), ProvenanceError> {
        let text = toml::to_string_pretty(self)?;
        write_atomically(path, text.as_bytes())
            .map_err(|source| ProvenanceError::Unwritable { path: path.to_path_buf(), source })
    }

    /// Reads `provenance.toml`.
    pub fn read(path: &Path) -> Result<Self, ProvenanceError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ProvenanceError::Unreadable { path: path.to_path_buf(), source })?;
        toml::from_str(&text)
            .map_err(|source| ProvenanceError::Malformed { path: path.to_path_buf(), source })
    }
}

impl ModelOrigin {
    /// Name, licence and fingerprint of a model.
    pub fn of(model: &BodyModel) -> Self {
        let mut fingerprint = Fingerprint::default();
        for vertex in model.mean_vertices() {
            vertex.to_array().iter().for_each(|value| fingerprint.add(&value.to_le_bytes()));
        }
        for face in model.faces() {
            face.iter().for_each(|vertex| fingerprint.add(&vertex.to_le_bytes()));
        }
        for vertex in 0..model.vertex_count() {
            let basis = model.surface().vertex_basis(vertex);
            basis.iter().for_each(|value| fingerprint.add(&value.to_le_bytes()));
            for (bone, weight) in model.surface().skin().of(vertex) {
                fingerprint.add(&bone.to_le_bytes());
                fingerprint.add(&weight.to_le_bytes());
            }
        }
        for axis in model.skeleton().axes() {
            axis.direction.to_array().iter().for_each(|value| fingerprint.add(&value.to_le_bytes()));
        }
        Self {
            name: model.metadata().name.clone(),
            license: model.metadata().license.clone(),
            fingerprint: fingerprint.text(),
        }
    }
}

impl InputFile {
    /// Name, size and fingerprint of a file.
    pub fn of(path: &Path) -> Result<Self, ProvenanceError> {
        let unreadable = |source| ProvenanceError::Unreadable { path: path.to_path_buf(), source };
        let mut file = File::open(path).map_err(unreadable)?;
        let mut fingerprint = Fingerprint::default();
        let mut size = 0;
        let mut block = vec![0; 1 << 16];
        loop {
            let length = file.read(&mut block).map_err(unreadable)?;
            if length == 0 {
                break;
            }
            size += length as u64;
            fingerprint.add(&block[..length]);
        }
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { name, size, fingerprint: fingerprint.text() })
    }
}

/// FNV-1a with 64 bits: tells changed contents from unchanged ones, not friend from foe.
struct Fingerprint(u64);

impl Default for Fingerprint {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fingerprint {
    fn add(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    fn text(&self) -> String {
        format!("fnv1a64:{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use serde::Serialize;

    use super::{Fingerprint, InputFile, ModelOrigin, Provenance, ProvenanceError};
    use crate::body::fixture;

    #[derive(Serialize)]
    struct Settings {
        rounds: u32,
        solver: Solver,
    }

    #[derive(Serialize)]
    struct Solver {
        tolerance: f64,
    }

    const SETTINGS: Settings = Settings { rounds: 4, solver: Solver { tolerance: 0.25 } };

    #[test]
    fn fingerprints_are_the_published_ones() {
        for (text, expected) in
            [("", "cbf29ce484222325"), ("a", "af63dc4c8601ec8c"), ("foobar", "85944171f73967e8")]
        {
            let mut fingerprint = Fingerprint::default();
            fingerprint.add(text.as_bytes());
            assert_eq!(fingerprint.text(), format!("fnv1a64:{expected}"));
        }
    }

    #[test]
    fn a_provenance_is_read_back_as_written() {
        let folder = tempfile::tempdir().unwrap();
        let input = folder.path().join("frame 1.ply");
        std::fs::write(&input, b"foobar").unwrap();
        let path = folder.path().join("provenance.toml");
        let provenance = Provenance::new("fit-sequence", &SETTINGS, 7)
            .unwrap()
            .with_model(&fixture::model())
            .with_inputs(&[input.clone(), input])
            .unwrap();
        provenance.write(&path).unwrap();
        assert_eq!(Provenance::read(&path).unwrap(), provenance);
        let text = std::fs::read_to_string(&path).unwrap();
        for line in [
            "verb = \"fit-sequence\"",
            "seed = 7",
            "tolerance = 0.25",
            "name = \"frame 1.ply\"",
            "size = 6",
            "fingerprint = \"fnv1a64:85944171f73967e8\"",
        ] {
            assert!(text.contains(line), "{line} is missing from\n{text}");
        }
        let own_folder = folder.path().display().to_string();
        assert!(!text.contains(&own_folder), "no machine's folders in results");
    }

    #[test]
    fn a_provenance_without_model_and_inputs_is_complete() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("provenance.toml");
        let provenance = Provenance::new("generate", &SETTINGS, 0).unwrap();
        provenance.write(&path).unwrap();
        assert_eq!(Provenance::read(&path).unwrap(), provenance);
    }

    #[test]
    fn a_model_keeps_its_fingerprint_through_its_file_and_loses_it_by_a_change() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.npz");
        let model = fixture::model();
        model.save(&path).unwrap();
        let loaded = crate::body::BodyModel::load(&path).unwrap();
        assert_eq!(ModelOrigin::of(&loaded), ModelOrigin::of(&model));
        assert_ne!(ModelOrigin::of(&fixture::model_with_segments(8)), ModelOrigin::of(&model));
    }

    #[test]
    fn broken_and_missing_files_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("provenance.toml");
        std::fs::write(&path, "verb = 3").unwrap();
        let malformed = Provenance::read(&path).unwrap_err();
        assert!(matches!(malformed, ProvenanceError::Malformed { .. }));
        assert!(malformed.to_string().contains("provenance.toml"));
        assert!(matches!(InputFile::of(Path::new("nowhere.ply")), Err(ProvenanceError::Unreadable { .. })));
    }
}
