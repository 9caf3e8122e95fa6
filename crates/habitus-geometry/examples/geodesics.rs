//! Times bounded geodesics and writes mesh, sources and distances for `benches/peers/geodesics.py`.
//!
//! `cargo run --release -p habitus-geometry --example geodesics -- <folder> [mesh file in metres]`

#![allow(clippy::print_stdout, reason = "an example talks to the one who runs it")]

use std::f64::consts::{PI, TAU};
use std::fmt::Write;
use std::path::PathBuf;
use std::time::Instant;

use glam::DVec3;
use habitus_geometry::io::{read_surface, write_mesh};
use habitus_geometry::{GeodesicWorkspace, Geodesics, MeshError, Surface, TriangleMesh};

/// P3 §3.1: 3 cm.
const RADIUS: f64 = 0.03;
const SOURCES: usize = 500;
const REPEATS: usize = 20;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1).map(PathBuf::from);
    let folder = arguments.next().ok_or("name a folder for the results")?;
    std::fs::create_dir_all(&folder)?;
    let mesh = match arguments.next() {
        None => wavy_torus()?,
        Some(path) => match read_surface(&path)? {
            Surface::Mesh(mesh) => mesh,
            Surface::Cloud(_) => return Err("a cloud has no geodesics".into()),
        },
    };
    let geodesics = Geodesics::new(mesh.positions(), mesh.faces());
    let count = mesh.positions().len();
    let sources: Vec<u32> = (0..SOURCES).map(|k| (k * count / SOURCES) as u32).collect();
    let mut workspace = GeodesicWorkspace::default();
    let mut found = Vec::new();
    let mut best = f64::INFINITY;
    for _ in 0..REPEATS {
        let begin = Instant::now();
        for source in &sources {
            geodesics.within_into(*source, RADIUS, &mut workspace, &mut found);
        }
        best = best.min(begin.elapsed().as_secs_f64() / SOURCES as f64);
    }
    let mut table = String::from("source,vertex,distance\n");
    for source in &sources {
        geodesics.within_into(*source, RADIUS, &mut workspace, &mut found);
        for (vertex, distance) in &found {
            writeln!(table, "{source},{vertex},{distance:.12}")?;
        }
    }
    write_mesh(&folder.join("mesh.obj"), &mesh)?;
    std::fs::write(folder.join("distances.csv"), table)?;
    std::fs::write(folder.join("seconds_per_source.txt"), format!("{best:e}\n"))?;
    println!("{count} vertices, {RADIUS} m: {:.1} µs a source on one thread", best * 1e6);
    Ok(())
}

/// A ring of cloth-like folds with edges of about eight millimetres: flat, bent and saddle-shaped places.
fn wavy_torus() -> Result<TriangleMesh, MeshError> {
    let (around, across) = (160_u32, 64_u32);
    let positions = (0..around * across)
        .map(|k| {
            let u = TAU * f64::from(k / across) / f64::from(around);
            let v = TAU * f64::from(k % across) / f64::from(across);
            let small = 0.07 + 0.012 * (9.0 * u + 2.0 * v).sin() * (3.0 * v + PI / 5.0).cos();
            let ring = 0.2 + small * v.cos();
            DVec3::new(ring * u.cos(), small * v.sin(), ring * u.sin())
        })
        .collect();
    let at = |row: u32, column: u32| row % around * across + column % across;
    let faces = (0..around)
        .flat_map(|row| {
            (0..across).flat_map(move |column| {
                let [a, b] = [at(row, column), at(row, column + 1)];
                let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
                [[a, b, c], [b, d, c]]
            })
        })
        .collect();
    TriangleMesh::new(positions, faces)
}
