//! The worst place counts.

use glam::DVec3;
use habitus_geometry::{PointCloud, Surface, TriangleMesh};

use super::{Patches, RankingConfig, RankingPart, RankingParts, edge_factor, mahalanobis, residuals};

/// A square sheet in the x–y plane, `side` vertices a side, 10 mm apart, with its normal along z.
fn sheet(side: u32) -> TriangleMesh {
    let positions = (0..side * side)
        .map(|i| DVec3::new(f64::from(i % side) * 0.01, f64::from(i / side) * 0.01, 0.0))
        .collect();
    let corners = (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| y * side + x));
    let faces = corners.flat_map(|i| [[i, i + 1, i + side + 1], [i, i + side + 1, i + side]]).collect();
    TriangleMesh::new(positions, faces).expect("is valid")
}

fn moved(mesh: &TriangleMesh, offset: impl Fn(DVec3) -> DVec3) -> TriangleMesh {
    let positions = mesh.positions().iter().map(|position| *position + offset(*position)).collect();
    mesh.with_positions(positions).expect("is finite")
}

fn good() -> RankingParts {
    RankingParts { worst_patch_mm: Some(1.0), edge_factor: 1.2, ..RankingParts::default() }
}

fn score(parts: RankingParts) -> f64 {
    parts.score(&RankingConfig::default())
}

#[test]
fn one_part_alone_scores_one_where_it_stops_being_acceptable() {
    let config = RankingConfig::default();
    let none = RankingParts { edge_factor: 1.0, worst_patch_mm: Some(0.0), ..RankingParts::default() };
    assert_eq!(none.score(&config), 0.0);
    let limits = [
        (RankingPart::WorstPatch, RankingParts { worst_patch_mm: Some(config.acceptable_patch_mm), ..none }),
        (
            RankingPart::FlippedFaces,
            RankingParts { flipped_faces: config.acceptable_flipped_faces as usize, ..none },
        ),
        (RankingPart::Edges, RankingParts { edge_factor: config.acceptable_edge_factor, ..none }),
        (RankingPart::Mahalanobis, RankingParts { mahalanobis: Some(config.acceptable_mahalanobis), ..none }),
        (RankingPart::Code, RankingParts { has_failure_code: true, ..none }),
        (RankingPart::Landmarks, RankingParts { landmark_mm: Some(config.acceptable_landmark_mm), ..none }),
    ];
    for (part, parts) in limits {
        assert!((parts.score(&config) - 1.0).abs() < 1e-12, "{part:?}");
        assert_eq!(parts.worst_part(&config), part);
    }
}

#[test]
fn a_worse_part_never_scores_better_and_one_that_is_no_number_is_worst() {
    let worse = [
        RankingParts { worst_patch_mm: Some(2.0), ..good() },
        RankingParts { flipped_faces: 3, ..good() },
        RankingParts { edge_factor: 1.5, ..good() },
        RankingParts { mahalanobis: Some(0.5), ..good() },
        RankingParts { landmark_mm: Some(5.0), ..good() },
    ];
    for parts in worse {
        assert!(score(parts) > score(good()), "{parts:?}");
    }
    let broken = score(RankingParts { worst_patch_mm: None, ..good() });
    assert!(broken.is_finite() && broken > 1e5);
    // Good parts pay for nothing: the score is at least that of the worst part alone.
    let bad = RankingParts { flipped_faces: 40, ..good() };
    assert!(score(bad) >= 2.0);
}

#[test]
fn edges_count_the_same_when_stretched_and_when_squeezed() {
    assert_eq!(edge_factor(0.5, 1.1), 2.0);
    assert_eq!(edge_factor(0.9, 2.0), 2.0);
    assert_eq!(mahalanobis(&[3.0, 4.0, 0.0, 0.0]), Some(2.5));
    assert_eq!(mahalanobis(&[]), None);
}

#[test]
fn one_bad_region_outranks_a_slightly_worse_mean() {
    let config = RankingConfig::default();
    let scan = sheet(60);
    let patches = Patches::of_template(scan.positions(), scan.faces(), config.patch_radius_mm / 1000.0);
    // Everywhere 3 mm off, against exact but for a bump of 20 mm over a twentieth of the area.
    let worse_mean = moved(&scan, |_| DVec3::new(0.0, 0.0, 0.003));
    let bump = moved(&scan, |at| {
        let is_in = at.distance(DVec3::new(0.3, 0.3, 0.0)) < 0.07;
        DVec3::new(0.0, 0.0, if is_in { 0.02 } else { 0.0 })
    });
    let scan = Surface::Mesh(scan);
    let rank = |registration: &TriangleMesh| {
        let residuals = residuals(registration, &scan, &config);
        let known: Vec<f64> = residuals.residual.iter().flatten().copied().collect();
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        let worst = patches.worst(&residuals.residual);
        let parts = RankingParts {
            worst_patch_mm: Some(worst.mean * 1000.0),
            worst_vertex: worst.vertex,
            edge_factor: 1.0,
            ..RankingParts::default()
        };
        (mean, parts)
    };
    let ((mean, everywhere), (bump_mean, local)) = (rank(&worse_mean), rank(&bump));
    assert!(bump_mean < mean, "the mean is deceived: {bump_mean} < {mean}");
    assert!(local.score(&config) > 2.0 * everywhere.score(&config), "{local:?} {everywhere:?}");
    assert!((everywhere.worst_patch_mm.expect("known") - 3.0).abs() < 1e-9);
    let middle = bump.positions()[local.worst_vertex as usize];
    assert!(middle.truncate().distance(glam::DVec2::new(0.3, 0.3)) < 0.03, "{middle}");
}

#[test]
fn signs_say_on_which_side_and_holes_say_nothing() {
    let config = RankingConfig::default();
    let whole = sheet(30);
    let registration = moved(&whole, |_| DVec3::new(0.0, 0.0, 0.004));
    // The scan ends at x = 0.15: there is a hole beyond.
    let kept = whole
        .faces()
        .iter()
        .filter(|face| face.iter().all(|vertex| whole.positions()[*vertex as usize].x < 0.155));
    let scan = TriangleMesh::new(whole.positions().to_vec(), kept.copied().collect()).expect("is valid");
    let used: Vec<bool> = whole.positions().iter().map(|position| position.x < 0.155).collect();
    let found = residuals(&registration, &Surface::Mesh(scan), &config);
    for (vertex, position) in whole.positions().iter().enumerate() {
        let distance = found.signed_distance[vertex];
        if position.x > 0.151 {
            assert!(distance.is_nan(), "over the hole: {position}");
        } else if position.x > 0.005 && position.x < 0.145 && position.y > 0.005 && position.y < 0.285 {
            assert!((distance - 0.004).abs() < 1e-12, "{position}: {distance}");
        }
        // The scan lies below the registration, that is inside it.
        if used[vertex] && position.x > 0.005 && position.y > 0.005 && position.y < 0.285 {
            assert!((found.scan_distance[vertex] + 0.004).abs() < 1e-12);
        }
    }
}

#[test]
fn a_part_of_the_scan_that_the_registration_does_not_reach_counts_unless_it_is_a_stray() {
    let config = RankingConfig::default();
    let registration = sheet(30);
    let mut points = registration.positions().to_vec();
    // A blister of the scan, 12 mm high, and one stray point far away.
    for point in &mut points {
        if point.distance(DVec3::new(0.15, 0.15, 0.0)) < 0.05 {
            point.z = 0.012;
        }
    }
    points.push(DVec3::new(0.05, 0.05, 0.5));
    let normals = vec![DVec3::Z; points.len()];
    let scan = Surface::Cloud(PointCloud::new(points, Some(normals)).expect("is valid"));
    let found = residuals(&registration, &scan, &config);
    let near = |x: f64, y: f64| (y * 100.0).round() as usize * 30 + (x * 100.0).round() as usize;
    let blister = found.residual[near(0.15, 0.15)].expect("known");
    assert!((blister - 0.012).abs() < 1e-9, "{blister}");
    let under_stray = found.residual[near(0.05, 0.05)].expect("known");
    assert_eq!(under_stray, 0.0);
}

#[test]
fn patches_are_those_of_a_plane() {
    let mesh = sheet(21);
    let patches = Patches::of_template(mesh.positions(), mesh.faces(), 0.025);
    let middle = 10 * 21 + 10;
    // Within 25 mm over edges of 10 mm and diagonals of 14.1 mm (which run one way).
    let members: Vec<(i32, i32)> =
        patches.of(middle).iter().map(|v| (*v as i32 % 21 - 10, *v as i32 / 21 - 10)).collect();
    let is_in = |x: i32, y: i32| {
        let diagonal = if x * y > 0 { x.abs().min(y.abs()) } else { 0 };
        10.0 * f64::from(x.abs() + y.abs() - 2 * diagonal) + 14.143 * f64::from(diagonal) <= 25.0
    };
    let expected: Vec<(i32, i32)> =
        (-3..=3).flat_map(|y| (-3..=3).map(move |x| (x, y))).filter(|(x, y)| is_in(*x, *y)).collect();
    assert_eq!(members, expected);
    assert!(patches.of(0).len() < members.len() && patches.of(0)[0] == 0);
}
