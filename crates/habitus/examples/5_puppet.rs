//! The part-based puppet alone on a folder of captures, and how far it is from the truth if the folder has one.
//!
//! `cargo run --release --example 5_puppet -- FOLDER [FIRST_PARTICLES [LATER_PARTICLES [FRAMES [SEED [points.ply]]]]]`
#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

use habitus::artifacts::frames::FrameFolder;
use habitus::body::BodyModel;
use habitus::geometry::{SurfaceIndex, TriangleMesh, io};
use habitus::optimize::Silent;
use habitus::stages::fit_sequence::{FitSequenceConfig, follow_with_puppet};
use habitus_synthetic::truth::DressedTruth;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("name a folder of captures")?);
    let mut number = |usual: usize| arguments.next().map_or(Ok(usual), |text| text.parse());
    let mut config = FitSequenceConfig::default();
    config.puppet.first_particles = number(config.puppet.first_particles)?;
    config.puppet.later_particles = number(config.puppet.later_particles)?;
    let frames = number(1)?;
    config.seed = number(1)? as u64;
    let cloud = arguments.next();

    let model = BodyModel::default_space()?;
    let source = FrameFolder::open(&folder)?.select(0, Some(frames.max(1) - 1), 1);
    let clock = Instant::now();
    let found = follow_with_puppet(&source, &model, &config, &mut Silent)?;
    println!("{} frames in {:.2} s", found.len(), clock.elapsed().as_secs_f64());

    let truth = DressedTruth::read(&folder).ok();
    for (index, frame) in found.iter().enumerate() {
        print!("{}: energy {:.1}, shape {:.2} deviations", frame.name, frame.energy, frame.shape_deviation);
        if let Some(truth) = &truth {
            let errors: Vec<f64> = frame
                .landmarks
                .iter()
                .zip(&truth.landmarks[index])
                .map(|(found, true_position)| found.position.distance(*true_position) * 1000.0)
                .collect();
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            let worst = errors.iter().copied().fold(0.0, f64::max);
            let body = TriangleMesh::new(truth.posed_vertices[index].clone(), truth.faces.clone())?;
            let body = SurfaceIndex::of_mesh(&body);
            let outside: f64 = frame.points.iter().map(|point| body.signed_distance(*point)).sum();
            let outside = outside / frame.points.len() as f64 * 1000.0;
            print!(", landmarks {mean:.0} mm (worst {worst:.0}), {outside:+.1} mm outside the true body");
        }
        println!();
    }
    if let (Some(path), Some(first)) = (cloud, found.first()) {
        let cloud = habitus::geometry::PointCloud::new(first.points.clone(), None)?;
        println!("{} points of the first frame; landmarks:", cloud.positions().len());
        for (name, landmark) in model.metadata().landmarks.iter().zip(&first.landmarks) {
            println!("  {name}: {:.3}, confidence {:.2}", landmark.position, landmark.confidence);
        }
        let spheres = TriangleMesh::new(
            first.points.iter().flat_map(|p| tetrahedron(*p)).collect(),
            tetrahedra(first.points.len()),
        )?;
        io::write_mesh(path.as_ref(), &spheres)?;
    }
    Ok(())
}

/// A centimetre around a point, so that any viewer shows it.
fn tetrahedron(center: glam::DVec3) -> [glam::DVec3; 4] {
    [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
        .map(|corner| center + glam::DVec3::from(corner) * 0.006)
}

fn tetrahedra(count: usize) -> Vec<[u32; 3]> {
    (0..count as u32)
        .flat_map(|k| [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]].map(|face| face.map(|v| 4 * k + v)))
        .collect()
}
