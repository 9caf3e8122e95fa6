//! The check that every objective passes before a solver may trust it.

use nalgebra::{DMatrix, DVector};

use crate::Objective;
use crate::sink::{Gradient, NormalEquations, Sink, ValueSum, Wanted};

/// How an objective contradicts itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Mismatch {
    /// The law that fails.
    pub law: &'static str,
    /// Where: a direction, a parameter or a matrix entry.
    pub place: String,
    /// What the objective says.
    pub coded: f64,
    /// What follows from its values.
    pub expected: f64,
}

impl std::fmt::Display for Mismatch {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            formatter,
            "{}, {}: coded {:e}, expected {:e}",
            self.law, self.place, self.coded, self.expected
        )
    }
}

/// Relative error that a derivative may have.
const TOLERANCE: f64 = 1e-6;
/// Relative error that sums of the same numbers in another order may have.
const SUM_TOLERANCE: f64 = 1e-10;
/// Difference steps. A smooth objective is resolved by the first; one with kinks (a hinge) by the shorter ones, which cross
/// fewer. A wrong derivative agrees with none of them.
const DIFFERENCE_STEPS: [f64; 3] = [1e-3, 1e-4, 1e-5];
const DIRECTION_COUNT: usize = 8;
const COORDINATE_COUNT: usize = 32;

/// Panics, naming the law and the place, unless the derivatives of `objective` at `at` follow from its values.
///
/// See [`derivative_mismatch`] for what is compared.
pub fn assert_derivatives_match(objective: &dyn Objective, at: &[f64]) {
    let mismatch = derivative_mismatch(objective, at);
    assert!(mismatch.is_none(), "{}", mismatch.map(|m| m.to_string()).unwrap_or_default());
}

/// The first way in which `objective` contradicts itself at `at`, if any.
///
/// All three sinks must see the same energy; the gradient must equal central differences of it in seeded random directions
/// and single parameters to 1e-6; Jᵀ W r must be half the gradient; the normal matrix must equal Jᵀ W J of recorded blocks;
/// and each plain block's Jacobian must equal differences of its residual to 1e-6. Builds dense matrices: meant for small
/// problems.
pub fn derivative_mismatch(objective: &dyn Objective, at: &[f64]) -> Option<Mismatch> {
    let count = objective.parameter_count();
    if at.len() != count {
        return Some(Mismatch {
            law: "parameter count",
            place: "point of the check".into(),
            coded: count as f64,
            expected: at.len() as f64,
        });
    }
    let gradient = Gradient::of(objective, at);
    let normal = NormalEquations::of(objective, at);
    values_differ(objective, at, &gradient, &normal)
        .or_else(|| slopes_differ(objective, at, &gradient))
        .or_else(|| normal_equations_differ(objective, at, &gradient, &normal))
        .or_else(|| jacobians_differ(objective, at))
}

/// Panics unless two objectives add the same energy, gradient and normal equations at `at`, up to rounding.
///
/// For a batched kernel beside the plain form of the same formula.
pub fn assert_same_contributions(one: &dyn Objective, other: &dyn Objective, at: &[f64]) {
    let (a, b) = (NormalEquations::of(one, at), NormalEquations::of(other, at));
    let (slope_a, slope_b) = (Gradient::of(one, at), Gradient::of(other, at));
    let (value_a, value_b) = (ValueSum::of(one, at).value, ValueSum::of(other, at).value);
    let mismatch = numbers_differ("same energy", &[value_a], &[value_b])
        .or_else(|| numbers_differ("same energy beside the normal equations", &[a.value], &[b.value]))
        .or_else(|| numbers_differ("same gradient", &slope_a.gradient, &slope_b.gradient))
        .or_else(|| {
            numbers_differ("same half gradient", a.half_gradient.as_slice(), b.half_gradient.as_slice())
        })
        .or_else(|| numbers_differ("same normal matrix", a.matrix.as_slice(), b.matrix.as_slice()));
    assert!(mismatch.is_none(), "{}", mismatch.map(|m| m.to_string()).unwrap_or_default());
}

/// Compares two lists relative to the largest number in them.
fn numbers_differ(law: &'static str, coded: &[f64], expected: &[f64]) -> Option<Mismatch> {
    let scale = coded.iter().chain(expected).fold(0.0_f64, |largest, x| largest.max(x.abs()));
    coded.iter().zip(expected).enumerate().find_map(|(i, (&coded, &expected))| {
        let agrees = (coded - expected).abs() <= SUM_TOLERANCE * scale;
        (!agrees).then(|| Mismatch { law, place: format!("entry {i}"), coded, expected })
    })
}

fn values_differ(
    objective: &dyn Objective,
    at: &[f64],
    gradient: &Gradient,
    normal: &NormalEquations,
) -> Option<Mismatch> {
    let value = ValueSum::of(objective, at).value;
    if !value.is_finite() {
        return Some(Mismatch { law: "finite energy", place: "value".into(), coded: value, expected: 0.0 });
    }
    numbers_differ("the gradient sink sees the energy of the value sink", &[gradient.value], &[value])
        .or_else(|| {
            numbers_differ("the normal equations see the energy of the value sink", &[normal.value], &[value])
        })
}

/// The directions of the check: a few dense random ones, then single parameters.
fn directions(count: usize) -> Vec<(String, Vec<f64>)> {
    let mut random = Random(1);
    let dense = (0..DIRECTION_COUNT)
        .map(|k| (format!("random direction {k}"), (0..count).map(|_| random.signed()).collect()))
        .collect::<Vec<_>>();
    let singles: Vec<usize> = if count <= COORDINATE_COUNT {
        (0..count).collect()
    } else {
        (0..COORDINATE_COUNT).map(|_| random.below(count)).collect()
    };
    let axes = singles.into_iter().map(|index| {
        let mut axis = vec![0.0; count];
        axis[index] = 1.0;
        (format!("parameter {index}"), axis)
    });
    dense.into_iter().chain(axes).collect()
}

fn slopes_differ(objective: &dyn Objective, at: &[f64], gradient: &Gradient) -> Option<Mismatch> {
    let steepness = norm(&gradient.gradient);
    for (place, direction) in directions(at.len()) {
        let coded: f64 = gradient.gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let mut closest = f64::NAN;
        let agrees = DIFFERENCE_STEPS.iter().any(|&step| {
            let energy = |scale: f64| ValueSum::of(objective, &moved(at, &direction, scale * step)).value;
            let numeric = extrapolated(energy(1.0) - energy(-1.0), energy(0.5) - energy(-0.5), step);
            if closest.is_nan() || (numeric - coded).abs() < (closest - coded).abs() {
                closest = numeric;
            }
            // A direction across the gradient is judged by the steepness around it, and none by less than rounding shows.
            let scale = numeric.abs().max(coded.abs()).max(1e-2 * steepness * norm(&direction));
            let rounding = 16.0 * f64::EPSILON * gradient.value.abs() / step;
            (numeric - coded).abs() <= TOLERANCE * scale + rounding
        });
        if !agrees {
            let law = "the gradient is the slope of the energy";
            return Some(Mismatch { law, place, coded, expected: closest });
        }
    }
    None
}

fn normal_equations_differ(
    objective: &dyn Objective,
    at: &[f64],
    gradient: &Gradient,
    normal: &NormalEquations,
) -> Option<Mismatch> {
    let half: Vec<f64> = gradient.gradient.iter().map(|g| g / 2.0).collect();
    let recorded = Recorder::of(objective, at).normal_matrix();
    numbers_differ("Jᵀ W r is half the gradient", normal.half_gradient.as_slice(), &half).or_else(|| {
        numbers_differ("the normal matrix is Jᵀ W J", normal.matrix.as_slice(), recorded.as_slice())
    })
}

/// Compares each plain block's Jacobian with differences of its residual: the energy alone cannot see a Jacobian error that
/// is orthogonal to the residual.
fn jacobians_differ(objective: &dyn Objective, at: &[f64]) -> Option<Mismatch> {
    let blocks = Recorder::blocks_of(objective, at);
    for (place, direction) in directions(at.len()) {
        let mut unresolved: Vec<usize> = (0..blocks.len()).collect();
        let mut last = None;
        for step in DIFFERENCE_STEPS {
            let shifted = [1.0, -1.0, 0.5, -0.5]
                .map(|scale| Recorder::blocks_of(objective, &moved(at, &direction, scale * step)));
            let is_same_list = shifted.iter().all(|list| {
                list.len() == blocks.len()
                    && list.iter().zip(&blocks).all(|(a, b)| a.residual.len() == b.residual.len())
            });
            // An objective may leave out blocks that vanish: where one appears within the step, nothing can be compared.
            if !is_same_list {
                last = None;
                continue;
            }
            unresolved.retain(|&index| {
                let residuals = shifted.each_ref().map(|list| &list[index].residual);
                let fault = blocks[index].fault(residuals, &direction, step);
                last = fault.map(|(coded, expected)| (index, coded, expected)).or(last);
                fault.is_some()
            });
        }
        if let (false, Some((index, coded, expected))) = (unresolved.is_empty(), last) {
            let law = "the Jacobian is the slope of the residual";
            return Some(Mismatch { law, place: format!("block {index} along {place}"), coded, expected });
        }
    }
    None
}

/// Fourth-order central difference from two second-order ones, over the whole and half the step.
fn extrapolated(whole: f64, half: f64, step: f64) -> f64 {
    (4.0 * half / step - whole / (2.0 * step)) / 3.0
}

fn moved(at: &[f64], direction: &[f64], step: f64) -> Vec<f64> {
    at.iter().zip(direction).map(|(x, d)| x + step * d).collect()
}

fn norm(vector: &[f64]) -> f64 {
    vector.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// A block as it was pushed.
struct Block {
    weight: f64,
    residual: Vec<f64>,
    columns: Vec<usize>,
    jacobian: DMatrix<f64>,
}

impl Block {
    /// Coded and differenced slope lengths along `direction`, if they disagree.
    ///
    /// `shifted` holds the residual at +1, −1, +½ and −½ steps.
    fn fault(&self, shifted: [&Vec<f64>; 4], direction: &[f64], step: f64) -> Option<(f64, f64)> {
        let along = DVector::from_iterator(self.columns.len(), self.columns.iter().map(|&c| direction[c]));
        let coded = &self.jacobian * &along;
        let numeric = DVector::from_iterator(
            self.residual.len(),
            (0..self.residual.len()).map(|i| {
                let [ahead, behind, half_ahead, half_behind] = shifted.map(|residual| residual[i]);
                extrapolated(ahead - behind, half_ahead - half_behind, step)
            }),
        );
        let scale = coded.norm().max(numeric.norm()).max(1e-2 * self.jacobian.norm() * along.norm());
        let rounding = 16.0 * f64::EPSILON * norm(&self.residual) / step;
        let agrees = (&numeric - &coded).norm() <= TOLERANCE * scale + rounding;
        (!agrees).then(|| (coded.norm(), numeric.norm()))
    }
}

/// Keeps every block.
struct Recorder {
    blocks: Vec<Block>,
    assembled: DMatrix<f64>,
}

impl Recorder {
    fn of(objective: &dyn Objective, at: &[f64]) -> Self {
        let mut recorder = Self { blocks: Vec::new(), assembled: DMatrix::zeros(at.len(), at.len()) };
        objective.add_to(at, &mut recorder);
        recorder
    }

    fn blocks_of(objective: &dyn Objective, at: &[f64]) -> Vec<Block> {
        Self::of(objective, at).blocks
    }

    fn normal_matrix(&self) -> DMatrix<f64> {
        let mut total = self.assembled.clone();
        for block in &self.blocks {
            let product = block.weight * (block.jacobian.transpose() * &block.jacobian);
            for (k, &row) in block.columns.iter().enumerate() {
                for (l, &column) in block.columns.iter().enumerate() {
                    total[(row, column)] += product[(k, l)];
                }
            }
        }
        total
    }
}

impl Sink for Recorder {
    fn wanted(&self) -> Wanted {
        Wanted::NormalEquations
    }

    fn add(&mut self, weight: f64, residual: &[f64], columns: &[usize], jacobian: &[f64]) {
        let jacobian = DMatrix::from_row_slice(residual.len(), columns.len(), jacobian);
        self.blocks.push(Block { weight, residual: residual.to_vec(), columns: columns.to_vec(), jacobian });
    }

    fn add_assembled(&mut self, _: f64, columns: &[usize], _: &[f64], normal_matrix: Option<&DMatrix<f64>>) {
        let Some(normal_matrix) = normal_matrix else { return };
        for (k, &row) in columns.iter().enumerate() {
            for (l, &column) in columns.iter().enumerate() {
                self.assembled[(row, column)] += normal_matrix[(k.max(l), k.min(l))];
            }
        }
    }
}

/// A small seeded generator (Steele, Lea and Flood 2014, SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number in [−1, 1).
    fn signed(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    fn below(&mut self, count: usize) -> usize {
        (self.next() % count as u64) as usize
    }
}
