//! The layer's file: round trip, plain reading, and refusal of what is broken.

use std::path::Path;

use glam::DVec3;

use super::file::read_layer_bytes;
use super::*;
use crate::artifacts::fixture::{largest_distance, rigged_sequence};
use crate::artifacts::npz::{NpzReader, NpzWriter};

/// A shell three centimetres over some of the figure's vertices, each of which hangs on two body vertices.
pub(crate) fn layer(frame_count: usize) -> ClothingLayer {
    let fit = rigged_sequence(frame_count);
    let vertex_count = 30;
    let body_count = fit.sequence.rest_vertices.len() as u32;
    let association = ClothingAssociation {
        body_vertices_per_clothing_vertex: 2,
        body_vertices: (0..vertex_count)
            .flat_map(|k| [3 * k % body_count, (3 * k + 1) % body_count])
            .collect(),
        weights: (0..vertex_count).flat_map(|k| if k % 7 == 0 { [1.0, 0.0] } else { [0.75, 0.25] }).collect(),
        origins: (0..vertex_count)
            .map(|k| if k % 5 == 0 { AssociationOrigin::Completed } else { AssociationOrigin::Diffused })
            .collect(),
        smallest_stretch: 0.2,
        spread_skin: None,
    };
    let frames = fit.sequence.frames.iter().enumerate().map(|(index, frame)| ClothingFrame {
        name: frame.name.clone(),
        capture_index: 2 * index,
        pose: frame.pose.clone(),
        codes: frame.codes.clone(),
        quality: AlignmentQuality { mean_to_capture: 1e-3 * index as f64, ..AlignmentQuality::default() },
    });
    ClothingLayer {
        input_frame: fit.sequence.input_frame.clone(),
        identity: fit.sequence.identity.clone(),
        rest_vertices: fit.sequence.rest_vertices.clone(),
        rest_joints: fit.sequence.rest_joints.clone(),
        association,
        clothing_faces: (0..vertex_count - 2).map(|k| [k, k + 1, k + 2]).collect(),
        frame_rate: FrameRate::new(30.0).unwrap(),
        frames: frames.collect(),
        offsets: (0..frame_count * vertex_count as usize * 3)
            .map(|k| 0.03 * (0.7 * k as f32).sin())
            .collect(),
        rig: fit.rig,
    }
}

fn written(layer: &ClothingLayer) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("layer.npz");
    write_layer(&path, layer).unwrap();
    std::fs::read(path).unwrap()
}

fn read(bytes: Vec<u8>) -> Result<ClothingLayer, LayerFileError> {
    read_layer_bytes(bytes, Path::new("layer.npz"))
}

#[test]
fn writing_and_reading_gives_the_same_clothing_to_the_bit() {
    let before = layer(4);
    let after = read(written(&before)).unwrap();
    assert_eq!(before.association, after.association);
    assert_eq!((&before.frames, &before.offsets), (&after.frames, &after.offsets));
    assert_eq!(before.input_frame, after.input_frame);
    assert_eq!(before.time_of(3), 0.2);
    for frame in 0..4 {
        assert_eq!(before.clothing_vertices(frame), after.clothing_vertices(frame));
    }
}

/// The layer with other bone weights than those of its body vertices: three bones share each vertex.
fn with_spread_skin(frame_count: usize) -> ClothingLayer {
    let mut layer = layer(frame_count);
    let bone_count = layer.rig.skeleton.bones().len();
    let mut table = vec![0.0; 30 * bone_count];
    for (vertex, row) in table.chunks_exact_mut(bone_count).enumerate() {
        for (k, weight) in [0.5, 0.3, 0.2].into_iter().enumerate() {
            row[(vertex + 2 * k) % bone_count] += weight;
        }
    }
    layer.association.spread_skin = Some(BlendedSkin::of_table(bone_count, &table));
    layer
}

#[test]
fn spread_bone_weights_pose_the_clothing_and_survive_the_file() {
    let before = with_spread_skin(3);
    assert!(largest_distance(&before.clothing_vertices(1), &layer(3).clothing_vertices(1)) > 1e-3);
    let after = read(written(&before)).unwrap();
    assert_eq!(before.association, after.association);
    for frame in 0..3 {
        assert_eq!(before.clothing_vertices(frame), after.clothing_vertices(frame));
    }
    // A program that knows version 1 alone would use other weights, so it must not read this file, but may read the other.
    for (layer, version) in [(&before, "\"version\":2"), (&layer(3), "\"version\":1")] {
        let text = NpzReader::new(written(layer), Path::new("layer.npz")).unwrap().text("metadata").unwrap();
        assert!(text.contains(version), "{text}");
    }
}

#[test]
fn bone_weights_that_are_no_shares_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("layer.npz");
    let bone_count = layer(1).rig.skeleton.bones().len();
    let mut weights = with_spread_skin(1).association.spread_skin.unwrap().table(bone_count);
    weights[2] += 0.1;
    for table in [&weights[..], &weights[bone_count..]] {
        let mut broken = layer(1);
        broken.association.spread_skin = Some(BlendedSkin::of_table(bone_count, table));
        assert!(matches!(write_layer(&path, &broken), Err(LayerFileError::Inconsistent { .. })));
    }
    assert!(!path.exists());
}

/// As a reader with nothing but the arrays would write it: Σ ω Σ w (R (anchor + offset) + t).
#[test]
fn the_arrays_alone_pose_the_clothing() {
    let layer = layer(3);
    let mut file = NpzReader::new(written(&layer), Path::new("layer.npz")).unwrap();
    let offsets = file.floats("offsets").unwrap().values;
    let bodies = file.indices("association_body_vertices", layer.rest_vertices.len()).unwrap().values;
    let weights = file.floats("association_weights").unwrap().values;
    for frame in 0..3 {
        let skeleton = layer.posed_skeleton(frame);
        let plain: Vec<DVec3> = (0..30)
            .map(|vertex| {
                let pairs = || (0..2).map(|k| (bodies[2 * vertex + k] as usize, weights[2 * vertex + k]));
                let anchor: DVec3 = pairs().map(|(body, weight)| layer.rest_vertices[body] * weight).sum();
                let rest = anchor + DVec3::from_slice(&offsets[(frame * 30 + vertex) * 3..]);
                let posed = |body: usize| -> DVec3 {
                    let bones = layer.rig.skin.of(body);
                    bones
                        .map(|(bone, w)| (skeleton.rotations[bone] * rest + skeleton.translations[bone]) * w)
                        .sum()
                };
                pairs().map(|(body, weight)| posed(body) * weight).sum()
            })
            .collect();
        assert!(largest_distance(&plain, &layer.clothing_vertices(frame)) < 1e-9);
    }
}

#[test]
fn what_contradicts_itself_is_neither_written_nor_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("layer.npz");
    let mut broken = layer(2);
    broken.association.weights[4] += 0.1;
    assert!(matches!(write_layer(&path, &broken), Err(LayerFileError::Inconsistent { .. })));
    let mut broken = layer(2);
    broken.offsets.pop();
    assert!(matches!(write_layer(&path, &broken), Err(LayerFileError::Inconsistent { .. })));
    let mut broken = layer(2);
    broken.offsets[5] = f32::NAN;
    assert!(matches!(write_layer(&path, &broken), Err(LayerFileError::Inconsistent { .. })));
    let mut broken = layer(2);
    broken.frames.swap(0, 1);
    assert!(matches!(write_layer(&path, &broken), Err(LayerFileError::Inconsistent { .. })));
    assert!(!path.exists());
}

#[test]
fn truncated_foreign_and_newer_files_are_refused_by_name() {
    let bytes = written(&layer(2));
    for length in [0, 1, bytes.len() / 3, bytes.len() / 2, bytes.len() - 1] {
        let error = read(bytes[..length].to_vec()).expect_err("is cut");
        assert!(error.to_string().contains("layer.npz"), "{error}");
    }
    let with_metadata = |text: &str| {
        let mut file = NpzWriter::new();
        file.add_text("metadata", text);
        read(file.into_bytes().unwrap())
    };
    let foreign = with_metadata(r#"{"format": "habitus-fit", "version": 1}"#);
    assert!(matches!(foreign, Err(LayerFileError::Foreign { .. })));
    let newer = with_metadata(r#"{"format": "habitus-clothing-layer", "version": 3}"#);
    assert!(matches!(newer, Err(LayerFileError::Newer { found: 3, .. })));
    assert!(with_metadata("{").is_err());
}
