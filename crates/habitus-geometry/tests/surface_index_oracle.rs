//! The index against brute force: closest point, warm start, radius, sign and rays.
#![allow(clippy::unwrap_used)]

use habitus_geometry::glam::DVec3;
use habitus_geometry::sampling::SplitMix;
use habitus_geometry::{SurfaceIndex, TriangleMesh};

/// A torus with radii 0.7 and 0.25 m, its outside outwards.
fn torus(around: u32, across: u32) -> TriangleMesh {
    let mut positions = Vec::new();
    let mut faces = Vec::new();
    for i in 0..around {
        for j in 0..across {
            let (u, v) = (
                std::f64::consts::TAU * f64::from(i) / f64::from(around),
                std::f64::consts::TAU * f64::from(j) / f64::from(across),
            );
            let ring = 0.7 + 0.25 * v.cos();
            positions.push(DVec3::new(ring * u.cos(), ring * u.sin(), 0.25 * v.sin()));
            let at = |i: u32, j: u32| (i % around) * across + j % across;
            faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            faces.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    TriangleMesh::new(positions, faces).unwrap()
}

/// Triangles of every size and shape, slivers included, thrown about.
fn soup(count: u32, random: &mut SplitMix) -> TriangleMesh {
    let mut positions = Vec::new();
    for _ in 0..count {
        let corner = point(random, 1.0);
        let (along, aside) = (point(random, 0.3), point(random, 0.3));
        let thinness = [1.0, 1e-3, 1e-7, 0.0][(random.bits() % 4) as usize];
        positions.extend([corner, corner + along, corner + along * 0.4 + aside * thinness]);
    }
    TriangleMesh::new(positions, (0..count).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect())
        .unwrap()
}

fn point(random: &mut SplitMix, reach: f64) -> DVec3 {
    DVec3::new(random.unit() - 0.5, random.unit() - 0.5, random.unit() - 0.5) * 2.0 * reach
}

/// Nearest distance to one triangle by another way than the library's: the plane, where the foot is inside, or the edges.
fn distance_to_triangle(point: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let segment = |p: DVec3, q: DVec3| {
        let edge = q - p;
        let along =
            if edge.length_squared() > 0.0 { (point - p).dot(edge) / edge.length_squared() } else { 0.0 };
        point.distance(p + edge * along.clamp(0.0, 1.0))
    };
    let edges = segment(a, b).min(segment(b, c)).min(segment(c, a));
    let Some(normal) = (b - a).cross(c - a).try_normalize() else { return edges };
    let is_over =
        [(a, b), (b, c), (c, a)].iter().all(|(p, q)| normal.dot((*q - *p).cross(point - *p)) >= 0.0);
    if is_over { edges.min(normal.dot(point - a).abs()) } else { edges }
}

fn brute_distance(mesh: &TriangleMesh, point: DVec3) -> f64 {
    (0..mesh.faces().len())
        .map(|face| distance_to_triangle(point, mesh.corners(face)))
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn closest_points_are_those_of_brute_force() {
    let mut random = SplitMix::new(1);
    for mesh in [torus(40, 21), soup(600, &mut random), soup(3, &mut random), torus(3, 3)] {
        let index = SurfaceIndex::of_mesh(&mesh);
        for step in 0..2000 {
            let query = point(&mut random, [0.1, 1.0, 3.0, 1000.0][step % 4]);
            let closest = index.closest(query);
            let truth = brute_distance(&mesh, query);
            let found = closest.distance_squared.sqrt();
            assert!((found - truth).abs() <= 1e-12 * (1.0 + truth), "{found} is not {truth}");
            let [a, b, c] = mesh.corners(closest.face as usize);
            let [u, v, w] = closest.barycentric;
            assert!((a * u + b * v + c * w).distance(closest.position) < 1e-12);
            assert!((u + v + w - 1.0).abs() < 1e-12 && u.min(v).min(w) > -1e-12);
            assert!((closest.position.distance(query) - found).abs() < 1e-12);

            let hint = (random.bits() % mesh.faces().len() as u64) as u32;
            assert_eq!(index.closest_warm(query, hint), closest);
            assert_eq!(index.closest_warm(query, closest.face), closest);
            assert_eq!(index.closest_warm(query, u32::MAX), closest);
            assert_eq!(index.closest_within(query, found * 1.0000001), Some(closest));
            assert_eq!(index.closest_within(query, found * 0.9999999), None);
        }
    }
}

#[test]
fn many_points_get_the_answers_of_one_at_a_time_on_any_thread_count() {
    let mesh = torus(50, 30);
    let index = SurfaceIndex::of_mesh(&mesh);
    let mut random = SplitMix::new(2);
    let queries: Vec<DVec3> = (0..3000).map(|_| point(&mut random, 1.0)).collect();
    let alone: Vec<_> = queries.iter().map(|query| index.closest(*query)).collect();
    let hints: Vec<u32> = alone.iter().map(|closest| closest.face).collect();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let index = SurfaceIndex::of_mesh(&mesh);
            let mut many = Vec::new();
            index.closest_many(&queries, None, &mut many);
            assert_eq!(many, alone);
            index.closest_many(&queries, Some(&hints), &mut many);
            assert_eq!(many, alone);
        });
    }
}

#[test]
fn a_cloud_gives_its_nearest_point_and_normal() {
    let mut random = SplitMix::new(3);
    for count in [1, 2, 5, 777] {
        let positions: Vec<DVec3> = (0..count).map(|_| point(&mut random, 1.0)).collect();
        let normals: Vec<DVec3> = (0..count).map(|_| point(&mut random, 1.0).normalize()).collect();
        let index = SurfaceIndex::of_cloud(&positions, &normals);
        for _ in 0..500 {
            let query = point(&mut random, 1.5);
            let nearest = (0..count)
                .min_by(|&i, &j| {
                    query.distance_squared(positions[i]).total_cmp(&query.distance_squared(positions[j]))
                })
                .unwrap();
            let closest = index.closest(query);
            assert_eq!((closest.face as usize, closest.position), (nearest, positions[nearest]));
            assert_eq!((closest.normal, closest.barycentric), (normals[nearest], [1.0, 0.0, 0.0]));
            assert_eq!(index.closest_warm(query, 0), closest);
        }
        assert_eq!(index.ray_hit(DVec3::ZERO, DVec3::X, 9.0), None);
    }
}

#[test]
fn the_sign_is_that_of_the_winding_number() {
    let mut random = SplitMix::new(4);
    // A coarse torus: sharp edges and corners, where a face's own normal would give wrong signs.
    for mesh in [torus(5, 4), torus(30, 16)] {
        let index = SurfaceIndex::of_mesh(&mesh);
        let mut inside_count = 0;
        for _ in 0..4000 {
            let query = point(&mut random, 1.2);
            // Van Oosterom and Strackee 1983: the solid angle of each triangle.
            let winding: f64 = (0..mesh.faces().len())
                .map(|face| {
                    let [a, b, c] = mesh.corners(face).map(|corner| corner - query);
                    let (la, lb, lc) = (a.length(), b.length(), c.length());
                    let numerator = a.dot(b.cross(c));
                    let denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
                    2.0 * numerator.atan2(denominator)
                })
                .sum::<f64>()
                / (2.0 * std::f64::consts::TAU);
            let is_inside = winding > 0.5;
            inside_count += usize::from(is_inside);
            assert_eq!(index.signed_distance(query) < 0.0, is_inside, "at {query}");
        }
        assert!(inside_count > 100);
    }
}

#[test]
fn rays_hit_what_brute_force_hits() {
    let mut random = SplitMix::new(5);
    for mesh in [torus(40, 21), soup(400, &mut random)] {
        let index = SurfaceIndex::of_mesh(&mesh);
        let mut hit_count = 0;
        for step in 0..4000 {
            let origin = point(&mut random, 1.5);
            // Every other ray runs along an axis, where the slab test divides by zero.
            let axis = [DVec3::X, -DVec3::Y, DVec3::Z, DVec3::new(1.0, 0.0, -1.0)][step / 2 % 4];
            let direction = if step % 2 == 0 { point(&mut random, 1.0) } else { axis * 2.0 };
            let unit = direction.normalize();
            let truth = (0..mesh.faces().len())
                .filter_map(|face| {
                    let [a, b, c] = mesh.corners(face);
                    // Möller and Trumbore 1997.
                    let (ab, ac) = (b - a, c - a);
                    let p = unit.cross(ac);
                    let determinant = ab.dot(p);
                    let t = origin - a;
                    let (u, q) = (t.dot(p) / determinant, t.cross(ab));
                    let (v, distance) = (unit.dot(q) / determinant, ac.dot(q) / determinant);
                    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance >= 0.0).then_some(distance)
                })
                .fold(f64::INFINITY, f64::min);
            let hit = index.ray_hit(origin, direction, 10.0);
            let found = hit.map_or(f64::INFINITY, |hit| hit.distance);
            let agrees = found == truth || (found - truth).abs() < 1e-6;
            assert!(agrees, "{found} is not {truth}");
            if let Some(hit) = hit {
                hit_count += 1;
                let [a, b, c] = mesh.corners(hit.face as usize);
                let [u, v, w] = hit.barycentric;
                let met = a * u + b * v + c * w;
                assert!(met.distance(origin + unit * hit.distance) < 1e-6);
                assert!(index.ray_hit(origin, direction, hit.distance * 0.999).is_none());
                assert_eq!(index.ray_hit(origin, direction, hit.distance), Some(hit));
            }
        }
        assert!(hit_count > 300, "{hit_count}");
    }
}

#[test]
fn no_ray_slips_between_two_faces() {
    let mesh = torus(24, 12);
    let index = SurfaceIndex::of_mesh(&mesh);
    let inside = DVec3::new(0.7, 0.0, 0.0);
    for face in mesh.faces() {
        for corner in 0..3 {
            let (a, b) =
                (mesh.positions()[face[corner] as usize], mesh.positions()[face[(corner + 1) % 3] as usize]);
            for share in [0.0, 0.25, 0.5, 1.0 / 3.0] {
                let target = a.lerp(b, share);
                assert!(index.ray_hit(inside, target - inside, 10.0).is_some());
            }
        }
    }
}

#[test]
fn odd_queries_and_odd_scales_are_survived() {
    for scale in [1e-200, 1e-20, 1e-6, 1e6, 1e18, 1e30, 1e100] {
        let mesh = torus(8, 6);
        let scaled = mesh.with_positions(mesh.positions().iter().map(|p| *p * scale).collect()).unwrap();
        let index = SurfaceIndex::of_mesh(&scaled);
        let mut random = SplitMix::new(6);
        for _ in 0..50 {
            let query = point(&mut random, 1.0);
            let truth = brute_distance(&mesh, query) * scale;
            let found = index.closest(query * scale).distance_squared.sqrt();
            // Beyond, fourth powers of the lengths leave the range of f64.
            if (1e-70..1e70).contains(&scale) {
                assert!((found - truth).abs() <= 1e-9 * truth, "{found} is not {truth} at scale {scale}");
            }
        }
    }
    let index = SurfaceIndex::of_mesh(&torus(8, 6));
    for query in [DVec3::NAN, DVec3::INFINITY, DVec3::splat(1e300), DVec3::ZERO] {
        index.closest(query);
        index.closest_warm(query, 3);
        index.closest_within(query, f64::NAN);
        index.ray_hit(query, DVec3::X, 1.0);
        index.ray_hit(DVec3::ZERO, query, f64::INFINITY);
    }
    assert_eq!(index.ray_hit(DVec3::ZERO, DVec3::ZERO, 1.0), None);
}
