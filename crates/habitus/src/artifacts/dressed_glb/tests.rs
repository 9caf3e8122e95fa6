//! A player that knows glTF alone must see the clothing that was synthesized.

use glam::DVec3;
use nalgebra::DMatrix;

use super::dressed_glb;
use crate::artifacts::clothing_layer::{ClothingLayer, pose_offsets};
use crate::artifacts::fixture::{largest_distance, moving_layer, rigged_sequence};
use crate::artifacts::skinned_glb::tests::Player;
use crate::artifacts::synthesized_sequence::SynthesizedSequence;
use crate::body::BlendedSkin;
use crate::statistics::{LinearSpace, LinearSpaceSettings, SampleMatrix};

#[test]
fn morph_targets_and_joints_give_the_synthesized_clothing() {
    a_player_sees_what_was_synthesized(&moving_layer(12, 0.0));
}

#[test]
fn a_player_uses_the_bone_weights_that_were_spread() {
    let mut layer = moving_layer(12, 0.0);
    let bone_count = layer.rig.skeleton.bones().len();
    let halves = layer.association.blended_skin(&layer.rig).table(bone_count);
    // Each vertex shares its bones with the one half the body away.
    let count = layer.clothing_vertex_count();
    let mut table = vec![0.0; halves.len()];
    for (place, weight) in table.iter_mut().enumerate() {
        *weight = 0.5 * (halves[place] + halves[(place + count / 2 * bone_count) % halves.len()]);
    }
    layer.association.spread_skin = Some(BlendedSkin::of_table(bone_count, &table));
    a_player_sees_what_was_synthesized(&layer);
}

fn a_player_sees_what_was_synthesized(layer: &ClothingLayer) {
    let mut samples = SampleMatrix::new(3 * layer.clothing_vertex_count());
    for frame in 0..12 {
        samples.push(&layer.frame_offsets(frame).iter().copied().map(f64::from).collect::<Vec<_>>());
    }
    let space = LinearSpace::learn(&samples, &LinearSpaceSettings::with_components(3)).unwrap();
    let coefficients =
        DMatrix::from_fn(12, space.component_count(), |frame, k| 0.3 * (frame as f64 + k as f64).sin());
    let mut body = rigged_sequence(12);
    for (frame, of_layer) in body.sequence.frames.iter_mut().zip(&layer.frames) {
        frame.pose.clone_from(&of_layer.pose);
    }
    let skin = layer.association.blended_skin(&layer.rig);
    let anchors = layer.association.anchors(&layer.rest_vertices);
    let clothing: Vec<Vec<DVec3>> = (0..12)
        .map(|frame| {
            let row: Vec<f64> = coefficients.row(frame).iter().copied().collect();
            let offsets: Vec<f32> = space.instance(&row).iter().map(|value| *value as f32).collect();
            let stretch = layer.association.smallest_stretch;
            pose_offsets(&skin.carriers(&anchors, &layer.posed_skeleton(frame), stretch), &offsets)
        })
        .collect();
    let sequence = SynthesizedSequence {
        body,
        frame_rate: layer.frame_rate,
        clothing_faces: layer.clothing_faces.clone(),
        clothing,
        coefficients,
        before: Vec::new(),
        after: Vec::new(),
    };
    let player = Player::open(&dressed_glb(&sequence, layer, &space).unwrap());
    let primitive = &player.root["meshes"][1]["primitives"][0];
    let attributes = &primitive["attributes"];
    let both = |name: &str| -> Vec<Vec<f64>> {
        let sets = ["0", "1"].map(|set| player.rows(&attributes[format!("{name}_{set}")]));
        sets[0].iter().zip(&sets[1]).map(|(a, b)| [a.clone(), b.clone()].concat()).collect()
    };
    let (bones, weights) = (both("JOINTS"), both("WEIGHTS"));
    let targets: Vec<Vec<Vec<f64>>> = primitive["targets"]
        .as_array()
        .unwrap()
        .iter()
        .map(|target| player.rows(&target["POSITION"]))
        .collect();
    let animation = &player.root["animations"][0];
    let channel = animation["channels"].as_array().unwrap().last().unwrap();
    assert_eq!(channel["target"]["path"], "weights");
    assert_eq!(player.root["nodes"][player.number(&channel["target"]["node"])]["name"], "clothing");
    let keys = player.rows(&animation["samplers"][player.number(&channel["sampler"])]["output"]).concat();
    for frame in 0..12 {
        let amounts = &keys[frame * targets.len()..(frame + 1) * targets.len()];
        let morphed: Vec<DVec3> = player
            .rows(&attributes["POSITION"])
            .iter()
            .enumerate()
            .map(|(vertex, base)| {
                let moved =
                    targets.iter().zip(amounts).map(|(t, amount)| DVec3::from_slice(&t[vertex]) * *amount);
                DVec3::from_slice(base) + moved.sum::<DVec3>()
            })
            .collect();
        let seen = player.skin(frame, &morphed, &bones, &weights);
        let distance = largest_distance(&seen, &sequence.clothing[frame]);
        assert!(distance < 1e-5, "frame {frame}: f32 file is {distance} m away");
    }
}
