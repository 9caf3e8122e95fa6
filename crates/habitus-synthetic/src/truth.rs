//! A dressed sequence on disk: one PLY capture per frame and the truth in one `.npz`.
//!
//! Keys of `truth.npz`: `settings` (UTF-8 JSON), `rest_vertices` (V, 3), `faces` (T, 3), `pose` (F, P),
//! `joints` (F, J, 3), `landmarks` (F, L, 3), `posed_vertices` (F, V, 3), all in metres and radians, and per garment
//! `garment_<name>_faces` (T, 3) and `garment_<name>_positions` (F, V, 3).

use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus::artifacts::npz::{Array, NpzReader, NpzWriter};
use habitus::body::BodyModel;
use habitus::geometry::io::write_mesh;

use crate::error::SyntheticError;
use crate::garment::Garment;
use crate::sequence::{DressedSequenceSettings, Performance, Progress, Scene, stream};
use crate::source_bodies::source_body;

/// File of the truth within a sequence's folder.
pub const TRUTH_FILE: &str = "truth.npz";

/// What a fit of a dressed sequence has to find.
#[derive(Debug, Clone, PartialEq)]
pub struct DressedTruth {
    /// What the sequence was made with.
    pub settings: DressedSequenceSettings,
    /// The person at rest, metres.
    pub rest_vertices: Vec<DVec3>,
    /// The body's faces.
    pub faces: Vec<[u32; 3]>,
    /// Pose parameters of each frame.
    pub poses: Vec<Vec<f64>>,
    /// Joints of each frame, metres.
    pub joints: Vec<Vec<DVec3>>,
    /// Landmark vertices of each frame, metres.
    pub landmarks: Vec<Vec<DVec3>>,
    /// The naked body of each frame, metres.
    pub posed_vertices: Vec<Vec<DVec3>>,
}

/// Name of a frame's capture.
pub fn capture_file(frame: usize) -> String {
    format!("frame_{frame:04}.ply")
}

/// Makes a sequence of a source body and writes it to a folder frame by frame; the truth comes last.
pub fn write_sequence(
    model: &BodyModel,
    settings: &DressedSequenceSettings,
    folder: &Path,
    progress: Progress<'_>,
) -> Result<DressedTruth, SyntheticError> {
    std::fs::create_dir_all(folder)
        .map_err(|error| SyntheticError::File { path: folder.to_path_buf(), reason: error.to_string() })?;
    let mut performance = Performance::new(model, source_body(model, settings.source_body)?, settings)?;
    let mut scenes: Vec<Scene> = Vec::with_capacity(settings.frame_count);
    stream(&mut performance, &mut |frame| {
        let path = folder.join(capture_file(frame.index));
        write_mesh(&path, &frame.capture)
            .map_err(|error| SyntheticError::File { path, reason: error.to_string() })?;
        scenes.push(frame.scene);
        progress(scenes.len(), settings.frame_count);
        Ok(())
    })?;
    let truth = DressedTruth::of(&performance, &scenes);
    truth.write(performance.garments(), &scenes, folder)?;
    Ok(truth)
}

impl DressedTruth {
    /// The truth of some scenes of a performance.
    pub fn of(performance: &Performance<'_>, scenes: &[Scene]) -> Self {
        Self {
            settings: performance.settings().clone(),
            rest_vertices: performance.body().positions().to_vec(),
            faces: performance.body().faces().to_vec(),
            poses: scenes.iter().map(|scene| scene.pose.parameters().to_vec()).collect(),
            joints: scenes.iter().map(|scene| scene.joints.clone()).collect(),
            landmarks: scenes.iter().map(|scene| scene.landmarks.clone()).collect(),
            posed_vertices: scenes.iter().map(|scene| scene.body_vertices.clone()).collect(),
        }
    }

    fn write(&self, garments: &[Garment], scenes: &[Scene], folder: &Path) -> Result<(), SyntheticError> {
        let path = folder.join(TRUTH_FILE);
        let settings = serde_json::to_string_pretty(&self.settings)
            .map_err(|error| SyntheticError::File { path: path.clone(), reason: error.to_string() })?;
        let mut archive = NpzWriter::new();
        archive.add_text("settings", &settings);
        archive.add("rest_vertices", &[self.rest_vertices.len(), 3], &coordinates(&self.rest_vertices));
        archive.add("faces", &[self.faces.len(), 3], &indices(&self.faces));
        let frame_count = self.poses.len();
        archive.add("pose", &[frame_count, self.poses.first().map_or(0, Vec::len)], &self.poses.concat());
        add_points(&mut archive, "joints", &self.joints);
        add_points(&mut archive, "landmarks", &self.landmarks);
        add_points(&mut archive, "posed_vertices", &self.posed_vertices);
        for (place, garment) in garments.iter().enumerate() {
            let key = format!("garment_{}", garment.name);
            archive.add(&format!("{key}_faces"), &[garment.faces.len(), 3], &indices(&garment.faces));
            let positions: Vec<Vec<DVec3>> =
                scenes.iter().map(|scene| scene.garment_positions[place].clone()).collect();
            add_points(&mut archive, &format!("{key}_positions"), &positions);
        }
        Ok(archive.write(&path)?)
    }

    /// Reads what a sequence's folder says of its settings, and nothing else.
    pub fn read_settings(folder: &Path) -> Result<DressedSequenceSettings, SyntheticError> {
        settings(&mut open(folder)?)
    }

    /// Reads the truth of a sequence's folder.
    pub fn read(folder: &Path) -> Result<Self, SyntheticError> {
        let mut archive = open(folder)?;
        let settings = settings(&mut archive)?;
        let rest = archive.floats("rest_vertices")?;
        archive.expect_shape("rest_vertices", &rest, &[None, Some(3)])?;
        let vertex_count = rest.shape[0];
        let faces = archive.indices("faces", vertex_count)?;
        archive.expect_shape("faces", &faces, &[None, Some(3)])?;
        let pose = archive.floats("pose")?;
        archive.expect_shape("pose", &pose, &[None, None])?;
        let frame_count = pose.shape[0];
        let poses = pose.values.chunks_exact(pose.shape[1].max(1)).map(<[f64]>::to_vec).collect();
        Ok(Self {
            settings,
            rest_vertices: points(&rest.values),
            faces: faces.values.chunks_exact(3).map(|face| [face[0], face[1], face[2]]).collect(),
            poses,
            joints: frames_of_points(&mut archive, "joints", frame_count, None)?,
            landmarks: frames_of_points(&mut archive, "landmarks", frame_count, None)?,
            posed_vertices: frames_of_points(
                &mut archive,
                "posed_vertices",
                frame_count,
                Some(vertex_count),
            )?,
        })
    }
}

fn open(folder: &Path) -> Result<NpzReader, SyntheticError> {
    let path: PathBuf = folder.join(TRUTH_FILE);
    let bytes = std::fs::read(&path)
        .map_err(|error| SyntheticError::File { path: path.clone(), reason: error.to_string() })?;
    Ok(NpzReader::new(bytes, &path)?)
}

fn settings(archive: &mut NpzReader) -> Result<DressedSequenceSettings, SyntheticError> {
    let text = archive.text("settings")?;
    Ok(serde_json::from_str(&text).map_err(|error| archive.invalid("settings", error.to_string()))?)
}

fn coordinates(points: &[DVec3]) -> Vec<f32> {
    points.iter().flat_map(|point| point.as_vec3().to_array()).collect()
}

fn indices(faces: &[[u32; 3]]) -> Vec<i32> {
    faces.as_flattened().iter().map(|&vertex| vertex as i32).collect()
}

fn points(values: &[f64]) -> Vec<DVec3> {
    values.chunks_exact(3).map(DVec3::from_slice).collect()
}

fn add_points(archive: &mut NpzWriter, key: &str, frames: &[Vec<DVec3>]) {
    let values: Vec<f32> = frames.iter().flat_map(|frame| coordinates(frame)).collect();
    archive.add(key, &[frames.len(), frames.first().map_or(0, Vec::len), 3], &values);
}

fn frames_of_points(
    archive: &mut NpzReader,
    key: &str,
    frame_count: usize,
    point_count: Option<usize>,
) -> Result<Vec<Vec<DVec3>>, SyntheticError> {
    let array: Array<f64> = archive.floats(key)?;
    archive.expect_shape(key, &array, &[Some(frame_count), point_count, Some(3)])?;
    Ok(array.values.chunks_exact((array.shape[1] * 3).max(1)).map(points).collect())
}
