//! The regressor of P3 §3.3: a fully connected network with two hidden layers of tanh units and a linear output.
//!
//! Inputs and outputs are standardised, and each output's error is weighted by the square of its deviation, so that the
//! loss is a mean square error in the unit of the targets. Training is a quasi-Newton descent that stops when the error
//! on validation rows no longer falls.
//!
//! Deviation: P3 does not say how inputs and outputs are scaled; see book/src/deviations.md.

use habitus_optimize::{
    Bounds, Event, Flow, LbfgsbSettings, Objective, Observer, Sink, SolveError, Tolerances, Wanted, lbfgsb,
};
use nalgebra::{DMatrix, DMatrixView};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::RandomStream;
use super::standardization::Standardization;

/// How a network is built and trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// Units of the two hidden layers. P3 §3.3: 60 and 80.
    pub hidden_units: [usize; 2],
    /// Weight of the mean square of the network's weights, relative to the variance of the targets; 0 in P3.
    pub weight_decay: f64,
    /// Descent ends after this many steps in a row without a lower validation error. P3 §3.3 stops "once validation error
    /// starts to increase".
    pub patience: usize,
    /// Descent ends after this many steps.
    pub max_iterations: usize,
    /// Spread of the first weights against that of unit variance through each layer: smaller is smoother.
    pub initial_scale: f64,
    /// Starts of each network, of which the one with the lowest validation error is kept. P3 does not say; the first descent alone
    /// depends on its start.
    pub starts: usize,
    /// Networks that are trained from different starts; their mean is the prediction. 1 in P3.
    pub ensemble: usize,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self {
            hidden_units: [60, 80],
            weight_decay: 0.0,
            patience: 40,
            max_iterations: 600,
            initial_scale: 0.3,
            starts: 4,
            ensemble: 1,
        }
    }
}

/// Why no network can be trained.
#[derive(Debug, Error, PartialEq)]
pub enum NetworkError {
    /// Inputs and targets do not belong together, or there is nothing to learn from.
    #[error(
        "{inputs} rows of inputs and {targets} rows of targets, of which {training} are for training: a network needs \
         as many of both, and at least two for training"
    )]
    Rows {
        /// Rows of inputs.
        inputs: usize,
        /// Rows of targets.
        targets: usize,
        /// Rows for training.
        training: usize,
    },
    /// The descent failed.
    #[error("training failed: {0}")]
    Solve(#[from] SolveError),
}

/// Widths of the four layers, and where each weight stands in the parameter vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkShape {
    /// Inputs, first hidden layer, second hidden layer, outputs.
    pub widths: [usize; 4],
}

impl NetworkShape {
    /// Number of weights and biases.
    pub fn parameter_count(self) -> usize {
        (0..3).map(|layer| self.layer_length(layer)).sum()
    }

    fn layer_length(self, layer: usize) -> usize {
        self.widths[layer + 1] * (self.widths[layer] + 1)
    }

    fn start_of(self, layer: usize) -> usize {
        (0..layer).map(|earlier| self.layer_length(earlier)).sum()
    }

    /// Weights of a layer, one row for each unit; the last column is the bias.
    fn layer(self, parameters: &[f64], layer: usize) -> DMatrixView<'_, f64> {
        let start = self.start_of(layer);
        let values = &parameters[start..start + self.layer_length(layer)];
        DMatrixView::from_slice(values, self.widths[layer + 1], self.widths[layer] + 1)
    }

    /// Activations of all layers; columns are rows of data, and inner layers end with a row of ones for the bias.
    fn activations(self, parameters: &[f64], inputs: &DMatrix<f64>) -> [DMatrix<f64>; 3] {
        let first = hidden(&(self.layer(parameters, 0) * inputs));
        let second = hidden(&(self.layer(parameters, 1) * &first));
        let output = self.layer(parameters, 2) * &second;
        [first, second, output]
    }
}

/// tanh of each entry, with a row of ones below.
fn hidden(sums: &DMatrix<f64>) -> DMatrix<f64> {
    let (units, rows) = sums.shape();
    let mut activations = DMatrix::from_element(units + 1, rows, 1.0);
    for (mut to, from) in activations.column_iter_mut().zip(sums.column_iter()) {
        to.as_mut_slice().iter_mut().zip(from.as_slice()).for_each(|(to, from)| *to = tanh(*from));
    }
    activations
}

/// tanh from one exponential: twice as fast as the library's, and right to 1e-15.
fn tanh(x: f64) -> f64 {
    let decay = (-2.0 * x.abs()).exp_m1();
    (-decay / (2.0 + decay)).copysign(x)
}

/// Rows of data as columns, with a row of ones below.
fn with_ones(rows: &DMatrix<f64>) -> DMatrix<f64> {
    let (count, width) = rows.shape();
    DMatrix::from_fn(width + 1, count, |i, row| if i < width { rows[(row, i)] } else { 1.0 })
}

/// Mean square error of a network on given rows, plus the decay of its weights: an [`Objective`] for the solvers.
///
/// Loss = Σ_rows Σ_outputs weight · (output − target)² / rows + decay · Σ weights² / weights.
pub struct NetworkLoss<'a> {
    shape: NetworkShape,
    /// One column a row of data, ones below.
    inputs: DMatrix<f64>,
    /// One column a row of data.
    targets: DMatrix<f64>,
    output_weights: &'a [f64],
    weight_decay: f64,
}

impl<'a> NetworkLoss<'a> {
    /// The loss on standardised rows; `output_weights` multiply the squared errors of each output.
    pub fn new(
        shape: NetworkShape,
        inputs: &DMatrix<f64>,
        targets: &DMatrix<f64>,
        output_weights: &'a [f64],
        weight_decay: f64,
    ) -> Self {
        assert_eq!(inputs.nrows(), targets.nrows(), "as many rows of inputs as of targets");
        assert_eq!(output_weights.len(), shape.widths[3], "one weight for each output");
        Self { shape, inputs: with_ones(inputs), targets: targets.transpose(), output_weights, weight_decay }
    }

    fn row_count(&self) -> f64 {
        self.targets.ncols().max(1) as f64
    }

    /// Output errors and their weighted mean square.
    fn errors(&self, output: &DMatrix<f64>) -> (DMatrix<f64>, f64) {
        let errors = output - &self.targets;
        let sum: f64 = errors
            .column_iter()
            .map(|column| column.iter().zip(self.output_weights).map(|(e, w)| w * e * e).sum::<f64>())
            .sum();
        (errors, sum / self.row_count())
    }

    /// Half the gradient by back-propagation of half the slopes at the output.
    fn half_gradient(
        &self,
        parameters: &[f64],
        activations: &[DMatrix<f64>; 3],
        mut slopes: DMatrix<f64>,
    ) -> Vec<f64> {
        let shape = self.shape;
        let mut gradient = vec![0.0; shape.parameter_count()];
        for layer in (0..3).rev() {
            let below = if layer == 0 { &self.inputs } else { &activations[layer - 1] };
            let start = shape.start_of(layer);
            (&slopes * below.transpose())
                .as_slice()
                .iter()
                .zip(&mut gradient[start..])
                .for_each(|(value, to)| *to = *value);
            if layer > 0 {
                let weights = shape.layer(parameters, layer);
                slopes = weights.columns(0, shape.widths[layer]).tr_mul(&slopes);
                for (mut column, active) in slopes.column_iter_mut().zip(below.column_iter()) {
                    column.iter_mut().zip(active.iter()).for_each(|(slope, a)| *slope *= 1.0 - a * a);
                }
            }
        }
        gradient
    }

    /// Σ over rows and outputs of the outer products of the outputs' slopes: for small networks, as a check needs it.
    fn normal_matrix(&self, parameters: &[f64], activations: &[DMatrix<f64>; 3]) -> DMatrix<f64> {
        let count = self.shape.parameter_count();
        let mut matrix = DMatrix::zeros(count, count);
        for (row, output) in
            (0..self.targets.ncols()).flat_map(|row| (0..self.output_weights.len()).map(move |o| (row, o)))
        {
            let mut slopes = DMatrix::zeros(self.targets.nrows(), self.targets.ncols());
            slopes[(output, row)] = 1.0;
            let slope = DMatrix::from_vec(count, 1, self.half_gradient(parameters, activations, slopes));
            matrix += (self.output_weights[output] / self.row_count()) * &slope * slope.transpose();
        }
        let decay = self.weight_decay / count as f64;
        (0..count).for_each(|k| matrix[(k, k)] += decay);
        matrix
    }
}

impl Objective for NetworkLoss<'_> {
    fn parameter_count(&self) -> usize {
        self.shape.parameter_count()
    }

    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
        sink.begin_part("network");
        let count = parameters.len();
        let columns: Vec<usize> = (0..count).collect();
        let activations = self.shape.activations(parameters, &self.inputs);
        let (mut errors, data) = self.errors(&activations[2]);
        let decay = self.weight_decay / count as f64;
        let value = data + decay * parameters.iter().map(|p| p * p).sum::<f64>();
        if sink.wanted() == Wanted::Value {
            sink.add_assembled(value, &columns, &vec![0.0; count], None);
            return;
        }
        for mut column in errors.column_iter_mut() {
            column.iter_mut().zip(self.output_weights).for_each(|(e, w)| *e *= w / self.row_count());
        }
        let mut half = self.half_gradient(parameters, &activations, errors);
        half.iter_mut().zip(parameters).for_each(|(half, parameter)| *half += decay * parameter);
        let matrix =
            (sink.wanted() == Wanted::NormalEquations).then(|| self.normal_matrix(parameters, &activations));
        sink.add_assembled(value, &columns, &half, matrix.as_ref());
    }
}

/// A trained regressor from rows of inputs to rows of outputs: one network, or the mean of several.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkRegressor {
    /// Mean and deviation of each input.
    pub inputs: Standardization,
    /// Mean and deviation of each output.
    pub outputs: Standardization,
    /// Widths of the layers.
    pub shape: NetworkShape,
    /// Weights of each network.
    pub members: Vec<Vec<f64>>,
}

/// How a training went.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingRecord {
    /// Steps up to the lowest validation error.
    pub iterations: usize,
    /// Mean square error of the training rows there, summed over outputs, in squared units of the targets.
    pub training_loss: f64,
    /// The same for the validation rows.
    pub validation_loss: f64,
}

impl NetworkRegressor {
    /// Trains on the rows named by `training`, and stops by the rows named by `validation`; without any, by the decrease
    /// of the loss. Rows may stand in both lists or in neither.
    pub fn train(
        inputs: &DMatrix<f64>,
        targets: &DMatrix<f64>,
        training: &[usize],
        validation: &[usize],
        config: &NetworkConfig,
        seed: u64,
    ) -> Result<(Self, Vec<TrainingRecord>), NetworkError> {
        if inputs.nrows() != targets.nrows() || training.len() < 2 {
            return Err(NetworkError::Rows {
                inputs: inputs.nrows(),
                targets: targets.nrows(),
                training: training.len(),
            });
        }
        let input_scale = Standardization::of(&inputs.select_rows(training));
        let output_scale = Standardization::of(&targets.select_rows(training));
        let (x, y) = (input_scale.apply(inputs), output_scale.apply(targets));
        // A weight of σ² makes the error of a standardised output one in the unit of the targets.
        let output_weights: Vec<f64> = output_scale.deviations.iter().map(|sd| sd * sd).collect();
        let decay = config.weight_decay * output_weights.iter().sum::<f64>();
        let shape =
            NetworkShape { widths: [x.ncols(), config.hidden_units[0], config.hidden_units[1], y.ncols()] };
        let part = |rows: &[usize], decay| {
            NetworkLoss::new(shape, &x.select_rows(rows), &y.select_rows(rows), &output_weights, decay)
        };
        let losses = (part(training, decay), part(validation, 0.0));
        let (members, starts) = (config.ensemble.max(1), config.starts.max(1));
        let trained: Result<Vec<_>, NetworkError> = (0..members * starts)
            .into_par_iter()
            .map(|start| train_member(&losses.0, &losses.1, config, seed ^ ((start as u64) << 32)))
            .collect();
        let error = |(_, record): &(Vec<f64>, TrainingRecord)| {
            if validation.is_empty() { record.training_loss } else { record.validation_loss }
        };
        let best = |trained: &[(Vec<f64>, TrainingRecord)]| {
            trained.iter().min_by(|a, b| error(a).total_cmp(&error(b))).cloned()
        };
        let trained = trained?;
        let (members, records) = trained.chunks(starts).filter_map(best).unzip();
        Ok((Self { inputs: input_scale, outputs: output_scale, shape, members }, records))
    }

    /// Outputs for rows of inputs.
    pub fn predict(&self, inputs: &DMatrix<f64>) -> DMatrix<f64> {
        let columns = with_ones(&self.inputs.apply(inputs));
        let mut sum = DMatrix::zeros(self.shape.widths[3], inputs.nrows());
        for parameters in &self.members {
            let [_, _, output] = self.shape.activations(parameters, &columns);
            sum += output;
        }
        self.outputs.undo(&(sum.transpose() / self.members.len().max(1) as f64))
    }
}

fn train_member(
    training: &NetworkLoss,
    validation: &NetworkLoss,
    config: &NetworkConfig,
    seed: u64,
) -> Result<(Vec<f64>, TrainingRecord), NetworkError> {
    let mut parameters = initial_parameters(training.shape, config.initial_scale, seed);
    let mut watch = EarlyStop::new(validation, config.patience);
    let settings = LbfgsbSettings {
        max_iterations: config.max_iterations,
        memory: 20,
        tolerances: Tolerances { energy: 1e-7, ..Tolerances::default() },
    };
    let bounds = Bounds::unbounded(parameters.len());
    let report = lbfgsb(training, &mut parameters, &bounds, &settings, &mut watch)?;
    let (iterations, parameters) = match watch.best {
        Some((iterations, _, best)) => (iterations, best),
        None => (report.iterations, parameters),
    };
    let loss = |part: &NetworkLoss| part.errors(&part.shape.activations(&parameters, &part.inputs)[2]).1;
    let record =
        TrainingRecord { iterations, training_loss: loss(training), validation_loss: loss(validation) };
    Ok((parameters, record))
}

/// Uniform weights of variance 1 / inputs (Glorot and Bengio 2010, LeCun's form), biases zero.
fn initial_parameters(shape: NetworkShape, scale: f64, seed: u64) -> Vec<f64> {
    let mut random = RandomStream::named(seed, "network weights");
    let mut parameters = vec![0.0; shape.parameter_count()];
    for layer in 0..3 {
        let (start, units) = (shape.start_of(layer), shape.widths[layer + 1]);
        let range = scale * (3.0 / shape.widths[layer].max(1) as f64).sqrt();
        // Column-major, the last column is the bias.
        for weight in &mut parameters[start..start + units * shape.widths[layer]] {
            *weight = range * (2.0 * random.unit() - 1.0);
        }
    }
    parameters
}

/// Remembers the parameters with the lowest validation error, and stops when it has not fallen for a while.
struct EarlyStop<'a> {
    validation: &'a NetworkLoss<'a>,
    patience: usize,
    iteration: usize,
    best: Option<(usize, f64, Vec<f64>)>,
}

impl<'a> EarlyStop<'a> {
    fn new(validation: &'a NetworkLoss<'a>, patience: usize) -> Self {
        Self { validation, patience, iteration: 0, best: None }
    }
}

impl Observer for EarlyStop<'_> {
    fn on_event(&mut self, _event: &Event) -> Flow {
        Flow::Continue
    }

    fn on_parameters(&mut self, parameters: &[f64]) -> Flow {
        self.iteration += 1;
        if self.validation.targets.ncols() == 0 {
            return Flow::Continue;
        }
        let shape = self.validation.shape;
        let error = self.validation.errors(&shape.activations(parameters, &self.validation.inputs)[2]).1;
        match &self.best {
            Some((iteration, lowest, _)) if error >= *lowest => {
                if self.iteration - iteration >= self.patience.max(1) { Flow::Stop } else { Flow::Continue }
            }
            _ => {
                self.best = Some((self.iteration, error, parameters.to_vec()));
                Flow::Continue
            }
        }
    }
}

#[cfg(test)]
mod tests;
