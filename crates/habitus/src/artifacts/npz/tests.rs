//! Arrays as numpy writes them, and archives that lie about their contents.

use std::io::{Cursor, Write};
use std::path::Path;

use half::f16;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::{NpzError, NpzReader, NpzWriter};

fn open(bytes: Vec<u8>) -> NpzReader {
    NpzReader::new(bytes, Path::new("arrays.npz")).unwrap()
}

/// An archive with one member made by hand: a numpy header and any bytes.
fn archive(header: &str, data: &[u8]) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    archive.start_file("a.npy", SimpleFileOptions::default()).unwrap();
    let padded = format!("{header:<117}\n");
    archive.write_all(b"\x93NUMPY\x01\x00").unwrap();
    archive.write_all(&(padded.len() as u16).to_le_bytes()).unwrap();
    archive.write_all(padded.as_bytes()).unwrap();
    archive.write_all(data).unwrap();
    archive.finish().unwrap().into_inner()
}

fn refused(header: &str, data: &[u8]) -> String {
    let error = open(archive(header, data)).floats("a").unwrap_err();
    assert!(matches!(&error, NpzError::Invalid { key, .. } if key == "a"), "{error}");
    error.to_string()
}

#[test]
fn every_number_type_is_read() {
    let mut file = NpzWriter::new();
    file.add("half", &[2], &[f16::from_f32(0.5), f16::from_f32(-2.0)]);
    file.add("single", &[1, 2], &[0.25_f32, 3.0]);
    file.add("double", &[2, 1], &[0.1_f64, 1e300]);
    file.add("signed", &[2], &[-7_i32, 7]);
    file.add("long", &[1], &[1_i64 << 40]);
    file.add("byte", &[3], &[0_u8, 1, 255]);
    file.add::<f64>("empty", &[0, 3], &[]);
    file.add_text("text", "Größe ≤ 2 m");
    let mut file = open(file.into_bytes().unwrap());
    assert_eq!(file.floats("half").unwrap().values, [0.5, -2.0]);
    assert_eq!(file.floats("single").unwrap().values, [0.25, 3.0]);
    assert_eq!(file.floats("double").unwrap().values, [0.1, 1e300]);
    assert_eq!(file.integers("signed").unwrap().values, [-7, 7]);
    assert_eq!(file.integers("long").unwrap().values, [1 << 40]);
    assert_eq!(file.indices("byte", 256).unwrap().values, [0, 1, 255]);
    assert_eq!(file.floats("empty").unwrap().shape, [0, 3]);
    assert_eq!(file.text("text").unwrap(), "Größe ≤ 2 m");
    assert!(file.contains("half") && !file.contains("quarter"));
}

#[test]
fn both_byte_orders_are_read() {
    let big = archive(
        "{'descr': '>f4', 'fortran_order': False, 'shape': (2,), }",
        &[0x3f, 0x80, 0, 0, 0xc0, 0, 0, 0],
    );
    assert_eq!(open(big).floats("a").unwrap().values, [1.0, -2.0]);
    let flags = archive("{'descr': '|b1', 'fortran_order': False, 'shape': (2,), }", &[1, 0]);
    assert_eq!(open(flags).floats("a").unwrap().values, [1.0, 0.0]);
}

#[test]
fn unusable_values_are_refused_with_their_place() {
    let mut file = NpzWriter::new();
    file.add("nan", &[2], &[0.0_f32, f32::NAN]);
    file.add("fraction", &[2], &[1.0_f32, 1.5]);
    file.add("large", &[2], &[3_i32, 9]);
    file.add("negative", &[1], &[-1_i32]);
    file.add("bytes", &[2], &[0xff_u8, 0xfe]);
    let mut file = open(file.into_bytes().unwrap());
    assert!(file.floats("nan").unwrap_err().to_string().contains("element 1"));
    assert!(file.integers("fraction").is_err());
    assert!(file.indices("large", 9).unwrap_err().to_string().contains("outside 0..9"));
    assert!(file.indices("negative", 9).is_err());
    assert!(file.text("bytes").unwrap_err().to_string().contains("UTF-8"));
    assert!(matches!(file.floats("nowhere"), Err(NpzError::Missing { .. })));
}

#[test]
fn headers_that_claim_more_than_there_is_allocate_nothing() {
    for shape in [
        "(1000000000000,)",
        "(9223372036854775807, 9223372036854775807)",
        "(3,)",
        "(0, 9223372036854775807, 4)",
    ] {
        let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
        assert!(refused(&header, &[0; 16]).contains("claims"), "{shape}");
    }
}

#[test]
fn unsupported_layouts_say_so() {
    let fortran = refused("{'descr': '<f4', 'fortran_order': True, 'shape': (1, 1), }", &[0; 4]);
    assert!(fortran.contains("ascontiguousarray"), "{fortran}");
    refused("{'descr': '<c16', 'fortran_order': False, 'shape': (1,), }", &[0; 16]);
    refused("{'descr': [('x', '<f4')], 'fortran_order': False, 'shape': (1,), }", &[0; 4]);
    refused("not a dictionary", &[0; 4]);
    assert!(NpzReader::new(b"PK\x03\x04 not an archive".to_vec(), Path::new("x.npz")).is_err());
}

#[test]
fn a_shape_that_does_not_hold_the_values_fails_by_name() {
    let mut file = NpzWriter::new();
    file.add("wrong", &[2, 2], &[1.0_f32; 3]);
    assert!(file.into_bytes().unwrap_err().contains("'wrong'"));
}

#[test]
fn a_file_that_cannot_be_written_leaves_the_old_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("arrays.npz");
    let mut file = NpzWriter::new();
    file.add("a", &[1], &[1.0_f32]);
    file.write(&path).unwrap();
    let before = std::fs::read(&path).unwrap();
    let mut broken = NpzWriter::new();
    broken.add("a", &[2], &[1.0_f32]);
    assert!(matches!(broken.write(&path), Err(NpzError::Write { .. })));
    assert_eq!(std::fs::read(&path).unwrap(), before);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no half file is left");
}
