use habitus::geometry::{SurfaceIndex, TriangleMesh};

use super::*;

fn world() -> (BodyModel, Population, LandmarkTable) {
    let model = BodyModel::default_space().unwrap();
    let population = Population::new(&model).unwrap();
    let table = LandmarkTable::of(&model);
    (model, population, table)
}

#[test]
fn a_scan_lies_on_its_truth_within_the_noise_and_leaves_holes() {
    let (model, population, table) = world();
    let settings = RawScanSettings { point_count: 20_000, stray_share: 0.0, ..RawScanSettings::default() };
    let scan = make_raw_scan(&model, &population, &table, &settings, "test").unwrap();
    let count = scan.mesh.positions().len();
    // The probe view counts points to a few per cent, and holes take some.
    assert!((16_000..22_000).contains(&count), "{count} points");
    let truth = TriangleMesh::new(scan.person.vertices.clone(), model.faces().to_vec()).unwrap();
    let index = SurfaceIndex::of_mesh(&truth);
    let mean = scan.mesh.positions().iter().map(|p| index.closest(*p).distance_squared.sqrt()).sum::<f64>()
        / count as f64;
    // Along a line of sight the mean of |N(0, 1 mm)| is 0.8 mm; oblique views and the heads' offsets change it a little.
    assert!((0.0005..0.0011).contains(&mean), "{mean}");
    // Scans are seen from outside: their faces look the way of the truth's.
    let normals = habitus::geometry::face_normals(scan.mesh.positions(), scan.mesh.faces());
    let agreeing = (0..normals.len())
        .filter(|face| {
            let [a, b, c] = scan.mesh.corners(*face);
            index.closest((a + b + c) / 3.0).normal.dot(normals[*face]) > 0.0
        })
        .count();
    assert!(agreeing * 100 > 99 * normals.len(), "{agreeing} of {}", normals.len());
    let scanned = SurfaceIndex::of_mesh(&scan.mesh);
    let uncovered =
        scan.person.vertices.iter().filter(|v| scanned.closest(**v).distance_squared > 1e-4).count();
    assert!(uncovered > 50, "only {uncovered} vertices lie in holes");
}

#[test]
fn the_same_name_gives_the_same_scan_and_another_name_another_person() {
    let (model, population, table) = world();
    let settings = RawScanSettings { point_count: 4_000, ..RawScanSettings::default() };
    let make = |name: &str| make_raw_scan(&model, &population, &table, &settings, name).unwrap();
    let (first, again, other) = (make("one"), make("one"), make("two"));
    assert_eq!(first.mesh, again.mesh);
    assert_eq!(first.landmarks, again.landmarks);
    assert_ne!(first.person.rest_vertices, other.person.rest_vertices);
}

#[test]
fn people_are_no_instances_of_the_space() {
    let (model, population, _) = world();
    let settings = PeopleSettings::default();
    let mut distances = Vec::new();
    for name in ["a", "b", "c", "d"] {
        let body = population.person(&model, &settings, 1, name);
        let coefficients = super::people::project(&model, &body);
        let nearest = model.rest_vertices(&coefficients);
        let mean: f64 =
            body.iter().zip(&nearest).map(|(a, b)| a.distance(*b)).sum::<f64>() / body.len() as f64;
        distances.push(mean);
    }
    assert!(distances.iter().all(|distance| *distance > 0.001), "{distances:?}");
}

#[test]
fn a_depth_pair_shows_front_and_back_of_one_person() {
    let (model, population, table) = world();
    let settings = RawScanSettings::default();
    let cameras = DepthPairSettings { noise_mm: 0.0, suit_mm: 0.0, ..DepthPairSettings::default() };
    let pair = make_depth_pair(&model, &population, &table, &settings, &cameras, "test").unwrap();
    assert_eq!(pair.front.person.rest_vertices, pair.back.person.rest_vertices);
    assert_ne!(pair.front.person.pose, pair.back.person.pose);
    for view in [&pair.front, &pair.back] {
        let points = view.image.points();
        assert!(points.len() > 10_000, "{} points", points.len());
        let mesh = TriangleMesh::new(view.person.vertices.clone(), model.faces().to_vec()).unwrap();
        let index = SurfaceIndex::of_mesh(&mesh);
        let farthest = points.iter().map(|p| index.closest(*p).distance_squared.sqrt()).fold(0.0, f64::max);
        // Depths are whole millimetres.
        assert!(farthest < 0.001, "{farthest}");
    }
}

#[test]
fn sixty_four_landmarks_name_different_vertices() {
    let (_, _, table) = world();
    let mut vertices: Vec<u32> = table.entries.iter().map(|(_, vertex)| *vertex).collect();
    vertices.sort_unstable();
    vertices.dedup();
    assert_eq!((table.entries.len(), vertices.len()), (64, 64));
}
