//! The result of `synthesize`: a dressed person in a motion, as meshes of one topology and as amounts of components.
//!
//! Keys of its `.npz`: `clothing` (F, V, 3) in f32 metres, `clothing_faces`, `coefficients` (F, K) in standard deviations,
//! `pose` (F, P), `body_rest_vertices`, `body_faces`, `frames_per_second`.

use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus_geometry::io::{WriteError, write_mesh};
use habitus_geometry::{MeshError, TriangleMesh};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::npz::{NpzError, NpzWriter};
use super::rigged_sequence::{FrameRate, RiggedSequence};

/// How much of a clothing is inside the body: where the body's surface winds around it once. Where parts of the body overlap, it
/// winds around twice or more; clothing there is pinched between them, and is counted apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Penetration {
    /// Share of the clothing's vertices.
    pub inside_share: f64,
    /// Mean depth of those, mm.
    pub mean_depth_mm: f64,
    /// Largest depth of a vertex, the middle of an edge or the middle of a face, mm.
    pub deepest_mm: f64,
    /// Share of the clothing's vertices that are pinched.
    #[serde(default)]
    pub pinched_share: f64,
}

impl Penetration {
    /// Over several frames: mean share, mean depth of what is inside, and largest depth.
    pub fn over(frames: &[Self]) -> Self {
        let count = frames.len().max(1) as f64;
        let share: f64 = frames.iter().map(|frame| frame.inside_share).sum();
        let depth: f64 = frames.iter().map(|frame| frame.inside_share * frame.mean_depth_mm).sum();
        Self {
            inside_share: share / count,
            mean_depth_mm: if share > 0.0 { depth / share } else { 0.0 },
            deepest_mm: frames.iter().map(|frame| frame.deepest_mm).fold(0.0, f64::max),
            pinched_share: frames.iter().map(|frame| frame.pinched_share).sum::<f64>() / count,
        }
    }
}

/// A dressed person in a motion, metres, y up.
#[derive(Clone, Debug, PartialEq)]
pub struct SynthesizedSequence {
    /// The body with a pose for each frame.
    pub body: RiggedSequence,
    /// Frames per second.
    pub frame_rate: FrameRate,
    /// Triangles of the clothing.
    pub clothing_faces: Vec<[u32; 3]>,
    /// Clothing of each frame, after it was pushed out of the body.
    pub clothing: Vec<Vec<DVec3>>,
    /// Coefficients of the layer's components, one row a frame, in standard deviations; no columns if the layer is replayed.
    pub coefficients: DMatrix<f64>,
    /// What was inside the body before it was pushed out, frame by frame; empty if it was not pushed out.
    pub before: Vec<Penetration>,
    /// What is inside the body after that; empty if it was not pushed out.
    pub after: Vec<Penetration>,
}

/// Form of a mesh sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshFiles {
    /// `clothing_000000.ply` and so on.
    Ply,
    /// `clothing_000000.obj` and so on.
    Obj,
}

/// Why a sequence cannot be written.
#[derive(Debug, Error)]
pub enum SynthesizedFileError {
    /// A folder cannot be made.
    #[error("{}: the folder cannot be made ({source})", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A frame is no mesh.
    #[error("frame {frame}: {source}")]
    Mesh {
        /// The frame.
        frame: usize,
        /// What is wrong.
        source: MeshError,
    },
    /// A mesh cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The archive cannot be written.
    #[error(transparent)]
    Npz(#[from] NpzError),
}

/// Writes the clothing of each frame into a folder, with the same order of vertices in every file.
pub fn write_clothing_meshes(
    folder: &Path,
    sequence: &SynthesizedSequence,
    form: MeshFiles,
) -> Result<(), SynthesizedFileError> {
    std::fs::create_dir_all(folder)
        .map_err(|source| SynthesizedFileError::Folder { path: folder.to_path_buf(), source })?;
    let extension = match form {
        MeshFiles::Ply => "ply",
        MeshFiles::Obj => "obj",
    };
    for (frame, vertices) in sequence.clothing.iter().enumerate() {
        let mesh = TriangleMesh::new(vertices.clone(), sequence.clothing_faces.clone())
            .map_err(|source| SynthesizedFileError::Mesh { frame, source })?;
        write_mesh(&folder.join(format!("clothing_{frame:06}.{extension}")), &mesh)?;
    }
    Ok(())
}

/// Writes the sequence as one archive.
pub fn write_synthesized(path: &Path, sequence: &SynthesizedSequence) -> Result<(), SynthesizedFileError> {
    let body = &sequence.body;
    let (frames, vertices) = (sequence.clothing.len(), sequence.clothing.first().map_or(0, Vec::len));
    let flat = |faces: &[[u32; 3]]| faces.iter().flatten().map(|vertex| *vertex as i32).collect::<Vec<_>>();
    let clothing: Vec<f32> =
        sequence.clothing.iter().flatten().flat_map(|vertex| vertex.as_vec3().to_array()).collect();
    let poses: Vec<f64> = body.sequence.frames.iter().flat_map(|frame| frame.pose.iter().copied()).collect();
    let rest: Vec<f64> = body.sequence.rest_vertices.iter().flat_map(|vertex| vertex.to_array()).collect();
    let mut file = NpzWriter::new();
    file.add("clothing", &[frames, vertices, 3], &clothing);
    file.add("clothing_faces", &[sequence.clothing_faces.len(), 3], &flat(&sequence.clothing_faces));
    let coefficients = sequence.coefficients.transpose();
    file.add("coefficients", &[sequence.coefficients.nrows(), coefficients.nrows()], coefficients.as_slice());
    file.add("pose", &[frames, body.rig.skeleton.pose_length()], &poses);
    file.add("body_rest_vertices", &[rest.len() / 3, 3], &rest);
    file.add("body_faces", &[body.rig.faces.len(), 3], &flat(&body.rig.faces));
    file.add("frames_per_second", &[1], &[sequence.frame_rate.frames_per_second()]);
    Ok(file.write(path)?)
}
