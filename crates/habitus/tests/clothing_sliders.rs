//! Fabrics and sizes from simulated sequences: sliders do what their names say, and what is left out is not learnt from.
#![allow(clippy::expect_used, reason = "test helpers stand outside test functions")]

use std::path::Path;

use habitus::artifacts::clothing_controls::ParameterTable;
use habitus::artifacts::clothing_layer::ClothingLayer;
use habitus::artifacts::rigged_sequence::FrameRate;
use habitus::body::BodyModel;
use habitus::evaluation::clothing_metrics::{Course, LeftOutKind};
use habitus::optimize::Silent;
use habitus::pipeline::{CaptureOrigin, ClothingEvaluation, EvaluatedClothing, read_stored_fit};
use habitus::stages::extract_clothing::{DressedSurfaces, ExtractClothingConfig, extract_clothing};
use habitus::stages::learn_clothing::LearnClothingConfig;
use habitus::stages::learn_clothing::config::SettleConfig;
use habitus_synthetic::clothing_data::{
    ClothingSequence, ClothingSet, PARAMETERS_FILE, SetSize, plan, write_clothing_data,
};

/// A coarse and short version of some sequences of a set, and what an evaluation says of them.
fn evaluated(set: ClothingSet, chosen: &[usize]) -> EvaluatedClothing {
    let model = BodyModel::default_space().expect("is embedded");
    let all = plan(&model, set, SetSize::Small, 1, &[]).expect("can be planned");
    let mut sequences: Vec<ClothingSequence> = chosen.iter().map(|index| all[*index].clone()).collect();
    for settings in sequences.iter_mut().map(|sequence| &mut sequence.settings) {
        settings.frame_count = 5;
        settings.settle_seconds = 0.4;
        settings.garment.cloth_edge_mm = 45.0;
        settings.cloth.substeps_per_second = 600.0;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let made = write_clothing_data(&model, &sequences, folder.path(), &|| ()).expect("can be made");
    assert!(made.iter().all(|sequence| sequence.error.is_none()), "{made:?}");
    let table = ParameterTable::read(&folder.path().join(PARAMETERS_FILE)).expect("is a table");
    let names: Vec<String> = sequences.iter().map(|sequence| sequence.name.clone()).collect();
    let mut layers: Vec<ClothingLayer> = Vec::new();
    for name in &names {
        let layer = layer_of(&folder.path().join(name), layers.first());
        layers.push(layer);
    }
    let config = LearnClothingConfig {
        settle: SettleConfig { rounds: 0, ..SettleConfig::default() },
        ..LearnClothingConfig::default()
    };
    let evaluation = ClothingEvaluation { names, layers, parameters: Some(&table), config: &config };
    evaluation.run(&mut Silent, &|| 0.0).expect("can be evaluated")
}

fn layer_of(run: &Path, like: Option<&ClothingLayer>) -> ClothingLayer {
    let fit = read_stored_fit(run).expect("is a fit");
    let frames = CaptureOrigin::read(run).expect("is there").frames().expect("are there");
    let rate = FrameRate::new(30.0).expect("is positive");
    let association = like.map(|layer| &layer.association);
    let surfaces = DressedSurfaces::Captured(&frames);
    let config = ExtractClothingConfig::default();
    extract_clothing(&fit, surfaces, association, rate, &config, &mut Silent).expect("can be extracted").layer
}

#[test]
fn a_larger_size_makes_a_larger_hem_all_the_way() {
    let found = evaluated(ClothingSet::Sizes, &[0, 2, 4, 5, 7]);
    let metrics = found.metrics;
    assert_eq!(metrics.left_out_kind, LeftOutKind::Size);
    for (control, bone) in [("t_shirt_width", "pelvis"), ("shorts_width", "thigh")] {
        let response = &metrics.hem_response[control];
        let hems: Vec<&String> = response.lengths_mm.keys().filter(|name| name.contains(bone)).collect();
        assert!(!hems.is_empty(), "{control}: {:?}", response.lengths_mm.keys());
        let grown = hems.iter().filter(|hem| response.grows(hem)).count();
        assert!(grown > 0, "{control}: {response:?}");
        let most = response.length_change().expect("has borders");
        assert!(most.change_mm > 30.0 && most.course == Course::Grows, "{control}: {most:?} of {response:?}");
    }
    // Longer shorts have a hem farther down. It need not be larger: thighs are thinner there.
    let response = &metrics.hem_response["shorts_length"];
    for (hem, heights) in response.heights_mm.iter().filter(|(name, _)| name.contains("thigh")) {
        assert!(heights.is_sorted_by(|a, b| a > b), "the hem of {hem} goes up: {heights:?}");
    }
    let most = response.height_change().expect("has borders");
    assert!(most.border.contains("thigh") && most.change_mm < -30.0, "{most:?} of {response:?}");
}

#[test]
fn every_material_is_left_out_once_and_compared_with_all_baselines() {
    let found = evaluated(ClothingSet::Fabrics, &[0, 2, 4, 5]);
    assert_eq!(found.metrics.left_out_kind, LeftOutKind::Material);
    assert_eq!(found.metrics.left_out.len(), 4);
    assert_eq!(found.maps.len(), 4);
    for (name, errors) in &found.metrics.left_out {
        let methods: Vec<&str> = errors.keys().map(String::as_str).collect();
        assert_eq!(methods, ["components", "default", "mean", "nearest_neighbour", "paper2018", "ridge"]);
        // No method is better than the components that it speaks in, which are the best by squares and nearly so by means.
        let floor = errors["components"];
        assert!(floor > 0.0 && errors.values().all(|error| *error > 0.9 * floor), "{name}: {errors:?}");
    }
    for map in &found.maps {
        let methods: Vec<&str> = map.errors_mm.iter().map(|(method, _)| method.as_str()).collect();
        assert_eq!(methods, ["default", "nearest_neighbour"]);
        let mean = map.errors_mm[0].1.iter().sum::<f64>() / map.vertices.len() as f64;
        let listed = found.metrics.left_out[&map.sequence]["default"];
        assert!((mean - listed).abs() < 1e-6, "{}: {mean} of {listed}", map.sequence);
    }
}
