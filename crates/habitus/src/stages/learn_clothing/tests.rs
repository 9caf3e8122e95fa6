use habitus_optimize::Silent;
use nalgebra::DMatrix;

use super::config::SettleConfig;
use super::*;
use crate::artifacts::clothing_model::{read_clothing_model, write_clothing_model};
use crate::artifacts::fixture::{largest_distance, moving_layer};

/// Few components and rows of the little figure; its poses are the true ones.
fn config() -> LearnClothingConfig {
    LearnClothingConfig {
        components: 6,
        components_of_several: 6,
        settle: SettleConfig { rounds: 0, ..SettleConfig::default() },
        split: ClothingSplit::Block,
        ..LearnClothingConfig::default()
    }
}

fn learn(config: &LearnClothingConfig) -> ClothingModel {
    learn_clothing(vec!["walk".into()], vec![moving_layer(80, 0.0)], None, config, &mut Silent).unwrap()
}

#[test]
fn a_layer_that_follows_a_joint_is_predicted_for_unseen_frames() {
    let layer = moving_layer(80, 0.0);
    let prepared = PreparedLayers::new(vec!["walk".into()], vec![layer], None, &config()).unwrap();
    let (train, test) = prepared.split(&config()).unwrap();
    for recipe in [ClothingRecipe::Default, ClothingRecipe::Paper2018] {
        let config = LearnClothingConfig { recipe, ..config() };
        let learnt = learn_rows(&prepared, &train, &train, &config).unwrap();
        let error = regression_error(&prepared, &learnt, &test, recipe);
        let features = prepared.features(recipe.feature_set());
        let amounts = prepared.amounts(&learnt.space, &train);
        let mean = Baseline::Mean
            .predict(&features.select_rows(&train), &amounts, &features.select_rows(&test))
            .unwrap();
        let of_mean = prepared.error_of_amounts(&learnt.space, &test, &mean);
        assert!(error < 0.5 * of_mean, "{recipe:?}: {error} mm, the mean layer {of_mean} mm");
    }
}

#[test]
fn a_model_survives_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.npz");
    for recipe in [ClothingRecipe::Default, ClothingRecipe::Paper2018] {
        let model = learn(&LearnClothingConfig { recipe, ..config() });
        write_clothing_model(&path, &model).unwrap();
        let read = read_clothing_model(&path).unwrap();
        assert_eq!(
            (&read.record, &read.controls, read.feature_set),
            (&model.record, &model.controls, model.feature_set)
        );
        assert_eq!(read.motions, model.motions);
        let layer = moving_layer(10, 0.0);
        let poses: Vec<&[f64]> = layer.frames.iter().map(|frame| frame.pose.as_slice()).collect();
        let times: Vec<f64> = (0..10).map(|frame| layer.time_of(frame)).collect();
        let difference = model.coefficients(&poses, &times, &[]) - read.coefficients(&poses, &times, &[]);
        assert!(difference.amax() < 1e-9, "{recipe:?}");
    }
}

#[test]
fn learning_does_not_depend_on_the_number_of_threads() {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(|| learn(&config()));
    assert_eq!(one, learn(&config()));
}

#[test]
fn squared_errors_of_amounts_are_those_of_the_vertices() {
    let prepared =
        PreparedLayers::new(vec!["walk".into()], vec![moving_layer(30, 0.0)], None, &config()).unwrap();
    let rows: Vec<usize> = (0..30).collect();
    let space = prepared.space(&rows, 6).unwrap();
    let amounts = prepared.amounts(&space, &rows);
    let mut wrong = amounts.clone();
    wrong.iter_mut().enumerate().for_each(|(k, value)| *value += (k as f64).sin());
    let offsets = |amounts: &DMatrix<f64>| prepared.offsets_of_amounts(&space, amounts);
    for (row, (a, b)) in offsets(&amounts).iter().zip(offsets(&wrong)).enumerate() {
        let squares: f64 = a.iter().zip(&b).map(|(a, b)| (1000.0 * (a - b)).powi(2)).sum();
        let mean_square = squares / (a.len() / 3) as f64;
        assert!((mean_square - (amounts.row(row) - wrong.row(row)).norm_squared()).abs() < 1e-6);
    }
}

#[test]
fn poses_settle_where_the_layer_is_the_same_in_all_frames() {
    // A rigid second skin whose poses were fitted with an error: the surface says what they were.
    let truth = {
        let mut layer = moving_layer(24, 0.0);
        let first = layer.frame_offsets(0).to_vec();
        layer.offsets = first.repeat(24);
        layer
    };
    let surfaces: Vec<_> = (0..24).map(|frame| truth.clothing_vertices(frame)).collect();
    let mut layer = truth.clone();
    for (index, frame) in layer.frames.iter_mut().enumerate() {
        for (k, value) in frame.pose.iter_mut().enumerate() {
            *value += 0.05 * (1.7 * (index * 31 + k) as f64).sin();
        }
    }
    let skin = layer.association.blended_skin(&layer.rig);
    let anchors = layer.association.anchors(&layer.rest_vertices);
    let offsets: Vec<f32> = surfaces
        .iter()
        .enumerate()
        .flat_map(|(frame, surface)| {
            let carriers = skin.carriers(&anchors, &layer.posed_skeleton(frame), 0.2);
            let unposed: Vec<f32> =
                carriers.iter().zip(surface).flat_map(|(c, p)| c.unpose(*p).as_vec3().to_array()).collect();
            unposed
        })
        .collect();
    layer.offsets = offsets;
    let spread = |layer: &ClothingLayer| {
        let config = config();
        let prepared = PreparedLayers::new(vec!["a".into()], vec![layer.clone()], None, &config).unwrap();
        let rows: Vec<usize> = (0..24).collect();
        prepared.space(&rows, 20).unwrap().total_variance()
    };
    let before = spread(&layer);
    let mut settled = vec![layer];
    settle_poses::settle_poses(&mut settled, &SettleConfig::default());
    assert!(spread(&settled[0]) < 0.05 * before, "{} of {before}", spread(&settled[0]));
    for (frame, surface) in surfaces.iter().enumerate() {
        assert!(largest_distance(&settled[0].clothing_vertices(frame), surface) < 1e-6, "the surface stays");
    }
}

#[test]
fn every_frame_is_in_exactly_one_part_of_a_split() {
    let prepared =
        PreparedLayers::new(vec!["walk".into()], vec![moving_layer(43, 0.0)], None, &config()).unwrap();
    for split in [ClothingSplit::Paper, ClothingSplit::Block] {
        let (train, test) = prepared.split(&LearnClothingConfig { split, ..config() }).unwrap();
        let mut all = [train, test.clone()].concat();
        all.sort_unstable();
        assert_eq!(all, (0..43).collect::<Vec<_>>());
        assert_eq!(test.len(), 9, "a fifth of the frames");
    }
}

#[test]
fn layers_that_do_not_belong_together_are_refused_by_name() {
    let mut other = moving_layer(10, 0.0);
    other.clothing_faces.pop();
    let names = vec!["walk".to_owned(), "jump".to_owned()];
    let refused = learn_clothing(names, vec![moving_layer(10, 0.0), other], None, &config(), &mut Silent);
    let message = refused.unwrap_err().to_string();
    assert!(message.contains("jump") && message.contains("surface"), "{message}");
    let few = learn_clothing(vec!["walk".into()], vec![moving_layer(3, 0.0)], None, &config(), &mut Silent);
    assert!(matches!(few, Err(LearnClothingError::TooFewFrames { found: 3 })));
    let none = learn_clothing(Vec::new(), Vec::new(), None, &config(), &mut Silent);
    assert!(matches!(none, Err(LearnClothingError::NoLayers)));
}
