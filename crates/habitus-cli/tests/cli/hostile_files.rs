//! Broken, hostile and foreign files: each ends in an error that names the file and what to do.

use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::bench::{Answer, fitted, run};
use crate::shapes::Shape;
use crate::words;

/// Fits a folder with this one file.
fn fit_file(name: &str, bytes: &[u8]) -> Answer {
    let folder = tempfile::tempdir().expect("a folder");
    let captures = folder.path().join("captures");
    std::fs::create_dir(&captures).expect("makes");
    std::fs::write(captures.join(name), bytes).expect("writes");
    run(words!["fit-sequence", captures, "-o", folder.path().join("run")])
}

/// Checks that a file is refused by its name and with these words.
#[track_caller]
fn refuse(name: &str, bytes: &[u8], needles: &[&str]) {
    let answer = fit_file(name, bytes).expect(1);
    assert!(answer.messages.starts_with("error: ") && answer.messages.contains(name), "{answer:?}");
    for needle in needles {
        assert!(answer.messages.contains(needle), "'{needle}' is not in {answer:?}");
    }
    assert!(answer.result.is_empty(), "{answer:?}");
}

fn capture() -> Vec<u8> {
    std::fs::read(fitted().captures.join("frame_0000.ply")).expect("exists")
}

/// The header's end and the whole file.
fn header_length(ply: &[u8]) -> usize {
    let end = b"end_header\n";
    ply.windows(end.len()).position(|window| window == end).expect("a header") + end.len()
}

/// An ASCII PLY of these vertices and faces, with counts as claimed.
fn ascii_ply(vertex_count: &str, vertices: &str, face_count: &str, faces: &str) -> Vec<u8> {
    format!(
        "ply\nformat ascii 1.0\nelement vertex {vertex_count}\nproperty float x\nproperty float y\n\
         property float z\nelement face {face_count}\nproperty list uchar int vertex_indices\nend_header\n\
         {vertices}{faces}"
    )
    .into_bytes()
}

const TETRAHEDRON: &str = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n";
const SIDES: &str = "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n";

#[test]
fn ply_cut_at_many_places() {
    let whole = capture();
    let header = header_length(&whole);
    let inside = [0.1, 0.3, 0.5, 0.7, 0.9, 0.999];
    let body = (whole.len() - header) as f64;
    let cuts = [1, 3, header / 2, header - 2, header].into_iter();
    for cut in cuts.chain(inside.map(|share| header + (share * body) as usize)).chain([whole.len() - 1]) {
        refuse("cut.ply", &whole[..cut], &[]);
    }
    let answer = fit_file("cut.ply", &whole[..whole.len() - 1]);
    assert!(answer.messages.contains("cut off"), "{answer:?}");
}

#[test]
fn ply_with_wrong_or_huge_counts() {
    refuse("few.ply", &ascii_ply("5", TETRAHEDRON, "4", SIDES), &[]);
    refuse("many.ply", &ascii_ply("3", TETRAHEDRON, "4", SIDES), &[]);
    refuse("faces.ply", &ascii_ply("4", TETRAHEDRON, "5", SIDES), &[]);
    refuse("spare.ply", &ascii_ply("4", TETRAHEDRON, "3", SIDES), &["left over"]);
    refuse("huge.ply", &ascii_ply("1000000000000", TETRAHEDRON, "4", SIDES), &["at most"]);
    refuse("beyond.ply", &ascii_ply("99999999999999999999999999", TETRAHEDRON, "4", SIDES), &[]);
    refuse("negative.ply", &ascii_ply("-4", TETRAHEDRON, "4", SIDES), &[]);
    let whole = String::from_utf8_lossy(&capture()).into_owned();
    let line = whole.lines().find(|line| line.starts_with("element vertex")).expect("a count").to_string();
    let binary = capture();
    let mut claims = b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000".to_vec();
    let place = binary.windows(line.len()).position(|window| window == line.as_bytes()).expect("is there");
    claims.extend(&binary[place + line.len()..]);
    refuse("billions.ply", &claims, &["at most"]);
}

#[test]
fn ply_with_impossible_numbers() {
    let vertices = |bad: &str| TETRAHEDRON.replacen("1 0 0", bad, 1);
    refuse("nan.ply", &ascii_ply("4", &vertices("nan 0 0"), "4", SIDES), &["vertex 1", "finite"]);
    refuse("inf.ply", &ascii_ply("4", &vertices("0 -inf 0"), "4", SIDES), &["vertex 1", "finite"]);
    refuse("word.ply", &ascii_ply("4", &vertices("one 0 0"), "4", SIDES), &[]);
    let beyond = SIDES.replacen("3 0 2 1", "3 0 2 9", 1);
    refuse("index.ply", &ascii_ply("4", TETRAHEDRON, "4", &beyond), &["vertex 9"]);
    let below = SIDES.replacen("3 0 2 1", "3 0 -2 1", 1);
    refuse("minus.ply", &ascii_ply("4", TETRAHEDRON, "4", &below), &[]);
    let twice = "3 0 0 1\n".repeat(4);
    refuse("twice.ply", &ascii_ply("4", TETRAHEDRON, "4", &twice), &["twice"]);
    let mut binary = capture();
    let header = header_length(&binary);
    binary[header..header + 8].copy_from_slice(&[0xff; 8]);
    refuse("bits.ply", &binary, &["finite"]);
}

#[test]
fn files_with_almost_nothing_on_them() {
    refuse("empty.ply", b"", &[]);
    refuse("none.ply", &ascii_ply("0", "", "0", ""), &[]);
    refuse("point.ply", &ascii_ply("1", "0 0 0\n", "0", ""), &["needs at least"]);
    refuse("zero_faces.ply", &ascii_ply("4", TETRAHEDRON, "0", ""), &["needs at least"]);
    refuse("tetrahedron.ply", &ascii_ply("4", TETRAHEDRON, "4", SIDES), &["needs at least"]);
    refuse("one.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", &["needs at least"]);
}

#[test]
fn files_that_are_something_else() {
    refuse("letter.ply", b"Dear reader,\nthis is no mesh.\n", &[]);
    refuse("picture.ply", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", &[]);
    refuse("mesh.obj", &capture(), &["line 1"]);
    refuse("solid.ply", b"solid body\nfacet normal 0 0 1\n", &["STL"]);
    refuse("body.glb", b"{\"asset\":{\"version\":\"2.0\"}}", &[]);
    refuse("word.off", b"OFF\nfour faces\n", &[]);
    refuse("old.ply", b"ply\nformat ascii 7.0\nend_header\n", &[]);
}

#[test]
fn other_formats_cut_or_miscounted() {
    let folder = tempfile::tempdir().expect("a folder");
    let exported = folder.path().join("body.glb");
    run(words!["export", fitted().run, "--glb", exported]).expect(0);
    let whole = std::fs::read(&exported).expect("exists");
    for share in [0.0005, 0.01, 0.4, 0.95] {
        refuse("cut.glb", &whole[..(whole.len() as f64 * share) as usize], &[]);
    }
    let mut stl = vec![0; 84];
    stl[80..84].copy_from_slice(&3_000_000_000_u32.to_le_bytes());
    stl.extend([0; 50]);
    refuse("huge.stl", &stl, &[]);
    refuse("cut.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0", &[]);
    refuse("count.off", b"OFF\n9 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", &[]);
    refuse("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", &[]);
    refuse("nan.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", &[]);
}

fn refuse_input(input: &Path, needles: &[&str]) {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("run");
    let answer = run(words!["fit-sequence", input, "-o", out]).expect(1);
    for needle in needles {
        assert!(answer.messages.contains(needle), "'{needle}' is not in {answer:?}");
    }
    assert!(!out.exists(), "a wrong input leaves no run folder behind");
}

#[test]
fn folders_without_a_sequence() {
    let folder = tempfile::tempdir().expect("a folder");
    refuse_input(&folder.path().join("nowhere"), &["nowhere", "cannot be read"]);
    refuse_input(folder.path(), &["no frames found", ".ply"]);
    std::fs::write(folder.path().join("notes.txt"), "nothing here").expect("writes");
    refuse_input(folder.path(), &["no frames found"]);
    refuse_input(&folder.path().join("scan_%04d.ply"), &["scan_%04d.ply", "no frames found"]);
    refuse_input(&folder.path().join("notes.txt"), &["notes.txt"]);
    for name in ["a.ply", "a.obj"] {
        std::fs::copy(fitted().captures.join("frame_0000.ply"), folder.path().join(name)).expect("copies");
    }
    refuse_input(folder.path(), &["several formats", "obj, ply", "pattern"]);
    let few =
        run(words!["fit-sequence", fitted().captures, "-o", folder.path().join("run"), "--first", "50"]);
    assert!(few.expect(1).messages.contains("--first"));
}

#[cfg(unix)]
#[test]
fn a_file_without_permission() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("secret.ply");
    std::fs::write(&file, capture()).expect("writes");
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o000)).expect("can be locked");
    if std::fs::read(&file).is_ok() {
        // The superuser may read everything; a folder in the file's place cannot be read by anybody.
        std::fs::remove_file(&file).expect("removes");
        std::fs::create_dir(&file).expect("makes");
        return refuse_input(&file, &["secret.ply"]);
    }
    let answer = run(words!["fit-sequence", file, "-o", folder.path().join("run")]).expect(1);
    assert!(answer.messages.contains("secret.ply"), "{answer:?}");
}

/// Places for other broken inputs: a folder and a path in it.
fn place(name: &str, bytes: &[u8]) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("writes");
    (folder, path)
}

#[test]
fn broken_models_and_fits_are_refused_by_name() {
    let whole = std::fs::read(fitted().run.join("3_fit_sequence/fit.npz")).expect("exists");
    for cut in [0, 10, whole.len() / 3, whole.len() - 30] {
        let (folder, path) = place("broken.npz", &whole[..cut]);
        for words in [
            words!["measure", path],
            words!["export", path, "--ply", folder.path().join("bodies")],
            words!["render", path, "-o", folder.path().join("a.png")],
            words!["fit-sequence", fitted().captures, "-o", folder.path().join("run"), "--model", path],
        ] {
            let answer = run(words).expect(1);
            assert!(answer.messages.contains("broken.npz"), "{answer:?}");
        }
    }
    // A fit is no body model.
    let (folder, path) = place("fit.npz", &whole);
    let out = folder.path().join("run");
    let answer = run(words!["fit-sequence", fitted().captures, "-o", out, "--model", path]).expect(1);
    assert!(answer.messages.contains("not a habitus body model"), "{answer:?}");
    let nothing = run(words!["report", folder.path()]).expect(1);
    assert!(nothing.messages.contains("no finished fit"), "{nothing:?}");
}

#[test]
fn broken_settings_are_refused_by_name() {
    let (folder, path) = place("settings.toml", b"[fit_sequence]\nrecipe = \"fast\"\n");
    let out = folder.path().join("run");
    let words = |path: &Path| run(words!["fit-sequence", fitted().captures, "-o", out, "--config", path]);
    let answer = words(&path).expect(1);
    assert!(answer.messages.contains("settings.toml") && answer.messages.contains("paper2016"), "{answer:?}");
    let (_folder, path) = place("half.toml", b"[fit_sequence]\ncomponents = 3\nrecipe = \n");
    let answer = words(&path).expect(1);
    assert!(answer.messages.contains("half.toml, line 3"), "{answer:?}");
    let answer = words(Path::new("missing.toml")).expect(1);
    assert!(answer.messages.contains("missing.toml"), "{answer:?}");
}

#[test]
fn a_run_folder_that_cannot_be_made_is_named() {
    let (_folder, path) = place("in_the_way", b"a file");
    let answer = run(words!["fit-sequence", fitted().captures, "-o", path]).expect(1);
    assert!(answer.messages.contains("in_the_way") && answer.messages.contains("-o"), "{answer:?}");
    let (folder, _) = place("letter.txt", b"keep me");
    let answer = run(words!["generate", "-o", folder.path(), "--frames", "1"]).expect(1);
    assert!(answer.messages.contains("letter.txt"), "{answer:?}");
    assert!(folder.path().join("letter.txt").exists(), "nothing of the user's is removed");
}

#[test]
fn a_person_is_not_refused() {
    // The other side of this page: what is right must pass by the same way.
    let folder = tempfile::tempdir().expect("a folder");
    Shape::person().write(&folder.path().join("person.obj"));
    let out = folder.path().join("run");
    run(words!["fit-sequence", folder.path().join("person.obj"), "-o", out]).expect(0);
}
