//! `learn_shape` from a folder of registrations to a model file.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus_geometry::guess_unit;
use habitus_geometry::io::{ReadError, read_mesh};
use habitus_optimize::Observer;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::registered_run::registration_folder;
use crate::artifacts::provenance::{Provenance, ProvenanceError};
use crate::artifacts::registered_scan::RegistrationRecord;
use crate::artifacts::review_decisions::{DecisionsError, ReviewDecisions, Verdict};
use crate::body::{BodyModel, ModelFileError, SpaceOrigin};
use crate::stages::learn_shape::{LearnShapeConfig, LearnShapeError, LearntShape, Registration, learn_shape};

/// Why a folder gives no model.
#[derive(Debug, Error)]
pub enum LearnFolderError {
    /// The folder cannot be listed.
    #[error("{}: the registrations cannot be listed ({source})", path.display())]
    Unlistable {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A list beside the registrations cannot be read.
    #[error("{}: {reason}", path.display())]
    List {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Decisions cannot be read.
    #[error(transparent)]
    Decisions(#[from] DecisionsError),
    /// No usable registration is there.
    #[error("{}: holds no usable registration (PLY in the base model's topology); register scans first, or look at {}", path.display(), DECISIONS)]
    Nothing {
        /// The folder.
        path: PathBuf,
    },
    /// Learning failed.
    #[error(transparent)]
    Learn(#[from] LearnShapeError),
    /// The model cannot be written.
    #[error(transparent)]
    Model(#[from] ModelFileError),
    /// The provenance cannot be made or written.
    #[error(transparent)]
    Provenance(#[from] ProvenanceError),
}

/// Name of the file that says which registrations a person accepted or rejected.
const DECISIONS: &str = ReviewDecisions::FILE;
/// Name of the table that says which sex a subject has.
const SUBJECTS: &str = "subjects.csv";

/// Whose registrations are learnt from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SubjectGroup {
    /// All.
    #[default]
    Everyone,
    /// Those that the table of subjects calls female.
    Female,
    /// Those that the table of subjects calls male.
    Male,
}

/// Registrations of a folder and what was left out.
#[derive(Clone, Debug, Default)]
pub struct RegistrationFolder {
    /// Usable registrations in the order of their names.
    pub registrations: Vec<Registration>,
    /// Their files.
    pub files: Vec<PathBuf>,
    /// Names of registrations that a person rejected, and of those of the other sex.
    pub left_out: Vec<String>,
    /// Registrations that cannot be used, with the reason.
    pub unusable: Vec<(String, String)>,
}

impl RegistrationFolder {
    /// Reads all PLY files of a folder, or the registrations of a run folder (of its last round), in the topology of `base`.
    ///
    /// A file that cannot be read or has another topology is set aside with its reason; `decisions.toml` in the folder or
    /// the run is honoured. Lengths come from the registration's record, or are guessed from the largest extent.
    pub fn read(
        path: &Path,
        base: &BodyModel,
        group: SubjectGroup,
        mut hear: impl FnMut(usize, usize),
    ) -> Result<Self, LearnFolderError> {
        let staged = registration_folder(path);
        let folder = if staged.is_dir() { staged } else { path.to_path_buf() };
        let files = mesh_files(&folder)?;
        let rejected = rejected_names(&[&folder.join(DECISIONS), &path.join(DECISIONS)])?;
        let members = group_members(&folder.join(SUBJECTS), group)?;
        let mut found = Self::default();
        let total = files.len();
        for (batch, chunk) in files.chunks(64).enumerate() {
            let read: Vec<_> = chunk.par_iter().map(|file| (file, read_registration(file, base))).collect();
            for (file, result) in read {
                let name = stem(file);
                let is_member = members.as_ref().is_none_or(|members| members.contains(&name));
                match result {
                    _ if rejected.contains(&name) || !is_member => found.left_out.push(name),
                    Ok(vertices) => {
                        found.registrations.push(Registration { name, vertices });
                        found.files.push(file.clone());
                    }
                    Err(reason) => found.unusable.push((name, reason)),
                }
            }
            hear((batch * 64 + chunk.len()).min(total), total);
        }
        if found.registrations.is_empty() {
            return Err(LearnFolderError::Nothing { path: folder });
        }
        Ok(found)
    }
}

/// Learns a model and writes it with its provenance beside it (`model.npz` and `model.provenance.toml`).
pub fn learn_shape_to_file(
    folder: &RegistrationFolder,
    base: &BodyModel,
    config: &LearnShapeConfig,
    output: &Path,
    observer: &mut dyn Observer,
) -> Result<LearntShape, LearnFolderError> {
    let provenance = Provenance::new("learn-shape", config, config.space.seed)?
        .with_model(base)
        .with_inputs(&folder.files)?;
    let learnt =
        learn_shape(&folder.registrations, base, config, origin(folder, base, config, output), observer)?;
    learnt.model.save(output)?;
    provenance.write(&output.with_extension("provenance.toml"))?;
    Ok(learnt)
}

fn origin(
    folder: &RegistrationFolder,
    base: &BodyModel,
    config: &LearnShapeConfig,
    output: &Path,
) -> SpaceOrigin {
    let base_name = &base.metadata().name;
    SpaceOrigin {
        name: stem(output),
        license: format!(
            "shape: that of the registrations it was learnt from; topology and rig: {} ({base_name})",
            base.metadata().license
        ),
        provenance: serde_json::json!({
            "made_by": format!("habitus learn-shape {}", env!("CARGO_PKG_VERSION")),
            "base": base_name,
            "registrations": folder.registrations.len(),
            "pose_normalization": config.pose_normalization.name(),
            "settings": config,
        }),
    }
}

/// The settings that a learnt model carries; none for a model that was made otherwise.
pub fn settings_of_model(model: &BodyModel) -> Option<LearnShapeConfig> {
    serde_json::from_value(model.metadata().provenance.get("settings")?.clone()).ok()
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn mesh_files(folder: &Path) -> Result<Vec<PathBuf>, LearnFolderError> {
    let failed = |source| LearnFolderError::Unlistable { path: folder.to_path_buf(), source };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ply")) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Vertices in metres.
fn read_registration(file: &Path, base: &BodyModel) -> Result<Vec<DVec3>, String> {
    let mesh = read_mesh(file).map_err(|error: ReadError| error.to_string())?;
    if mesh.positions().len() != base.vertex_count() || mesh.faces() != base.faces() {
        return Err(format!(
            "has {} vertices and {} faces in another topology than the base model's {} and {}; give the model that it was registered with",
            mesh.positions().len(),
            mesh.faces().len(),
            base.vertex_count(),
            base.faces().len()
        ));
    }
    let scale = recorded_scale(file).unwrap_or_else(|| guessed_scale(mesh.positions()));
    Ok(mesh.positions().iter().map(|position| *position * scale).collect())
}

/// Metres per unit as the registration's record says.
fn recorded_scale(mesh_file: &Path) -> Option<f64> {
    let record = RegistrationRecord::read(mesh_file.parent()?, mesh_file.file_stem()?.to_str()?).ok()?;
    Some(record.metres_per_unit).filter(|scale| scale.is_finite() && *scale > 0.0)
}

fn guessed_scale(positions: &[DVec3]) -> f64 {
    let (low, high) = positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), point| {
        (low.min(*point), high.max(*point))
    });
    guess_unit((high - low).max_element()).unit.metres()
}

/// Scans that the first of these files that exists rejects, in whatever round.
fn rejected_names(files: &[&Path]) -> Result<BTreeSet<String>, DecisionsError> {
    let Some(path) = files.iter().find(|file| file.is_file()) else { return Ok(BTreeSet::new()) };
    let decisions = ReviewDecisions::read(path)?;
    let rejected = decisions.iter().filter(|decision| decision.verdict == Some(Verdict::Reject));
    Ok(rejected.map(|decision| decision.scan.clone()).collect())
}

/// Names of the subjects of one sex from a table `scan,sex`; none if everyone is wanted.
fn group_members(table: &Path, group: SubjectGroup) -> Result<Option<BTreeSet<String>>, LearnFolderError> {
    let wanted = match group {
        SubjectGroup::Everyone => return Ok(None),
        SubjectGroup::Female => "female",
        SubjectGroup::Male => "male",
    };
    let failed = |reason: String| LearnFolderError::List { path: table.to_path_buf(), reason };
    let text = std::fs::read_to_string(table).map_err(|error| {
        failed(format!("to learn of one sex, write this table with lines scan,sex ({error})"))
    })?;
    let mut sexes = BTreeMap::new();
    for (line, text) in text.lines().enumerate().filter(|(_, text)| !text.trim().is_empty()) {
        let Some((scan, sex)) = text.split_once(',') else {
            return Err(failed(format!("line {}: write scan,sex", line + 1)));
        };
        sexes.insert(scan.trim().to_string(), sex.trim().to_ascii_lowercase());
    }
    let members = sexes
        .into_iter()
        .filter(|(_, sex)| sex == wanted || (sex.len() == 1 && wanted.starts_with(sex.as_str())));
    Ok(Some(members.map(|(scan, _)| scan).collect()))
}

#[cfg(test)]
mod tests {
    use habitus_geometry::TriangleMesh;
    use habitus_geometry::io::write_mesh;
    use habitus_optimize::Silent;

    use super::*;
    use crate::body::fixture;
    use crate::stages::learn_shape::PoseNormalization;

    /// Four bodies in millimetres, one of another topology and a broken file.
    fn folder_of_bodies(base: &BodyModel) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        for (index, height) in [-1.0, 0.0, 1.0, 2.0].into_iter().enumerate() {
            let positions =
                base.rest_vertices(&[height, 0.3 * height * height]).iter().map(|v| *v * 1000.0).collect();
            let mesh = TriangleMesh::new(positions, base.faces().to_vec()).expect("a mesh");
            write_mesh(&folder.path().join(format!("person_{index}.ply")), &mesh).expect("writes");
        }
        let other =
            TriangleMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).expect("a mesh");
        write_mesh(&folder.path().join("other.ply"), &other).expect("writes");
        std::fs::write(folder.path().join("broken.ply"), b"ply\n").expect("writes");
        folder
    }

    #[test]
    fn a_folder_in_millimetres_becomes_a_model_that_loads() {
        let base = fixture::model();
        let folder = folder_of_bodies(&base);
        let found =
            RegistrationFolder::read(folder.path(), &base, SubjectGroup::Everyone, |_, _| {}).expect("reads");
        assert_eq!(found.registrations.len(), 4);
        assert_eq!(found.unusable.len(), 2, "each bad file is told once, and does not stop the rest");
        let output = folder.path().join("mine.npz");
        let config = LearnShapeConfig { pose_normalization: PoseNormalization::None, ..Default::default() };
        learn_shape_to_file(&found, &base, &config, &output, &mut Silent).expect("learns");
        let model = BodyModel::load(&output).expect("loads");
        assert_eq!(model.metadata().name, "mine");
        assert!(model.component_count() >= 1 && model.faces() == base.faces());
        assert_eq!(settings_of_model(&model), Some(config));
        assert!(
            Provenance::read(&folder.path().join("mine.provenance.toml")).expect("reads").inputs.len() == 4
        );
        let size = |model: &BodyModel| {
            let heights = model.mean_vertices().iter().map(|vertex| vertex.y);
            heights.clone().fold(f64::MIN, f64::max) - heights.fold(f64::MAX, f64::min)
        };
        assert!((size(&model) - size(&base)).abs() < 0.3);
    }

    #[test]
    fn decisions_and_sexes_are_honoured() {
        let base = fixture::model();
        let folder = folder_of_bodies(&base);
        let decisions = "[[decision]]\nscan = \"person_1\"\nverdict = \"reject\"\nnote = \"arm\"\n[[decision]]\nscan = \"person_2\"\nverdict = \"accept\"\n";
        std::fs::write(folder.path().join(DECISIONS), decisions).expect("writes");
        std::fs::write(
            folder.path().join(SUBJECTS),
            "person_0,female\nperson_1,F\nperson_2,male\nperson_3,f\n",
        )
        .expect("writes");
        let names = |group| {
            let found = RegistrationFolder::read(folder.path(), &base, group, |_, _| {}).expect("reads");
            found.registrations.iter().map(|r| r.name.clone()).collect::<Vec<_>>()
        };
        assert_eq!(names(SubjectGroup::Everyone), ["person_0", "person_2", "person_3"]);
        assert_eq!(names(SubjectGroup::Female), ["person_0", "person_3"]);
        assert_eq!(names(SubjectGroup::Male), ["person_2"]);
        std::fs::write(folder.path().join(DECISIONS), "[[decision]]\nverdict = 3\n").expect("writes");
        let error = RegistrationFolder::read(folder.path(), &base, SubjectGroup::Everyone, |_, _| {});
        assert!(error.expect_err("is refused").to_string().contains(DECISIONS));
    }
}
