use habitus_optimize::Silent;

use super::config::PushOutConfig;
use super::*;
use crate::artifacts::clothing_controls::{ClothingControls, ParameterTable};
use crate::artifacts::clothing_model::{
    ClothingRegressor, LearningRecord, millimetres_per_coefficient, with_controls,
};
use crate::artifacts::fixture::{largest_distance, moving_layer};
use crate::body::{FeatureSet, fixture};
use crate::statistics::kernel_mixture::KernelMixture;
use crate::statistics::kernel_ridge::{KernelChoice, KernelRidgeConfig, Samples, equal_relevance};
use crate::statistics::{LinearSpace, LinearSpaceSettings, SampleMatrix};

fn without_push_out() -> SynthesizeConfig {
    SynthesizeConfig { push_out: PushOutConfig { rounds: 0, ..PushOutConfig::default() } }
}

#[test]
fn the_same_identity_gives_the_captured_clothing_back() {
    let layer = moving_layer(20, 0.0);
    let model = fixture::model();
    let unchanged = change_body(&layer, &model, &layer.identity).unwrap();
    let replayed = replay_layer(&unchanged, &without_push_out(), &mut Journal::none(), &mut Silent).unwrap();
    for frame in 0..20 {
        let distance = largest_distance(&replayed.clothing[frame], &layer.clothing_vertices(frame));
        assert!(distance < 1e-5, "frame {frame}: {distance} m");
    }
}

#[test]
fn another_identity_carries_the_clothing_with_it() {
    let layer = moving_layer(6, 0.0);
    let model = fixture::model();
    let larger: Vec<f64> =
        layer.identity.iter().enumerate().map(|(k, c)| if k == 0 { c + 2.0 } else { *c }).collect();
    let changed = change_body(&layer, &model, &larger).unwrap();
    let sequence = replay_layer(&changed, &without_push_out(), &mut Journal::none(), &mut Silent).unwrap();
    // Offsets stay: what moves the clothing is the body under it, blended in the same way.
    let bodies = |layer: &ClothingLayer| {
        let posed = layer.posed_skeleton(3);
        let skin = layer.association.blended_skin(&layer.rig);
        let anchors = layer.association.anchors(&layer.rest_vertices);
        let carriers = skin.carriers(&anchors, &posed, layer.association.smallest_stretch);
        carriers.into_iter().map(|carrier| carrier.origin).collect::<Vec<_>>()
    };
    let (before, after) = (bodies(&layer), bodies(&changed));
    let as_given = layer.clothing_vertices(3);
    assert!(largest_distance(&before, &after) > 0.01);
    for (vertex, (a, b)) in before.iter().zip(&after).enumerate() {
        let moved = sequence.clothing[3][vertex] - as_given[vertex];
        assert!(moved.distance(*b - *a) < 1e-6, "vertex {vertex}");
    }
}

#[test]
fn what_a_body_has_beyond_the_space_stays_with_another_identity() {
    let layer = moving_layer(2, 0.0);
    let model = fixture::model();
    let mut larger = layer.identity.clone();
    larger[0] += 2.0;
    let detail = DVec3::new(0.0, 0.01, 0.02);
    let mut detailed = layer.clone();
    detailed.rest_vertices[5] += detail;
    let [plain, detailed] = [&layer, &detailed].map(|layer| change_body(layer, &model, &larger).unwrap());
    for (vertex, (plain, detailed)) in plain.rest_vertices.iter().zip(&detailed.rest_vertices).enumerate() {
        let expected = if vertex == 5 { detail } else { DVec3::ZERO };
        assert!((*detailed - *plain).distance(expected) < 1e-12, "vertex {vertex}");
    }
}

/// A model of three widths of the second skin.
fn model_of_widths() -> ClothingModel {
    let widths = [0.0, 0.01, 0.02];
    let layers = widths.map(|width| moving_layer(25, width));
    let names: Vec<String> = ["narrow", "middle", "wide"].map(str::to_owned).to_vec();
    let table = ParameterTable {
        columns: vec!["width".into()],
        rows: names.iter().cloned().zip(widths.map(|width| vec![width])).collect(),
    };
    let controls = ClothingControls::learn(&table, &names, 4).unwrap();
    let mut samples = SampleMatrix::new(3 * layers[0].clothing_vertex_count());
    let mut rows = Vec::new();
    for (layer, name) in layers.iter().zip(&names) {
        for frame in 0..25 {
            samples.push(&layer.frame_offsets(frame).iter().copied().map(f64::from).collect::<Vec<_>>());
        }
        let poses: Vec<&[f64]> = layer.frames.iter().map(|frame| frame.pose.as_slice()).collect();
        let times: Vec<f64> = (0..25).map(|frame| layer.time_of(frame)).collect();
        let motion = FeatureSet::Paper2018.of_motion(&layer.rig.skeleton, &poses, &times);
        rows.push(with_controls(&motion, &[controls.of_sequence(name).unwrap(); 25]));
    }
    let space = LinearSpace::learn(&samples, &LinearSpaceSettings::with_components(4)).unwrap();
    let scale = millimetres_per_coefficient(&space);
    let amounts = DMatrix::from_fn(75, space.component_count(), |row, k| {
        space.coefficients(samples.sample(row))[k] * scale[k]
    });
    let features = DMatrix::from_rows(&rows.iter().flat_map(DMatrix::row_iter).collect::<Vec<_>>());
    let mut relevance = equal_relevance(&features);
    // The width alone and the motion together count about the same.
    if let Some(width) = relevance.last_mut() {
        *width *= 7.0;
    }
    let config = KernelRidgeConfig::default();
    let samples = Samples::of_one_sequence(&features, &amounts);
    let choice = KernelChoice::by_left_out_blocks(&samples, &relevance, &config).unwrap();
    let whole = DMatrix::identity(amounts.ncols(), amounts.ncols());
    let kernels = KernelMixture::learn(&samples, vec![(relevance, whole)], &choice, 500).unwrap();
    let mut dressed = layers[0].clone();
    dressed.frames.clear();
    dressed.offsets.clear();
    ClothingModel {
        dressed,
        space,
        feature_set: FeatureSet::Paper2018,
        controls,
        regressor: ClothingRegressor::Kernels(kernels),
        motions: Vec::new(),
        record: LearningRecord::default(),
    }
}

#[test]
fn a_larger_size_makes_the_clothing_wider_monotonically() {
    let model = model_of_widths();
    let motion = Motion::of_layer(&moving_layer(10, 0.0));
    let mean_width = |width: f64| {
        let mut controls = model.controls.defaults();
        model.controls.set(&mut controls, "width", width).unwrap();
        let sequence = synthesize(
            &model,
            &model.dressed,
            &motion,
            &controls,
            &without_push_out(),
            &mut Journal::none(),
            &mut Silent,
        )
        .unwrap();
        let body = sequence.body.posed_vertices(5);
        let widths = sequence.clothing[5].iter().zip(&body).map(|(clothing, body)| clothing.distance(*body));
        widths.sum::<f64>() / body.len() as f64
    };
    let widths: Vec<f64> = (0..=8).map(|step| mean_width(0.0025 * f64::from(step))).collect();
    assert!(widths.windows(2).all(|pair| pair[1] > pair[0]), "{widths:?}");
    assert!(widths[8] - widths[0] > 0.012, "of 20 mm that were learnt from: {widths:?}");
}

#[test]
fn motions_and_controls_that_do_not_fit_are_refused() {
    let model = model_of_widths();
    let mut motion = Motion::of_layer(&moving_layer(4, 0.0));
    let config = without_push_out();
    let no_controls =
        synthesize(&model, &model.dressed, &motion, &[], &config, &mut Journal::none(), &mut Silent);
    assert!(matches!(no_controls, Err(SynthesizeError::Controls { found: 0, needed: 1 })));
    motion.poses[2].pop();
    let broken =
        synthesize(&model, &model.dressed, &motion, &[0.0], &config, &mut Journal::none(), &mut Silent);
    assert!(matches!(broken, Err(SynthesizeError::Motion { .. })));
    let other = fixture::model_with_segments(8);
    let refused = change_body(&model.dressed, &other, &[0.0]);
    assert!(matches!(refused, Err(SynthesizeError::OtherBody { .. })));
}

#[test]
fn threads_do_not_change_the_result() {
    let layer = moving_layer(20, 0.0);
    let run =
        || replay_layer(&layer, &SynthesizeConfig::default(), &mut Journal::none(), &mut Silent).unwrap();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(run);
    assert_eq!(one, run());
}

/// Hears how many frames are done, and stops after some.
struct Watch {
    done: Vec<usize>,
    stop_at: usize,
}

impl Observer for Watch {
    fn on_event(&mut self, event: &Event) -> Flow {
        if let Event::Progress { done, .. } = event {
            self.done.push(*done);
        }
        if self.done.last().is_some_and(|done| *done >= self.stop_at) { Flow::Stop } else { Flow::Continue }
    }
}

#[test]
fn a_killed_synthesis_goes_on_where_it_stopped() {
    let layer = moving_layer(40, 0.0);
    let config = SynthesizeConfig::default();
    let fresh = replay_layer(&layer, &config, &mut Journal::none(), &mut Silent).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let run = |stop_at: usize| {
        let mut watch = Watch { done: Vec::new(), stop_at };
        let mut journal = Journal::open(&path, "key").unwrap();
        let made = pool.install(|| replay_layer(&layer, &config, &mut journal, &mut watch));
        (made, watch.done)
    };
    let (killed, done) = run(16);
    assert!(matches!(killed, Err(SynthesizeError::Stopped)));
    assert_eq!(done, [8, 16]);
    let (resumed, done) = run(usize::MAX);
    assert_eq!(done, [24, 32, 40], "what was finished is not done again");
    assert_eq!(resumed.unwrap(), fresh, "the same to the bit");
}
