//! A clothing model of a person in a made-up tunic, learnt from three sequences of different fabric and size.

use std::path::Path;

use habitus::artifacts::clothing_controls::ParameterTable;
use habitus::artifacts::clothing_layer::{
    AlignmentQuality, AssociationOrigin, ClothingAssociation, ClothingFrame, ClothingLayer,
};
use habitus::artifacts::clothing_model::write_clothing_model;
use habitus::artifacts::fabric::find_fabric;
use habitus::artifacts::fitted_sequence::InputFrame;
use habitus::artifacts::rigged_sequence::{FrameRate, Rig};
use habitus::body::BodyModel;
use habitus::geometry::glam::{DMat3, DVec3};
use habitus::geometry::vertex_normals;
use habitus::optimize::Silent;
use habitus::stages::learn_clothing::config::SettleConfig;
use habitus::stages::learn_clothing::{LearnClothingConfig, learn_clothing};

/// Fabric of each sequence, and how wide the tunic is: the narrow one reaches into the body.
pub const SEQUENCES: [(&str, f64); 3] = [("denim", -0.05), ("silk-satin", 0.02), ("jersey", 0.045)];
const FRAMES: usize = 16;

/// Learns the model and writes it.
pub fn write_dressed_model(path: &Path) {
    let model = BodyModel::default_space().expect("is embedded");
    let names: Vec<String> = SEQUENCES.iter().map(|(name, _)| (*name).to_string()).collect();
    let layers = SEQUENCES.iter().map(|(_, width)| tunic(&model, *width)).collect();
    let fabric_columns = (0..39).map(|k| format!("fabric_{k:02}"));
    let row = |(name, width): &(&str, f64)| {
        let mut numbers = find_fabric(name).expect("is ours").table().to_vec();
        numbers.push(1.0 + width * 10.0);
        ((*name).to_string(), numbers)
    };
    let table = ParameterTable {
        columns: fabric_columns.chain(["tunic_width".to_string()]).collect(),
        rows: SEQUENCES.iter().map(row).collect(),
    };
    let config = LearnClothingConfig {
        components_of_several: 8,
        settle: SettleConfig { rounds: 0, ..SettleConfig::default() },
        ..LearnClothingConfig::default()
    };
    let model = learn_clothing(names, layers, Some(&table), &config, &mut Silent).expect("learns");
    write_clothing_model(path, &model).expect("writes");
}

/// The trunk's skin, `width` metres farther out, on a person who waves and turns.
fn tunic(model: &BodyModel, width: f64) -> ClothingLayer {
    let identity = vec![0.4, -0.5, 0.3, 0.2];
    let body = model.rest_vertices(&identity);
    let is_covered = |place: DVec3| (0.55..1.4).contains(&place.y) && place.x.abs() < 0.25;
    let covered: Vec<u32> =
        (0..body.len() as u32).filter(|vertex| is_covered(body[*vertex as usize])).collect();
    let place_of = |vertex: u32| covered.binary_search(&vertex).ok().map(|place| place as u32);
    let clothing_faces = model
        .faces()
        .iter()
        .filter_map(|[a, b, c]| Some([place_of(*a)?, place_of(*b)?, place_of(*c)?]))
        .collect();
    let normals = vertex_normals(&body, model.faces());
    let pose_length = model.skeleton().pose_length();
    let mut frames = Vec::new();
    let mut offsets = Vec::new();
    for frame in 0..FRAMES {
        let time = frame as f64 * 0.4;
        let mut pose: Vec<f64> = (0..pose_length).map(|k| 0.15 * (time + 1.3 * k as f64).sin()).collect();
        pose[..6].copy_from_slice(&[0.02 * time, 0.0, 0.0, 0.0, 0.1 * time, 0.0]);
        let flutter = 0.01 * (time * 1.3).sin();
        offsets.extend(covered.iter().flat_map(|vertex| {
            let hang = (1.4 - body[*vertex as usize].y) * 0.5;
            (normals[*vertex as usize] * (width + (width.max(0.0) + flutter) * hang)).as_vec3().to_array()
        }));
        frames.push(ClothingFrame {
            name: format!("frame_{frame:04}"),
            capture_index: frame,
            pose,
            codes: Vec::new(),
            quality: AlignmentQuality::default(),
        });
    }
    ClothingLayer {
        input_frame: InputFrame {
            metres_per_unit: 1.0,
            internal_from_input: DMat3::IDENTITY,
            report: Vec::new(),
        },
        rig: Rig::of(model),
        rest_joints: model.joints(&body),
        identity,
        association: ClothingAssociation {
            body_vertices_per_clothing_vertex: 1,
            weights: vec![1.0; covered.len()],
            origins: vec![AssociationOrigin::Diffused; covered.len()],
            body_vertices: covered,
            smallest_stretch: 0.2,
            spread_skin: None,
        },
        rest_vertices: body,
        clothing_faces,
        frame_rate: FrameRate::new(30.0).expect("is positive"),
        frames,
        offsets,
    }
}
