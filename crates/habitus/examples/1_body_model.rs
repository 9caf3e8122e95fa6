//! A body of the default space: its build, its pose, its measures.
//!
//! `cargo run -p habitus --example 1_body_model [-- body.ply]`
#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use habitus::body::BodyModel;
use habitus::geometry::TriangleMesh;
use habitus::geometry::io::write_mesh;
use habitus::stages::measure::{Definitions, measure};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // The default space ships inside the library; others load with `BodyModel::load`.
    let model = BodyModel::default_space()?;
    println!(
        "{}: {} vertices, {} components",
        model.metadata().name,
        model.vertex_count(),
        model.component_count()
    );

    // Build: coefficients are in standard deviations of the population, inside ±3; the rest are zero.
    let identity = [1.0, -0.5, 0.8];
    let rest_vertices = model.rest_vertices(&identity);
    let definitions = Definitions::standard()?;
    for measurement in measure(&model, &rest_vertices, &definitions)?.iter().take(4) {
        println!("{}: {:.3} m", measurement.name, measurement.value);
    }

    // Pose: 30 numbers in metres and radians. Joints lie where this body has them.
    let skeleton = model.skeleton();
    let mut pose = skeleton.rest_pose();
    for (index, axis) in skeleton.axes().iter().enumerate().filter(|(_, axis)| axis.name.contains("elbow")) {
        // The first six numbers move the root.
        pose.parameters_mut()[habitus::body::ROOT_LENGTH + index] = axis.limits[1].min(1.2);
    }
    let posed = skeleton.pose(&model.joints(&rest_vertices), pose.parameters());
    let vertices = model.pose_vertices(&rest_vertices, &posed);
    let hand = skeleton.bones().iter().position(|bone| bone.name == "left_hand").ok_or("no left hand")?;
    println!("with bent elbows the left wrist is at {:.3}", posed.joints[hand]);

    if let Some(path) = std::env::args().nth(1) {
        write_mesh(path.as_ref(), &TriangleMesh::new(vertices, model.faces().to_vec())?)?;
        println!("wrote {path}");
    }
    Ok(())
}
