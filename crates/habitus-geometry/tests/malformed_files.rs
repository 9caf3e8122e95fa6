//! Broken and odd files: each gives an error that names the problem; none panics, none is read as something else.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use habitus_geometry::glam::DVec3;
use habitus_geometry::io::{
    Format, MeshToGlb, PlyContent, glb_bytes, obj_text, ply_bytes, read_surface_bytes,
};
use habitus_geometry::sampling::SplitMix;
use habitus_geometry::{Surface, TriangleMesh};

fn message(format: Format, bytes: &[u8]) -> String {
    match read_surface_bytes(format, bytes, Path::new("odd.file")) {
        Err(error) => error.to_string(),
        Ok((surface, _)) => panic!("{format} was read: {surface:?}\n{}", String::from_utf8_lossy(bytes)),
    }
}

fn ply(header: &str, body: &str) -> Vec<u8> {
    format!("ply\nformat ascii 1.0\n{header}end_header\n{body}").into_bytes()
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";
const CORNERS: &str = "property list uchar int vertex_indices\n";

fn ply_mesh(vertices: &str, faces: &str, vertex_rows: &str, face_rows: &str) -> Vec<u8> {
    ply(
        &format!("element vertex {vertices}\n{XYZ}element face {faces}\n{CORNERS}"),
        &format!("{vertex_rows}{face_rows}"),
    )
}

const THREE: &str = "0 0 0\n1 0 0\n0 1 0\n";

#[test]
fn broken_ply_files_say_what_is_wrong() {
    let binary = |header: &str, body: &[u8]| {
        let mut bytes = format!("ply\nformat binary_little_endian 1.0\n{header}end_header\n").into_bytes();
        bytes.extend_from_slice(body);
        bytes
    };
    let cases: Vec<(Vec<u8>, &str)> = vec![
        (vec![], "does not begin like such a file"),
        (b"ply".to_vec(), "does not begin"),
        (b"v 0 0 0\nf 1 1 1\n".to_vec(), "but like OBJ"),
        (b"glTF\x02\0\0\0\n".to_vec(), "but like GLB"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\n".to_vec(), "ends inside its header"),
        (b"ply\nend_header\n".to_vec(), "`format <encoding> 1.0` is missing"),
        (b"ply\nformat ascii 2.0\nend_header\n".to_vec(), "line 2"),
        (b"ply\nformat martian 1.0\nend_header\n".to_vec(), "binary_big_endian"),
        (ply("element vertex -3\n", ""), "line 3"),
        (ply("element vertex 1e3\n", ""), "whole count"),
        (ply(&format!("{XYZ}element vertex 1\n"), "0 0 0\n"), "an element before its properties"),
        (ply("element vertex 1\nproperty float16 x\n", "0\n"), "line 4"),
        (ply("element vertex 1\nproperty list float int x\n", "0\n"), "line 4"),
        (ply("element vertex 1\nproperty float x\nproperty float x\n", "0 0\n"), "property x appears twice"),
        (
            ply(&format!("element vertex 1\n{XYZ}element vertex 1\n{XYZ}"), "0 0 0\n0 0 0\n"),
            "element vertex appears twice",
        ),
        (ply("nonsense here\n", ""), "nonsense here"),
        (ply("element vertex 1\nproperty float x\nproperty float y\n", "0 0\n"), "`z` is missing"),
        (
            ply(&format!("element vertex 1\n{}", XYZ.replace("float x", "list uchar float x")), "1 0 0 0\n"),
            "`x` is missing",
        ),
        (ply(&format!("element face 1\n{CORNERS}"), "3 0 1 2\n"), "`vertex` is missing"),
        (
            ply(
                &format!("element vertex 3\n{XYZ}element face 1\nproperty int color\n"),
                &format!("{THREE}7\n"),
            ),
            "vertex_indices",
        ),
        (
            ply(
                &format!("element vertex 3\n{XYZ}element tristrips 1\n{CORNERS}"),
                &format!("{THREE}3 0 1 2\n"),
            ),
            "triangle strips",
        ),
        (ply_mesh("3", "1", "0 0 0\n1 0 0\n", "3 0 1 2\n"), "line 12: expected the end of the row"),
        (ply_mesh("3", "2", THREE, "3 0 1 2\n"), "inside face 1 of 2"),
        (ply_mesh("3", "1", THREE, "3 0 1 2\n3 0 1 2\n"), "left over"),
        (ply_mesh("2", "1", THREE, "3 0 1 2\n"), "line 12: expected the end of the row"),
        (ply_mesh("99999999999999", "1", THREE, "3 0 1 2\n"), "can hold at most"),
        (ply_mesh("18446744073709551615", "1", THREE, "3 0 1 2\n"), "can hold at most"),
        (ply_mesh("99999999999999999999999", "1", THREE, "3 0 1 2\n"), "whole count"),
        (ply_mesh("3", "4000000000", THREE, "3 0 1 2\n"), "can hold at most"),
        (
            ply_mesh("3", "1", "0 0 0\nnan 0 0\n0 1 0\n", "3 0 1 2\n"),
            "line 11: vertex 1 has a coordinate that is not finite",
        ),
        (ply_mesh("3", "1", "0 0 0\n1 0 0\n0 -inf 0\n", "3 0 1 2\n"), "vertex 2"),
        (
            ply_mesh("3", "1", "0 0 0\n1 0\n0 1 0\n", "3 0 1 2\n"),
            "line 11: a value of this vertex row is missing",
        ),
        (ply_mesh("3", "1", "0 0 0\n1 0 zero\n0 1 0\n", "3 0 1 2\n"), "found \"zero\""),
        (ply_mesh("3", "1", THREE, "3 0 1 3\n"), "face 0 names vertex 3, but there are only 3"),
        (ply_mesh("3", "1", THREE, "3 0 1 -1\n"), "line 13"),
        (ply_mesh("3", "1", THREE, "3 0 1 1.5\n"), "whole number"),
        (ply_mesh("3", "1", THREE, "300 0 1 2\n"), "range of its type"),
        (ply_mesh("3", "1", THREE, "-3 0 1 2\n"), "range of its type"),
        (ply_mesh("3", "1", THREE, "4 0 1 2\n"), "a value of this face row is missing"),
        (ply_mesh("3", "2", THREE, "3 0 1 1\n3 2 2 2\n"), "all 2 faces"),
        (ply_mesh("0", "0", "", ""), "no vertices"),
        (ply("", ""), "`vertex` is missing"),
        (ply_mesh("3", "1", "\u{0}\u{1}\u{2}binary rubbish here\n0 0 0\n0 0 0\n", "3 0 1 2\n"), "a number"),
        (binary(&format!("element vertex 2\n{XYZ}"), &[0; 23]), "can hold at most 1"),
        (binary(&format!("element vertex 1\n{XYZ}"), &[0, 0, 192, 127, 0, 0, 0, 0, 0, 0, 0, 0]), "vertex 0"),
        (binary(&format!("element vertex 1\n{XYZ}"), b"0 0 0\n0 0 0\n1 1 1\n"), "left over"),
        (
            binary(
                &format!("element vertex 1\n{XYZ}element face 1\nproperty list int int vertex_indices\n"),
                &[[0; 12].as_slice(), &[255; 4]].concat(),
            ),
            "list length",
        ),
        (
            binary(
                &format!("element vertex 1\n{XYZ}element face 1\nproperty list uint int vertex_indices\n"),
                &[[0; 12].as_slice(), &[255; 4], &[0; 40]].concat(),
            ),
            "ends inside face 0",
        ),
        (
            binary(
                &format!("element vertex 1\n{XYZ}element face 1\nproperty list uchar float vertex_indices\n"),
                &[[0; 12].as_slice(), &[3], &[63; 12]].concat(),
            ),
            "a vertex index",
        ),
    ];
    assert!(cases.len() >= 40);
    for (bytes, expected) in cases {
        let message = message(Format::Ply, &bytes);
        assert!(message.contains(expected) && message.contains("odd.file"), "{message:?} lacks {expected:?}");
    }
}

#[test]
fn broken_text_files_say_what_is_wrong() {
    let obj_start = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let obj = |rest: &str| format!("{obj_start}{rest}");
    let facet = "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    let cases: Vec<(Format, String, &str)> = vec![
        (Format::Obj, String::new(), "no vertices"),
        (Format::Obj, "Dear reader,\nthis is a letter.\n".into(), "line 1"),
        (Format::Obj, "ply\nformat ascii 1.0\n".into(), "line 1"),
        (Format::Obj, "v 0 0\n".into(), "vertex coordinate is missing"),
        (Format::Obj, "v 0 0 x\n".into(), "found \"x\""),
        (Format::Obj, "v 0 0 NaN\n".into(), "vertex 0"),
        (Format::Obj, "v 0 0 1e999\n".into(), "vertex 0"),
        (Format::Obj, obj("f 1 2 4\n"), "line 4: face 0 names vertex 3"),
        (Format::Obj, obj("f 0 1 2\n"), "count from 1"),
        (Format::Obj, obj("f -1 -2 -4\n"), "names vertex -1"),
        (Format::Obj, obj("f 1 2 99999999999\n"), "names vertex 99999999998"),
        (Format::Obj, obj("f 1 2 99999999999999999999999\n"), "line 4"),
        (Format::Obj, obj("f 1/a 2 3\n"), "1/a"),
        (Format::Obj, obj("f 1/1/1/1 2 3\n"), "1/1/1/1"),
        (Format::Obj, obj("f 1.0 2 3\n"), "1.0"),
        (Format::Obj, obj("f\n"), "line 4"),
        (Format::Obj, obj("f 1 1 1\n"), "all 1 faces"),
        (Format::Obj, obj("surf 0 1 0 1 1 2\n"), "free-form"),
        (Format::Off, String::new(), "does not begin"),
        (Format::Off, "OFF\n".into(), "counts is missing"),
        (Format::Off, "OFF\n3\n".into(), "face count is missing"),
        (Format::Off, "OFF\n3 -1 0\n".into(), "\"-1\""),
        (Format::Off, "OFF\n99999999999 1 0\n0 0 0\n".into(), "can hold at most"),
        (Format::Off, "OFF\n1 99999999999 0\n0 0 0\n".into(), "can hold at most"),
        (
            Format::Off,
            "OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n".into(),
            "line 6: the file ends inside face 0 of 1",
        ),
        (Format::Off, "OFF\n2 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n".into(), "left over"),
        (Format::Off, "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n".into(), "names vertex 3"),
        (Format::Off, "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4 0 1 2\n".into(), "corner of this face is missing"),
        (Format::Off, "OFF\n3 1 0\n0 0 0\n1 0 inf\n0 1 0\n3 0 1 2\n".into(), "vertex 1"),
        (Format::Off, "4OFF\n3 1 0\n".into(), "not supported"),
        (Format::Off, "OFF BINARY\n".into(), "binary OFF"),
        (Format::Stl, String::new(), "ends inside its header"),
        (Format::Stl, "solid\nendsolid\n".into(), "no vertices"),
        (Format::Stl, facet.into(), "no `endsolid`"),
        (Format::Stl, facet.replace("vertex 1 0 0\n", ""), "a corner of this facet"),
        (Format::Stl, facet.replace("outer loop\n", ""), "`outer loop`"),
        (Format::Stl, facet.replace("1 0 0", "1 0 nan"), "vertex 1"),
        (Format::Stl, facet.replace("endfacet", "facet"), "`endfacet`"),
        (Format::Stl, format!("{facet}v 0 0 0\n"), "`facet` or `endsolid`"),
        (Format::Stl, format!("{facet}endsolid\nmore\n"), "`solid`"),
    ];
    for (format, text, expected) in cases {
        let message = message(format, text.as_bytes());
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
}

#[test]
fn broken_binary_stl_says_what_is_wrong() {
    let mut header = vec![b'x'; 80];
    let with = |count: u32, body: &[u8]| [header.as_slice(), &count.to_le_bytes(), body].concat();
    let triangle: Vec<u8> = [0.0f32; 3]
        .iter()
        .chain(&[0., 0., 0., 1., 0., 0., 0., 1., 0.])
        .flat_map(|v| v.to_le_bytes())
        .chain([0, 0])
        .collect();
    let mut broken = triangle.clone();
    broken[12..16].copy_from_slice(&f32::NAN.to_le_bytes());
    for (bytes, expected) in [
        (with(0, &[]), "no vertices"),
        (with(u32::MAX, &triangle), "can hold at most 1"),
        (with(2, &triangle), "can hold at most 1"),
        (with(1, &triangle[..49]), "can hold at most 0"),
        (with(1, &[triangle.clone(), triangle.clone()].concat()), "left over"),
        (with(1, &broken), "vertex 0"),
        (header[..50].to_vec(), "does not begin"),
    ] {
        let message = message(Format::Stl, &bytes);
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
    header.clear();
}

/// A GLB with this description and 36 bytes: one triangle, without indices.
fn glb(json: &str) -> Vec<u8> {
    glb_with(json, &[])
}

/// The same with more binary data after the triangle.
fn glb_with(json: &str, more: &[u8]) -> Vec<u8> {
    let mut text = json.as_bytes().to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let triangle = [0.0f32, 0., 0., 1., 0., 0., 0., 1., 0.];
    let mut binary: Vec<u8> = triangle.iter().flat_map(|value| value.to_le_bytes()).collect();
    binary.extend_from_slice(more);
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend_from_slice(&((28 + text.len() + binary.len()) as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &binary)] {
        bytes.extend_from_slice(&(chunk.len() as u32).to_le_bytes());
        bytes.extend_from_slice(kind);
        bytes.extend_from_slice(chunk);
    }
    bytes
}

const TRIANGLE: &str = r#"{"asset":{"version":"2.0"},"nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],"bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36}]}"#;

#[test]
fn broken_glb_files_say_what_is_wrong() {
    assert!(read_surface_bytes(Format::Glb, &glb(TRIANGLE), Path::new("good")).is_ok());
    let changes = [
        (r#""version":"2.0""#, r#""version":"1.0""#, "2.x"),
        (r#"{"asset""#, r#"{"extensionsRequired":["KHR_draco_mesh_compression"],"asset""#, "KHR_draco"),
        (r#"{"asset""#, r#"["asset""#, "a description in JSON"),
        (r#"{"mesh":0}"#, r#"{"mesh":7}"#, "meshes[7]"),
        (r#"{"mesh":0}"#, r#"{"mesh":-1}"#, "nodes[0]"),
        (r#"{"mesh":0}"#, r#"{"mesh":0,"children":[0]}"#, "no usable surface"),
        (
            r#"{"mesh":0}"#,
            r#"{"mesh":0,"children":[1]},{"children":[2]},{"children":[1]}"#,
            "nodes must form a tree",
        ),
        (r#"{"mesh":0}"#, r#"{"mesh":0,"children":[5]}"#, "nodes[5]"),
        (r#"{"mesh":0}"#, r#"{"mesh":0,"matrix":[1,2,3]}"#, "right length"),
        (r#"{"mesh":0}"#, r#"{"mesh":0,"rotation":[0,0,0,0]}"#, "rotation of length 1"),
        (r#"{"mesh":0}"#, r#"{"mesh":0,"scale":[1e308,1e308,1e308],"children":[]}, {"scale":[0,0,0]}"#, ""),
        (r#"{"POSITION":0}"#, r#"{"NORMAL":0}"#, "POSITION"),
        (r#"{"POSITION":0}"#, r#"{"POSITION":1}"#, "accessors[1]"),
        (r#"{"POSITION":0}}"#, r#"{"POSITION":0},"mode":1}"#, "lines"),
        (r#"{"POSITION":0}}"#, r#"{"POSITION":0},"indices":0}"#, "component type 5126"),
        (r#"{"POSITION":0}}"#, r#"{"POSITION":0},"extensions":{"KHR_draco_mesh_compression":{}}}"#, "Draco"),
        (r#""count":3"#, r#""count":4"#, "can hold at most 3"),
        (r#""count":3"#, r#""count":18446744073709551615"#, "can hold at most 3"),
        (r#""count":3"#, r#""count":2"#, "triangle 0 of 1"),
        (r#""count":3"#, r#""count":0"#, "no vertices"),
        (r#""count":3"#, r#""count":"three""#, "accessors[0]"),
        (r#""count":3"#, r#""count":3,"sparse":{}"#, "sparse"),
        (r#""count":3"#, r#""count":3,"byteOffset":18446744073709551615"#, "can hold at most 0"),
        (r#""count":3"#, r#""count":3,"byteOffset":4"#, "can hold at most 2"),
        (r#""type":"VEC3""#, r#""type":"VEC4""#, "expected VEC3"),
        (r#""componentType":5126"#, r#""componentType":5123"#, "component type 5123"),
        (r#""bufferView":0,"#, "", "without data"),
        (r#""bufferView":0,"#, r#""bufferView":3,"#, "bufferViews[3]"),
        (r#""byteLength":36}],"buffers""#, r#""byteLength":40}],"buffers""#, "40 of byte"),
        (r#"{"buffer":0,"byteLength":36}"#, r#"{"buffer":0,"byteLength":36,"byteStride":4}"#, "stride"),
        (
            r#"{"buffer":0,"byteLength":36}"#,
            r#"{"buffer":0,"byteOffset":18446744073709551615,"byteLength":36}"#,
            "bufferViews[0]",
        ),
        (r#"[{"byteLength":36}]}"#, r#"[{"byteLength":36,"uri":"data.bin"}]}"#, "outside the file"),
        (r#"[{"byteLength":36}]}"#, "[]}", "buffers[0]"),
    ];
    for (from, to, expected) in changes {
        assert!(TRIANGLE.contains(from), "{from}");
        let bytes = glb(&TRIANGLE.replacen(from, to, 1));
        if expected.is_empty() {
            assert!(read_surface_bytes(Format::Glb, &bytes, Path::new("odd but right")).is_ok());
            continue;
        }
        let message = message(Format::Glb, &bytes);
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
    // A small file that shows one mesh in very many places.
    let many = vec![r#"{"mesh":0}"#; 3000].join(",");
    let many = glb(&TRIANGLE.replacen(r#"{"mesh":0}"#, &many, 1));
    assert!(read_surface_bytes(Format::Glb, &many, Path::new("instances")).is_ok());
    let parts = vec![r#"{"attributes":{"POSITION":0}}"#; 3000].join(",");
    let parts = glb(&TRIANGLE.replacen(r#"{"attributes":{"POSITION":0}}"#, &parts, 1));
    assert!(read_surface_bytes(Format::Glb, &parts, Path::new("shared")).is_ok());
    // A small file that draws the same fan of triangles very many times.
    let fan = r#"{"attributes":{"POSITION":0},"mode":6,"indices":1}"#;
    let fans = vec![fan; 600].join(",");
    let fans = TRIANGLE
        .replacen(r#"{"attributes":{"POSITION":0}}"#, &fans, 1)
        .replacen(
            r#""type":"VEC3"}"#,
            r#""type":"VEC3"},{"bufferView":1,"componentType":5121,"count":3000,"type":"SCALAR"}"#,
            1,
        )
        .replacen(
            r#""byteLength":36}],"buffers""#,
            r#""byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":3000}],"buffers""#,
            1,
        );
    let indices: Vec<u8> = (0..3000u32).map(|place| (place % 3) as u8).collect();
    assert!(
        message(Format::Glb, &glb_with(&fans, &indices)).contains("more triangles than the file has bytes")
    );
    assert!(message(Format::Glb, b"glTF").contains("container header"));
    assert!(message(Format::Glb, b"glTF\x01\0\0\0").contains("version 1"));
    assert!(message(Format::Glb, b"glTF\x02\0\0\0\x0c\0\0\0").contains("JSON chunk is missing"));
    assert!(message(Format::Glb, b"glTF\x02\0\0\0\xff\xff\xff\xff").contains("declared length"));
}

/// A valid file of every kind, of about the size that lets each byte be tried.
fn valid_files() -> Vec<(Format, Vec<u8>)> {
    let mut positions = Vec::new();
    let mut faces = Vec::new();
    for place in 0..12u32 {
        let angle = f64::from(place) * 0.7;
        positions.push(DVec3::new(angle.cos(), angle.sin(), f64::from(place)));
        if place >= 2 {
            faces.push([place - 2, place - 1, place]);
        }
    }
    let mesh = TriangleMesh::new(positions, faces).unwrap();
    let mut ascii = format!(
        "element vertex {}\n{XYZ}element face {}\n{CORNERS}",
        mesh.positions().len(),
        mesh.faces().len()
    );
    let rows: String = mesh.positions().iter().map(|p| format!("{} {} {}\n", p.x, p.y, p.z)).collect();
    let corners: String = mesh.faces().iter().map(|[a, b, c]| format!("3 {a} {b} {c}\n")).collect();
    let off = format!("OFF\n12 10 0\n{rows}{corners}");
    ascii = format!("ply\nformat ascii 1.0\n{ascii}end_header\n{rows}{corners}");
    let facets: String = (0..mesh.faces().len())
        .map(|face| {
            let corners: String =
                mesh.corners(face).iter().map(|p| format!("vertex {} {} {}\n", p.x, p.y, p.z)).collect();
            format!("facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n")
        })
        .collect();
    let mut stl = vec![0; 80];
    stl.extend_from_slice(&(mesh.faces().len() as u32).to_le_bytes());
    for face in 0..mesh.faces().len() {
        stl.extend_from_slice(&[0; 12]);
        for corner in mesh.corners(face) {
            corner.as_vec3().to_array().iter().for_each(|value| stl.extend_from_slice(&value.to_le_bytes()));
        }
        stl.extend_from_slice(&[0; 2]);
    }
    let binary = PlyContent { positions: mesh.positions(), faces: mesh.faces(), ..PlyContent::default() };
    vec![
        (Format::Ply, ascii.into_bytes()),
        (Format::Ply, ply_bytes(binary).unwrap()),
        (Format::Obj, obj_text(&mesh).into_bytes()),
        (Format::Off, off.into_bytes()),
        (Format::Stl, format!("solid s\n{facets}endsolid s\n").into_bytes()),
        (Format::Stl, stl),
        (Format::Glb, glb_bytes(MeshToGlb { mesh: &mesh, normals: None, colors: None }).unwrap()),
    ]
}

#[test]
fn files_cut_anywhere_are_refused_or_lose_nothing_they_promised() {
    for (format, bytes) in valid_files() {
        let (whole, _) = read_surface_bytes(format, &bytes, Path::new("whole")).unwrap();
        for length in 0..bytes.len() {
            let Ok((cut, _)) = read_surface_bytes(format, &bytes[..length], Path::new("cut")) else {
                continue;
            };
            // OBJ promises no counts, so a cut one may be a smaller mesh; any other must be the same, the last digits of
            // the last number and the name after `endsolid` apart.
            if format != Format::Obj {
                assert_eq!(cut.positions().len(), whole.positions().len(), "{format} cut to {length}");
                let (Surface::Mesh(cut), Surface::Mesh(whole)) = (&cut, &whole) else {
                    panic!("{format} lost its faces")
                };
                assert_eq!(cut.faces().len(), whole.faces().len());
                assert!(bytes.len() - length <= 3, "{format} cut to {length} of {}", bytes.len());
            }
        }
    }
}

#[test]
fn files_with_changed_bytes_never_panic_nor_grow() {
    let mut random = SplitMix::new(11);
    for (format, bytes) in valid_files() {
        for round in 0..6000 {
            let mut changed = bytes.clone();
            for _ in 0..=round % 3 {
                let place = (random.bits() % changed.len() as u64) as usize;
                changed[place] = match random.bits() % 4 {
                    0 => 0xFF,
                    1 => b'9',
                    2 => changed[place] ^ (1 << (random.bits() % 8)),
                    _ => random.bits() as u8,
                };
            }
            if let Ok((surface, report)) = read_surface_bytes(format, &changed, Path::new("changed")) {
                assert!(surface.positions().iter().all(|position| position.is_finite()));
                assert!(surface.positions().len() <= changed.len());
                assert!(report.polygon_count <= changed.len());
            }
        }
    }
}

#[test]
fn rubbish_of_any_length_is_refused_by_every_format() {
    let mut random = SplitMix::new(12);
    for format in [Format::Ply, Format::Obj, Format::Off, Format::Stl, Format::Glb] {
        for length in [0, 1, 2, 3, 4, 11, 12, 83, 84, 85, 133, 134, 1000, 100_000] {
            let bytes: Vec<u8> = (0..length).map(|_| random.bits() as u8).collect();
            message(format, &bytes);
            message(format, &vec![0; length]);
        }
        for (other, bytes) in valid_files() {
            if other != format {
                message(format, &bytes);
            }
        }
    }
}

#[test]
fn one_point_is_a_cloud_and_not_an_error() {
    let (surface, _) = read_surface_bytes(Format::Obj, b"v 1 2 3\n", Path::new("point.obj")).unwrap();
    assert!(matches!(surface, Surface::Cloud(cloud) if cloud.positions() == [DVec3::new(1.0, 2.0, 3.0)]));
}
