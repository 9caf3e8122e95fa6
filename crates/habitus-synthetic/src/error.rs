//! What can go wrong when making a dressed sequence.

use std::path::PathBuf;

/// Errors of this crate; each names what to change.
#[derive(Debug, thiserror::Error)]
pub enum SyntheticError {
    /// A mesh that was made is not a valid mesh.
    #[error("a generated mesh is invalid: {0}")]
    Mesh(#[from] habitus::geometry::MeshError),
    /// An archive is broken or does not fit the model.
    #[error(transparent)]
    Archive(#[from] habitus::artifacts::npz::NpzError),
    /// A garment has no cloth left after its openings were cut.
    #[error(
        "the garment \"{garment}\" has no cloth on this body; give a larger ease or a smaller cloth_edge_mm"
    )]
    EmptyGarment {
        /// Name of the garment.
        garment: &'static str,
    },
    /// The capture found no surface.
    #[error("frame {frame}: nothing was captured; use smaller voxels or more cameras")]
    EmptyCapture {
        /// Index of the frame.
        frame: usize,
    },
    /// A setting is out of its range.
    #[error("setting {setting} is {value}, but must be {expected}")]
    Setting {
        /// Name of the setting.
        setting: &'static str,
        /// What was given.
        value: String,
        /// What is allowed.
        expected: String,
    },
    /// A motion file cannot be read.
    #[error(transparent)]
    Motion(#[from] habitus::artifacts::motion_files::MotionFileError),
    /// A motion cannot be brought to the person.
    #[error(transparent)]
    Retarget(#[from] habitus::fitting::retarget::RetargetError),
    /// A fabric is not known, or its file is broken.
    #[error(transparent)]
    Fabric(#[from] habitus::artifacts::fabric::FabricError),
    /// A file could not be read or written.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: PathBuf,
        /// What failed.
        reason: String,
    },
}
