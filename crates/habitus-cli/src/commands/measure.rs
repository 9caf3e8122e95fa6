//! `habitus measure`.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Args;
use habitus::artifacts::measurements::{Measurement, write_measurements};
use habitus::artifacts::sequence_files::FitFileError;
use habitus::body::BodyModel;
use habitus::pipeline::{RunError, measure_rest_body, measure_stored_fit, read_stored_fit};

use crate::Outcome;
use crate::console::Console;
use crate::sequence_job::load_model;

const EXAMPLES: &str = "\
Examples:
  habitus measure run
  habitus measure run/3_fit_sequence/fit.npz --csv body.csv
  habitus measure model.npz --identity coefficients.txt

± is one standard deviation, from how well the captures determine the body.";

/// Arguments of the verb.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct MeasureArguments {
    /// Run folder, fit.npz or body model
    pub body: PathBuf,
    /// Identity coefficients for a body model, numbers in a text file [default: the mean body]
    #[arg(long, value_name = "FILE")]
    pub identity: Option<PathBuf>,
    /// Body model that a run was fitted with [default: the one inside the program]
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Write the table as a file too
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
}

/// Shows the table.
pub fn run(arguments: &MeasureArguments, console: &Console) -> anyhow::Result<Outcome> {
    let measurements = match read_stored_fit(&arguments.body) {
        Ok(fit) => {
            if let Some(path) = &arguments.identity {
                bail!("{}: an identity goes with a body model; a fit has its own", path.display());
            }
            measure_stored_fit(&load_model(arguments.model.as_deref())?, &fit)?
        }
        Err(RunError::Files(FitFileError::Foreign { .. })) => {
            let model = BodyModel::load(&arguments.body)?;
            let identity = match &arguments.identity {
                Some(path) => read_identity(path, model.component_count())?,
                None => vec![0.0; model.component_count()],
            };
            measure_rest_body(&model, &model.rest_vertices(&identity))?
        }
        Err(error) => return Err(error.into()),
    };
    console.result(table(&measurements));
    if let Some(path) = &arguments.csv {
        write_measurements(path, &measurements)
            .with_context(|| format!("{}: the table cannot be written", path.display()))?;
    }
    Ok(Outcome::Fine)
}

/// Numbers between blanks or commas; missing ones are zero.
pub fn read_identity(path: &Path, component_count: usize) -> anyhow::Result<Vec<f64>> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("{}: the identity cannot be read", path.display()))?;
    let mut identity = Vec::new();
    for word in text.split(|character: char| character.is_whitespace() || character == ',') {
        if word.is_empty() {
            continue;
        }
        match word.parse::<f64>() {
            Ok(value) if value.is_finite() => identity.push(value),
            _ => bail!("{}: '{word}' is no finite number", path.display()),
        }
    }
    if identity.len() > component_count {
        let found = identity.len();
        bail!("{}: {found} coefficients, but the model has {component_count}", path.display());
    }
    identity.resize(component_count, 0.0);
    Ok(identity)
}

fn table(measurements: &[Measurement]) -> String {
    let width = measurements.iter().map(|measurement| measurement.name.len()).max().unwrap_or(0);
    let rows = measurements.iter().map(|measurement| {
        let quantity = measurement.quantity;
        let value = quantity.to_display(measurement.value);
        let plus_minus = measurement
            .plus_minus
            .map(|value| format!(" ± {:.1}", quantity.to_display(value)))
            .unwrap_or_default();
        let name = measurement.name.replace('_', " ");
        format!("{name:width$}  {value:8.1}{plus_minus} {}", quantity.display_unit())
    });
    rows.collect::<Vec<_>>().join("\n")
}
