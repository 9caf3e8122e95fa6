//! `evaluate clothing`: P3 Tables 1 and 2, the splits that ask for more, and what is compared with them.

use std::collections::BTreeMap;

use habitus_optimize::{Event, Flow, Observer};

use super::clothing_model_run::ClothingModelRunError;
use crate::artifacts::clothing_controls::ParameterTable;
use crate::artifacts::clothing_layer::ClothingLayer;
use crate::artifacts::synthesized_sequence::Penetration;
use crate::body::FeatureSet;
use crate::evaluation::clothing_metrics::{ClothingMetrics, SplitErrors};
use crate::evaluation::layer_reconstruction::{PosedLayer, SurfacePairs};
use crate::stages::learn_clothing::config::SettleConfig;
use crate::stages::learn_clothing::{
    Baseline, ClothingRecipe, ClothingSplit, LearnClothingConfig, LearnClothingError, Learnt, PreparedLayers,
    learn_rows, name_of, regression_error,
};
use crate::stages::synthesize::config::PushOutConfig;
use crate::stages::synthesize::{PushOut, body_mesh};

/// Components of P3's Table 1, besides all of them.
const TABLE_COMPONENTS: [usize; 3] = [1, 5, 40];
/// Frames whose penetration is looked at, evenly spread.
const PENETRATION_FRAMES: usize = 40;

/// Settings of an evaluation.
pub struct ClothingEvaluation<'a> {
    /// Names of the sequences.
    pub names: Vec<String>,
    /// Their layers.
    pub layers: Vec<ClothingLayer>,
    /// Semantic parameters, if any.
    pub parameters: Option<&'a ParameterTable>,
    /// Settings of the stage; recipe and split are varied.
    pub config: &'a LearnClothingConfig,
}

impl ClothingEvaluation<'_> {
    /// Learns and measures everything; `seconds_now` is the caller's clock.
    pub fn run(
        self,
        observer: &mut dyn Observer,
        seconds_now: &dyn Fn() -> f64,
    ) -> Result<ClothingMetrics, ClothingModelRunError> {
        let mut metrics = ClothingMetrics { sequences: self.names.clone(), ..ClothingMetrics::default() };
        let as_fitted = LearnClothingConfig {
            settle: SettleConfig { rounds: 0, ..self.config.settle.clone() },
            ..self.config.clone()
        };
        let fitted =
            PreparedLayers::new(self.names.clone(), self.layers.clone(), self.parameters, &as_fitted)?;
        metrics.pca_error_fitted_poses_mm = pca_table(&fitted)?;
        drop(fitted);
        let start = seconds_now();
        let prepared = PreparedLayers::new(self.names, self.layers, self.parameters, self.config)?;
        metrics.seconds.insert("settle".into(), seconds_now() - start);
        metrics.frames = prepared.rows.len();
        let start = seconds_now();
        metrics.pca_error_mm = pca_table(&prepared)?;
        metrics.seconds.insert("components".into(), seconds_now() - start);
        let mut step = 0;
        let mut progress = |observer: &mut dyn Observer| {
            step += 1;
            let event = Event::Progress { stage: "evaluate", done: step, total: 6 };
            match observer.on_event(&event) {
                Flow::Continue => Ok(()),
                Flow::Stop => Err(LearnClothingError::Stopped),
            }
        };
        progress(observer)?;
        for split in [ClothingSplit::Paper, ClothingSplit::Block] {
            for recipe in [ClothingRecipe::Paper2018, ClothingRecipe::Default] {
                let config = LearnClothingConfig { recipe, split, ..self.config.clone() };
                let start = seconds_now();
                let learnt = measure_split(&prepared, &config, &mut metrics)?;
                let key = format!("learn_{}_{}", name_of(&recipe), name_of(&split));
                metrics.seconds.insert(key, seconds_now() - start);
                if (recipe, split) == (ClothingRecipe::Default, ClothingSplit::Block) {
                    measure_block(&prepared, &learnt, &config, &mut metrics)?;
                }
                progress(observer)?;
            }
        }
        if prepared.layers.len() > 1 {
            leave_one_out(&prepared, self.config, &mut metrics)?;
        }
        if !prepared.controls.is_empty() {
            control_response(&prepared, self.config, &mut metrics)?;
        }
        progress(observer)?;
        Ok(metrics)
    }
}

/// P3 Table 1.
fn pca_table(prepared: &PreparedLayers) -> Result<BTreeMap<String, f64>, ClothingModelRunError> {
    let rows: Vec<usize> = (0..prepared.rows.len()).collect();
    let whole = prepared.space(&rows, rows.len())?;
    let mut table = BTreeMap::new();
    for components in TABLE_COMPONENTS {
        let error = prepared.error_of_space(&whole.truncated(components), &rows);
        table.insert(components.to_string(), error);
    }
    table.insert("all".into(), prepared.error_of_space(&whole, &rows));
    Ok(table)
}

/// One recipe and the baselines on one split.
fn measure_split(
    prepared: &PreparedLayers,
    config: &LearnClothingConfig,
    metrics: &mut ClothingMetrics,
) -> Result<Learnt, ClothingModelRunError> {
    let (train, test) = prepared.split(config)?;
    let all: Vec<usize> = (0..prepared.rows.len()).collect();
    let space_rows = if config.split == ClothingSplit::Paper { &all } else { &train };
    let learnt = learn_rows(prepared, space_rows, &train, config)?;
    let errors = SplitErrors {
        train_mm: regression_error(prepared, &learnt, &train, config.recipe),
        prediction_mm: regression_error(prepared, &learnt, &test, config.recipe),
    };
    let split = name_of(&config.split);
    metrics.regression.entry(name_of(&config.recipe)).or_default().insert(split.clone(), errors);
    if let std::collections::btree_map::Entry::Vacant(place) = metrics.baselines.entry(split) {
        let mut found = BTreeMap::new();
        for baseline in Baseline::ALL {
            found.insert(
                baseline.name().to_owned(),
                baseline_error(prepared, &learnt, baseline, &train, &test)?,
            );
        }
        place.insert(found);
    }
    Ok(learnt)
}

fn baseline_error(
    prepared: &PreparedLayers,
    learnt: &Learnt,
    baseline: Baseline,
    train: &[usize],
    test: &[usize],
) -> Result<f64, ClothingModelRunError> {
    let features = prepared.features(FeatureSet::Paper2018);
    let amounts = prepared.amounts(&learnt.space, train);
    let predicted = baseline.predict(&features.select_rows(train), &amounts, &features.select_rows(test))?;
    Ok(prepared.error_of_amounts(&learnt.space, test, &predicted))
}

/// Every sequence in turn is not learnt from: an unseen motion, body, fabric or size.
fn leave_one_out(
    prepared: &PreparedLayers,
    config: &LearnClothingConfig,
    metrics: &mut ClothingMetrics,
) -> Result<(), ClothingModelRunError> {
    let mut sums: BTreeMap<String, Vec<SplitErrors>> = BTreeMap::new();
    for (left_out, name) in prepared.names.iter().enumerate() {
        let (test, train): (Vec<usize>, Vec<usize>) =
            (0..prepared.rows.len()).partition(|row| prepared.rows[*row].0 == left_out);
        let mut found = BTreeMap::new();
        for recipe in [ClothingRecipe::Paper2018, ClothingRecipe::Default] {
            let config = LearnClothingConfig { recipe, ..config.clone() };
            let learnt = learn_rows(prepared, &train, &train, &config)?;
            let errors = SplitErrors {
                train_mm: regression_error(prepared, &learnt, &train, recipe),
                prediction_mm: regression_error(prepared, &learnt, &test, recipe),
            };
            found.insert(name_of(&recipe), errors.prediction_mm);
            sums.entry(name_of(&recipe)).or_default().push(errors);
            if recipe == ClothingRecipe::Default {
                for baseline in Baseline::ALL {
                    let error = baseline_error(prepared, &learnt, baseline, &train, &test)?;
                    found.insert(baseline.name().to_owned(), error);
                }
            }
        }
        metrics.left_out.insert(name.clone(), found);
    }
    for (recipe, errors) in sums {
        let count = errors.len() as f64;
        let mean = SplitErrors {
            train_mm: errors.iter().map(|errors| errors.train_mm).sum::<f64>() / count,
            prediction_mm: errors.iter().map(|errors| errors.prediction_mm).sum::<f64>() / count,
        };
        metrics.regression.entry(recipe).or_default().insert("leave_one_out".into(), mean);
    }
    let count = metrics.left_out.len() as f64;
    let mut means: BTreeMap<String, f64> = BTreeMap::new();
    for found in metrics.left_out.values() {
        for baseline in Baseline::ALL {
            *means.entry(baseline.name().into()).or_default() += found[baseline.name()] / count;
        }
    }
    metrics.baselines.insert("leave_one_out".into(), means);
    Ok(())
}

/// Frame errors, normals, accelerations and penetration of the block that was set aside.
fn measure_block(
    prepared: &PreparedLayers,
    learnt: &Learnt,
    config: &LearnClothingConfig,
    metrics: &mut ClothingMetrics,
) -> Result<(), ClothingModelRunError> {
    let (train, test) = prepared.split(config)?;
    let features = prepared.features(config.recipe.feature_set());
    metrics.block_start = train.len();
    let order: Vec<usize> = train.iter().chain(&test).copied().collect();
    for row in &order {
        let amounts = learnt.regressor.predict(&features.select_rows(&[*row]));
        metrics.frame_error_mm.push(prepared.error_of_amounts(&learnt.space, &[*row], &amounts));
    }
    let amounts = learnt.regressor.predict(&features.select_rows(&test));
    let offsets = prepared.offsets_of_amounts(&learnt.space, &amounts);
    let posed: Vec<PosedLayer<'_>> = prepared.layers.iter().map(PosedLayer::new).collect();
    let frames: Vec<(usize, usize)> = test.iter().map(|row| prepared.rows[*row]).collect();
    let surfaces = SurfacePairs::new(&posed, &frames, &offsets);
    metrics.normal_error_deg = surfaces.normal_error_deg();
    metrics.acceleration_error = surfaces.acceleration_error();
    let layer = &prepared.layers[0];
    let push_out =
        PushOut::new(layer.clothing_vertex_count(), &layer.clothing_faces, &PushOutConfig::default());
    let step = (frames.len() / PENETRATION_FRAMES).max(1);
    let (mut before, mut after) = (Vec::new(), Vec::new());
    let (mut error_before, mut error_after) = (0.0, 0.0);
    for (index, (owner, frame)) in frames.iter().enumerate().step_by(step) {
        let layer = &prepared.layers[*owner];
        let rest = layer.rig.skin.clone();
        let mut body = Vec::new();
        rest.apply_into(&layer.rest_vertices, &layer.posed_skeleton(*frame), &mut body);
        let Ok(body) = body_mesh(body, &layer.rig.faces) else { continue };
        let (truth, mut clothing) = surfaces.pair(index);
        error_before += mean_distance(truth, &clothing);
        let (inside_before, inside_after) = push_out.apply(&mut clothing, &body, &mut Vec::new());
        error_after += mean_distance(truth, &clothing);
        before.push(inside_before);
        after.push(inside_after);
    }
    metrics.penetration_before = Penetration::over(&before);
    metrics.penetration_after = Penetration::over(&after);
    metrics.prediction_before_push_out_mm = 1000.0 * error_before / before.len().max(1) as f64;
    metrics.prediction_after_push_out_mm = 1000.0 * error_after / after.len().max(1) as f64;
    Ok(())
}

fn mean_distance(a: &[glam::DVec3], b: &[glam::DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).sum::<f64>() / a.len().max(1) as f64
}

/// Each control alone from its smallest to its largest value, the others at their means: mean movement on each bone.
fn control_response(
    prepared: &PreparedLayers,
    config: &LearnClothingConfig,
    metrics: &mut ClothingMetrics,
) -> Result<(), ClothingModelRunError> {
    let all: Vec<usize> = (0..prepared.rows.len()).collect();
    let config = LearnClothingConfig { recipe: ClothingRecipe::Default, ..config.clone() };
    let learnt = learn_rows(prepared, &all, &all, &config)?;
    let step = (all.len() / PENETRATION_FRAMES).max(1);
    let rows: Vec<usize> = all.into_iter().step_by(step).collect();
    let mut features = prepared.features(config.recipe.feature_set()).select_rows(&rows);
    let first = features.ncols() - prepared.controls.len();
    for (k, control) in prepared.controls.controls.iter().enumerate() {
        features.column_mut(first + k).fill(control.default);
    }
    let layer = &prepared.layers[0];
    let skin = layer.association.blended_skin(&layer.rig);
    for (k, control) in prepared.controls.controls.iter().enumerate() {
        let mut at = |value: f64| {
            features.column_mut(first + k).fill(value);
            prepared.offsets_of_amounts(&learnt.space, &learnt.regressor.predict(&features))
        };
        let (low, high) = (at(control.minimum), at(control.maximum));
        features.column_mut(first + k).fill(control.default);
        let mut moved = vec![(0.0, 0.0); layer.rig.skeleton.bones().len()];
        for point in 0..skin.point_count() {
            let mean: f64 = low
                .iter()
                .zip(&high)
                .map(|(low, high)| {
                    let at = |offsets: &[f64]| glam::DVec3::from_slice(&offsets[3 * point..]);
                    at(low).distance(at(high))
                })
                .sum::<f64>()
                / low.len().max(1) as f64;
            for (bone, weight) in skin.of(point) {
                moved[bone].0 += weight * mean;
                moved[bone].1 += weight;
            }
        }
        let response = layer
            .rig
            .skeleton
            .bones()
            .iter()
            .zip(moved)
            .filter(|(_, (_, weight))| *weight > 1.0)
            .map(|(bone, (sum, weight))| (bone.name.clone(), 1000.0 * sum / weight));
        metrics.control_response_mm.insert(control.name.clone(), response.collect());
    }
    Ok(())
}
