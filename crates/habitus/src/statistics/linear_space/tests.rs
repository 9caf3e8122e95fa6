use nalgebra::DMatrix;

use super::*;
use crate::artifacts::npz::{NpzReader, NpzWriter};
use crate::statistics::{GramMatrix, GramPrecision};

/// Samples with a falling spectrum about a mean far from zero, as bodies have.
fn samples(count: usize, length: usize, factors: usize) -> SampleMatrix {
    let mut stream = crate::statistics::RandomStream::named(7, "test samples");
    let mut draw = |rows, columns| DMatrix::from_fn(rows, columns, |_, _| stream.normal());
    let directions = draw(length, factors);
    let mut scores = draw(factors, count);
    for (k, mut row) in scores.row_iter_mut().enumerate() {
        row *= 0.8_f64.powi(k as i32);
    }
    let mut values = directions * scores + draw(length, count) * 1e-3;
    values.add_scalar_mut(3.0);
    values.into()
}

fn settings(components: usize) -> LinearSpaceSettings {
    LinearSpaceSettings::with_components(components)
}

fn largest_difference(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}

/// How far `basisᵀ W basis` is from the identity.
fn orthonormality_error(space: &LinearSpace) -> f64 {
    let mut weighted = space.basis().clone();
    for (mut row, weight) in weighted.row_iter_mut().zip(space.weights()) {
        row *= *weight;
    }
    let count = space.component_count();
    (space.basis().transpose() * weighted - DMatrix::identity(count, count)).amax()
}

#[test]
fn a_full_rank_space_reproduces_its_samples() {
    let samples = samples(23, 300, 30);
    let space = LinearSpace::learn(&samples, &settings(100)).expect("learns");
    assert_eq!(space.component_count(), 22, "one degree of freedom is the mean");
    for sample in samples.samples() {
        assert!(largest_difference(sample, &space.project(sample)) < 1e-9);
    }
    let sum: f64 = space.standard_deviations().iter().map(|deviation| deviation * deviation).sum();
    assert!((sum / space.total_variance() - 1.0).abs() < 1e-12, "nothing is left over");
}

#[test]
fn components_are_those_of_a_plain_singular_value_decomposition() {
    // More coordinates than a slab and more samples than a tile, so that sums over both are exercised.
    let samples = samples(270, 4200, 20);
    let space = LinearSpace::learn(&samples, &settings(12)).expect("learns");
    let mut centred = samples.columns().into_owned();
    let mean = nalgebra::DVector::from_vec(samples.mean());
    centred.column_iter_mut().for_each(|mut column| column -= &mean);
    // The decomposition of the 270 × 270 triangle has the same values and is quicker than that of all coordinates.
    let svd = centred.clone().qr().unpack().1.svd(false, true);
    let right = svd.v_t.expect("was asked for").transpose();
    for component in 0..12 {
        let expected = svd.singular_values[component] / 269.0_f64.sqrt();
        assert!((space.standard_deviations()[component] / expected - 1.0).abs() < 1e-12);
        let direction = (&centred * right.column(component)).normalize();
        assert!((direction.dot(&space.basis().column(component)).abs() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn the_basis_is_orthonormal_in_the_weights_it_was_learnt_with() {
    let samples = samples(40, 500, 60);
    let weights: Vec<f64> = (0..500).map(|k| 0.2 + f64::from(k % 7)).collect();
    for weights in [&[][..], &weights] {
        let space = LinearSpace::learn_weighted(&samples, weights, &settings(39)).expect("learns");
        assert!(orthonormality_error(&space) < 1e-12);
    }
}

#[test]
fn weights_are_scaled_coordinates() {
    let samples = samples(30, 200, 40);
    let weights: Vec<f64> = (0..200).map(|k| 1.0 + f64::from(k % 3)).collect();
    let mut scaled = samples.clone();
    for index in 0..samples.len() {
        let values = scaled.sample_mut(index).iter_mut().zip(&weights);
        values.for_each(|(value, weight)| *value *= weight.sqrt());
    }
    let weighted = LinearSpace::learn_weighted(&samples, &weights, &settings(5)).expect("learns");
    let plain = LinearSpace::learn(&scaled, &settings(5)).expect("learns");
    let (left, right) = (weighted.standard_deviations(), plain.standard_deviations());
    assert!(largest_difference(left, right) < 1e-12);
    for index in 0..samples.len() {
        let coefficients = weighted.coefficients(samples.sample(index));
        let expected = plain.coefficients(scaled.sample(index));
        // Signs are settled on different coordinates.
        let pairs = coefficients.iter().zip(&expected);
        assert!(pairs.fold(0.0_f64, |worst, (x, y)| worst.max((x.abs() - y.abs()).abs())) < 1e-9);
    }
}

#[test]
fn coefficients_of_an_instance_come_back() {
    let space = LinearSpace::learn(&samples(30, 200, 10), &settings(6)).expect("learns");
    let coefficients = [0.5, -2.0, 1.0, 3.0, -0.25, 0.125];
    let found = space.coefficients(&space.instance(&coefficients));
    assert!(largest_difference(&found, &coefficients) < 1e-12);
    let short = space.truncated(2);
    assert_eq!(short.component_count(), 2);
    assert_eq!(short.instance(&coefficients), space.instance(&coefficients[..2]));
}

#[test]
fn coefficients_of_the_samples_have_unit_variance() {
    let samples = samples(200, 90, 8);
    let space = LinearSpace::learn(&samples, &settings(5)).expect("learns");
    let all: Vec<Vec<f64>> = samples.samples().map(|sample| space.coefficients(sample)).collect();
    for component in 0..5 {
        let variance = all.iter().map(|c| c[component] * c[component]).sum::<f64>() / 199.0;
        assert!((variance - 1.0).abs() < 1e-10);
    }
}

#[test]
fn single_precision_products_and_power_iterations_give_the_same_space() {
    let samples = samples(320, 5000, 60);
    let exact = LinearSpace::learn(&samples, &settings(20)).expect("learns");
    let single = LinearSpaceSettings { double_precision_up_to_samples: 0, ..settings(20) };
    let power = LinearSpaceSettings { exact_up_to_samples: 0, ..settings(20) };
    for (name, settings) in [("f32", single), ("power", power)] {
        let space = LinearSpace::learn(&samples, &settings).expect("learns");
        assert!(orthonormality_error(&space) < 1e-12);
        for (found, expected) in space.standard_deviations().iter().zip(exact.standard_deviations()) {
            assert!((found / expected - 1.0).abs() < 1e-9, "{name}: {found} for {expected}");
        }
        assert!((space.total_variance() / exact.total_variance() - 1.0).abs() < 1e-6, "{name}");
        // What the two spaces make of a sample, in standard deviations of the noise (1e-3): far below it.
        for sample in samples.samples().take(5) {
            let difference = largest_difference(&space.project(sample), &exact.project(sample));
            assert!(difference < 2e-6, "{name}: {difference}");
        }
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let samples = samples(300, 4500, 20);
    let learn = |threads: usize, settings: &LinearSpaceSettings| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| LinearSpace::learn(&samples, settings).expect("learns"))
    };
    let single = LinearSpaceSettings { double_precision_up_to_samples: 0, ..settings(10) };
    let power = LinearSpaceSettings { exact_up_to_samples: 0, power_iterations: 2, ..settings(10) };
    for settings in [settings(10), single, power] {
        assert_eq!(learn(1, &settings), learn(3, &settings));
    }
}

#[test]
fn repeated_samples_leave_no_made_up_components() {
    let mut samples = samples(5, 60, 5);
    for index in 0..5 {
        let copy = samples.sample(index).to_vec();
        samples.push(&copy);
    }
    let space = LinearSpace::learn(&samples, &settings(9)).expect("learns");
    assert_eq!(space.component_count(), 4);
    assert!(orthonormality_error(&space) < 1e-12);
}

#[test]
fn the_products_of_a_subset_are_those_of_its_own_mean() {
    let samples = samples(12, 80, 20);
    let picked = [1, 4, 5, 9, 11];
    let whole = GramMatrix::of(&samples, GramPrecision::Double);
    let expected = GramMatrix::of(&samples.subset(&picked), GramPrecision::Double);
    let difference = (whole.of_subset(&picked).values() - expected.values()).amax();
    assert!(difference < 1e-12 * expected.values().amax());
}

#[test]
fn what_cannot_be_learnt_is_refused_by_name() {
    let mut few = samples(1, 10, 3);
    let learn = |samples: &SampleMatrix, weights: &[f64]| {
        LinearSpace::learn_weighted(samples, weights, &settings(3)).expect_err("is refused")
    };
    assert_eq!(learn(&few, &[]), LinearSpaceError::TooFewSamples { found: 1 });
    let copy = few.sample(0).to_vec();
    few.push(&copy);
    assert_eq!(learn(&few, &[]), LinearSpaceError::NoVariation { found: 2 });
    let mut weights = vec![1.0; 10];
    weights[4] = 0.0;
    assert_eq!(learn(&few, &weights), LinearSpaceError::BadWeight { coordinate: 4, value: 0.0 });
    assert!(learn(&few, &weights[..3]).to_string().contains("length 3"));
    few.sample_mut(1)[7] = f64::NAN;
    assert_eq!(learn(&few, &[]), LinearSpaceError::NotFinite { sample: 1, coordinate: 7 });
}

#[test]
fn the_file_gives_the_space_back() {
    let samples = samples(12, 30, 6);
    let weights: Vec<f64> = (1..=30).map(f64::from).collect();
    for weights in [&[][..], &weights] {
        let space = LinearSpace::learn_weighted(&samples, weights, &settings(4)).expect("learns");
        let mut file = NpzWriter::new();
        space.add_to(&mut file, "shape_");
        let bytes = file.into_bytes().expect("is written");
        let mut file = NpzReader::new(bytes, std::path::Path::new("space.npz")).expect("opens");
        assert_eq!(LinearSpace::read_from(&mut file, "shape_").expect("reads"), space);
        assert!(LinearSpace::read_from(&mut file, "other_").is_err());
    }
}
