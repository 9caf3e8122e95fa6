//! From features to amounts of the components: the two recipes, and what they are compared with.
//!
//! Deviation: the default recipe is no network; see book/src/deviations.md.

use glam::DVec3;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::config::{ClothingRecipe, LearnClothingConfig, RelevanceConfig};
use super::{LearnClothingError, PreparedLayers};
use crate::artifacts::clothing_model::ClothingRegressor;
use crate::body::{Feature, FeatureKind, FeatureSet, Skeleton};
use crate::statistics::kernel_mixture::KernelMixture;
use crate::statistics::kernel_ridge::{
    ControlKernel, KernelChoice, KernelRidge, KernelRidgeConfig, Samples, equal_relevance,
};
use crate::statistics::nearest_neighbours::NearestNeighbour;
use crate::statistics::network::NetworkRegressor;
use crate::statistics::{LinearSpace, RandomStream};

impl ClothingRecipe {
    /// What describes the motion in this recipe.
    pub fn feature_set(self) -> FeatureSet {
        match self {
            Self::Default => FeatureSet::FromPelvis,
            Self::Paper2018 => FeatureSet::Paper2018,
        }
    }
}

/// What every recipe must beat; all of them see the features of P3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Baseline {
    /// The mean layer, whatever the motion.
    Mean,
    /// Linear ridge regression, its damping chosen on left-out blocks.
    Ridge,
    /// The layer of the most similar frame.
    NearestNeighbour,
}

impl Baseline {
    /// All baselines.
    pub const ALL: [Self; 3] = [Self::Mean, Self::Ridge, Self::NearestNeighbour];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Ridge => "ridge",
            Self::NearestNeighbour => "nearest_neighbour",
        }
    }

    /// Amounts for `asked`, learnt from `features` and `amounts`.
    pub fn predict(
        self,
        features: &DMatrix<f64>,
        amounts: &DMatrix<f64>,
        asked: &DMatrix<f64>,
    ) -> Result<DMatrix<f64>, LearnClothingError> {
        Ok(match self {
            Self::Mean => DMatrix::from_rows(&vec![amounts.row_mean(); asked.nrows()]),
            Self::Ridge => {
                let relevance = equal_relevance(features);
                let samples = Samples::of_one_sequence(features, amounts);
                KernelRidge::learn(&samples, &relevance, &KernelRidgeConfig::linear())?.predict(asked)
            }
            Self::NearestNeighbour => NearestNeighbour::learn(features, amounts).predict(asked),
        })
    }
}

/// Learns the recipe's regressor from the given rows.
pub(super) fn learn_regressor(
    prepared: &PreparedLayers,
    space: &LinearSpace,
    rows: &[usize],
    config: &LearnClothingConfig,
) -> Result<ClothingRegressor, LearnClothingError> {
    let set = config.recipe.feature_set();
    let features = prepared.features(set).select_rows(rows);
    let amounts = prepared.amounts(space, rows);
    match config.recipe {
        ClothingRecipe::Paper2018 => {
            let mut random = RandomStream::named(config.seed, "validation frames");
            let count = (config.validation_share * rows.len() as f64).round() as usize;
            let validation = random.choose(count, rows.len());
            let training: Vec<usize> = (0..rows.len()).filter(|row| !validation.contains(row)).collect();
            let features = with_noise(&features, prepared.controls.len(), config);
            let (network, _) = NetworkRegressor::train(
                &features,
                &amounts,
                &training,
                &validation,
                &config.network,
                config.seed,
            )?;
            Ok(ClothingRegressor::Network(network))
        }
        ClothingRecipe::Default => {
            let samples = Samples {
                inputs: &features,
                targets: &amounts,
                control_count: prepared.controls.len(),
                sequences: &sequence_starts(prepared, rows),
            };
            Ok(ClothingRegressor::Kernels(learn_kernels(prepared, space, &samples, config)?))
        }
    }
}

/// Places in `rows` where another sequence begins.
fn sequence_starts(prepared: &PreparedLayers, rows: &[usize]) -> Vec<usize> {
    let sequence = |place: usize| prepared.rows[rows[place]].0;
    (0..rows.len()).filter(|place| *place == 0 || sequence(*place) != sequence(place - 1)).collect()
}

/// Features whose last `control_count` columns have Gaussian noise (P3 §5.2), so that a handful of fabrics or sizes is not
/// learnt by heart.
fn with_noise(features: &DMatrix<f64>, control_count: usize, config: &LearnClothingConfig) -> DMatrix<f64> {
    let mut noisy = features.clone();
    let mut random = RandomStream::named(config.seed, "control noise");
    let first = features.ncols() - control_count;
    for mut column in noisy.columns_mut(first, control_count).column_iter_mut() {
        let deviation = config.control_noise * column.variance().sqrt();
        column.iter_mut().for_each(|value| *value += deviation * random.normal());
    }
    noisy
}

/// How much kinds of inputs count: one value of each list of the settings.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Relevance {
    closeness: f64,
    rate: f64,
    up: f64,
    velocity: f64,
    turn: f64,
}

impl Relevance {
    /// The first of each list.
    fn first(config: &RelevanceConfig) -> Result<Self, LearnClothingError> {
        let first =
            |name, values: &[f64]| values.first().copied().ok_or(LearnClothingError::NoRelevance { name });
        Ok(Self {
            closeness: first("closeness", &config.closeness)?,
            rate: first("rates", &config.rates)?,
            up: first("up", &config.up)?,
            velocity: first("velocity", &config.velocity)?,
            turn: first("turn", &config.turn)?,
        })
    }

    /// Copies with each of `values` in one place.
    fn with_each(self, values: &[f64], place: fn(&mut Self) -> &mut f64) -> Vec<Self> {
        let with = |value: &f64| {
            let mut changed = self;
            *place(&mut changed) = *value;
            changed
        };
        values.iter().map(with).collect()
    }
}

/// One kernel and one relevance of each kind of input for the whole body, then a regressor for each bone's part of the clothing.
///
/// All of them are chosen, kind by kind, by the error on contiguous blocks that are left out of the rows in turn, and where there
/// are more than two sequences, on whole sequences that are, too. Frames and sequences which are set aside have no say.
fn learn_kernels(
    prepared: &PreparedLayers,
    space: &LinearSpace,
    samples: &Samples<'_>,
    config: &LearnClothingConfig,
) -> Result<KernelMixture, LearnClothingError> {
    let skeleton = &prepared.layers[0].rig.skeleton;
    let described = config.recipe.feature_set().features(skeleton);
    let of_controls = control_relevance(prepared, samples.inputs, described.len());
    let of_inputs = |relevance: &Relevance, part: Option<usize>| -> Vec<f64> {
        let motion = described.iter().map(|feature| relevance_of(feature, part, relevance, skeleton));
        motion.chain(of_controls.iter().map(|value| config.relevance.control * value)).collect()
    };
    let choose = |relevance: &Relevance, kernels: &KernelRidgeConfig| {
        KernelChoice::by_left_out_blocks(samples, &of_inputs(relevance, None), kernels)
    };
    let mut relevance = Relevance::first(&config.relevance)?;
    let of_controls: &[ControlKernel] =
        if samples.control_count > 0 { &config.kernels.controls } else { &[] };
    let mut kernels = config.kernels.clone();
    let mut choice: Option<KernelChoice> = None;
    for controls in of_controls {
        let tried = config.kernels.with_controls(*controls);
        let found = choose(&relevance, &tried)?;
        if choice.is_none_or(|choice| found.left_out_error < choice.left_out_error) {
            (choice, kernels) = (Some(found), tried);
        }
    }
    let mut choice = match choice {
        Some(choice) => choice,
        None => choose(&relevance, &kernels)?,
    };
    let lists = &config.relevance;
    type Place = fn(&mut Relevance) -> &mut f64;
    let kinds: [(&[f64], Place); 4] = [
        (&lists.rates, |relevance| &mut relevance.rate),
        (&lists.up, |relevance| &mut relevance.up),
        (&lists.velocity, |relevance| &mut relevance.velocity),
        (&lists.turn, |relevance| &mut relevance.turn),
    ];
    for (values, place) in kinds {
        for tried in relevance.with_each(values, place) {
            let found = choose(&tried, &kernels)?;
            if found.left_out_error < choice.left_out_error {
                (choice, relevance) = (found, tried);
            }
        }
    }
    let masks = part_masks(prepared);
    let mixings: Vec<DMatrix<f64>> = masks.iter().map(|(_, mask)| mixing(space, mask)).collect();
    let parts = |relevance: &Relevance| -> Vec<(Vec<f64>, DMatrix<f64>)> {
        let of_part = |((bone, _), mixing): (&(usize, Vec<f64>), &DMatrix<f64>)| {
            (of_inputs(relevance, Some(*bone)), mixing.clone())
        };
        masks.iter().zip(&mixings).map(of_part).collect()
    };
    let mut best = (f64::INFINITY, parts(&relevance));
    for tried in relevance.with_each(&lists.closeness, |relevance| &mut relevance.closeness) {
        let parts = parts(&tried);
        let error = KernelMixture::left_out_error(samples, &parts, &choice, &kernels)?;
        if error < best.0 {
            best = (error, parts);
        }
    }
    Ok(KernelMixture::learn(samples, best.1, &choice, kernels.most_rows)?)
}

/// How much each control counts: in its deviations over the rows; components of fabrics by what they hold of the fabrics' variance,
/// for the last of them are hardly more than the tables' rounding.
fn control_relevance(prepared: &PreparedLayers, features: &DMatrix<f64>, motion_width: usize) -> Vec<f64> {
    let mut relevance = equal_relevance(features).split_off(motion_width);
    if let Some(fabrics) = &prepared.controls.fabrics {
        let deviations = fabrics.space.standard_deviations();
        let largest = deviations.first().copied().unwrap_or(1.0).max(f64::MIN_POSITIVE);
        for (value, deviation) in relevance.iter_mut().zip(deviations) {
            *value *= deviation / largest;
        }
    }
    relevance
}

/// How much a feature counts for a part: less for each joint between them.
fn relevance_of(feature: &Feature, part: Option<usize>, relevance: &Relevance, skeleton: &Skeleton) -> f64 {
    let in_its_unit = match feature.kind {
        FeatureKind::Angle => 1.0,
        FeatureKind::Rate => relevance.rate,
        FeatureKind::Up => relevance.up,
        FeatureKind::Velocity | FeatureKind::Speed => relevance.velocity,
        FeatureKind::Turn => relevance.turn,
    };
    let Some(part) = part else { return in_its_unit };
    // An axis moves two bones against one another: the nearer one counts.
    let own = joints_between(skeleton, part, feature.bone);
    let parent =
        skeleton.bones()[feature.bone].parent.map_or(own, |bone| joints_between(skeleton, part, bone));
    in_its_unit * relevance.closeness.powi(own.min(parent) as i32)
}

/// Number of joints on the way from one bone to another.
fn joints_between(skeleton: &Skeleton, a: usize, b: usize) -> usize {
    let path = |mut bone: usize| {
        let mut path = vec![bone];
        while let Some(parent) = skeleton.bones()[bone].parent {
            path.push(parent);
            bone = parent;
        }
        path
    };
    let (from_a, from_b) = (path(a), path(b));
    let shared = from_a.iter().rev().zip(from_b.iter().rev()).take_while(|(a, b)| a == b).count();
    from_a.len() + from_b.len() - 2 * shared
}

/// Weight of each bone on each clothing vertex, for bones that the clothing hangs on.
fn part_masks(prepared: &PreparedLayers) -> Vec<(usize, Vec<f64>)> {
    let layer = &prepared.layers[0];
    let skin = layer.association.blended_skin(&layer.rig);
    let mut masks = vec![vec![0.0; skin.point_count()]; layer.rig.skeleton.bones().len()];
    (0..skin.point_count())
        .for_each(|point| skin.of(point).for_each(|(bone, weight)| masks[bone][point] = weight));
    masks.into_iter().enumerate().filter(|(_, mask)| mask.iter().any(|weight| *weight > 0.0)).collect()
}

/// `basisᵀ · diag(weights · mask) · basis`: what is left of amounts where the mask is one, seen in the space again.
fn mixing(space: &LinearSpace, mask: &[f64]) -> DMatrix<f64> {
    let basis = space.basis();
    let mut masked = basis.clone();
    for mut column in masked.column_iter_mut() {
        for (vertex, mask) in mask.iter().enumerate() {
            (0..3).for_each(|axis| column[3 * vertex + axis] *= mask);
        }
        column.iter_mut().zip(space.weights()).for_each(|(value, weight)| *value *= weight);
    }
    basis.tr_mul(&masked)
}

/// Area around each vertex of a mesh, scaled to a mean of one.
pub(super) fn relative_areas(vertices: &[DVec3], faces: &[[u32; 3]]) -> Vec<f64> {
    let mut areas = vec![0.0; vertices.len()];
    for face in faces {
        let [a, b, c] = face.map(|vertex| vertices[vertex as usize]);
        let third = (b - a).cross(c - a).length() / 6.0;
        face.iter().for_each(|vertex| areas[*vertex as usize] += third);
    }
    let mean = areas.iter().sum::<f64>() / areas.len().max(1) as f64;
    // A vertex without area still has a place in the space.
    areas.iter().map(|area| (area / mean).max(1e-3)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::fixture;

    #[test]
    fn joints_are_counted_along_the_tree() {
        let model = fixture::model();
        let skeleton = model.skeleton();
        for bone in 0..skeleton.bones().len() {
            assert_eq!(joints_between(skeleton, bone, bone), 0);
            if let Some(parent) = skeleton.bones()[bone].parent {
                assert_eq!(joints_between(skeleton, bone, parent), 1);
            }
        }
        let named = |name: &str| skeleton.bones().iter().position(|bone| bone.name == name).unwrap();
        assert_eq!(joints_between(skeleton, named("left_shank"), named("right_shank")), 4);
    }
}
