//! Full source bodies: people who are not instances of the space that is fitted.
//!
//! They carry every detail of the population's source data in the topology of the default space (CC0), so a fit
//! meets the part of a body that its own components cannot express.

use std::path::Path;

use glam::DVec3;
use habitus::artifacts::npz::{NpzError, NpzReader};
use habitus::body::BodyModel;
use serde::Deserialize;

use crate::error::SyntheticError;

const ARCHIVE: &[u8] = include_bytes!("../assets/source_bodies.npz");
const ARCHIVE_NAME: &str = "source_bodies.npz (embedded)";

/// A regressed joint of a body in the right topology is within this of the source's own joint, metres.
const LARGEST_JOINT_ERROR: f64 = 0.01;

#[derive(Deserialize)]
struct Metadata {
    names: Vec<String>,
}

fn open() -> Result<NpzReader, NpzError> {
    NpzReader::new(ARCHIVE.to_vec(), Path::new(ARCHIVE_NAME))
}

/// Names of the source bodies, in order.
pub fn source_body_names() -> Result<Vec<String>, SyntheticError> {
    let mut archive = open()?;
    let text = archive.text("metadata")?;
    let metadata: Metadata =
        serde_json::from_str(&text).map_err(|error| archive.invalid("metadata", error.to_string()))?;
    Ok(metadata.names)
}

/// Rest vertices of one source body in the topology of the default space, metres.
pub fn source_body(model: &BodyModel, index: usize) -> Result<Vec<DVec3>, SyntheticError> {
    let mut archive = open()?;
    let vertices = archive.integers("vertices")?;
    archive.expect_shape("vertices", &vertices, &[None, Some(model.vertex_count()), Some(3)])?;
    let body_count = vertices.shape[0];
    if index >= body_count {
        return Err(SyntheticError::Setting {
            setting: "source_body",
            value: index.to_string(),
            expected: format!("below {body_count}"),
        });
    }
    let (offset, scale) = (single(&mut archive, "offset")?, single(&mut archive, "scale")?);
    let length = model.vertex_count() * 3;
    let body: Vec<DVec3> = vertices.values[index * length..(index + 1) * length]
        .chunks_exact(3)
        .map(|place| DVec3::new(place[0] as f64, place[1] as f64, place[2] as f64) * scale + offset)
        .collect();
    check_topology(&mut archive, model, &body, index)?;
    Ok(body)
}

/// Joints that the model finds on the body must be near those that the source data gives.
fn check_topology(
    archive: &mut NpzReader,
    model: &BodyModel,
    body: &[DVec3],
    index: usize,
) -> Result<(), SyntheticError> {
    let joints = archive.floats("joints")?;
    let joint_count = model.skeleton().bones().len();
    archive.expect_shape("joints", &joints, &[None, Some(joint_count), Some(3)])?;
    let stored = joints.values.chunks_exact(3).skip(index * joint_count).map(DVec3::from_slice);
    let farthest = model
        .joints(body)
        .iter()
        .zip(stored)
        .map(|(found, stored)| found.distance(stored))
        .fold(0.0, f64::max);
    if farthest > LARGEST_JOINT_ERROR {
        let reason = format!(
            "belongs to another topology: a joint is {farthest:.2} m off in the model's; use the default space"
        );
        return Err(archive.invalid("vertices", reason).into());
    }
    Ok(())
}

/// The only element of an array.
fn single(archive: &mut NpzReader, key: &str) -> Result<f64, NpzError> {
    let array = archive.floats(key)?;
    archive.expect_shape(key, &array, &[Some(1)])?;
    Ok(array.values[0])
}
