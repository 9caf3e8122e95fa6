//! Run folders: the only place that puts stages in order and files on disk.
//!
//! ```text
//! captures ──input_key──▶ RunFolder/3_fit_sequence ──fit_sequence──▶ measure ──▶ files ──▶ Summary
//! ```
//! A stage whose inputs, settings and version are those of the files on disk is not done again; one that was killed
//! goes on from its journal.

mod capture_origin;
mod clothing_run;
mod input_key;
mod register_run;
mod registered_run;
mod run_folder;
mod sequence_run;
mod summary;
mod user_landmarks;

pub use capture_origin::CaptureOrigin;
pub use clothing_run::{
    ClothingInput, ClothingRun, ClothingRunError, ClothingSummary, Connectivity, LAYER_FILE, captures_of_fit,
    read_stored_layer,
};
pub use input_key::InputKey;
pub use register_run::{RegisterRun, RegisterRunError, RegisterSummary, ScanInput, ScanSummary, list_scans};
pub use registered_run::{
    RegisteredRun, RegisteredRunError, ScanPair, ScanPlaces, decide_by_score, registration_folder,
    round_folder,
};
pub use run_folder::{RunFolder, RunFolderError, StageFolder, StageName};
pub use sequence_run::{
    MeasuredFit, RunError, SequenceInput, SequenceRun, file_names, measure_fit, measure_rest_body,
    measure_stored_fit, read_stored_fit,
};
pub use summary::{CodeSummary, MeasurementSummary, Seconds, Summary};
pub use user_landmarks::{LandmarkFileError, read_user_landmarks};
