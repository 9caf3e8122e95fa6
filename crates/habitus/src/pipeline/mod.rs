//! Run folders: the only place that puts stages in order and files on disk.
//!
//! ```text
//! captures ──input_key──▶ RunFolder/3_fit_sequence ──fit_sequence──▶ measure ──▶ files ──▶ Summary
//! ```
//! A stage whose inputs, settings and version are those of the files on disk is not done again; one that was killed
//! goes on from its journal.

mod bootstrap;
mod capture_origin;
mod clothing_evaluation;
mod clothing_left_out;
mod clothing_model_run;
mod clothing_run;
mod clothing_sliders;
mod input_key;
mod landmark_run;
mod learnt_shape;
mod reconstruction_evaluation;
mod register_run;
mod registered_run;
mod run_folder;
mod sequence_run;
mod shape_space_evaluation;
mod summary;
mod user_landmarks;

pub use bootstrap::{
    Bootstrap, BootstrapConfig, BootstrapError, BootstrapInput, CurvePoint, RejectedScan, RoundSummary,
};
pub use capture_origin::CaptureOrigin;
pub use clothing_evaluation::{ClothingEvaluation, EvaluatedClothing};
pub use clothing_model_run::{
    ClothingModelRunError, ClothingSource, SynthesisInput, SynthesisSummary, finished_synthesis,
    learn_clothing_files, read_layers, read_motion, synthesis_journal, synthesized_file_names,
    write_synthesis,
};
pub use clothing_run::{
    ClothingInput, ClothingRun, ClothingRunError, ClothingSummary, Connectivity, LAYER_FILE, captures_of_fit,
    read_stored_layer,
};
pub use input_key::InputKey;
pub use landmark_run::LandmarkRun;
pub use learnt_shape::{
    LearnFolderError, RegistrationFolder, SubjectGroup, learn_shape_to_file, settings_of_model,
};
pub use reconstruction_evaluation::{
    EvaluateReconstructionsError, KnownPair, by_components, by_training_samples,
};
pub use register_run::{RegisterRun, RegisterRunError, RegisterSummary, ScanInput, ScanSummary, list_scans};
pub use registered_run::{
    RegisteredRun, RegisteredRunError, ScanPair, ScanPlaces, decide_by_score, registration_folder,
    round_folder,
};
pub use run_folder::{RunFolder, RunFolderError, StageFolder, StageName};
pub use sequence_run::{
    MeasuredFit, RunError, SequenceInput, SequenceRun, file_names, measure_rest_body, measure_stored_fit,
    read_stored_fit,
};
pub use shape_space_evaluation::{
    EvaluateSpaceError, EvaluationScope, NamedFitError, NamedQuality, ShapeSpaceMetrics, evaluate_run,
    evaluate_shape_space,
};
pub use summary::{CodeSummary, MeasurementSummary, Seconds, Summary};
pub use user_landmarks::{LandmarkFileError, read_user_landmarks};
