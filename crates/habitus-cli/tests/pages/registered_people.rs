//! A run folder with a few registrations of known faults.

use std::path::{Path, PathBuf};

use habitus::artifacts::registered_scan::{
    DistanceSummary, EdgeRatio, FittedModel, RegisteredScan, RegistrationQuality, RegistrationRecord,
};
use habitus::body::BodyModel;
use habitus::geometry::glam::DVec3;
use habitus::geometry::io::write_mesh;
use habitus::geometry::{TriangleMesh, vertex_normals};
use tempfile::TempDir;

/// Scans and registrations, in millimetres and z up.
pub struct RegisteredPeople {
    _folder: TempDir,
    /// The run folder.
    pub run: PathBuf,
    /// Folder of the scans.
    pub scans: PathBuf,
}

/// The scans, from the worst registration to the best.
pub const WORST_FIRST: [&str; 5] =
    ["arm <b>off & \"odd\"", "belly bulge", "unusual", "everywhere 2 mm", "exact"];

/// Puts scans and registrations into a folder.
pub fn registered_people() -> RegisteredPeople {
    let folder = tempfile::tempdir().expect("a folder");
    let (run, scans) = (folder.path().join("lab run"), folder.path().join("scans"));
    let registrations = run.join("1_register");
    std::fs::create_dir_all(&registrations).expect("makes");
    std::fs::create_dir_all(&scans).expect("makes");
    let model = BodyModel::default_space().expect("is embedded");
    for (number, name) in WORST_FIRST.into_iter().enumerate() {
        let size = if name == "unusual" { 4.0 } else { 0.7 };
        let identity: Vec<f64> =
            (0..8).map(|k| if (number + k) % 3 == 0 { size } else { -0.6 * size }).collect();
        let body = model.rest_vertices(&identity);
        write(&scans.join(format!("{name}.ply")), &model, &body);
        let registered = with_fault(name, &model, &body);
        let mesh = TriangleMesh::new(in_file(&registered), model.faces().to_vec()).expect("is finite");
        RegisteredScan { mesh, record: record(name, &model, identity) }
            .write(&registrations)
            .expect("writes");
    }
    RegisteredPeople { _folder: folder, run, scans }
}

fn with_fault(name: &str, model: &BodyModel, body: &[DVec3]) -> Vec<DVec3> {
    let normals = vertex_normals(body, model.faces());
    let moved = |vertex: usize| match name {
        "everywhere 2 mm" => normals[vertex] * 0.002,
        "belly bulge" => {
            let distance = body[vertex].distance(DVec3::new(0.0, 1.05, 0.12));
            normals[vertex] * 0.02 * (1.0 - (distance / 0.12).min(1.0))
        }
        "exact" | "unusual" => DVec3::ZERO,
        // The arm on the person's left hangs away from the scan's.
        _ => DVec3::new(0.0, 0.05, 0.0) * ((body[vertex].x - 0.3) / 0.1).clamp(0.0, 1.0),
    };
    (0..body.len()).map(|vertex| body[vertex] + moved(vertex)).collect()
}

/// Metres with y up as millimetres with z up.
fn in_file(positions: &[DVec3]) -> Vec<DVec3> {
    positions.iter().map(|p| DVec3::new(p.x, -p.z, p.y) * 1000.0).collect()
}

fn write(path: &Path, model: &BodyModel, body: &[DVec3]) {
    let mesh = TriangleMesh::new(in_file(body), model.faces().to_vec()).expect("is finite");
    write_mesh(path, &mesh).expect("writes");
}

fn record(name: &str, model: &BodyModel, identity: Vec<f64>) -> RegistrationRecord {
    let distances = DistanceSummary { mean: 0.9, p95: 2.0 };
    RegistrationRecord {
        name: name.into(),
        key: "made".into(),
        quality: RegistrationQuality {
            point_to_surface_mm: distances,
            held_out_mm: distances,
            surface_to_point_mm: distances,
            covered_share: 0.95,
            edge_ratio: EdgeRatio { p1: 0.9, p99: 1.12 },
            flipped_faces: if name.starts_with("arm") { 12 } else { 0 },
            landmark_mm: Some(6.0),
            seconds: 0.4,
            code: "ok".into(),
        },
        codes: Vec::new(),
        fitted_model: Some(FittedModel { model: model.metadata().name.clone(), identity, pose: Vec::new() }),
        metres_per_unit: 0.001,
    }
}
