//! How far a skirt opens between two legs in poses that it was not captured in: the offsets of the first frame of a clothing
//! layer, posed over all frames.
//!
//! ```text
//! cargo run --release -p habitus --example 6_clothing_seam -- [--meshes FOLDER] denim/4_extract_clothing/layer.npz ...
//! ```
//!
//! An edge opens by how much longer it is than in the first frame; of each edge the frame counts in which it opens most. With
//! `--meshes` the frame of each layer in which the middle opens most is written, dressed.
#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus::artifacts::clothing_layer::{ClothingLayer, pose_offsets, read_layer};
use habitus::geometry::io::write_mesh;
use habitus::geometry::{MeshError, Topology, TriangleMesh};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut folder = None;
    if arguments.first().is_some_and(|first| first == "--meshes") && arguments.len() > 1 {
        folder = Some(PathBuf::from(arguments.remove(1)));
        arguments.remove(0);
    }
    if arguments.is_empty() {
        return Err("give one or more files layer.npz".into());
    }
    println!(
        "| layer | edges across the middle | mm long | open mm, largest | mean | any edge, largest | mean |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for (number, path) in arguments.iter().enumerate() {
        let layer = read_layer(Path::new(path))?;
        let topology = Topology::new(layer.clothing_vertex_count(), &layer.clothing_faces);
        let posed = first_offsets_over_all_frames(&layer);
        let middle = edges_across_the_middle(&layer, topology.edges());
        let lengths: Vec<f64> = middle.iter().map(|edge| 1000.0 * length(edge, &posed[0])).collect();
        let (across, all) = (openings_mm(&middle, &posed), openings_mm(topology.edges(), &posed));
        println!(
            "| {path} | {} | {:.0} | {:.0} | {:.1} | {:.0} | {:.1} |",
            middle.len(),
            mean(&lengths),
            largest(&across),
            mean(&across),
            largest(&all),
            mean(&all),
        );
        if let Some(folder) = &folder {
            let frame = widest_frame(&middle, &posed);
            write_mesh(&folder.join(format!("{number}.ply")), &dressed(&layer, frame, &posed[frame])?)?;
        }
    }
    Ok(())
}

/// The frame in which the edges are longest in the mean.
fn widest_frame(edges: &[[u32; 2]], posed: &[Vec<DVec3>]) -> usize {
    let width = |frame: &usize| edges.iter().map(|edge| length(edge, &posed[*frame])).sum::<f64>();
    (0..posed.len()).max_by(|a, b| width(a).total_cmp(&width(b))).unwrap_or(0)
}

/// Body and clothing of a frame in one mesh, metres.
fn dressed(layer: &ClothingLayer, frame: usize, clothing: &[DVec3]) -> Result<TriangleMesh, MeshError> {
    let mut positions = Vec::new();
    layer.rig.skin.apply_into(&layer.rest_vertices, &layer.posed_skeleton(frame), &mut positions);
    let first = positions.len() as u32;
    positions.extend(clothing);
    let faces = layer.clothing_faces.iter().map(|face| face.map(|vertex| vertex + first));
    TriangleMesh::new(positions, layer.rig.faces.iter().copied().chain(faces).collect())
}

/// The clothing of each frame as if nothing but the bones had moved since the first one, metres.
fn first_offsets_over_all_frames(layer: &ClothingLayer) -> Vec<Vec<DVec3>> {
    let skin = layer.association.blended_skin(&layer.rig);
    let anchors = layer.association.anchors(&layer.rest_vertices);
    let stretch = layer.association.smallest_stretch;
    (0..layer.frames.len())
        .map(|frame| {
            let carriers = skin.carriers(&anchors, &layer.posed_skeleton(frame), stretch);
            pose_offsets(&carriers, layer.frame_offsets(0))
        })
        .collect()
}

/// Edges below both hips whose ends lie on different sides of the body's middle in the first frame, as its pelvis sees it.
fn edges_across_the_middle(layer: &ClothingLayer, edges: &[[u32; 2]]) -> Vec<[u32; 2]> {
    let bones = layer.rig.skeleton.bones();
    let hips = bones.iter().zip(&layer.rest_joints).filter(|(bone, _)| bone.parent == Some(0));
    let lowest_hip = hips.map(|(_, joint)| joint.y).fold(f64::INFINITY, f64::min);
    let middle = layer.rest_joints[0].x;
    let posed = layer.posed_skeleton(0);
    let unturned = posed.rotations[0].transpose();
    let seen: Vec<DVec3> =
        layer.clothing_vertices(0).iter().map(|place| unturned * (*place - posed.translations[0])).collect();
    let is_across = |[a, b]: &[u32; 2]| {
        let (a, b) = (seen[*a as usize], seen[*b as usize]);
        (a.x < middle) != (b.x < middle) && a.y.max(b.y) < lowest_hip
    };
    edges.iter().copied().filter(is_across).collect()
}

fn openings_mm(edges: &[[u32; 2]], posed: &[Vec<DVec3>]) -> Vec<f64> {
    let opening = |edge: &[u32; 2]| {
        let longest = posed.iter().map(|frame| length(edge, frame)).fold(0.0, f64::max);
        1000.0 * (longest - length(edge, &posed[0]))
    };
    edges.iter().map(opening).collect()
}

fn length([a, b]: &[u32; 2], positions: &[DVec3]) -> f64 {
    positions[*a as usize].distance(positions[*b as usize])
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
