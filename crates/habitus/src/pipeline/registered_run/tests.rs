use std::path::Path;

use habitus_geometry::io::write_mesh;
use habitus_optimize::Silent;

use super::*;
use crate::artifacts::registered_scan::{
    DistanceSummary, EdgeRatio, RegistrationQuality, RegistrationRecord,
};
use crate::body::fixture;

/// A registration that lies `offset` metres above its scan, in millimetres.
fn put(folder: &Path, name: &str, offset: f64) -> PathBuf {
    let model = fixture::model();
    let mesh_of = |offset: f64| {
        let moved = model.mean_vertices().iter().map(|vertex| (*vertex + DVec3::Y * offset) * 1000.0);
        TriangleMesh::new(moved.collect(), model.faces().to_vec()).unwrap()
    };
    let scans = folder.join("scans");
    let registrations = folder.join("1_register");
    std::fs::create_dir_all(&scans).unwrap();
    std::fs::create_dir_all(&registrations).unwrap();
    let scan = scans.join(format!("{name}.ply"));
    write_mesh(&scan, &mesh_of(0.0)).unwrap();
    let distances = DistanceSummary { mean: 1.0, p95: 2.0 };
    let quality = RegistrationQuality {
        point_to_surface_mm: distances,
        held_out_mm: distances,
        surface_to_point_mm: distances,
        covered_share: 1.0,
        edge_ratio: EdgeRatio { p1: 1.0, p99: 1.0 },
        flipped_faces: 0,
        landmark_mm: None,
        seconds: 0.0,
        code: "ok".into(),
    };
    let record = RegistrationRecord {
        name: name.into(),
        key: String::new(),
        quality,
        codes: Vec::new(),
        fitted_model: None,
        metres_per_unit: 0.001,
    };
    RegisteredScan { mesh: mesh_of(offset), record }.write(&registrations).unwrap();
    scan
}

fn ranking(folder: &Path, scans: &[PathBuf]) -> Vec<(String, Option<f64>)> {
    let run = RegisteredRun::open(&folder.join("1_register"), scans, &fixture::model()).unwrap();
    let ranked = run.rank(&RankingConfig::default(), &mut Silent).unwrap();
    ranked.into_iter().map(|ranked| (ranked.name, ranked.parts.worst_patch_mm)).collect()
}

#[test]
fn the_worst_is_first_and_only_what_changed_is_ranked_again() {
    let folder = tempfile::tempdir().unwrap();
    let scans =
        [("a", 0.001), ("b", 0.02), ("c", 0.0)].map(|(name, offset)| put(folder.path(), name, offset));
    let first = ranking(folder.path(), &scans);
    let names: Vec<&str> = first.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["b", "a", "c"]);
    assert!(first[0].1 > Some(5.0) && first[2].1 < Some(1e-3), "{first:?}");
    // Marked in the kept file, entries come back unless their registration has changed.
    let kept = folder.path().join("1_register").join(RANKING);
    let mut file: RankingFile = serde_json::from_str(&std::fs::read_to_string(&kept).unwrap()).unwrap();
    file.scans.iter_mut().for_each(|ranked| ranked.parts.worst_patch_mm = Some(77.0));
    std::fs::write(&kept, serde_json::to_string(&file).unwrap()).unwrap();
    put(folder.path(), "c", 0.002);
    let second = ranking(folder.path(), &scans);
    assert_eq!((second[0].1, second[1].1), (Some(77.0), Some(77.0)));
    assert!(second[2].0 == "c" && second[2].1 < Some(5.0), "{second:?}");
}

#[test]
fn a_scan_that_cannot_be_read_ranks_worst_and_a_missing_one_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut scans: Vec<PathBuf> = ["a", "b"].iter().map(|name| put(folder.path(), name, 0.0)).collect();
    std::fs::write(&scans[1], b"ply\nbroken").unwrap();
    assert_eq!(ranking(folder.path(), &scans)[0], ("b".to_string(), None));
    scans.pop();
    let run = RegisteredRun::open(&folder.path().join("1_register"), &scans, &fixture::model()).unwrap();
    let message = run.pair("b").unwrap_err().to_string();
    assert!(message.contains("'b'") && message.contains("--scans"), "{message}");
    assert!(matches!(run.pair("../a"), Err(RegisteredRunError::NoRegistration { .. })));
    let empty = folder.path().join("none/1_register");
    assert!(matches!(
        RegisteredRun::open(&empty, &[], &fixture::model()),
        Err(RegisteredRunError::Nothing { .. })
    ));
}

#[test]
fn scores_decide_what_nobody_has_decided() {
    let ranked = |name: &str, patch_mm: f64| RankedRegistration {
        name: name.into(),
        registration: "now".into(),
        mean_mm: 1.0,
        parts: RankingParts { worst_patch_mm: Some(patch_mm), edge_factor: 1.0, ..RankingParts::default() },
        within: Vec::new(),
    };
    let ranking = [ranked("bad", 60.0), ranked("kept", 60.0), ranked("good", 0.6)];
    let mut decisions = ReviewDecisions::default();
    let word = Decision {
        scan: "kept".into(),
        verdict: Some(Verdict::Accept),
        note: String::new(),
        registration: None,
    };
    decisions.set(word.clone());
    assert_eq!(decide_by_score(&mut decisions, &ranking, &RankingConfig::default(), 1.0), (1, 1));
    assert_eq!(decisions.of("kept"), Some(&word));
    assert_eq!(decisions.of("good").unwrap().verdict, Some(Verdict::Accept));
    assert!(decisions.of("bad").unwrap().note.starts_with("score 10.00"));
    assert_eq!(decisions.of("bad").unwrap().verdict_on("now"), Some(Verdict::Reject));
    assert_eq!(decisions.of("bad").unwrap().verdict_on("registered anew"), None);
}

#[test]
fn the_last_round_is_reviewed_unless_the_run_has_registrations_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path();
    assert_eq!(registration_folder(run), run.join("1_register"));
    for round in [0, 2, 10] {
        put(&round_folder(run, round), "a", 0.0);
    }
    // A round that has been begun and holds nothing yet.
    std::fs::create_dir_all(round_folder(run, 11).join("1_register")).unwrap();
    assert_eq!(registration_folder(run), round_folder(run, 10).join("1_register"));
    put(run, "a", 0.0);
    assert_eq!(registration_folder(run), run.join("1_register"));
}

#[test]
fn scans_inside_the_run_are_found_after_it_moved() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (folder.path().join("old"), folder.path().join("new"));
    std::fs::create_dir(&old).unwrap();
    let outside = folder.path().join("elsewhere.ply");
    ScanPlaces { scans: vec![old.join("0_scans/a.ply"), outside.clone()] }.write(&old).unwrap();
    std::fs::rename(&old, &new).unwrap();
    assert_eq!(ScanPlaces::read(&new).unwrap().scans, [new.join("0_scans/a.ply"), outside]);
    assert_eq!(ScanPlaces::read(folder.path()), None);
}
