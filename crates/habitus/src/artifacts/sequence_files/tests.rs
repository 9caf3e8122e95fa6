//! The fit's file: round trip, plain skinning from its arrays alone, and refusal of what is broken.

use std::path::Path;

use glam::{DMat3, DVec3};

use super::{FitFileError, read_fit, read_fit_bytes, write_fit, write_landmarks};
use crate::artifacts::fixture::{largest_distance, rigged_sequence};
use crate::artifacts::npz::{NpzReader, NpzWriter};

fn written(frame_count: usize) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fit.npz");
    write_fit(&path, &rigged_sequence(frame_count)).unwrap();
    std::fs::read(path).unwrap()
}

#[test]
fn writing_and_reading_changes_nothing_beyond_rounding() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fit.npz");
    let before = rigged_sequence(20);
    write_fit(&path, &before).unwrap();
    let after = read_fit(&path).unwrap();
    let (a, b) = (&before.sequence, &after.sequence);
    assert_eq!(a.input_frame, b.input_frame);
    assert_eq!(
        (&a.identity, &a.identity_covariance, &a.codes),
        (&b.identity, &b.identity_covariance, &b.codes)
    );
    assert!(largest_distance(&a.rest_vertices, &b.rest_vertices) < 1e-12);
    assert!(largest_distance(&a.rest_joints, &b.rest_joints) < 1e-12);
    assert!(a.smallest_clearance.iter().zip(&b.smallest_clearance).all(|(a, b)| (a - b).abs() < 1e-12));
    assert_eq!(before.rig.faces, after.rig.faces);
    assert_eq!(before.rig.landmarks, after.rig.landmarks);
    assert_eq!(before.rig.skin.bones, after.rig.skin.bones);
    assert_eq!(a.frames.len(), b.frames.len());
    for (index, (x, y)) in a.frames.iter().zip(&b.frames).enumerate() {
        assert_eq!((&x.name, &x.codes, x.energy, x.seconds), (&y.name, &y.codes, y.energy, y.seconds));
        assert_eq!(x.capture_scale, y.capture_scale);
        // The sequence turns past π: the file's rotation vectors are unwound, so even the numbers come back.
        let worst = x.pose.iter().zip(&y.pose).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-9, "frame {index}: pose differs by {worst}");
        let of = |landmarks: &[crate::artifacts::fitted_sequence::Landmark]| -> Vec<DVec3> {
            landmarks.iter().map(|landmark| landmark.position).collect()
        };
        assert!(largest_distance(&of(&x.landmarks), &of(&y.landmarks)) < 1e-9);
        assert!(largest_distance(&before.posed_vertices(index), &after.posed_vertices(index)) < 1e-9);
    }
}

/// Linear blend skinning as a reader with nothing but the arrays would write it.
struct PlainReader {
    rest: Vec<DVec3>,
    joints: Vec<DVec3>,
    skin_bones: Vec<u32>,
    skin_weights: Vec<f64>,
    parents: Vec<i64>,
    axis_bones: Vec<u32>,
    axes: Vec<DVec3>,
    poses: Vec<f64>,
}

impl PlainReader {
    fn open(bytes: Vec<u8>) -> Self {
        let mut file = NpzReader::new(bytes, Path::new("fit.npz")).unwrap();
        let mut points = |key: &str| -> Vec<DVec3> {
            file.floats(key).unwrap().values.chunks_exact(3).map(DVec3::from_slice).collect()
        };
        let (rest, joints, axes) =
            (points("rest_vertices"), points("rest_joints"), points("axis_directions"));
        Self {
            rest,
            joints,
            axes,
            skin_bones: file.indices("skin_bones", 15).unwrap().values,
            skin_weights: file.floats("skin_weights").unwrap().values,
            parents: file.integers("bone_parents").unwrap().values,
            axis_bones: file.indices("axis_bones", 15).unwrap().values,
            poses: file.floats("pose").unwrap().values,
        }
    }

    fn posed(&self, frame: usize) -> (Vec<DVec3>, Vec<DVec3>) {
        let pose = &self.poses[frame * 30..(frame + 1) * 30];
        let turn = |axis: DVec3, angle: f64| DMat3::from_axis_angle(axis, angle);
        let root = DVec3::from_slice(&pose[3..6]);
        let mut rotations = vec![turn(root.normalize(), root.length())];
        let mut joints = vec![self.joints[0] + DVec3::from_slice(pose)];
        for bone in 1..15 {
            let parent = self.parents[bone] as usize;
            let mut local = DMat3::IDENTITY;
            for axis in (0..24).filter(|axis| self.axis_bones[*axis] as usize == bone) {
                local *= turn(self.axes[axis], pose[6 + axis]);
            }
            joints.push(joints[parent] + rotations[parent] * (self.joints[bone] - self.joints[parent]));
            rotations.push(rotations[parent] * local);
        }
        let vertices = (0..self.rest.len())
            .map(|vertex| {
                (0..4)
                    .map(|slot| {
                        let bone = self.skin_bones[4 * vertex + slot] as usize;
                        (rotations[bone] * (self.rest[vertex] - self.joints[bone]) + joints[bone])
                            * self.skin_weights[4 * vertex + slot]
                    })
                    .sum()
            })
            .collect();
        (vertices, joints)
    }
}

#[test]
fn plain_skinning_of_the_arrays_gives_the_body_in_the_input_frame() {
    let fit = rigged_sequence(6);
    let bytes = written(6);
    let plain = PlainReader::open(bytes.clone());
    let mut file = NpzReader::new(bytes, Path::new("fit.npz")).unwrap();
    let stored_joints = file.floats("joints").unwrap();
    assert_eq!(stored_joints.shape, [6, 15, 3]);
    for frame in 0..6 {
        let (vertices, joints) = plain.posed(frame);
        let expected: Vec<DVec3> =
            fit.posed_vertices(frame).iter().map(|v| fit.sequence.input_frame.to_input(*v)).collect();
        let stored: Vec<DVec3> = stored_joints.values[frame * 45..(frame + 1) * 45]
            .chunks_exact(3)
            .map(DVec3::from_slice)
            .collect();
        // Millimetres: a few thousand units, so 1e-9 is twelve digits.
        assert!(largest_distance(&vertices, &expected) < 1e-9 * 1e3);
        assert!(largest_distance(&joints, &stored) < 1e-9 * 1e3);
    }
}

#[test]
fn the_stated_arrays_are_there_with_their_shapes() {
    let mut file = NpzReader::new(written(3), Path::new("fit.npz")).unwrap();
    let vertex_count = rigged_sequence(1).sequence.rest_vertices.len();
    for (key, shape) in [
        ("identity", vec![6]),
        ("identity_uncertainty", vec![6]),
        ("identity_covariance", vec![6, 6]),
        ("pose", vec![3, 30]),
        ("rest_vertices", vec![vertex_count, 3]),
        ("rest_joints", vec![15, 3]),
        ("joints", vec![3, 15, 3]),
        ("landmarks", vec![3, 14, 3]),
        ("landmark_confidence", vec![3, 14]),
        ("frame_ok", vec![3]),
        ("capture_scale", vec![3]),
        ("skin_bones", vec![vertex_count, 4]),
        ("skin_weights", vec![vertex_count, 4]),
        ("bone_parents", vec![15]),
        ("axis_bones", vec![24]),
        ("axis_directions", vec![24, 3]),
        ("axis_limits", vec![24, 2]),
        ("smallest_clearance", vec![vertex_count]),
    ] {
        assert_eq!(file.floats(key).unwrap().shape, shape, "{key}");
    }
    assert_eq!(file.floats("frame_ok").unwrap().values, [1.0, 0.0, 1.0]);
    assert_eq!(file.floats("identity_uncertainty").unwrap().values, [0.2; 6]);
}

#[test]
fn a_truncated_or_damaged_file_is_refused_and_never_panics() {
    let bytes = written(2);
    for length in (0..bytes.len()).step_by(211) {
        assert!(read_fit_bytes(bytes[..length].to_vec(), Path::new("fit.npz")).is_err(), "cut at {length}");
    }
    for position in (0..bytes.len()).step_by(97) {
        let mut damaged = bytes.clone();
        damaged[position] ^= 0x5a;
        let _ = read_fit_bytes(damaged, Path::new("fit.npz"));
    }
}

#[test]
fn other_and_newer_files_are_refused_by_name() {
    let with_metadata = |text: &str| {
        let mut file = NpzWriter::new();
        file.add_text("metadata", text);
        read_fit_bytes(file.into_bytes().unwrap(), Path::new("fit.npz")).unwrap_err()
    };
    let foreign = with_metadata(r#"{"format": "habitus-body-model", "version": 1}"#);
    assert!(matches!(foreign, FitFileError::Foreign { .. }), "{foreign}");
    let newer = with_metadata(r#"{"format": "habitus-fit", "version": 7}"#);
    assert!(matches!(newer, FitFileError::Newer { found: 7, .. }), "{newer}");
    let incomplete = with_metadata(r#"{"format": "habitus-fit", "version": 1}"#);
    assert!(incomplete.to_string().contains("fit.npz"), "{incomplete}");
    let model = crate::body::fixture::file_bytes(4);
    assert!(matches!(read_fit_bytes(model, Path::new("m.npz")), Err(FitFileError::Foreign { .. })));
}

#[test]
fn a_fit_that_could_not_be_read_again_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fit.npz");
    let refused = |change: fn(&mut super::FittedSequence), word: &str| {
        let mut fit = rigged_sequence(2);
        change(&mut fit.sequence);
        let error = write_fit(&path, &fit).unwrap_err();
        assert!(error.to_string().contains(word), "{error}");
        assert!(!path.exists());
    };
    refused(|sequence| sequence.frames[1].pose[4] = f64::NAN, "take, 0001.ply");
    refused(|sequence| sequence.frames[1].pose.truncate(12), "take, 0001.ply");
    refused(|sequence| sequence.frames[0].landmarks.clear(), "take, 0000.ply");
    refused(|sequence| sequence.frames[0].capture_scale = 0.0, "scale");
    refused(|sequence| sequence.rest_vertices[3].x = f64::INFINITY, "rest body");
    refused(|sequence| sequence.input_frame.metres_per_unit = 0.0, "unit");
    refused(|sequence| sequence.input_frame.internal_from_input.x_axis *= -1.0, "rotation");
    refused(|sequence| sequence.smallest_clearance.truncate(2), "vertices");
}

#[test]
fn a_quality_number_that_is_not_finite_survives_as_unknown() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fit.npz");
    let mut fit = rigged_sequence(1);
    fit.sequence.frames[0].energy = f64::INFINITY;
    write_fit(&path, &fit).unwrap();
    assert!(read_fit(&path).unwrap().sequence.frames[0].energy.is_nan());
}

#[test]
fn landmarks_are_written_in_the_input_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("landmarks.csv");
    let fit = rigged_sequence(2);
    write_landmarks(&path, &fit).unwrap();
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("frame,landmark,x,y,z,confidence"));
    let first = lines.next().unwrap();
    let values = first.strip_prefix("\"take, 0000.ply\",forehead,").unwrap();
    let numbers: Vec<f64> = values.split(',').map(|value| value.parse().unwrap()).collect();
    let expected = fit.sequence.input_frame.to_input(fit.sequence.frames[0].landmarks[0].position);
    assert!(DVec3::from_slice(&numbers).distance(expected) < 1e-9);
    assert_eq!((numbers[3], text.lines().count()), (0.75, 1 + 2 * 14));
}
