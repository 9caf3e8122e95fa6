//! A glTF player in a few lines plays the file's bytes back; its bodies must be ours at every frame.

use glam::{DMat4, DQuat, DVec3, DVec4};
use serde_json::Value;

use super::{SkinnedGlbError, skinned_glb, write_skinned_glb};
use crate::artifacts::fixture::{largest_distance, rigged_sequence};
use crate::artifacts::rigged_sequence::FrameRate;

fn rate(frames_per_second: f64) -> FrameRate {
    FrameRate::new(frames_per_second).unwrap()
}

/// A glTF file taken apart by the specification alone.
pub(in crate::artifacts) struct Player {
    pub(in crate::artifacts) root: Value,
    binary: Vec<u8>,
}

impl Player {
    pub(in crate::artifacts) fn open(bytes: &[u8]) -> Self {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let json_length = word(12);
        assert_eq!((&bytes[16..20], json_length % 4), (&b"JSON"[..], 0));
        let root = serde_json::from_slice(&bytes[20..20 + json_length]).unwrap();
        let binary_header = 20 + json_length;
        assert_eq!(&bytes[binary_header + 4..binary_header + 8], b"BIN\0");
        let binary = bytes[binary_header + 8..].to_vec();
        assert_eq!(binary.len(), word(binary_header));
        Self { root, binary }
    }

    pub(in crate::artifacts) fn number(&self, value: &Value) -> usize {
        value.as_u64().unwrap() as usize
    }

    /// Elements of an accessor as rows of numbers.
    pub(in crate::artifacts) fn rows(&self, accessor: &Value) -> Vec<Vec<f64>> {
        let accessor = &self.root["accessors"][self.number(accessor)];
        let view = &self.root["bufferViews"][self.number(&accessor["bufferView"])];
        let start = self.number(&view["byteOffset"]);
        let data = &self.binary[start..start + self.number(&view["byteLength"])];
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            other => panic!("unknown type {other}"),
        };
        let numbers: Vec<f64> = match self.number(&accessor["componentType"]) {
            5121 => data.iter().map(|byte| f64::from(*byte)).collect(),
            5125 => {
                data.chunks_exact(4).map(|b| f64::from(u32::from_le_bytes(b.try_into().unwrap()))).collect()
            }
            5126 => {
                data.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap()))).collect()
            }
            other => panic!("unknown component type {other}"),
        };
        let rows: Vec<Vec<f64>> = numbers.chunks_exact(width).map(<[f64]>::to_vec).collect();
        assert_eq!(rows.len(), self.number(&accessor["count"]));
        rows
    }

    /// Global transforms of all nodes at a key frame of the animation.
    fn node_transforms(&self, frame: usize) -> Vec<DMat4> {
        let nodes = self.root["nodes"].as_array().unwrap();
        let triple = |value: &Value| -> DVec3 {
            let numbers: Vec<f64> = value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
            DVec3::from_slice(&numbers)
        };
        let mut translations: Vec<DVec3> =
            nodes.iter().map(|node| node.get("translation").map_or(DVec3::ZERO, triple)).collect();
        let mut rotations = vec![DQuat::IDENTITY; nodes.len()];
        let animation = &self.root["animations"][0];
        for channel in animation["channels"].as_array().unwrap() {
            let sampler = &animation["samplers"][self.number(&channel["sampler"])];
            assert_eq!(sampler["interpolation"], "LINEAR");
            let key = &self.rows(&sampler["output"])[frame];
            let node = self.number(&channel["target"]["node"]);
            match channel["target"]["path"].as_str().unwrap() {
                "translation" => translations[node] = DVec3::from_slice(key),
                "rotation" => rotations[node] = DQuat::from_slice(key),
                "weights" => {}
                other => panic!("unknown path {other}"),
            }
        }
        let mut global = vec![DMat4::IDENTITY; nodes.len()];
        let mut open: Vec<(usize, DMat4)> = self.root["scenes"][0]["nodes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|node| (self.number(node), DMat4::IDENTITY))
            .collect();
        while let Some((node, parent)) = open.pop() {
            global[node] = parent * DMat4::from_rotation_translation(rotations[node], translations[node]);
            if let Some(children) = nodes[node].get("children") {
                open.extend(
                    children.as_array().unwrap().iter().map(|child| (self.number(child), global[node])),
                );
            }
        }
        global
    }

    pub(in crate::artifacts) fn skinned(&self, frame: usize) -> Vec<DVec3> {
        let attributes = &self.root["meshes"][0]["primitives"][0]["attributes"];
        let (bones, weights) = (self.rows(&attributes["JOINTS_0"]), self.rows(&attributes["WEIGHTS_0"]));
        let positions: Vec<DVec3> =
            self.rows(&attributes["POSITION"]).iter().map(|row| DVec3::from_slice(row)).collect();
        self.skin(frame, &positions, &bones, &weights)
    }

    /// Positions moved by the joints of a frame.
    pub(in crate::artifacts) fn skin(
        &self,
        frame: usize,
        positions: &[DVec3],
        bones: &[Vec<f64>],
        weights: &[Vec<f64>],
    ) -> Vec<DVec3> {
        let global = self.node_transforms(frame);
        let skin = &self.root["skins"][0];
        let matrices: Vec<DMat4> = skin["joints"]
            .as_array()
            .unwrap()
            .iter()
            .zip(self.rows(&skin["inverseBindMatrices"]))
            .map(|(node, inverse_bind)| {
                global[self.number(node)] * DMat4::from_cols_array(&inverse_bind.try_into().unwrap())
            })
            .collect();
        positions
            .iter()
            .zip(bones.iter().zip(weights))
            .map(|(position, (bones, weights))| {
                let position = position.extend(1.0);
                let sum: DVec4 = bones
                    .iter()
                    .zip(weights)
                    .map(|(bone, weight)| matrices[*bone as usize] * position * *weight)
                    .sum();
                sum.truncate()
            })
            .collect()
    }
}

#[test]
fn a_player_sees_our_bodies_at_every_frame() {
    let fit = rigged_sequence(20);
    let player = Player::open(&skinned_glb(&fit, rate(25.0)).unwrap());
    for frame in 0..20 {
        let distance = largest_distance(&player.skinned(frame), &fit.posed_vertices(frame));
        assert!(distance < 1e-5, "frame {frame}: f32 file is {distance} m away");
    }
}

#[test]
fn the_description_is_what_gltf_demands() {
    let fit = rigged_sequence(4);
    let player = Player::open(&skinned_glb(&fit, rate(50.0)).unwrap());
    let root = &player.root;
    assert_eq!(root["asset"]["version"], "2.0");
    assert_eq!(root["nodes"].as_array().unwrap().len(), 16);
    assert_eq!(root["skins"][0]["joints"].as_array().unwrap().len(), 15);
    assert_eq!(root["nodes"][0]["name"], "pelvis");
    assert_eq!(root["nodes"][0]["children"], serde_json::json!([1, 4, 7]));
    assert_eq!(root["extras"]["failed_frames"][0]["frame"], 1);
    let sampler = &root["animations"][0]["samplers"][3];
    let times: Vec<f64> = player.rows(&sampler["input"]).concat();
    assert!(times.iter().zip([0.0, 0.02, 0.04, 0.06]).all(|(a, b)| (a - b).abs() < 1e-8));
    let bounds = &root["accessors"][player.number(&sampler["input"])];
    assert_eq!(bounds["min"][0].as_f64(), Some(0.0));
    let attributes = &root["meshes"][0]["primitives"][0]["attributes"];
    for (weights, bones) in
        player.rows(&attributes["WEIGHTS_0"]).iter().zip(player.rows(&attributes["JOINTS_0"]))
    {
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-6);
        assert!(weights.iter().zip(&bones).all(|(weight, bone)| *weight > 0.0 || *bone == 0.0));
    }
    for normal in player.rows(&attributes["NORMAL"]) {
        assert!((DVec3::from_slice(&normal).length() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn rotations_take_the_short_way_between_frames() {
    let fit = rigged_sequence(40);
    let player = Player::open(&skinned_glb(&fit, rate(25.0)).unwrap());
    for sampler in &player.root["animations"][0]["samplers"].as_array().unwrap()[1..] {
        let keys = player.rows(&sampler["output"]);
        for pair in keys.windows(2) {
            assert!(DQuat::from_slice(&pair[0]).dot(DQuat::from_slice(&pair[1])) > 0.0);
        }
    }
}

#[test]
fn geometry_reads_the_rest_body_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("body.glb");
    let fit = rigged_sequence(0);
    write_skinned_glb(&path, &fit, rate(30.0)).unwrap();
    let mesh = habitus_geometry::io::read_mesh(&path).unwrap();
    assert_eq!(mesh.faces().len(), fit.rig.faces.len());
    assert!(largest_distance(mesh.positions(), &fit.sequence.rest_vertices) < 1e-6);
}

#[test]
fn positions_beyond_single_precision_are_refused() {
    let mut fit = rigged_sequence(2);
    fit.sequence.rest_vertices[0].x = 1e300;
    assert!(matches!(skinned_glb(&fit, rate(25.0)), Err(SkinnedGlbError::Content(_))));
}
