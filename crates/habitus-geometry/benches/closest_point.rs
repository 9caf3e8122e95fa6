//! Closest points and rays on a 50k-triangle surface the size of a body: best and median times beside a floor.
//!
//! Run alone: `cargo bench -p habitus-geometry --bench closest_point`.
#![allow(clippy::print_stdout, clippy::expect_used)]

use std::hint::black_box;
use std::ops::Range;
use std::time::Instant;

use habitus_geometry::glam::DVec3;
use habitus_geometry::{SurfaceIndex, TriangleMesh, normals};

const REPEATS: usize = 60;
/// Queries that are timed together.
const PIECE: usize = 1625;
/// Vertices of the body whose closest points are asked for.
const QUERY_COUNT: u32 = 6500;

/// A wavy closed surface about 1.8 m tall: 250 rings of 100 vertices, 50k triangles.
fn wavy_body(rings: u32, around: u32) -> TriangleMesh {
    let mut positions = Vec::new();
    let mut faces = Vec::new();
    for ring in 0..rings {
        for step in 0..around {
            let height = (f64::from(ring) + 0.5) / f64::from(rings);
            let angle = std::f64::consts::TAU * f64::from(step) / f64::from(around);
            let profile = (std::f64::consts::PI * height).sin().sqrt();
            let waves = 1.0 + 0.15 * (9.0 * angle + 14.0 * height).sin() + 0.1 * (25.0 * height).cos();
            let radius = 0.2 * profile * waves;
            positions.push(DVec3::new(radius * angle.cos(), 1.8 * height, radius * angle.sin()));
        }
    }
    for ring in 0..rings - 1 {
        for step in 0..around {
            let (here, next) = (ring * around + step, ring * around + (step + 1) % around);
            faces.push([here, here + around, next]);
            faces.push([next, here + around, next + around]);
        }
    }
    TriangleMesh::new(positions, faces).expect("the surface is made here")
}

/// Milliseconds of a task over `count` items, as the sum of the best times of its pieces: on a shared machine a short
/// piece runs undisturbed now and then, a long one never does.
fn time(name: &str, count: usize, piece: usize, mut task: impl FnMut(Range<usize>)) {
    let mut best_ms = 0.0;
    let mut median_ms = 0.0;
    for start in (0..count).step_by(piece) {
        let mut times: Vec<f64> = (0..REPEATS)
            .map(|_| {
                let begun = Instant::now();
                task(start..(start + piece).min(count));
                begun.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        times.sort_by(f64::total_cmp);
        best_ms += times[0];
        median_ms += times[REPEATS / 2];
    }
    let each = best_ms * 1e3 / count as f64;
    println!("{name:<44} best {best_ms:8.3} ms   median {median_ms:8.3} ms   best {each:7.3} us each");
}

fn main() {
    let mesh = wavy_body(250, 100);
    let body = wavy_body(65, 100);
    let body_normals = normals::vertex_normals(body.positions(), body.faces());
    let queries: Vec<DVec3> = (0..QUERY_COUNT as usize)
        .map(|vertex| {
            body.positions()[vertex]
                - body_normals[vertex] * (0.01 + 0.02 * ((vertex * 7919) % 100) as f64 / 100.0)
        })
        .collect();
    println!(
        "{} triangles, {} queries 1-3 cm off, {} threads",
        mesh.faces().len(),
        queries.len(),
        rayon::current_num_threads()
    );
    // Peers' arithmetic floor: about 50 boxes and a few triangles at full SIMD rate, 0.3 µs a query and core.
    println!(
        "floor: closest {:.2} ms, ray {:.2} ms on one core\n",
        0.3e-3 * f64::from(QUERY_COUNT),
        0.1e-3 * f64::from(QUERY_COUNT)
    );

    let face_count = mesh.faces().len();
    time("build, mesh", face_count, face_count, |_| drop(black_box(SurfaceIndex::of_mesh(&mesh))));
    let positions = mesh.positions();
    let vertex_normals = normals::vertex_normals(positions, mesh.faces());
    time("build, cloud of its vertices", positions.len(), positions.len(), |_| {
        drop(black_box(SurfaceIndex::of_cloud(positions, &vertex_normals)));
    });

    // As between two rounds of a fit: everything has moved by three millimetres.
    let moved: Vec<DVec3> = queries.iter().map(|query| *query + DVec3::new(0.002, -0.002, 0.001)).collect();
    let count = queries.len();
    let of_mesh = SurfaceIndex::of_mesh(&mesh);
    let of_cloud = SurfaceIndex::of_cloud(positions, &vertex_normals);
    for (name, index) in [("mesh", &of_mesh), ("cloud", &of_cloud)] {
        let mut found = Vec::new();
        index.closest_many(&queries, None, &mut found);
        let hints: Vec<u32> = found.iter().map(|point| point.face).collect();
        time(&format!("{name}: closest, cold, one thread"), count, PIECE, |range| {
            for query in &queries[range] {
                black_box(index.closest(*query));
            }
        });
        time(&format!("{name}: closest, warm, one thread"), count, PIECE, |range| {
            for (query, hint) in moved[range.clone()].iter().zip(&hints[range]) {
                black_box(index.closest_warm(*query, *hint));
            }
        });
        time(&format!("{name}: closest_many, cold"), count, count, |_| {
            index.closest_many(&queries, None, &mut found);
        });
        time(&format!("{name}: closest_many, warm"), count, count, |_| {
            index.closest_many(&moved, Some(&hints), &mut found);
        });
    }
    time("rays along normals, one thread", count, PIECE, |range| {
        for (query, normal) in queries[range.clone()].iter().zip(&body_normals[range]) {
            black_box(of_mesh.ray_hit(*query, *normal, 0.15));
        }
    });
}
