//! `learn_clothing` and `synthesize` on files.

use std::path::{Path, PathBuf};

use habitus_optimize::Observer;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::clothing_run::LAYER_FILE;
use super::input_key::InputKey;
use super::run_folder::{RunFolder, RunFolderError, StageFolder, StageName};
use super::sequence_run::{RunError, file_names, input_file, read_stored_fit};
use crate::artifacts::clothing_controls::{ControlsError, ParameterTable};
use crate::artifacts::clothing_layer::{ClothingLayer, LayerFileError, read_layer};
use crate::artifacts::clothing_model::{
    ClothingModel, ClothingModelError, read_clothing_model, write_clothing_model,
};
use crate::artifacts::dressed_glb::write_dressed_glb;
use crate::artifacts::journal::Journal;
use crate::artifacts::motion_clip::MotionClip;
use crate::artifacts::motion_files::{MotionFileError, read_joint_motion};
use crate::artifacts::provenance::{Provenance, ProvenanceError};
use crate::artifacts::rigged_sequence::FrameRate;
use crate::artifacts::skinned_glb::SkinnedGlbError;
use crate::artifacts::synthesized_sequence::{
    MeshFiles, Penetration, SynthesizedFileError, SynthesizedSequence, write_clothing_meshes,
    write_synthesized,
};
use crate::artifacts::write_atomically;
use crate::body::BodyModel;
use crate::fitting::retarget::{RetargetBody, RetargetError, RetargetSettings, retarget};
use crate::stages::learn_clothing::{LearnClothingConfig, LearnClothingError, learn_clothing};
use crate::stages::synthesize::{Motion, SynthesizeConfig, SynthesizeError};
use crate::statistics::{LinearSpace, LinearSpaceError};

/// Names of the files of a synthesized run.
pub mod synthesized_file_names {
    /// Meshes, poses and coefficients as arrays.
    pub const ARRAYS: &str = "sequence.npz";
    /// Skinned body and clothing with animated components.
    pub const ANIMATION: &str = "dressed.glb";
    /// Folder of the clothing's meshes.
    pub const MESHES: &str = "clothing";
    /// What other programs read.
    pub const SUMMARY: &str = "summary.json";
}

/// Why a clothing model or a synthesis cannot be had.
#[derive(Debug, Error)]
pub enum ClothingModelRunError {
    /// A run folder cannot be used.
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    /// A layer cannot be read.
    #[error(transparent)]
    Layer(#[from] LayerFileError),
    /// A model cannot be read or written.
    #[error(transparent)]
    Model(#[from] ClothingModelError),
    /// The parameters cannot be used.
    #[error(transparent)]
    Controls(#[from] ControlsError),
    /// Learning failed.
    #[error(transparent)]
    Learn(#[from] LearnClothingError),
    /// Synthesis failed.
    #[error(transparent)]
    Synthesize(#[from] SynthesizeError),
    /// A result cannot be written.
    #[error(transparent)]
    Files(#[from] SynthesizedFileError),
    /// The animation cannot be written.
    #[error(transparent)]
    Animation(#[from] SkinnedGlbError),
    /// The provenance cannot be made or written.
    #[error(transparent)]
    Provenance(#[from] ProvenanceError),
    /// A fit cannot be read for its motion.
    #[error(transparent)]
    Fit(#[from] RunError),
    /// A motion file cannot be read.
    #[error(transparent)]
    MotionFile(#[from] MotionFileError),
    /// A motion cannot be brought to the skeleton.
    #[error(transparent)]
    Retarget(#[from] RetargetError),
    /// A layer that is replayed has no components.
    #[error("the layer has no components: {0}")]
    Space(#[from] LinearSpaceError),
}

/// Layers with the names of their sequences: the names of the run folders, or of the files.
pub fn read_layers(paths: &[PathBuf]) -> Result<(Vec<String>, Vec<ClothingLayer>), ClothingModelRunError> {
    let mut names = Vec::new();
    let mut layers = Vec::new();
    for path in paths {
        let in_run = path.join(StageName::ExtractClothing.folder()).join(LAYER_FILE);
        layers.push(read_layer(if path.is_file() { path } else { &in_run })?);
        let name = if path.is_file() { path.file_stem() } else { path.file_name() };
        names.push(name.unwrap_or(path.as_os_str()).to_string_lossy().into_owned());
    }
    Ok((names, layers))
}

/// Reads the layers, learns and writes the model; gives it back.
pub fn learn_clothing_files(
    paths: &[PathBuf],
    parameters: Option<&Path>,
    output: &Path,
    config: &LearnClothingConfig,
    observer: &mut dyn Observer,
) -> Result<ClothingModel, ClothingModelRunError> {
    let (names, layers) = read_layers(paths)?;
    let table = parameters.map(ParameterTable::read).transpose()?;
    let model = learn_clothing(names, layers, table.as_ref(), config, observer)?;
    write_clothing_model(output, &model)?;
    Ok(model)
}

/// Reads a motion for a dressed person: a run with a fit, a `fit.npz`, a motion clip, or a BVH, ASF/AMC or AMASS file, which
/// is brought to the person's skeleton at the frame rate of the clothes.
pub fn read_motion(
    path: &Path,
    model: &BodyModel,
    dressed: &ClothingLayer,
    frame_rate: FrameRate,
) -> Result<Motion, ClothingModelRunError> {
    let is_archive = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npz"));
    if path.is_dir() || is_archive {
        match read_stored_fit(path) {
            Err(RunError::Files(_)) if is_archive => {}
            fit => return Ok(Motion::of_fit(&fit?, frame_rate)),
        }
        if let Ok(clip) = MotionClip::read(path, &dressed.rig.skeleton) {
            return Ok(Motion::of_clip(&clip));
        }
    }
    let captured = read_joint_motion(path)?;
    let settings = RetargetSettings {
        frames_per_second: Some(frame_rate.frames_per_second()),
        ..RetargetSettings::default()
    };
    let body = RetargetBody::new(model, &dressed.rest_vertices)?;
    Ok(Motion::of_clip(&retarget(&captured, &body, &settings)?))
}

/// What clothes are synthesized from.
#[derive(Debug)]
pub enum ClothingSource {
    /// A model.
    Model(Box<ClothingModel>),
    /// A layer, which is replayed over another body.
    Layer(Box<ClothingLayer>),
}

impl ClothingSource {
    /// Reads a model, a layer or a run folder with a layer.
    pub fn read(path: &Path) -> Result<Self, ClothingModelRunError> {
        if path.is_file() {
            match read_clothing_model(path) {
                Ok(model) => return Ok(Self::Model(Box::new(model))),
                Err(ClothingModelError::Foreign { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        let (_, mut layers) = read_layers(&[path.to_path_buf()])?;
        Ok(Self::Layer(Box::new(layers.swap_remove(0))))
    }

    /// The dressed person.
    pub fn dressed(&self) -> &ClothingLayer {
        match self {
            Self::Model(model) => &model.dressed,
            Self::Layer(layer) => layer,
        }
    }

    /// Components for the animation; a replayed layer has those of its own frames.
    pub fn animated(
        &self,
        sequence: &mut SynthesizedSequence,
        components: usize,
    ) -> Result<LinearSpace, ClothingModelRunError> {
        match self {
            Self::Model(model) => Ok(model.space.clone()),
            Self::Layer(layer) => {
                let mut samples =
                    crate::statistics::SampleMatrix::with_capacity(3 * layer.clothing_vertex_count(), 0);
                for frame in 0..layer.frames.len() {
                    let offsets = layer.frame_offsets(frame).iter().copied().map(f64::from);
                    samples.push(&offsets.collect::<Vec<f64>>());
                }
                let settings = crate::statistics::LinearSpaceSettings::with_components(components);
                let space = LinearSpace::learn(&samples, &settings)?;
                let rows: Vec<_> = samples
                    .samples()
                    .map(|sample| nalgebra::RowDVector::from_vec(space.coefficients(sample)))
                    .collect();
                sequence.coefficients = nalgebra::DMatrix::from_rows(&rows);
                Ok(space)
            }
        }
    }
}

/// The contents of a synthesized run's `summary.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SynthesisSummary {
    /// The verb that made the run.
    pub verb: String,
    /// Version of the program.
    pub version: String,
    /// Frames.
    pub frames: usize,
    /// Vertices of the clothing.
    pub clothing_vertices: usize,
    /// Clothing inside the body before it was pushed out; none if it was not.
    pub penetration_before: Option<Penetration>,
    /// Clothing inside the body at last; none if it was not looked at.
    pub penetration_after: Option<Penetration>,
    /// Seconds of prediction, posing and push-out.
    pub seconds: f64,
    /// Frames over those seconds.
    pub frames_per_second: f64,
}

/// All that a synthesized sequence depends on.
pub struct SynthesisInput<'a> {
    /// File of the model or layer.
    pub source_file: &'a Path,
    /// The dressed person.
    pub dressed: &'a ClothingLayer,
    /// Motion and controls; none: a layer is replayed.
    pub motion: Option<(&'a Motion, &'a [f64])>,
    /// Form of the mesh files, if any are asked for.
    pub meshes: Option<MeshFiles>,
    /// Settings of the stage.
    pub config: &'a SynthesizeConfig,
}

impl SynthesisInput<'_> {
    /// The key of the results: the same inputs and settings of the same version give the same.
    pub fn key(&self) -> Result<String, ClothingModelRunError> {
        let in_run = self.source_file.join(StageName::ExtractClothing.folder()).join(LAYER_FILE);
        let file = if self.source_file.is_file() { self.source_file } else { in_run.as_path() };
        let mut provenance = Provenance::new("synthesize", self.config, 0)?;
        provenance.inputs = vec![input_file(file)];
        let mut key = InputKey::new();
        key.add_text(&toml::to_string(&provenance).map_err(ProvenanceError::from)?);
        let mut add_numbers = |numbers: &mut dyn Iterator<Item = f64>| {
            key.add_bytes(&numbers.flat_map(f64::to_le_bytes).collect::<Vec<u8>>());
        };
        add_numbers(&mut self.dressed.rest_vertices.iter().flat_map(|place| place.to_array()));
        if let Some((motion, controls)) = self.motion {
            add_numbers(&mut motion.poses.iter().flatten().copied());
            add_numbers(&mut std::iter::once(motion.frame_rate.frames_per_second()));
            add_numbers(&mut controls.iter().copied());
        }
        key.add_text(&format!("{:?}", self.meshes));
        Ok(key.text())
    }
}

/// The summary of a synthesized run, if the results in the folder are whole and those of this key.
pub fn finished_synthesis(
    run: &RunFolder,
    key: &str,
) -> Result<Option<SynthesisSummary>, ClothingModelRunError> {
    let stage = run.stage(StageName::Synthesize)?;
    let text = std::fs::read_to_string(stage.file(synthesized_file_names::SUMMARY)).ok();
    Ok(text.filter(|_| stage.is_finished(key)).and_then(|text| serde_json::from_str(&text).ok()))
}

/// The journal of a synthesis: frames that an earlier, killed run with this key has finished, unless `afresh`.
pub fn synthesis_journal(run: &RunFolder, key: &str, afresh: bool) -> Result<Journal, ClothingModelRunError> {
    let stage = run.stage(StageName::Synthesize)?;
    stage.mark_unfinished()?;
    if afresh {
        stage.remove(file_names::JOURNAL)?;
    }
    Ok(stage.journal(file_names::JOURNAL, key)?)
}

/// Writes a synthesized sequence into its run folder; its journal is no longer needed.
pub fn write_synthesis(
    run: &RunFolder,
    source: &ClothingSource,
    input: &SynthesisInput<'_>,
    mut sequence: SynthesizedSequence,
    seconds: f64,
) -> Result<SynthesisSummary, ClothingModelRunError> {
    let SynthesisInput { dressed, meshes, config, .. } = *input;
    const REPLAYED_COMPONENTS: usize = 40;
    let stage: StageFolder = run.stage(StageName::Synthesize)?;
    stage.mark_unfinished()?;
    let space = source.animated(&mut sequence, REPLAYED_COMPONENTS)?;
    write_synthesized(&stage.file(synthesized_file_names::ARRAYS), &sequence)?;
    write_dressed_glb(&stage.file(synthesized_file_names::ANIMATION), &sequence, dressed, &space)?;
    if let Some(form) = meshes {
        write_clothing_meshes(&stage.file(synthesized_file_names::MESHES), &sequence, form)?;
    }
    let over = |frames: &[Penetration]| (!frames.is_empty()).then(|| Penetration::over(frames));
    let summary = SynthesisSummary {
        verb: "synthesize".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        frames: sequence.clothing.len(),
        clothing_vertices: dressed.clothing_vertex_count(),
        penetration_before: over(&sequence.before),
        penetration_after: over(&sequence.after),
        seconds,
        frames_per_second: sequence.clothing.len() as f64 / seconds.max(1e-9),
    };
    let path = stage.file(synthesized_file_names::SUMMARY);
    let text = serde_json::to_string_pretty(&summary).unwrap_or_default() + "\n";
    write_atomically(&path, text.as_bytes())
        .map_err(|source| RunFolderError::Unusable { path: path.clone(), source })?;
    Provenance::new("synthesize", config, 0)?.write(&stage.file(file_names::PROVENANCE))?;
    stage.mark_finished(&input.key()?)?;
    stage.remove(file_names::JOURNAL)?;
    Ok(summary)
}
