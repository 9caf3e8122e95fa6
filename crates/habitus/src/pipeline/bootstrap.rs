//! P1 §3.3: registering all scans and learning a space from the good registrations take turns.
//!
//! ```text
//! RUN/rounds/0/1_register ─rank─▶ accepted ─▶ rounds/0/2_learn_shape/model.npz ─▶ RUN/rounds/1/1_register ─▶ …
//! ```
//! Everything has a key of its inputs: a killed run goes on at the next scan, and what has not changed is not done again.

mod acceptance;
mod round_summary;

use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus_optimize::{Event, Flow, Observer};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::input_key::InputKey;
use super::register_run::{RegisterRun, RegisterRunError, ScanInput, ScanSummary};
use super::registered_run::{RegisteredRun, RegisteredRunError, ScanPlaces, round_folder};
use super::run_folder::{RunFolder, RunFolderError, StageFolder, StageName};
use crate::artifacts::provenance::{ModelOrigin, Provenance, ProvenanceError};
use crate::artifacts::registered_scan::{RegisteredScan, RegistrationFileError};
use crate::artifacts::review_decisions::{DecisionsError, ReviewDecisions};
use crate::artifacts::write_atomically;
use crate::body::{BodyModel, IdentityCoefficients, ModelFileError, SpaceOrigin};
use crate::evaluation::registration_ranking::{RankedRegistration, RankingConfig};
use crate::stages::learn_shape::{LearnShapeConfig, LearnShapeError, Registration, learn_shape};
use crate::stages::register::{RegisterConfig, Template};
use crate::statistics::RandomStream;

use acceptance::Acceptance;
pub use round_summary::{CurvePoint, RejectedScan, RoundSummary};

/// Settings of the rounds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BootstrapConfig {
    /// Rounds in all; P1 §4.5 makes five passes.
    pub rounds: usize,
    /// Registrations that nobody has decided about pass with a smaller score.
    pub accept_below: f64,
    /// A space is learnt from at least this many registrations.
    pub fewest_accepted: usize,
    /// Where fewer registrations passed, random bodies of the model that the first round started from fill up to this many
    /// samples: a handful of registrations would teach less than that model knows. P1 has none; zero for none.
    pub filled_up_to: usize,
}

impl Default for BootstrapConfig {
    fn default() -> Self {
        Self { rounds: 5, accept_below: 1.0, fewest_accepted: 10, filled_up_to: 60 }
    }
}

/// Why bootstrapping stops.
#[derive(Debug, Error)]
pub enum BootstrapError {
    /// The run folder cannot be used.
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    /// Registrations cannot be begun.
    #[error(transparent)]
    Register(#[from] RegisterRunError),
    /// Registrations cannot be ranked.
    #[error(transparent)]
    Ranking(#[from] RegisteredRunError),
    /// A registration cannot be read.
    #[error(transparent)]
    Registration(#[from] RegistrationFileError),
    /// Decisions cannot be read.
    #[error(transparent)]
    Decisions(#[from] DecisionsError),
    /// A provenance cannot be made or written.
    #[error(transparent)]
    Provenance(#[from] ProvenanceError),
    /// No space can be learnt.
    #[error("round {round}: {source}")]
    Learn {
        /// The round.
        round: usize,
        /// Why.
        source: LearnShapeError,
    },
    /// A model cannot be written or read.
    #[error(transparent)]
    Model(#[from] ModelFileError),
    /// Too few registrations passed.
    #[error("round {round}: {passed} of {scans} registrations passed, but {needed} are needed to learn from; look at them with habitus review {} or raise --accept-below", run.display())]
    TooFewPassed {
        /// The round.
        round: usize,
        /// Registrations that passed.
        passed: usize,
        /// All registrations.
        scans: usize,
        /// How many are needed.
        needed: usize,
        /// The run folder.
        run: PathBuf,
    },
    /// A file of the run cannot be written.
    #[error("{}: cannot be written ({source})", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The observer asked to stop.
    #[error("stopped; give the same command again to go on")]
    Stopped,
}

/// All that the rounds depend on.
#[derive(Clone, Copy)]
pub struct BootstrapInput<'a> {
    /// The scans.
    pub scans: &'a [ScanInput],
    /// The model that the first round starts from; its topology and rig are those of every round.
    pub model: &'a BodyModel,
    /// Names and vertices of landmarks of the template, instead of the model's own.
    pub landmarks: Option<&'a [(String, u32)]>,
    /// Settings of the registrations.
    pub register: &'a RegisterConfig,
    /// Settings of the spaces.
    pub learn_shape: &'a LearnShapeConfig,
    /// Settings of the ranking.
    pub review: &'a RankingConfig,
    /// Settings of the rounds.
    pub config: &'a BootstrapConfig,
}

/// Names of the files.
pub(super) mod file_names {
    /// The learnt model.
    pub const MODEL: &str = "model.npz";
    /// Who passed.
    pub const ACCEPTED: &str = "accepted.json";
    /// What is kept of a round.
    pub const SUMMARY: &str = "summary.json";
    /// Inputs, settings and versions.
    pub const PROVENANCE: &str = "provenance.toml";
}

/// Scans that are registered between two looks at the observer.
const SCANS_A_STEP: usize = 8;

/// A bootstrapping under way.
pub struct Bootstrap<'a> {
    run: &'a RunFolder,
    input: BootstrapInput<'a>,
    /// The space that the next round starts from.
    model: BodyModel,
    rounds: Vec<RoundSummary>,
}

/// The contents of `RUN/summary.json`.
#[derive(Serialize)]
struct Summary<'a> {
    verb: &'static str,
    version: &'static str,
    rounds: &'a [RoundSummary],
}

impl<'a> Bootstrap<'a> {
    /// Begins, or goes on with what the run folder holds.
    pub fn new(run: &'a RunFolder, input: BootstrapInput<'a>) -> Result<Self, BootstrapError> {
        let places = ScanPlaces { scans: input.scans.iter().map(|scan| scan.scan.clone()).collect() };
        places.write(run.path())?;
        Ok(Self { run, input, model: input.model.clone(), rounds: Vec::new() })
    }

    /// The space that was learnt last.
    pub fn model(&self) -> &BodyModel {
        &self.model
    }

    /// The rounds so far.
    pub fn rounds(&self) -> &[RoundSummary] {
        &self.rounds
    }

    /// One more round. `clock` gives seconds.
    pub fn next_round(
        &mut self,
        clock: &(dyn Fn() -> f64 + Sync),
        observer: &mut dyn Observer,
    ) -> Result<&RoundSummary, BootstrapError> {
        let begin = clock();
        let round = self.rounds.len();
        let path = round_folder(self.run.path(), round);
        let folder = RunFolder::open(&path)?;
        let failed = self.register(&folder, clock, observer)?;
        let registrations = folder.stage(StageName::Register)?;
        let files: Vec<PathBuf> = self.input.scans.iter().map(|scan| scan.scan.clone()).collect();
        let registered = RegisteredRun::open(registrations.path(), &files, &self.model)?;
        let mut ranking = registered.rank(self.input.review, observer)?;
        // What an earlier run has left of scans that are no longer given, or that fail now, is not learnt from.
        let mut given: Vec<&str> = self.input.scans.iter().map(|scan| scan.name.as_str()).collect();
        given.retain(|name| !failed.iter().any(|other| other == name));
        given.sort_unstable();
        ranking.retain(|ranked| given.binary_search(&ranked.name.as_str()).is_ok());
        let acceptance = self.accept(round, &path, &ranking)?;
        let mut summary = RoundSummary::new(round, &ranking, failed, &acceptance, self.input.review);
        self.learn(round, &folder, &ranking, &acceptance, observer)?;
        summary.components = self.model.component_count();
        summary.seconds = clock() - begin;
        let summary = keep_summary(&path.join(file_names::SUMMARY), summary)?;
        self.rounds.push(summary);
        Ok(&self.rounds[round])
    }

    /// Puts the last space and all rounds where other verbs look for them; returns the model's file.
    pub fn finish(&self) -> Result<PathBuf, BootstrapError> {
        let unwritable =
            |path: &Path, source| BootstrapError::Unwritable { path: path.to_path_buf(), source };
        let model = self.run.stage(StageName::LearnShape)?.file(file_names::MODEL);
        self.model.save(&model)?;
        let path = self.run.path().join(file_names::SUMMARY);
        let summary = Summary { verb: "bootstrap", version: env!("CARGO_PKG_VERSION"), rounds: &self.rounds };
        let text = serde_json::to_string_pretty(&summary).map_err(|error| unwritable(&path, error.into()))?;
        write_atomically(&path, (text + "\n").as_bytes()).map_err(|source| unwritable(&path, source))?;
        Ok(model)
    }

    /// Registers all scans with the current space; returns the names of those that have no registration.
    fn register(
        &self,
        folder: &RunFolder,
        clock: &(dyn Fn() -> f64 + Sync),
        observer: &mut dyn Observer,
    ) -> Result<Vec<String>, BootstrapError> {
        let landmarks = self.input.landmarks.map(<[_]>::to_vec);
        let template = Template::Model(&self.model);
        let stage = RegisterRun::prepare(folder, template, &[], landmarks, self.input.register)?;
        let mut summaries: Vec<ScanSummary> = Vec::with_capacity(self.input.scans.len());
        for scans in self.input.scans.chunks(SCANS_A_STEP.max(rayon::current_num_threads())) {
            summaries.extend(stage.run(scans, false, clock, &|_| {}));
            tell(observer, "register", summaries.len(), self.input.scans.len())?;
        }
        let failed = summaries.iter().filter(|scan| scan.quality.is_none());
        Ok(failed.map(|scan| scan.name.clone()).collect())
    }

    /// Who passed. A round that another has followed stays as it was.
    fn accept(
        &self,
        round: usize,
        path: &Path,
        ranking: &[RankedRegistration],
    ) -> Result<Acceptance, BootstrapError> {
        let BootstrapInput { config, review, .. } = self.input;
        let file = path.join(file_names::ACCEPTED);
        if round_folder(self.run.path(), round + 1).is_dir()
            && let Some(kept) = Acceptance::read(&file, ranking, config, review)
        {
            return Ok(kept);
        }
        let decisions = ReviewDecisions::read(&self.run.path().join(ReviewDecisions::FILE))?;
        let acceptance = Acceptance::decide(ranking, &decisions, config, review);
        acceptance
            .write(&file)
            .map_err(|source| BootstrapError::Unwritable { path: file.clone(), source })?;
        let passed = acceptance.accepted.len();
        if passed < config.fewest_accepted {
            return Err(BootstrapError::TooFewPassed {
                round,
                passed,
                scans: ranking.len(),
                needed: config.fewest_accepted,
                run: self.run.path().to_path_buf(),
            });
        }
        Ok(acceptance)
    }

    /// Learns the round's space, unless it is there already, and takes it over.
    fn learn(
        &mut self,
        round: usize,
        folder: &RunFolder,
        ranking: &[RankedRegistration],
        acceptance: &Acceptance,
        observer: &mut dyn Observer,
    ) -> Result<(), BootstrapError> {
        let stage = folder.stage(StageName::LearnShape)?;
        let file = stage.file(file_names::MODEL);
        let key = self.learn_key(ranking, acceptance)?;
        if stage.is_finished(&key)
            && let Ok(model) = BodyModel::load(&file)
        {
            self.model = model;
            return Ok(());
        }
        stage.mark_unfinished()?;
        let registrations = folder.stage(StageName::Register)?;
        let mut samples = read_registrations(&registrations, &acceptance.accepted)?;
        let passed = samples.len();
        let missing = self.input.config.filled_up_to.saturating_sub(passed);
        samples.extend(draws_of_start(self.input.model, &registrations, &acceptance.accepted, missing)?);
        let origin = SpaceOrigin {
            name: format!("{} of round {round}", self.input.model.metadata().name),
            license: "that of the scans it was learnt from".into(),
            provenance: serde_json::json!({
                "verb": "bootstrap",
                "round": round,
                "registrations": passed,
                "draws_of_start": missing,
                "started_from": self.input.model.metadata().name,
            }),
        };
        let learnt = learn_shape(&samples, &self.model, self.input.learn_shape, origin, observer)
            .map_err(|source| BootstrapError::Learn { round, source })?;
        learnt.model.save(&file)?;
        let provenance = Provenance::new("bootstrap", self.input.learn_shape, self.input.register.seed)?;
        provenance.with_model(&self.model).write(&stage.file(file_names::PROVENANCE))?;
        stage.mark_finished(&key)?;
        // The file's own numbers, so that a run that goes on later sees the same ones.
        self.model = BodyModel::load(&file)?;
        Ok(())
    }

    fn learn_key(
        &self,
        ranking: &[RankedRegistration],
        acceptance: &Acceptance,
    ) -> Result<String, BootstrapError> {
        let settings = Provenance::new("bootstrap", self.input.learn_shape, 0)?;
        let mut key = InputKey::new();
        let filled_up_to = self.input.config.filled_up_to;
        if filled_up_to > acceptance.accepted.len() {
            key.add_text(&format!("{filled_up_to} {}", ModelOrigin::of(self.input.model).fingerprint));
        }
        key.add_text(&toml::to_string(&settings).map_err(ProvenanceError::from)?);
        key.add_text(&ModelOrigin::of(&self.model).fingerprint);
        for name in &acceptance.accepted {
            key.add_text(name);
            let ranked = ranking.iter().find(|ranked| ranked.name == *name);
            key.add_text(ranked.map_or("", |ranked| ranked.registration.as_str()));
        }
        Ok(key.text())
    }
}

/// Names of the scans whose registrations a round learnt from, in order; none of a round that has not got so far.
pub(super) fn accepted_of_round(folder: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(folder.join(file_names::ACCEPTED)).unwrap_or_default();
    serde_json::from_str::<Acceptance>(&text).map(|acceptance| acceptance.accepted).unwrap_or_default()
}

/// Vertices of registrations in metres.
fn read_registrations(stage: &StageFolder, names: &[String]) -> Result<Vec<Registration>, BootstrapError> {
    let read = |name: &String| {
        let registered = RegisteredScan::read(stage.path(), name)?;
        let metres = registered.record.metres_per_unit;
        let vertices: Vec<DVec3> = registered.mesh.positions().iter().map(|p| *p * metres).collect();
        Ok(Registration { name: name.clone(), vertices })
    };
    names.par_iter().map(read).collect()
}

/// Random bodies of the model that bootstrapping started from, standing as the registrations do.
fn draws_of_start(
    model: &BodyModel,
    stage: &StageFolder,
    names: &[String],
    count: usize,
) -> Result<Vec<Registration>, BootstrapError> {
    let mut draws = Vec::with_capacity(count);
    for (number, name) in names.iter().cycle().take(count).enumerate() {
        let mut stream = RandomStream::named(0, &format!("draw {number} of the start"));
        let limit = IdentityCoefficients::LIMIT;
        let identity: Vec<f64> =
            (0..model.component_count()).map(|_| stream.normal().clamp(-limit, limit)).collect();
        let rest = model.rest_vertices(&identity);
        let vertices = match RegisteredScan::read(stage.path(), name)?.record.fitted_model {
            Some(fitted) => {
                let joints = model.surface().rest_joints(&identity);
                model.pose_vertices(&rest, &model.skeleton().pose(&joints, &fitted.pose))
            }
            None => rest,
        };
        draws.push(Registration { name: format!("draw {number}"), vertices });
    }
    Ok(draws)
}

/// Writes a summary; one that says the same but for its time stays, as nothing was done again.
fn keep_summary(path: &Path, summary: RoundSummary) -> Result<RoundSummary, BootstrapError> {
    if let Ok(kept) = RoundSummary::read(path)
        && (RoundSummary { seconds: summary.seconds, ..kept.clone() }) == summary
    {
        return Ok(kept);
    }
    summary.write(path).map_err(|source| BootstrapError::Unwritable { path: path.to_path_buf(), source })?;
    Ok(summary)
}

fn tell(
    observer: &mut dyn Observer,
    stage: &'static str,
    done: usize,
    total: usize,
) -> Result<(), BootstrapError> {
    match observer.on_event(&Event::Progress { stage, done, total }) {
        Flow::Continue => Ok(()),
        Flow::Stop => Err(BootstrapError::Stopped),
    }
}
