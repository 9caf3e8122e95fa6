//! Destroys the connectivity of a captured sequence: each frame becomes a mesh of its own on the same surface.
//!
//! `cargo run --example remesh_sequence -- <captures> <output folder> [spacing in metres] [step]`

#![allow(clippy::print_stdout, reason = "an example talks to the one who runs it")]

use std::path::PathBuf;

use habitus::artifacts::frames::{FrameFolder, FrameSource};
use habitus::geometry::Surface;
use habitus::geometry::io::write_mesh;
use habitus_synthetic::remesh::remeshed;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, output, ..] = arguments.as_slice() else {
        return Err("name the captures and a folder".into());
    };
    let spacing: f64 = arguments.get(2).map_or(Ok(0.014), |text| text.parse())?;
    let step: usize = arguments.get(3).map_or(Ok(1), |text| text.parse())?;
    let output = PathBuf::from(output);
    std::fs::create_dir_all(&output)?;
    let frames = FrameFolder::open(&PathBuf::from(input))?.select(0, None, step);
    for frame in 0..frames.len() {
        let Surface::Mesh(mesh) = frames.surface(frame)? else { return Err("a cloud has no surface".into()) };
        let other = remeshed(&mesh, spacing, frame as u64).ok_or("nothing is left on the grid")?;
        println!("{}: {} vertices", frames.name(frame), other.positions().len());
        let name = PathBuf::from(frames.name(frame)).with_extension("ply");
        write_mesh(&output.join(name), &other)?;
    }
    Ok(())
}
