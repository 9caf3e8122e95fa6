//! Known truth: raw scans whose correspondence is known are registered where they truly belong.
#![allow(clippy::expect_used, reason = "a test may fail loudly")]

use std::sync::LazyLock;

use glam::DVec3;
use habitus::artifacts::registered_scan::RegisteredScan;
use habitus::artifacts::scan::{Scan, ScanLandmarks};
use habitus::artifacts::template_mesh::TemplateMesh;
use habitus::body::BodyModel;
use habitus::geometry::{PointCloud, Surface, TriangleMesh};
use habitus::stages::register::{
    PreparedTemplate, RegisterConfig, RegisterError, RegisterRecipe, Template, register,
};
use habitus_synthetic::raw_scan::{LandmarkTable, Population, RawScan, RawScanSettings, make_raw_scan};

static MODEL: LazyLock<BodyModel> = LazyLock::new(|| BodyModel::default_space().expect("is embedded"));
static SCAN: LazyLock<RawScan> = LazyLock::new(|| {
    let population = Population::new(&MODEL).expect("source bodies");
    let settings = RawScanSettings { point_count: 20_000, ..RawScanSettings::default() };
    make_raw_scan(&MODEL, &population, &LandmarkTable::of(&MODEL), &settings, "registered").expect("a scan")
});

fn scan(with_landmarks: bool) -> Scan {
    let marks = SCAN.landmarks.iter().map(|mark| (mark.name.clone(), mark.position));
    let entries = if with_landmarks { marks.collect() } else { Vec::new() };
    Scan {
        name: "registered".into(),
        surface: Surface::Mesh(SCAN.mesh.clone()),
        landmarks: ScanLandmarks { entries },
    }
}

fn registered(scan: &Scan, config: &RegisterConfig) -> RegisteredScan {
    let template = PreparedTemplate::new(Template::Model(&MODEL), None, config).expect("a template");
    register(scan, &template).expect("can be registered")
}

/// Mean distance of corresponding vertices, millimetres.
fn error_mm(found: &[DVec3], truth: &[DVec3]) -> f64 {
    found.iter().zip(truth).map(|(a, b)| a.distance(*b)).sum::<f64>() / truth.len() as f64 * 1000.0
}

/// Bounds are about half as much again as was measured when they were promised.
#[test]
fn a_raw_scan_is_registered_where_it_truly_belongs() {
    let truth = &SCAN.person.vertices;
    let config = RegisterConfig::default();
    for with_landmarks in [false, true] {
        let found = registered(&scan(with_landmarks), &config);
        let error = error_mm(found.mesh.positions(), truth);
        assert!(error < 5.0, "{error} mm with landmarks: {with_landmarks}");
        assert!(found.record.quality.held_out_mm.mean < 1.5, "{:?}", found.record.quality);
        assert!(found.is_ok(), "{:?}", found.record.codes);
    }
    let paper = RegisterConfig { recipe: RegisterRecipe::Paper, ..RegisterConfig::default() };
    let found = registered(&scan(true), &paper);
    let body = (0..truth.len()).filter(|v| !MODEL.part_labels()[*v].is_bare());
    let pick = |points: &[DVec3]| body.clone().map(|vertex| points[vertex]).collect::<Vec<DVec3>>();
    let error = error_mm(&pick(found.mesh.positions()), &pick(truth));
    // What the paper's energy reaches without a prior: its surface is near, its correspondence is not.
    assert!(error < 35.0, "{error} mm by the paper's recipe");
    assert!(found.record.quality.surface_to_point_mm.mean < 5.0);
}

/// The same person in millimetres with z up, and as a cloud: results come back in the scan's own frame.
#[test]
fn unit_axis_and_faces_of_a_scan_do_not_matter() {
    let turned = |point: &DVec3| DVec3::new(point.x, -point.z, point.y) * 1000.0;
    let positions: Vec<DVec3> = SCAN.mesh.positions().iter().map(turned).collect();
    let truth: Vec<DVec3> = SCAN.person.vertices.iter().map(turned).collect();
    let config = RegisterConfig::default();
    let mesh = TriangleMesh::new(positions.clone(), SCAN.mesh.faces().to_vec()).expect("valid");
    let normals = habitus::geometry::vertex_normals(mesh.positions(), mesh.faces());
    let cloud = PointCloud::new(positions, Some(normals)).expect("valid");
    for surface in [Surface::Mesh(mesh), Surface::Cloud(cloud)] {
        let scan = Scan { name: "registered".into(), surface, landmarks: ScanLandmarks::default() };
        let found = registered(&scan, &config);
        let error = error_mm(found.mesh.positions(), &truth) / 1000.0;
        assert!(error < 6.0, "{error} mm");
        assert_eq!(found.record.metres_per_unit, 0.001);
    }
}

#[test]
fn a_mesh_with_landmarks_is_template_enough_and_needs_them() {
    let mesh = TriangleMesh::new(MODEL.mean_vertices().to_vec(), MODEL.faces().to_vec()).expect("valid");
    let landmarks = LandmarkTable::of(&MODEL).entries;
    let template = TemplateMesh { name: "mean".into(), mesh, landmarks };
    let config = RegisterConfig::default();
    let prepared = PreparedTemplate::new(Template::Mesh(&template), None, &config).expect("a template");
    let found = register(&scan(true), &prepared).expect("can be registered");
    let quality = &found.record.quality;
    assert!(quality.surface_to_point_mm.mean < 5.0, "{quality:?}");
    let error = error_mm(found.mesh.positions(), &SCAN.person.vertices);
    assert!(error < 40.0, "{error} mm without a model");
    let refused = register(&scan(false), &prepared);
    assert!(matches!(refused, Err(RegisterError::TooFewLandmarks { found: 0, .. })));
}

#[test]
fn one_and_two_threads_give_the_same_registration() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| registered(&scan(true), &RegisterConfig::default()))
    };
    assert_eq!(on(1).mesh, on(2).mesh);
}

#[test]
fn an_almost_empty_scan_is_refused_by_name() {
    let positions = SCAN.mesh.positions()[..50].to_vec();
    let cloud = PointCloud::new(positions, None).expect("valid");
    let scan =
        Scan { name: "dust".into(), surface: Surface::Cloud(cloud), landmarks: ScanLandmarks::default() };
    let config = RegisterConfig::default();
    let template = PreparedTemplate::new(Template::Model(&MODEL), None, &config).expect("a template");
    let message = register(&scan, &template).expect_err("is refused").to_string();
    assert!(message.contains("dust") && message.contains("50"), "{message}");
}
