//! The model file: a round trip changes nothing, and no broken file gets in or panics.

use std::path::Path;

use super::{ModelFileError, read};
use crate::artifacts::npz::NpzError;
use crate::body::fixture;
use crate::body::model::BodyModel;

fn read_bytes(bytes: Vec<u8>) -> Result<BodyModel, ModelFileError> {
    read(bytes, Path::new("model.npz"))
}

#[test]
fn saving_and_loading_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("figure.npz");
    let model = fixture::model();
    model.save(&path).unwrap();
    let loaded = BodyModel::load(&path).unwrap();
    assert_eq!(loaded.metadata(), model.metadata());
    assert_eq!(loaded.skeleton(), model.skeleton());
    assert_eq!(loaded.faces(), model.faces());
    assert_eq!(loaded.mean_vertices(), model.mean_vertices());
    assert_eq!(loaded.standard_deviations(), model.standard_deviations());
    assert_eq!(loaded.landmark_vertices(), model.landmark_vertices());
    assert_eq!(loaded.mirror_vertices(), model.mirror_vertices());
    assert_eq!(loaded.part_labels(), model.part_labels());
    assert_eq!(loaded.surface().skin().bones, model.surface().skin().bones);
    assert_eq!(loaded.surface.basis, model.surface.basis);
    assert_eq!(loaded.surface().joint_map(), model.surface().joint_map());
    let bytes = std::fs::read(&path).unwrap();
    loaded.save(&path).unwrap();
    assert!(std::fs::read(&path).unwrap() == bytes, "equal models are equal to the byte");
}

#[test]
fn a_missing_file_is_named() {
    let error = BodyModel::load(Path::new("nowhere/at_all.npz")).unwrap_err();
    assert!(matches!(error, ModelFileError::Unreadable { .. }));
    assert!(error.to_string().contains("at_all.npz"), "{error}");
}

#[test]
fn a_truncated_file_is_refused_wherever_it_is_cut() {
    let bytes = fixture::file_bytes(4);
    for length in (0..bytes.len()).step_by(37) {
        assert!(read_bytes(bytes[..length].to_vec()).is_err(), "cut at {length} of {}", bytes.len());
    }
}

#[test]
fn a_damaged_byte_never_panics() {
    let bytes = fixture::file_bytes(4);
    for position in (0..bytes.len()).step_by(11) {
        let mut damaged = bytes.clone();
        damaged[position] ^= 0x5a;
        // The archive's own checksums catch almost all of it; a changed time stamp may pass.
        let _ = read_bytes(damaged);
    }
}

#[test]
fn foreign_and_newer_files_are_refused_by_name() {
    let change = |key: &'static str, value: serde_json::Value| {
        read_bytes(fixture::file_bytes_with_metadata(move |mut metadata| {
            metadata[key] = value.clone();
            metadata
        }))
        .unwrap_err()
    };
    let foreign = change("format", "habitus-fit".into());
    assert!(matches!(&foreign, ModelFileError::Foreign { found, .. } if found == "habitus-fit"));
    let newer = change("version", 2.into());
    assert!(matches!(newer, ModelFileError::Newer { found: 2, .. }));
    assert!(newer.to_string().contains("update habitus"), "{newer}");
    for (key, value) in [
        ("version", serde_json::json!("one")),
        ("bones", serde_json::json!(["pelvis"])),
        ("axes", serde_json::json!([])),
        ("landmarks", serde_json::json!(["forehead"])),
        ("measurement_vertices", serde_json::json!({"crown": 4_000_000})),
        ("measurement_vertices", serde_json::json!({"crown": -1})),
        ("name", serde_json::json!(null)),
    ] {
        let error = change(key, value);
        assert!(error.to_string().contains("model.npz"), "{key}: {error}");
    }
}

#[test]
fn a_plain_archive_without_the_arrays_says_which_is_missing() {
    let mut file = crate::artifacts::npz::NpzWriter::new();
    file.add("mean", &[1, 3], &[0.0_f32; 3]);
    let error = read_bytes(file.into_bytes().unwrap()).unwrap_err();
    assert!(
        matches!(&error, ModelFileError::Npz(NpzError::Missing { key, .. }) if key == "metadata"),
        "{error}"
    );
}

#[test]
fn each_array_is_checked_against_the_others() {
    use crate::artifacts::npz::NpzWriter;
    // Each case replaces one array by an unusable one.
    type Replacement = (&'static str, fn(&mut NpzWriter, &str));
    let cases: [Replacement; 19] = [
        ("mean", |file, key| file.add(key, &[2, 2], &[0.0_f32; 4])),
        ("mean", |file, key| file.add(key, &[1, 3], &[f32::NAN; 3])),
        ("mean", |file, key| file.add::<f32>(key, &[0, 3], &[])),
        ("basis", |file, key| file.add(key, &[1, 3], &[0.0_f32; 3])),
        ("standard_deviations", |file, key| file.add(key, &[6], &[-1.0_f32; 6])),
        ("faces", |file, key| file.add(key, &[1, 3], &[0_i32, 1, 1_000_000])),
        ("faces", |file, key| file.add(key, &[1, 3], &[0_i32, 1, -1])),
        ("skin_bones", |file, key| file.add(key, &[1, 4], &[0_u8; 4])),
        ("skin_weights", |file, key| file.add(key, &[1, 4], &[0.5_f32; 4])),
        ("joint_regressor_offsets", |file, key| file.add(key, &[16], &[0_i32; 16])),
        ("joint_regressor_offsets", |file, key| file.add(key, &[2], &[1_i32, 0])),
        ("bone_parents", |file, key| file.add(key, &[15], &[-1_i32; 15])),
        ("axis_bones", |file, key| file.add(key, &[24], &[0_i32; 24])),
        ("axis_limits", |file, key| file.add(key, &[24, 2], &[0.0_f32; 48])),
        ("landmark_vertices", |file, key| file.add(key, &[1], &[0_i32])),
        ("mirror_vertices", |file, key| file.add(key, &[3], &[0_i32, 1, 2])),
        ("mirror_vertices", |file, key| file.add(key, &[690], &[0_i32; 690])),
        ("faces", |file, key| file.add(key, &[1, 3], &[0_i32, 1, 1])),
        ("joint_regressor_values", |file, key| file.add(key, &[60], &[0.3_f32; 60])),
    ];
    for (index, (key, replace)) in cases.into_iter().enumerate() {
        let bytes = fixture::file_bytes_with(4, key, |file| replace(file, key));
        let error = read_bytes(bytes).err().unwrap_or_else(|| panic!("case {index}, '{key}', was accepted"));
        assert!(error.to_string().contains("model.npz"), "{error}");
    }
}
