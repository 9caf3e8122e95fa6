//! The fitted bodies as plain meshes in the input's own frame: one PLY for each frame, and the rest body.

use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus_geometry::io::{WriteError, write_mesh};
use habitus_geometry::{MeshError, TriangleMesh};
use thiserror::Error;

use super::rigged_sequence::RiggedSequence;

/// Name of the rest body's file.
pub const REST_FILE: &str = "rest.ply";

/// Why bodies cannot be written.
#[derive(Debug, Error)]
pub enum BodyExportError {
    /// The folder cannot be made.
    #[error("{}: the folder cannot be made ({source})", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A body is not a usable mesh.
    #[error("frame {frame}: {source}")]
    Mesh {
        /// The frame, counted from 0; the rest body has the number of frames.
        frame: usize,
        /// What is wrong.
        source: MeshError,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// What to do with frames whose codes say that their body is not to be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FailedFrames {
    /// No file for them.
    LeaveOut,
    /// A file for every frame.
    Write,
}

/// Name of a frame's file; frames count from 0 as in `fit.npz`.
pub fn body_file_name(frame: usize) -> String {
    format!("body_{frame:06}.ply")
}

/// Writes `body_000000.ply` … and `rest.ply` in the input's frame and unit, each at the scale of its frame's own
/// capture, so that both lie over one another; gives the files in order.
pub fn write_bodies(
    folder: &Path,
    fit: &RiggedSequence,
    failed_frames: FailedFrames,
) -> Result<Vec<PathBuf>, BodyExportError> {
    std::fs::create_dir_all(folder)
        .map_err(|source| BodyExportError::Folder { path: folder.to_path_buf(), source })?;
    let mut written = Vec::new();
    for (frame, fitted) in fit.sequence.frames.iter().enumerate() {
        if fitted.is_ok() || failed_frames == FailedFrames::Write {
            let path = folder.join(body_file_name(frame));
            write_body(&path, fit, frame, &at_capture_scale(fit, frame))?;
            written.push(path);
        }
    }
    let path = folder.join(REST_FILE);
    write_body(&path, fit, fit.sequence.frames.len(), &fit.sequence.rest_vertices)?;
    written.push(path);
    Ok(written)
}

fn at_capture_scale(fit: &RiggedSequence, frame: usize) -> Vec<DVec3> {
    let mut vertices = fit.posed_vertices(frame);
    let scale = fit.sequence.frames[frame].capture_scale;
    vertices.iter_mut().for_each(|vertex| *vertex *= scale);
    vertices
}

fn write_body(
    path: &Path,
    fit: &RiggedSequence,
    frame: usize,
    vertices: &[DVec3],
) -> Result<(), BodyExportError> {
    let input_frame = &fit.sequence.input_frame;
    let positions = vertices.iter().map(|vertex| input_frame.to_input(*vertex)).collect();
    let mesh = TriangleMesh::new(positions, fit.rig.faces.clone())
        .map_err(|source| BodyExportError::Mesh { frame, source })?;
    Ok(write_mesh(path, &mesh)?)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use habitus_geometry::io::read_mesh;

    use super::{FailedFrames, write_bodies};
    use crate::artifacts::fixture::{largest_distance, rigged_sequence};

    #[test]
    fn bodies_are_written_in_the_input_frame() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("bodies");
        let fit = rigged_sequence(3);
        let files = write_bodies(&target, &fit, FailedFrames::Write).unwrap();
        let names: Vec<_> = files.iter().map(|path| path.file_name().unwrap().to_str().unwrap()).collect();
        assert_eq!(names, ["body_000000.ply", "body_000001.ply", "body_000002.ply", "rest.ply"]);
        for (frame, file) in files[..3].iter().enumerate() {
            let mesh = read_mesh(file).unwrap();
            let scale = if frame == 2 { 1.5 } else { 1.0 };
            let to_capture = |v: &DVec3| fit.sequence.input_frame.to_input(*v) * scale;
            let expected: Vec<DVec3> = fit.posed_vertices(frame).iter().map(to_capture).collect();
            assert_eq!(mesh.faces(), fit.rig.faces);
            // Millimetres as 32-bit floats.
            assert!(largest_distance(mesh.positions(), &expected) < 1e-3);
        }
    }

    #[test]
    fn failed_frames_can_be_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let files = write_bodies(folder.path(), &rigged_sequence(3), FailedFrames::LeaveOut).unwrap();
        assert_eq!(files.len(), 3, "frame 1 failed");
        assert!(!folder.path().join("body_000001.ply").exists());
    }
}
