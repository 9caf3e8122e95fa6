use habitus_optimize::{assert_derivatives_match, assert_same_contributions};
use nalgebra::DMatrix;

use super::*;

const SHAPE: NetworkShape = NetworkShape { widths: [3, 4, 5, 2] };
const OUTPUT_WEIGHTS: [f64; 2] = [0.7, 2.5];

fn rows(count: usize, width: usize, name: &str) -> DMatrix<f64> {
    let mut random = RandomStream::named(9, name);
    DMatrix::from_fn(count, width, |_, _| random.normal())
}

/// The loss row by row and output by output, with slopes by the chain rule written out: the oracle.
struct PlainLoss<'a>(&'a NetworkLoss<'a>);

impl Objective for PlainLoss<'_> {
    fn parameter_count(&self) -> usize {
        self.0.parameter_count()
    }

    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
        let loss = self.0;
        let [inputs, first, second, outputs] = loss.shape.widths;
        let layers: Vec<_> = (0..3).map(|layer| loss.shape.layer(parameters, layer)).collect();
        let at = |layer: usize, unit: usize, input: usize| {
            loss.shape.start_of(layer) + input * loss.shape.widths[layer + 1] + unit
        };
        for row in 0..loss.targets.ncols() {
            let x: Vec<f64> = loss.inputs.column(row).iter().copied().collect();
            let sum = |layer: usize, unit: usize, below: &[f64]| -> f64 {
                below.iter().enumerate().map(|(k, b)| layers[layer][(unit, k)] * b).sum()
            };
            let mut a: Vec<f64> = (0..first).map(|unit| sum(0, unit, &x).tanh()).collect();
            a.push(1.0);
            let mut b: Vec<f64> = (0..second).map(|unit| sum(1, unit, &a).tanh()).collect();
            b.push(1.0);
            for output in 0..outputs {
                let residual = sum(2, output, &b) - loss.targets[(output, row)];
                let mut slope = vec![0.0; parameters.len()];
                for k in 0..=second {
                    slope[at(2, output, k)] = b[k];
                }
                for k in 0..second {
                    let s = layers[2][(output, k)] * (1.0 - b[k] * b[k]);
                    for j in 0..=first {
                        slope[at(1, k, j)] += s * a[j];
                    }
                    for j in 0..first {
                        let t = s * layers[1][(k, j)] * (1.0 - a[j] * a[j]);
                        for i in 0..=inputs {
                            slope[at(0, j, i)] += t * x[i];
                        }
                    }
                }
                let columns: Vec<usize> = (0..parameters.len()).collect();
                sink.add(loss.output_weights[output] / loss.row_count(), &[residual], &columns, &slope);
            }
        }
        for (index, parameter) in parameters.iter().enumerate() {
            sink.add(loss.weight_decay / parameters.len() as f64, &[*parameter], &[index], &[1.0]);
        }
    }
}

#[test]
fn the_batched_loss_has_the_right_derivatives_and_is_the_plain_one() {
    let (inputs, targets) = (rows(7, 3, "inputs"), rows(7, 2, "targets"));
    let loss = NetworkLoss::new(SHAPE, &inputs, &targets, &OUTPUT_WEIGHTS, 0.3);
    let at = initial_parameters(SHAPE, 1.0, 3);
    assert_derivatives_match(&loss, &at);
    assert_derivatives_match(&PlainLoss(&loss), &at);
    assert_same_contributions(&loss, &PlainLoss(&loss), &at);
}

#[test]
fn our_tanh_is_the_library_s() {
    for k in -4000..=4000 {
        let x = 0.01 * f64::from(k);
        assert!((tanh(x) - x.tanh()).abs() <= 4.0 * f64::EPSILON, "{x}");
    }
    assert_eq!(tanh(1e-12), 1e-12);
}

/// A smooth law of two inputs, one of them nearly without effect on the second output.
fn law(inputs: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(inputs.nrows(), 2, |row, k| {
        let (x, y) = (inputs[(row, 0)], inputs[(row, 1)]);
        if k == 0 { 30.0 * (x + 0.5 * y).sin() + 100.0 } else { 0.2 * x * y - 3.0 }
    })
}

#[test]
fn training_learns_a_smooth_law_and_is_the_same_on_every_number_of_threads() {
    let inputs = rows(240, 2, "law");
    let targets = law(&inputs);
    let (training, validation): (Vec<usize>, Vec<usize>) = (0..200).partition(|row| row % 5 != 0);
    let config = NetworkConfig { ensemble: 3, hidden_units: [12, 10], ..NetworkConfig::default() };
    let train = || NetworkRegressor::train(&inputs, &targets, &training, &validation, &config, 5).unwrap();
    let (regressor, records) = train();
    let unseen: Vec<usize> = (200..240).collect();
    let error = regressor.predict(&inputs.select_rows(&unseen)) - targets.select_rows(&unseen);
    let root_mean_square = (error.column(0).norm_squared() / 40.0).sqrt();
    assert!(root_mean_square < 2.0, "of a deviation near 20: {root_mean_square}");
    assert_eq!(records.len(), 3);
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(train);
    assert_eq!(one_thread.0, regressor);
}

#[test]
fn training_stops_where_the_validation_error_is_lowest() {
    // Targets are noise: every step beyond the first few makes the validation rows worse.
    let (inputs, targets) = (rows(60, 4, "noise in"), rows(60, 2, "noise out"));
    let training: Vec<usize> = (0..40).collect();
    let validation: Vec<usize> = (40..60).collect();
    let short = NetworkConfig { patience: 5, ..NetworkConfig::default() };
    let never = NetworkConfig { patience: 1000, max_iterations: 200, ..NetworkConfig::default() };
    let train =
        |config| NetworkRegressor::train(&inputs, &targets, &training, &validation, config, 1).unwrap().1;
    let (early, late) = (train(&short), train(&never));
    assert!(early[0].iterations < 40, "{early:?}");
    assert!(early[0].validation_loss >= late[0].validation_loss, "the longer look finds no worse network");
    assert!(early[0].validation_loss < 4.0, "not far above the variance, 2");
}

#[test]
fn rows_that_do_not_match_are_refused() {
    let result = NetworkRegressor::train(
        &rows(5, 2, "a"),
        &rows(4, 2, "b"),
        &[0, 1],
        &[],
        &NetworkConfig::default(),
        0,
    );
    assert!(matches!(result, Err(NetworkError::Rows { inputs: 5, targets: 4, .. })));
}
