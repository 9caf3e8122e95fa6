//! A body model of one's own: made-up registrations (people in slightly different postures) to a model file.
//!
//! `cargo run --release --example 3_learn_shape -- FOLDER [COUNT]` writes the registrations too.
#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::error::Error;
use std::path::PathBuf;

use habitus::body::{BodyModel, SpaceOrigin};
use habitus::geometry::TriangleMesh;
use habitus::geometry::io::write_mesh;
use habitus::optimize::Silent;
use habitus::stages::learn_shape::{LearnShapeConfig, Registration, learn_shape};
use habitus::statistics::RandomStream;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).map(PathBuf::from);
    let count = std::env::args().nth(2).map_or(Ok(40), |count| count.parse())?;
    let base = BodyModel::default_space()?;
    let registrations: Vec<Registration> = (0..count).map(|index| person(&base, index)).collect();
    if let Some(folder) = folder {
        std::fs::create_dir_all(&folder)?;
        for registration in &registrations {
            let mesh = TriangleMesh::new(registration.vertices.clone(), base.faces().to_vec())?;
            write_mesh(&folder.join(format!("{}.ply", registration.name)), &mesh)?;
        }
    }
    let origin = SpaceOrigin { name: "mine".into(), license: "CC0-1.0".into(), provenance: ().into() };
    let learnt = learn_shape(&registrations, &base, &LearnShapeConfig::default(), origin, &mut Silent)?;
    let variance: f64 = learnt.space.standard_deviations().iter().take(10).map(|d| d * d).sum();
    println!("{} components of {count} people", learnt.model.component_count());
    println!("the first ten carry {:.1} %", 100.0 * variance / learnt.space.total_variance());
    Ok(())
}

/// A person of the default space who does not stand quite still.
fn person(base: &BodyModel, index: usize) -> Registration {
    let mut stream = RandomStream::named(3, &format!("person {index}"));
    let identity: Vec<f64> = (0..80).map(|_| stream.normal().clamp(-2.5, 2.5)).collect();
    let mut pose = base.skeleton().rest_pose();
    let angles = &mut pose.parameters_mut()[6..];
    for (angle, axis) in angles.iter_mut().zip(base.skeleton().axes()) {
        *angle = (0.08 * stream.normal()).clamp(axis.limits[0], axis.limits[1]);
    }
    let joints = base.surface().rest_joints(&identity);
    let posed = base.skeleton().pose(&joints, pose.parameters());
    let vertices = base.pose_vertices(&base.rest_vertices(&identity), &posed);
    Registration { name: format!("person_{index:04}"), vertices }
}
