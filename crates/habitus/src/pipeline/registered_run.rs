//! Registrations of a run beside their scans: what is ranked, reviewed and learnt from.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus_geometry::io::{ReadError, read_surface};
use habitus_geometry::{PointCloud, Surface, TriangleMesh};
use habitus_optimize::{Event, Flow, Observer};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::input_key::InputKey;
use super::run_folder::StageName;
use crate::artifacts::provenance::{InputFile, ProvenanceError};
use crate::artifacts::registered_scan::{RegisteredScan, RegistrationFileError, mesh_file};
use crate::artifacts::review_decisions::{Decision, DecisionsError, ReviewDecisions, Verdict};
use crate::artifacts::write_atomically;
use crate::body::{BodyModel, PartLabel};
use crate::evaluation::fit_error::{FitError, FitErrorSettings, FitErrorSums, vertex_distances};
use crate::evaluation::registration_ranking::{
    Patches, RankedRegistration, RankingConfig, RankingParts, edge_factor, mahalanobis, residuals,
};

/// Why registrations cannot be ranked or reviewed.
#[derive(Debug, Error)]
pub enum RegisteredRunError {
    /// The run has no registrations.
    #[error("{}: holds no registrations; run habitus register or habitus bootstrap with -o {} first", path.display(), path.display())]
    Nothing {
        /// The run folder.
        path: PathBuf,
    },
    /// There is no registration of this name.
    #[error("there is no registration of a scan '{name}'")]
    NoRegistration {
        /// The name.
        name: String,
    },
    /// The scan of a registration is not where it was.
    #[error("the scan of the registration '{name}' is not found; say where the scans are with --scans")]
    NoScan {
        /// Name of the scan.
        name: String,
    },
    /// A registration cannot be read.
    #[error(transparent)]
    Registration(#[from] RegistrationFileError),
    /// A scan cannot be read.
    #[error(transparent)]
    Scan(#[from] ReadError),
    /// A file cannot be fingerprinted.
    #[error(transparent)]
    Fingerprint(#[from] ProvenanceError),
    /// Decisions cannot be read or kept.
    #[error(transparent)]
    Decisions(#[from] DecisionsError),
    /// The ranking cannot be kept.
    #[error("{}: the ranking cannot be written ({source})", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The person stopped it.
    #[error("stopped while ranking; what was ranked is kept")]
    Stopped,
}

/// Registrations in a folder, and where their scans are.
pub struct RegisteredRun {
    folder: PathBuf,
    names: Vec<String>,
    scans: HashMap<String, PathBuf>,
    /// The template upright; empty if it is not known.
    upright: Vec<DVec3>,
    /// Vertices that do not count: hands, whose fingers no template of closed hands follows (P1 §4.1).
    is_hand: Vec<bool>,
    patches_of: PatchesOf,
}

/// What the patches of the template are made from.
struct PatchesOf {
    positions: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
}

/// A registration and its scan in metres and in the scan's own frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanPair {
    /// The registration.
    pub registration: TriangleMesh,
    /// The scan.
    pub scan: Surface,
}

/// The kept ranking.
#[derive(Default, Serialize, Deserialize)]
struct RankingFile {
    /// What all entries depend on besides registration and scan.
    key: String,
    scans: Vec<RankedRegistration>,
}

/// Name of the kept ranking beside the registrations.
const RANKING: &str = "ranking.json";
/// Scans that are ranked between two writings of the file.
const KEPT_EVERY: usize = 32;

impl RegisteredRun {
    /// The registrations in a folder. `scan_files` may hold more scans than were registered; a scan's name is its file
    /// name without ending. `model` says what is up and which vertices are hands, if its template is the registrations'.
    pub fn open(
        folder: &Path,
        scan_files: &[PathBuf],
        model: &BodyModel,
    ) -> Result<Self, RegisteredRunError> {
        let nothing = || RegisteredRunError::Nothing { path: run_of(folder) };
        let entries = std::fs::read_dir(folder).map_err(|_| nothing())?;
        let mut names: Vec<String> = entries
            .filter_map(Result::ok)
            .map(|entry| entry.path())
            .filter(|path| path.extension().is_some_and(|extension| extension == "ply"))
            .filter(|path| path.with_extension("json").is_file())
            .filter_map(|path| Some(path.file_stem()?.to_str()?.to_string()))
            .collect();
        names.sort_unstable();
        let first = names.first().ok_or_else(nothing)?;
        let first = RegisteredScan::read(folder, first)?;
        let is_of_model =
            first.mesh.faces() == model.faces() && first.mesh.positions().len() == model.vertex_count();
        let (positions, upright, is_hand) = if is_of_model {
            let is_hand = model.part_labels().iter().map(|label| *label == PartLabel::Hand).collect();
            (model.mean_vertices().to_vec(), model.mean_vertices().to_vec(), is_hand)
        } else {
            (scaled(first.mesh.positions(), first.record.metres_per_unit), Vec::new(), Vec::new())
        };
        let scans = scan_files
            .iter()
            .filter_map(|path| Some((path.file_stem()?.to_str()?.to_string(), path.clone())));
        Ok(Self {
            folder: folder.to_path_buf(),
            names,
            scans: scans.collect(),
            upright,
            is_hand,
            patches_of: PatchesOf { positions, faces: first.mesh.faces().to_vec() },
        })
    }

    /// Names of the registered scans in order.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The template upright, y up; empty if it is not known.
    pub fn upright(&self) -> &[DVec3] {
        &self.upright
    }

    /// Reads a registration and its scan.
    pub fn pair(&self, name: &str) -> Result<ScanPair, RegisteredRunError> {
        if self.names.binary_search_by(|known| known.as_str().cmp(name)).is_err() {
            return Err(RegisteredRunError::NoRegistration { name: name.into() });
        }
        let registered = RegisteredScan::read(&self.folder, name)?;
        self.pair_of(&registered)
    }

    fn pair_of(&self, registered: &RegisteredScan) -> Result<ScanPair, RegisteredRunError> {
        let name = &registered.record.name;
        let scan = self.scans.get(name).ok_or_else(|| RegisteredRunError::NoScan { name: name.clone() })?;
        let metres = registered.record.metres_per_unit;
        let registration = registered.mesh.with_positions(scaled(registered.mesh.positions(), metres));
        let scan = match read_surface(scan)? {
            Surface::Mesh(mesh) => mesh.with_positions(scaled(mesh.positions(), metres)).map(Surface::Mesh),
            Surface::Cloud(cloud) => {
                let normals = cloud.normals().map(<[DVec3]>::to_vec);
                PointCloud::new(scaled(cloud.positions(), metres), normals).map(Surface::Cloud)
            }
        };
        // Finite numbers times a factor: only one that is no number can make them invalid.
        let invalid = |error: habitus_geometry::MeshError| RegistrationFileError::Record {
            path: mesh_file(&self.folder, name),
            reason: error.to_string(),
        };
        Ok(ScanPair { registration: registration.map_err(invalid)?, scan: scan.map_err(invalid)? })
    }

    /// Ranks all registrations, worst first. What was ranked before and has not changed is not ranked again.
    pub fn rank(
        &self,
        config: &RankingConfig,
        observer: &mut dyn Observer,
    ) -> Result<Vec<RankedRegistration>, RegisteredRunError> {
        let path = self.folder.join(RANKING);
        let key = self.ranking_key(config);
        let kept: BTreeMap<String, RankedRegistration> = std::fs::read_to_string(&path)
            .ok()
            .and_then(|text| serde_json::from_str::<RankingFile>(&text).ok())
            .filter(|file| file.key == key)
            .map(|file| file.scans.into_iter().map(|ranked| (ranked.name.clone(), ranked)).collect())
            .unwrap_or_default();
        let mut ranking = Vec::with_capacity(self.names.len());
        let mut patches = None;
        for names in self.names.chunks(KEPT_EVERY) {
            let fingerprints: Vec<String> =
                names.par_iter().map(|name| self.fingerprint(name)).collect::<Result<_, _>>()?;
            let is_kept = |(name, registration): (&String, &String)| {
                kept.get(name).is_some_and(|ranked| ranked.registration == *registration)
            };
            let is_all_kept = names.iter().zip(&fingerprints).all(is_kept);
            if is_all_kept {
                ranking.extend(names.iter().filter_map(|name| kept.get(name).cloned()));
            } else {
                let radius = config.patch_radius_mm / 1000.0;
                let patches = &*patches.get_or_insert_with(|| {
                    Patches::of_template(&self.patches_of.positions, &self.patches_of.faces, radius)
                });
                let ranked = names.par_iter().zip(fingerprints).map(|(name, registration)| {
                    match kept.get(name).filter(|ranked| ranked.registration == registration) {
                        Some(ranked) => Ok(ranked.clone()),
                        None => self.rank_one(name, registration, patches, config),
                    }
                });
                ranking.extend(ranked.collect::<Result<Vec<_>, _>>()?);
                self.keep(&path, &RankingFile { key: key.clone(), scans: ranking.clone() })?;
            }
            let event = Event::Progress { stage: "rank", done: ranking.len(), total: self.names.len() };
            if observer.on_event(&event) == Flow::Stop {
                return Err(RegisteredRunError::Stopped);
            }
        }
        let score = |ranked: &RankedRegistration| ranked.parts.score(config);
        ranking.sort_by(|a, b| score(b).total_cmp(&score(a)).then_with(|| a.name.cmp(&b.name)));
        Ok(ranking)
    }

    /// Fit error over the registrations of these names (P1 §4.2); those whose scan is gone are left out.
    pub fn fit_error(
        &self,
        names: &[String],
        settings: &FitErrorSettings,
        observer: &mut dyn Observer,
    ) -> Result<FitError, RegisteredRunError> {
        let mut sums = FitErrorSums::default();
        for (batch, names_of_batch) in names.chunks(KEPT_EVERY).enumerate() {
            let compared: Vec<_> = names_of_batch
                .par_iter()
                .map(|name| {
                    let registered = RegisteredScan::read(&self.folder, name).ok()?;
                    let pair = self.pair_of(&registered).ok()?;
                    let distances = vertex_distances(&pair.registration, &pair.scan, settings);
                    Some((distances, registered.record.quality.held_out_mm))
                })
                .collect();
            for (distances, held_out) in compared.iter().flatten() {
                sums.add(distances, held_out, settings);
            }
            let done = batch * KEPT_EVERY + names_of_batch.len();
            if observer.on_event(&Event::Progress { stage: "compare", done, total: names.len() })
                == Flow::Stop
            {
                return Err(RegisteredRunError::Stopped);
            }
        }
        Ok(sums.finished(settings))
    }

    /// Fingerprint of a registered mesh, by which decisions know it.
    pub fn fingerprint(&self, name: &str) -> Result<String, RegisteredRunError> {
        Ok(InputFile::of(&mesh_file(&self.folder, name))?.fingerprint)
    }

    /// What parts depend on besides registration and scan; acceptable values only weigh them.
    fn ranking_key(&self, config: &RankingConfig) -> String {
        let mut key = InputKey::new();
        for value in [config.patch_radius_mm, config.stray_distance_mm, config.compatible_angle_deg] {
            key.add_bytes(&value.to_le_bytes());
        }
        config.curve_mm.iter().for_each(|value| key.add_bytes(&value.to_le_bytes()));
        key.add_text(env!("CARGO_PKG_VERSION"));
        for position in &self.patches_of.positions {
            position.to_array().iter().for_each(|value| key.add_bytes(&value.to_le_bytes()));
        }
        key.text()
    }

    fn keep(&self, path: &Path, file: &RankingFile) -> Result<(), RegisteredRunError> {
        let unwritable = |source| RegisteredRunError::Unwritable { path: path.to_path_buf(), source };
        let text = serde_json::to_string_pretty(file).map_err(|error| unwritable(error.into()))?;
        write_atomically(path, text.as_bytes()).map_err(unwritable)
    }

    /// One registration; a scan that cannot be compared ranks as the worst.
    fn rank_one(
        &self,
        name: &str,
        registration: String,
        patches: &Patches,
        config: &RankingConfig,
    ) -> Result<RankedRegistration, RegisteredRunError> {
        let registered = RegisteredScan::read(&self.folder, name)?;
        let quality = &registered.record.quality;
        let mut parts = RankingParts {
            worst_patch_mm: None,
            worst_vertex: 0,
            flipped_faces: quality.flipped_faces,
            edge_factor: edge_factor(quality.edge_ratio.p1, quality.edge_ratio.p99),
            mahalanobis: registered.record.fitted_model.as_ref().and_then(|fit| mahalanobis(&fit.identity)),
            landmark_mm: quality.landmark_mm,
            has_failure_code: !registered.is_ok(),
        };
        let mut within = Vec::new();
        match self.pair_of(&registered) {
            Ok(pair) => {
                let mut found = residuals(&pair.registration, &pair.scan, config);
                for (residual, is_hand) in found.residual.iter_mut().zip(&self.is_hand) {
                    *residual = residual.filter(|_| !is_hand);
                }
                within = found.within(&config.curve_mm);
                let worst = patches.worst(&found.residual);
                parts.worst_patch_mm = Some(worst.mean * 1000.0);
                parts.worst_vertex = worst.vertex;
            }
            Err(RegisteredRunError::Scan(_)) => {}
            Err(error) => return Err(error),
        }
        let mean_mm = quality.point_to_surface_mm.mean;
        Ok(RankedRegistration { name: name.into(), registration, mean_mm, parts, within })
    }
}

fn scaled(positions: &[DVec3], factor: f64) -> Vec<DVec3> {
    positions.iter().map(|position| *position * factor).collect()
}

/// The run folder that a stage's folder lies in.
fn run_of(folder: &Path) -> PathBuf {
    folder.parent().unwrap_or(folder).to_path_buf()
}

/// Where the scans of a run are, so that a review can show them. Kept apart from the results, which name no folder of any
/// machine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanPlaces {
    /// Files of the scans.
    pub scans: Vec<PathBuf>,
}

impl ScanPlaces {
    /// Name of the file in the run folder.
    const FILE: &'static str = ".scans.toml";

    /// Remembers them. Paths inside the run stay relative to it, so that it can be moved.
    pub fn write(&self, run: &Path) -> Result<(), RegisteredRunError> {
        let path = run.join(Self::FILE);
        let unwritable = |source| RegisteredRunError::Unwritable { path: path.clone(), source };
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
        let folder = absolute(run);
        let places = self.scans.iter().map(|scan| absolute(scan));
        let scans = places.map(|scan| scan.strip_prefix(&folder).map(Path::to_path_buf).unwrap_or(scan));
        let text = toml::to_string(&Self { scans: scans.collect() })
            .map_err(|error| unwritable(std::io::Error::other(error)))?;
        write_atomically(&path, text.as_bytes()).map_err(unwritable)
    }

    /// What a run remembers, if anything.
    pub fn read(run: &Path) -> Option<Self> {
        let text = std::fs::read_to_string(run.join(Self::FILE)).ok()?;
        let places: Self = toml::from_str(&text).ok()?;
        Some(Self { scans: places.scans.iter().map(|scan| run.join(scan)).collect() })
    }
}

/// Where the registrations of a run are: its own, or those of the last round of its bootstrapping.
pub fn registration_folder(run: &Path) -> PathBuf {
    let own = run.join(StageName::Register.folder());
    let holds_some = |folder: &PathBuf| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
        entries.map(|entry| entry.path()).any(|path| path.extension().is_some_and(|ending| ending == "ply"))
    };
    if holds_some(&own) {
        return own;
    }
    let rounds = std::fs::read_dir(run.join(ROUNDS)).into_iter().flatten().filter_map(Result::ok);
    let numbers = rounds.filter_map(|entry| entry.file_name().to_str()?.parse::<usize>().ok());
    let folders =
        numbers.map(|number| (number, round_folder(run, number).join(StageName::Register.folder())));
    let last = folders.filter(|(_, folder)| holds_some(folder)).max_by_key(|(number, _)| *number);
    last.map_or(own, |(_, folder)| folder)
}

/// Folder of the rounds of a bootstrapping.
const ROUNDS: &str = "rounds";

/// Folder of one round.
pub fn round_folder(run: &Path, round: usize) -> PathBuf {
    run.join(ROUNDS).join(round.to_string())
}

/// The rounds of a bootstrapping that have a space, in order.
pub fn finished_rounds(run: &Path) -> Vec<usize> {
    let entries = std::fs::read_dir(run.join(ROUNDS)).into_iter().flatten().filter_map(Result::ok);
    let mut rounds: Vec<usize> = entries
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .filter(|round| round_folder(run, *round).join(StageName::LearnShape.folder()).is_dir())
        .collect();
    rounds.sort_unstable();
    rounds
}

/// Decides what nobody has decided: accepts up to a score and rejects above, with the reason as a note. Returns how many
/// were accepted and rejected.
pub fn decide_by_score(
    decisions: &mut ReviewDecisions,
    ranking: &[RankedRegistration],
    config: &RankingConfig,
    accept_below: f64,
) -> (usize, usize) {
    let (mut accepted, mut rejected) = (0, 0);
    for ranked in ranking {
        let earlier = decisions.of(&ranked.name);
        if earlier.is_some_and(|decision| decision.verdict_on(&ranked.registration).is_some()) {
            continue;
        }
        let score = ranked.parts.score(config);
        let is_accepted = score < accept_below;
        let note = earlier.map_or(String::new(), |decision| decision.note.clone());
        let reason = format!("score {score:.2}, not below {accept_below}");
        decisions.set(Decision {
            scan: ranked.name.clone(),
            verdict: Some(if is_accepted { Verdict::Accept } else { Verdict::Reject }),
            note: if is_accepted || !note.is_empty() { note } else { reason },
            registration: Some(ranked.registration.clone()),
        });
        *(if is_accepted { &mut accepted } else { &mut rejected }) += 1;
    }
    (accepted, rejected)
}

#[cfg(test)]
mod tests;
