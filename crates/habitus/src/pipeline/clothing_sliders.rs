//! What each slider of a clothing model moves, and what it does to hems.

use glam::DVec3;
use habitus_geometry::Topology;
use nalgebra::DMatrix;

use super::clothing_evaluation::PENETRATION_FRAMES;
use super::clothing_model_run::ClothingModelRunError;
use crate::artifacts::clothing_layer::ClothingLayer;
use crate::evaluation::clothing_metrics::{ClothingMetrics, HemResponse};
use crate::stages::learn_clothing::{
    ClothingRecipe, LearnClothingConfig, Learnt, PreparedLayers, learn_rows,
};

/// Values of a control, from its smallest to its largest.
const STEPS: usize = 9;

/// Each control alone from its smallest to its largest value, the others at their means, in a model of all frames.
pub(super) fn measure_sliders(
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
    let controls = &prepared.controls.controls;
    for (k, control) in controls.iter().enumerate() {
        features.column_mut(first + k).fill(control.default);
    }
    let borders = Borders::of(&prepared.layers[0]);
    for (k, control) in controls.iter().enumerate() {
        let mut hems = HemResponse::default();
        let mut ends = Vec::new();
        for step in 0..STEPS {
            let share = step as f64 / (STEPS - 1) as f64;
            let value = control.minimum + share * (control.maximum - control.minimum);
            features.column_mut(first + k).fill(value);
            let offsets = predicted(prepared, &learnt, &features);
            hems.values.push(value);
            for (name, length) in borders.lengths_mm(&offsets) {
                hems.lengths_mm.entry(name).or_default().push(length);
            }
            for (name, height) in borders.heights_mm(&offsets) {
                hems.heights_mm.entry(name).or_default().push(height);
            }
            if step == 0 || step + 1 == STEPS {
                ends.push(offsets);
            }
        }
        features.column_mut(first + k).fill(control.default);
        let response = moved_by_bone(&prepared.layers[0], &ends[0], &ends[1]);
        metrics.control_response_mm.insert(control.name.clone(), response.into_iter().collect());
        if !hems.lengths_mm.is_empty() {
            metrics.hem_response.insert(control.name.clone(), hems);
        }
    }
    Ok(())
}

/// Offsets of each row of features.
fn predicted(prepared: &PreparedLayers, learnt: &Learnt, features: &DMatrix<f64>) -> Vec<Vec<f64>> {
    prepared.offsets_of_amounts(&learnt.space, &learnt.regressor.predict(features))
}

/// Mean movement of the clothing on each bone in mm, for bones that carry at least a vertex's worth of it.
fn moved_by_bone(layer: &ClothingLayer, low: &[Vec<f64>], high: &[Vec<f64>]) -> Vec<(String, f64)> {
    let skin = layer.association.blended_skin(&layer.rig);
    let mut moved = vec![(0.0, 0.0); layer.rig.skeleton.bones().len()];
    for point in 0..skin.point_count() {
        let at = |offsets: &[f64]| DVec3::from_slice(&offsets[3 * point..]);
        let distances = low.iter().zip(high).map(|(low, high)| at(low).distance(at(high)));
        let mean = distances.sum::<f64>() / low.len().max(1) as f64;
        for (bone, weight) in skin.of(point) {
            moved[bone].0 += weight * mean;
            moved[bone].1 += weight;
        }
    }
    let bones = layer.rig.skeleton.bones().iter().zip(moved);
    let carrying = bones.filter(|(_, (_, weight))| *weight > 1.0);
    carrying.map(|(bone, (sum, weight))| (bone.name.clone(), 1000.0 * sum / weight)).collect()
}

/// The borders of a clothing and where its vertices hang, at rest.
struct Borders {
    anchors: Vec<DVec3>,
    loops: Vec<(String, Vec<u32>)>,
}

impl Borders {
    /// Each border under the name of the bone that carries most of it; a second one of a bone gets a number.
    fn of(layer: &ClothingLayer) -> Self {
        let anchors = layer.association.anchors(&layer.rest_vertices);
        let topology = Topology::new(anchors.len(), &layer.clothing_faces);
        let skin = layer.association.blended_skin(&layer.rig);
        let bones = layer.rig.skeleton.bones();
        let mut loops: Vec<(String, Vec<u32>)> = Vec::new();
        let mut found = topology.boundary_loops();
        let height = |border: &[u32]| {
            let sum: f64 = border.iter().map(|vertex| anchors[*vertex as usize].y).sum();
            sum / border.len().max(1) as f64
        };
        found.sort_by(|a, b| height(a).total_cmp(&height(b)));
        for border in found {
            let mut weights = vec![0.0; bones.len()];
            for vertex in &border {
                skin.of(*vertex as usize).for_each(|(bone, weight)| weights[bone] += weight);
            }
            let heaviest = (0..bones.len()).max_by(|a, b| weights[*a].total_cmp(&weights[*b])).unwrap_or(0);
            let name = bones.get(heaviest).map_or_else(String::new, |bone| bone.name.clone());
            let same = loops.iter().filter(|(known, _)| known.split(' ').next() == Some(&name)).count();
            loops.push((if same == 0 { name } else { format!("{name} {}", same + 1) }, border));
        }
        Self { anchors, loops }
    }

    /// Mean length of each border over rows of offsets, in mm.
    fn lengths_mm(&self, offsets: &[Vec<f64>]) -> Vec<(String, f64)> {
        self.means_mm(offsets, |places| {
            let next = places.iter().cycle().skip(1);
            places.iter().zip(next).map(|(a, b)| a.distance(*b)).sum()
        })
    }

    /// Mean height of each border over rows of offsets, in mm.
    fn heights_mm(&self, offsets: &[Vec<f64>]) -> Vec<(String, f64)> {
        self.means_mm(offsets, |places| {
            places.iter().map(|place| place.y).sum::<f64>() / places.len().max(1) as f64
        })
    }

    /// Mean over rows of offsets of what is measured, in metres, on the places of each border at rest.
    fn means_mm(&self, offsets: &[Vec<f64>], measure: impl Fn(&[DVec3]) -> f64) -> Vec<(String, f64)> {
        let mean = |border: &[u32]| {
            let measured = offsets.iter().map(|offsets| {
                let place = |vertex: &u32| {
                    let vertex = *vertex as usize;
                    self.anchors[vertex] + DVec3::from_slice(&offsets[3 * vertex..])
                };
                measure(&border.iter().map(place).collect::<Vec<DVec3>>())
            });
            1000.0 * measured.sum::<f64>() / offsets.len().max(1) as f64
        };
        self.loops.iter().map(|(name, border)| (name.clone(), mean(border))).collect()
    }
}
