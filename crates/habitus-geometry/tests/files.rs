//! Each format gives back what was written into it, and what it changes is in the report.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use habitus_geometry::glam::DVec3;
use habitus_geometry::io::{
    Format, MeshToGlb, PlyContent, ReadError, ReadReport, WriteError, glb_bytes, obj_text, ply_bytes,
    read_mesh, read_surface, read_surface_bytes, read_surface_with_report, write_cloud, write_mesh,
    write_ply_with_colors,
};
use habitus_geometry::{PointCloud, Surface, TriangleMesh};

fn tetrahedron() -> TriangleMesh {
    // Thirds have no short decimal form, so that a writer which rounds is caught; the last vertex has no face.
    let positions = vec![
        DVec3::ZERO,
        DVec3::new(1.0 / 3.0, 0.0, 0.0),
        DVec3::new(0.0, 1e-7 / 3.0, 0.25),
        DVec3::new(0.0, -2.0, 1234.5),
        DVec3::new(9.0, 9.0, 9.0),
    ];
    TriangleMesh::new(positions, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]).unwrap()
}

fn read(format: Format, bytes: &[u8]) -> (Surface, ReadReport) {
    read_surface_bytes(format, bytes, Path::new("in memory")).unwrap()
}

fn mesh_of(format: Format, bytes: &[u8]) -> TriangleMesh {
    match read(format, bytes).0 {
        Surface::Mesh(mesh) => mesh,
        Surface::Cloud(_) => panic!("a mesh was expected"),
    }
}

fn cloud_of(format: Format, bytes: &[u8]) -> PointCloud {
    match read(format, bytes).0 {
        Surface::Cloud(cloud) => cloud,
        Surface::Mesh(_) => panic!("a cloud was expected"),
    }
}

#[test]
fn ply_and_obj_give_back_the_same_mesh_exactly() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["mesh.ply", "mesh.obj", "MESH.PLY"] {
        let path = folder.path().join(name);
        write_mesh(&path, &tetrahedron()).unwrap();
        assert_eq!(read_mesh(&path).unwrap(), tetrahedron());
    }
    let colored = folder.path().join("colored.ply");
    write_ply_with_colors(&colored, &tetrahedron(), &[[1, 2, 3]; 5]).unwrap();
    assert_eq!(read_mesh(&colored).unwrap(), tetrahedron());
    assert!(matches!(
        write_ply_with_colors(&colored, &tetrahedron(), &[[1, 2, 3]; 4]),
        Err(WriteError::Content { .. })
    ));
    // Nothing is left beside the files.
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 4);
}

#[test]
fn glb_gives_back_the_mesh_in_single_precision() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.glb");
    write_mesh(&path, &tetrahedron()).unwrap();
    let read = read_mesh(&path).unwrap();
    assert_eq!(read.faces(), tetrahedron().faces());
    for (read, written) in read.positions().iter().zip(tetrahedron().positions()) {
        assert_eq!(*read, written.as_vec3().as_dvec3());
    }
    let colors = [[9u8, 8, 7]; 5];
    let bytes = glb_bytes(MeshToGlb { mesh: &tetrahedron(), normals: None, colors: Some(&colors) }).unwrap();
    assert_eq!(mesh_of(Format::Glb, &bytes), read);
    let huge = tetrahedron().with_positions(vec![DVec3::splat(1e300); 5]).unwrap();
    assert!(matches!(write_mesh(&path, &huge), Err(WriteError::Content { .. })));
}

#[test]
fn clouds_keep_their_normals() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.ply");
    let cloud = PointCloud::new(vec![DVec3::ONE / 3.0, DVec3::X], Some(vec![DVec3::Z, DVec3::Y])).unwrap();
    write_cloud(&path, &cloud).unwrap();
    assert_eq!(read_surface(&path).unwrap(), Surface::Cloud(cloud));
    assert!(matches!(read_mesh(&path), Err(ReadError::CloudInsteadOfMesh { point_count: 2, .. })));
}

/// Vertices with every scalar type, lists before and after what is wanted, and a table that is skipped.
fn odd_ply(encoding: &str) -> Vec<u8> {
    let mut bytes = format!(
        "ply\r\nformat {encoding} 1.0\r\ncomment caf\u{e9}\r\nobj_info x\r\nelement lamp 2\r\nproperty list ushort short beams\r\n\
         property char id\r\nelement vertex 4\r\nproperty int8 tag\r\nproperty float64 z\r\nproperty list uchar double extra\r\n\
         property float x\r\nproperty int y\r\nproperty uint32 id\r\nelement empty 123456789012\r\n\
         element face 2\r\nproperty uchar red\r\nproperty list int32 uint16 vertex_index\r\nproperty list uint8 float texcoord\r\nend_header\r\n"
    )
    .into_bytes();
    if encoding == "ascii" {
        bytes.extend_from_slice(
            b"2 -5 6 1\n0 2\n\n-1 0.5 1 7.5 1.5 3 4000000000\n0 1.5 0 2.5 4 1\n1 0 2 1 2 0 -5 2\r\n  1 0 0 0 0 3\n9 4 0 1 2 3 2 0.5 0.5\n9 3 0 2 3 0\n",
        );
        return bytes;
    }
    let big = encoding.contains("big");
    let mut put = |little: &[u8]| {
        if big { bytes.extend(little.iter().rev()) } else { bytes.extend_from_slice(little) }
    };
    put(&2u16.to_le_bytes());
    put(&(-5i16).to_le_bytes());
    put(&6i16.to_le_bytes());
    put(&[1]);
    put(&0u16.to_le_bytes());
    put(&[2]);
    type Row<'a> = (i8, f64, &'a [f64], f32, i32, u32);
    let rows: [Row<'_>; 4] = [
        (-1, 0.5, &[7.5], 1.5, 3, 4_000_000_000),
        (0, 1.5, &[], 2.5, 4, 1),
        (1, 0.0, &[1.0, 2.0], 0.0, -5, 2),
        (1, 0.0, &[], 0.0, 0, 3),
    ];
    for (tag, z, extra, x, y, id) in rows {
        put(&tag.to_le_bytes());
        put(&z.to_le_bytes());
        put(&[extra.len() as u8]);
        extra.iter().for_each(|value| put(&value.to_le_bytes()));
        put(&x.to_le_bytes());
        put(&y.to_le_bytes());
        put(&id.to_le_bytes());
    }
    for (corners, texture) in [(&[0u16, 1, 2, 3][..], &[0.5f32, 0.5][..]), (&[0, 2, 3], &[])] {
        put(&[9]);
        put(&(corners.len() as i32).to_le_bytes());
        corners.iter().for_each(|corner| put(&corner.to_le_bytes()));
        put(&[texture.len() as u8]);
        texture.iter().for_each(|value| put(&value.to_le_bytes()));
    }
    bytes
}

#[test]
fn odd_ply_layouts_are_the_same_mesh_in_every_encoding() {
    for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let (surface, report) = read(Format::Ply, &odd_ply(encoding));
        let Surface::Mesh(mesh) = surface else { panic!("a mesh was expected") };
        assert_eq!(
            mesh.positions(),
            [DVec3::new(1.5, 3.0, 0.5), DVec3::new(2.5, 4.0, 1.5), DVec3::new(0.0, -5.0, 0.0), DVec3::ZERO],
            "{encoding}"
        );
        assert_eq!(mesh.faces(), [[0, 1, 2], [0, 2, 3], [0, 2, 3]]);
        assert_eq!((report.polygon_count, report.fanned_polygon_count), (2, 1));
    }
}

#[test]
fn degenerate_faces_are_dropped_and_counted() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 1 2\nf 1 2\nf 1 2 2 3\n";
    let (surface, report) = read(Format::Obj, text.as_bytes());
    let Surface::Mesh(mesh) = surface else { panic!("a mesh was expected") };
    assert_eq!(mesh.faces(), [[0, 1, 2], [0, 1, 2]]);
    assert_eq!((report.polygon_count, report.degenerate_face_count), (4, 3));
}

#[test]
fn obj_statements_of_all_kinds_are_understood() {
    let text = "# a comment\r\nmtllib a.mtl\r\no thing\r\nv 0 0 0 1.0\r\nv 1 0 0 0.5 0.5 0.5\r\nv 1 \\\r\n 1 0\r\nv 0 1 0\r\n\
        vt 0 0\r\nvn 0 0 1\r\ng a b\r\ns off\r\nusemtl m\r\nf 1/1/1 2//1 3/1 \\\r\n 4\r\nv 0 0 5\r\nf -1 -5 -4 # the last and two before\r\nl 1 2\r\n";
    let mesh = mesh_of(Format::Obj, text.as_bytes());
    assert_eq!(mesh.positions().len(), 5);
    assert_eq!(mesh.positions()[2], DVec3::new(1.0, 1.0, 0.0));
    assert_eq!(mesh.faces(), [[0, 1, 2], [0, 2, 3], [4, 0, 1]]);
    let cloud = cloud_of(Format::Obj, b"v 0 0 0\nv 1 2 3\nvn 0 0 2\nvn 1 0 0\n");
    assert_eq!(cloud.normals().unwrap(), [DVec3::Z, DVec3::X]);
    assert_eq!(obj_text(&mesh_of(Format::Obj, obj_text(&mesh).as_bytes())), obj_text(&mesh));
}

fn binary_stl(triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
    let mut bytes = b"solid but binary".to_vec();
    bytes.resize(80, b' ');
    bytes.extend_from_slice(&(triangles.len() as u32).to_le_bytes());
    for triangle in triangles {
        bytes.extend_from_slice(&[0; 12]);
        triangle.iter().flatten().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
        bytes.extend_from_slice(&[0, 0]);
    }
    bytes
}

#[test]
fn stl_corners_at_one_place_become_one_vertex() {
    let (a, b, c, d) = ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.1, 0.1, 1.0]);
    let bytes = binary_stl(&[[a, c, b], [a, b, d], [b, c, d], [c, [-0.0, 0.0, -0.0], d], [a, a, b]]);
    let (surface, report) = read(Format::Stl, &bytes);
    let Surface::Mesh(mesh) = surface else { panic!("a mesh was expected") };
    assert_eq!((mesh.positions().len(), mesh.faces().len()), (4, 4));
    assert_eq!((report.joined_vertex_count, report.degenerate_face_count), (11, 1));

    let text = "solid a b c\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n   vertex 0 1e0 0\n  endloop\n endfacet\nendsolid a\nsolid\nendsolid\n";
    assert_eq!(mesh_of(Format::Stl, text.as_bytes()).faces(), [[0, 1, 2]]);
}

#[test]
fn off_in_its_spellings_is_understood() {
    let plain = "OFF\n# comment\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n\n0 1 0\n4 0 1 2 3\n3 0 1 2 255 0 0\n";
    let mesh = mesh_of(Format::Off, plain.as_bytes());
    assert_eq!(mesh.faces(), [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
    let one_line = "COFF 3 1 3\n0 0 0 255 255 255 1\n1 0 0 1 1 1 1\n0 1 0 1 1 1 1\n3 0 1 2";
    assert_eq!(mesh_of(Format::Off, one_line.as_bytes()).positions().len(), 3);
    let normals = "NOFF\n2 0 0\n0 0 0 0 0 1\n1 0 0 0 2 0\n";
    assert_eq!(cloud_of(Format::Off, normals.as_bytes()).normals().unwrap(), [DVec3::Z, DVec3::Y]);
}

/// A GLB with these parts.
fn glb(json: &str, binary: &[u8]) -> Vec<u8> {
    let mut text = json.as_bytes().to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend_from_slice(&((28 + text.len() + binary.len()) as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text[..]), (b"BIN\0", binary)] {
        bytes.extend_from_slice(&(chunk.len() as u32).to_le_bytes());
        bytes.extend_from_slice(kind);
        bytes.extend_from_slice(chunk);
    }
    bytes
}

#[test]
fn glb_nodes_strides_index_sizes_and_strips_are_followed() {
    // Four interleaved vertices (position and something else), then byte, short and strip indices.
    let mut binary = Vec::new();
    for [x, y, z] in [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]] {
        [x, y, z, 77.0].iter().for_each(|value| binary.extend_from_slice(&value.to_le_bytes()));
    }
    binary.extend_from_slice(&[0, 1, 2, 0]);
    [1u16, 3, 2, 0].iter().for_each(|index| binary.extend_from_slice(&index.to_le_bytes()));
    let json = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[2]}],
        "nodes":[{"mesh":0,"translation":[0,0,5]},{"mesh":1,"scale":[-1,1,1]},{"children":[0,1],"rotation":[0,0,0.7071067811865476,0.7071067811865476]},{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1},{"attributes":{"POSITION":0},"indices":2}]},{"primitives":[{"attributes":{"POSITION":0},"mode":5}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"},{"bufferView":1,"componentType":5121,"count":3,"type":"SCALAR"},{"bufferView":1,"byteOffset":4,"componentType":5123,"count":3,"type":"SCALAR"}],
        "bufferViews":[{"buffer":0,"byteLength":64,"byteStride":16},{"buffer":0,"byteOffset":64,"byteLength":12}],"buffers":[{"byteLength":76}]}"#;
    let mesh = mesh_of(Format::Glb, &glb(json, &binary));
    // Parts of one mesh share vertices; node 3 is in no scene; the mirrored strip keeps its front in front.
    assert_eq!(
        mesh.faces(),
        [[0, 1, 2], [1, 3, 2], [4, 6, 5], [6, 7, 5]].map(|face: [u32; 3]| face).to_vec()
    );
    // A quarter turn about z takes x to y.
    assert!(mesh.positions()[1].distance(DVec3::new(0.0, 1.0, 5.0)) < 1e-12);
    assert!(mesh.positions()[5].distance(DVec3::new(0.0, -1.0, 0.0)) < 1e-12);
}

#[test]
fn unusable_normals_are_left_out_and_counted() {
    let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
        property float nx\nproperty float ny\nproperty float nz\nend_header\n0 0 0 0 0 1\n1 0 0 0 0 0\n";
    let (surface, report) = read(Format::Ply, text.as_bytes());
    assert!(matches!(surface, Surface::Cloud(cloud) if cloud.normals().is_none()));
    assert_eq!(report.unusable_normal_count, 1);
}

#[test]
fn a_path_is_in_every_message() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("nobody.ply");
    assert!(read_surface(&missing).unwrap_err().to_string().contains("nobody.ply"));
    let unknown = folder.path().join("body.fbx");
    assert!(matches!(read_surface_with_report(&unknown), Err(ReadError::UnknownFormat { .. })));
    assert!(matches!(write_mesh(&unknown, &tetrahedron()), Err(WriteError::UnknownFormat { .. })));
    assert!(write_mesh(&folder.path().join("no/such/folder.ply"), &tetrahedron()).is_err());
    assert!(
        ply_bytes(PlyContent { positions: &[DVec3::X], normals: Some(&[]), ..PlyContent::default() })
            .is_err()
    );
}
