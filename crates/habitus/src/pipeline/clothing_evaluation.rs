//! `evaluate clothing`: P3 Tables 1 and 2, the splits that ask for more, and what is compared with them.

use std::collections::BTreeMap;

use habitus_optimize::{Event, Flow, Observer};

use super::clothing_left_out::leave_one_out;
use super::clothing_model_run::ClothingModelRunError;
use super::clothing_sliders::measure_sliders;
use crate::artifacts::clothing_controls::ParameterTable;
use crate::artifacts::clothing_layer::ClothingLayer;
use crate::artifacts::synthesized_sequence::Penetration;
use crate::body::FeatureSet;
use crate::evaluation::clothing_metrics::{ClothingErrorMap, ClothingMetrics, SplitErrors};
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
pub(super) const PENETRATION_FRAMES: usize = 40;

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

/// What an evaluation found.
pub struct EvaluatedClothing {
    /// The numbers.
    pub metrics: ClothingMetrics,
    /// Where on the clothing sequences that were left out are wrong.
    pub maps: Vec<ClothingErrorMap>,
}

impl ClothingEvaluation<'_> {
    /// Learns and measures everything; `seconds_now` is the caller's clock.
    pub fn run(
        self,
        observer: &mut dyn Observer,
        seconds_now: &dyn Fn() -> f64,
    ) -> Result<EvaluatedClothing, ClothingModelRunError> {
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
        if !prepared.controls.is_empty() {
            measure_sliders(&prepared, self.config, &mut metrics)?;
        }
        let mut maps = Vec::new();
        if prepared.layers.len() > 1 {
            let start = seconds_now();
            let mut prepared = prepared;
            maps = leave_one_out(&mut prepared, self.parameters, self.config, &mut metrics, observer)?;
            metrics.seconds.insert("leave_one_out".into(), seconds_now() - start);
        }
        progress(observer)?;
        Ok(EvaluatedClothing { metrics, maps })
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

pub(super) fn baseline_error(
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
