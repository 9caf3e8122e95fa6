//! Every sequence in turn is not learnt from: an unseen motion, body, fabric or size.

use std::collections::BTreeMap;

use habitus_optimize::{Event, Flow, Observer};
use rayon::prelude::*;

use super::clothing_evaluation::baseline_error;
use super::clothing_model_run::ClothingModelRunError;
use crate::artifacts::clothing_controls::{ClothingControls, ParameterTable};
use crate::artifacts::clothing_layer::ClothingLayer;
use crate::body::FeatureSet;
use crate::evaluation::clothing_metrics::{ClothingErrorMap, ClothingMetrics, LeftOutKind, SplitErrors};
use crate::evaluation::layer_reconstruction::PosedLayer;
use crate::stages::learn_clothing::{
    Baseline, ClothingRecipe, LearnClothingConfig, LearnClothingError, Learnt, PreparedLayers, learn_rows,
    name_of, regression_error,
};

/// Name of what the components of the other sequences can express at best, in the table of sequences left out.
const COMPONENTS_ALONE: &str = "components";
/// Sequences that must stay for their fabrics to span a space of their own.
const LEAST_SEQUENCES: usize = 3;

/// Measures each sequence with what was learnt from the others; the components and the standardisation of the fabrics, too,
/// are those of the others.
pub(super) fn leave_one_out(
    prepared: &mut PreparedLayers,
    parameters: Option<&ParameterTable>,
    config: &LearnClothingConfig,
    metrics: &mut ClothingMetrics,
    observer: &mut dyn Observer,
) -> Result<Vec<ClothingErrorMap>, ClothingModelRunError> {
    metrics.left_out_kind = kind_of(&prepared.controls);
    let all_controls = prepared.controls.clone();
    let mut sums: BTreeMap<String, Vec<SplitErrors>> = BTreeMap::new();
    let mut maps = Vec::new();
    let names = prepared.names.clone();
    for (left_out, name) in names.iter().enumerate() {
        let event = Event::Progress { stage: "leave one out", done: left_out, total: names.len() };
        if observer.on_event(&event) == Flow::Stop {
            return Err(LearnClothingError::Stopped.into());
        }
        let others: Vec<String> = names.iter().filter(|other| *other != name).cloned().collect();
        if let Some(table) = parameters
            && others.len() >= LEAST_SEQUENCES
        {
            prepared.controls = ClothingControls::learn(table, &others, config.fabric_components)?;
            prepared.controls.add_sequence(table, name)?;
        }
        let (found, errors, map) = measure_one(prepared, left_out, config)?;
        for (recipe, errors) in errors {
            sums.entry(recipe).or_default().push(errors);
        }
        metrics.left_out.insert(name.clone(), found);
        maps.push(map);
    }
    prepared.controls = all_controls;
    summarise(sums, metrics);
    Ok(maps)
}

type RecipeErrors = Vec<(String, SplitErrors)>;

/// Errors of all methods on one sequence that they did not see.
fn measure_one(
    prepared: &PreparedLayers,
    left_out: usize,
    config: &LearnClothingConfig,
) -> Result<(BTreeMap<String, f64>, RecipeErrors, ClothingErrorMap), ClothingModelRunError> {
    let (test, train): (Vec<usize>, Vec<usize>) =
        (0..prepared.rows.len()).partition(|row| prepared.rows[*row].0 == left_out);
    let (mut found, mut of_recipes) = (BTreeMap::new(), Vec::new());
    let mut map = empty_map(prepared, left_out);
    for recipe in [ClothingRecipe::Paper2018, ClothingRecipe::Default] {
        let config = LearnClothingConfig { recipe, ..config.clone() };
        let learnt = learn_rows(prepared, &train, &train, &config)?;
        let errors = SplitErrors {
            train_mm: regression_error(prepared, &learnt, &train, recipe),
            prediction_mm: regression_error(prepared, &learnt, &test, recipe),
        };
        found.insert(name_of(&recipe), errors.prediction_mm);
        of_recipes.push((name_of(&recipe), errors));
        if recipe == ClothingRecipe::Default {
            for baseline in Baseline::ALL {
                let error = baseline_error(prepared, &learnt, baseline, &train, &test)?;
                found.insert(baseline.name().to_owned(), error);
            }
            found.insert(COMPONENTS_ALONE.to_owned(), prepared.error_of_space(&learnt.space, &test));
            map.errors_mm = error_maps(prepared, &learnt, &train, &test, recipe)?;
        }
    }
    Ok((found, of_recipes, map))
}

/// Mean error of each vertex over the frames that were left out, of the recipe and of the nearest frame.
fn error_maps(
    prepared: &PreparedLayers,
    learnt: &Learnt,
    train: &[usize],
    test: &[usize],
    recipe: ClothingRecipe,
) -> Result<Vec<(String, Vec<f64>)>, ClothingModelRunError> {
    let own = prepared.features(recipe.feature_set()).select_rows(test);
    let features = prepared.features(FeatureSet::Paper2018);
    let nearest = Baseline::NearestNeighbour.predict(
        &features.select_rows(train),
        &prepared.amounts(&learnt.space, train),
        &features.select_rows(test),
    )?;
    let predicted = [
        (name_of(&recipe), learnt.regressor.predict(&own)),
        (Baseline::NearestNeighbour.name().to_owned(), nearest),
    ];
    let posed: Vec<PosedLayer<'_>> = prepared.layers.iter().map(PosedLayer::new).collect();
    let of_amounts = |(name, amounts)| {
        let offsets = prepared.offsets_of_amounts(&learnt.space, &amounts);
        let of_frame = |(row, offsets): (&usize, &Vec<f64>)| {
            let (layer, frame) = prepared.rows[*row];
            posed[layer].vertex_errors(frame, offsets)
        };
        let frames: Vec<Vec<f64>> = test.par_iter().zip(&offsets).map(of_frame).collect();
        let scale = 1000.0 / frames.len().max(1) as f64;
        let mut sums = vec![0.0; prepared.layers[0].clothing_vertex_count()];
        for frame in &frames {
            sums.iter_mut().zip(frame).for_each(|(sum, error)| *sum += scale * error);
        }
        (name, sums)
    };
    Ok(predicted.into_iter().map(of_amounts).collect())
}

/// The middle frame of a sequence, without errors.
fn empty_map(prepared: &PreparedLayers, sequence: usize) -> ClothingErrorMap {
    let layer: &ClothingLayer = &prepared.layers[sequence];
    let frame = layer.frames.len() / 2;
    let mut body = Vec::new();
    layer.rig.skin.apply_into(&layer.rest_vertices, &layer.posed_skeleton(frame), &mut body);
    ClothingErrorMap {
        sequence: prepared.names[sequence].clone(),
        vertices: layer.clothing_vertices(frame),
        faces: layer.clothing_faces.clone(),
        body,
        body_faces: layer.rig.faces.clone(),
        errors_mm: Vec::new(),
    }
}

fn kind_of(controls: &ClothingControls) -> LeftOutKind {
    match (controls.fabric_component_count(), controls.len()) {
        (0, 0) => LeftOutKind::Sequence,
        (0, _) => LeftOutKind::Size,
        (fabrics, all) if fabrics == all => LeftOutKind::Material,
        _ => LeftOutKind::Sequence,
    }
}

/// Means over the sequences, beside the other splits.
fn summarise(sums: BTreeMap<String, Vec<SplitErrors>>, metrics: &mut ClothingMetrics) {
    const SPLIT: &str = "leave_one_out";
    for (recipe, errors) in sums {
        let count = errors.len() as f64;
        let mean = SplitErrors {
            train_mm: errors.iter().map(|errors| errors.train_mm).sum::<f64>() / count,
            prediction_mm: errors.iter().map(|errors| errors.prediction_mm).sum::<f64>() / count,
        };
        metrics.regression.entry(recipe).or_default().insert(SPLIT.into(), mean);
    }
    let count = metrics.left_out.len() as f64;
    let mut means: BTreeMap<String, f64> = BTreeMap::new();
    for found in metrics.left_out.values() {
        for baseline in Baseline::ALL {
            *means.entry(baseline.name().into()).or_default() += found[baseline.name()] / count;
        }
    }
    metrics.baselines.insert(SPLIT.into(), means);
}
