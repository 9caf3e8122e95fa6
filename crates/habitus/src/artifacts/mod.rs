//! What stages hand to one another: data and its file form, no algorithm.

pub mod body_export;
pub mod clothing_controls;
pub mod clothing_layer;
pub mod clothing_model;
pub mod codes;
mod csv;
pub mod depth_image;
pub mod dressed_glb;
pub mod fabric;
pub mod fitted_sequence;
#[cfg(test)]
pub(crate) mod fixture;
pub mod frames;
pub mod journal;
pub mod measurements;
pub mod motion_bvh;
pub mod motion_clip;
pub mod motion_files;
pub mod npz;
pub mod provenance;
pub mod registered_scan;
pub mod review_decisions;
mod rig_file;
pub mod rigged_sequence;
pub mod scan;
pub mod scan_landmarks;
pub mod sequence_files;
pub mod skinned_glb;
pub mod synthesized_sequence;
pub mod template_mesh;

use std::io::Write;
use std::path::Path;

/// Writes a file under a temporary name beside it and renames it: a kill at any moment leaves either
/// the old file or the new one.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".partial");
    let temporary = path.with_file_name(name);
    let mut file = std::fs::File::create(&temporary)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    std::fs::rename(&temporary, path)
}
