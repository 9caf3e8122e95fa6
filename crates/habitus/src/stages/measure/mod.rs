//! Measures a body as a tape, a scale and callipers do: definitions are data, each number comes with its curve.
//!
//! ```text
//! rest vertices ──points by name──▶ plane ──cut of a body part──▶ taut tape ──▶ value and curve
//! identity ± covariance ──finite differences──▶ ± of each value
//! ```
//! Bodies are measured in the rest pose of their model: y up, arms and legs a little apart.

mod cross_section;
mod definitions;
mod method;
mod points;
#[cfg(test)]
mod tests;

pub use definitions::{
    BreadthDirection, Definition, Definitions, DefinitionsError, Extreme, Method, PointReference, Tape,
};

use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use thiserror::Error;

use crate::artifacts::measurements::Measurement;
use crate::body::BodyModel;
use method::BoundDefinition;
use points::RestBody;

/// Step of the differences, in standard deviations of the population: a girth of a faceted body is smooth only
/// in pieces, so the step must span many of them, and the space is linear, so it may.
const DIFFERENCE_STEP: f64 = 0.25;

/// Why a body cannot be measured.
#[derive(Debug, Error, PartialEq)]
pub enum MeasureError {
    /// The body has another topology than the model.
    #[error("the body has {found} vertices, the model '{model}' has {needed}: measure it with its own model")]
    WrongVertexCount {
        /// Vertices of the body.
        found: usize,
        /// Vertices of the model.
        needed: usize,
        /// Name of the model.
        model: String,
    },
    /// A vertex is not finite.
    #[error("vertex {vertex} of the body is not finite")]
    NotFinite {
        /// The vertex.
        vertex: usize,
    },
    /// A definition names something that the model does not have.
    #[error("measurement '{measurement}' needs '{point}', which the model does not name")]
    UnknownPoint {
        /// The measurement.
        measurement: String,
        /// The point or bone.
        point: String,
    },
    /// The plane of a measurement does not cut its part of the body.
    #[error(
        "measurement '{measurement}' finds nothing to measure: its cut misses the named part of the body"
    )]
    NothingThere {
        /// The measurement.
        measurement: String,
    },
    /// The covariance does not fit the model.
    #[error("the covariance is {rows} × {columns}, the model has {components} components")]
    WrongCovariance {
        /// Rows of the covariance.
        rows: usize,
        /// Columns of the covariance.
        columns: usize,
        /// Components of the model.
        components: usize,
    },
}

impl Definitions {
    /// Those definitions that a model has all the names for, and the reasons why others are left out.
    pub fn available_in(&self, model: &BodyModel) -> (Self, Vec<MeasureError>) {
        let mut missing = Vec::new();
        let mut keep = |definition: &&Definition| match BoundDefinition::new(definition, model) {
            Ok(_) => true,
            Err(error) => {
                missing.push(error);
                false
            }
        };
        let measurements = self.measurements.iter().filter(&mut keep).cloned().collect();
        (Self { measurements }, missing)
    }
}

/// Measures a body of the model's topology in its rest pose; rest vertices in metres, y up.
pub fn measure(
    model: &BodyModel,
    rest_vertices: &[DVec3],
    definitions: &Definitions,
) -> Result<Vec<Measurement>, MeasureError> {
    check_vertices(model, rest_vertices)?;
    let body = RestBody { vertices: rest_vertices, joints: model.joints(rest_vertices) };
    definitions
        .measurements
        .iter()
        .map(|definition| {
            let bound = BoundDefinition::new(definition, model)?;
            let taken = bound.take(&body, None)?;
            Ok(measurement(&bound, taken))
        })
        .collect()
}

/// Measures a body as [`measure`] does, and with the covariance of the errors of its first identity coefficients (in
/// standard deviations of the population, squared) each value gets its ± of one standard deviation.
pub fn measure_with_uncertainty(
    model: &BodyModel,
    rest_vertices: &[DVec3],
    identity_covariance: &DMatrix<f64>,
    definitions: &Definitions,
) -> Result<Vec<Measurement>, MeasureError> {
    let mut measurements = measure(model, rest_vertices, definitions)?;
    let plus_minus = measurement_uncertainty(model, rest_vertices, identity_covariance, definitions)?;
    for (measurement, plus_minus) in measurements.iter_mut().zip(plus_minus) {
        measurement.plus_minus = Some(plus_minus);
    }
    Ok(measurements)
}

/// One standard deviation of each measurement: √(gᵀ Σ g), with g the derivative of the measurement by the identity,
/// from central differences. A searched girth stays at its level: at an extreme the level's own shift is of second
/// order.
pub fn measurement_uncertainty(
    model: &BodyModel,
    rest_vertices: &[DVec3],
    covariance: &DMatrix<f64>,
    definitions: &Definitions,
) -> Result<Vec<f64>, MeasureError> {
    let component_count = covariance.nrows();
    if !covariance.is_square() || component_count > model.component_count() {
        let (rows, columns) = covariance.shape();
        return Err(MeasureError::WrongCovariance { rows, columns, components: model.component_count() });
    }
    let bound: Vec<BoundDefinition<'_>> = definitions
        .measurements
        .iter()
        .map(|definition| BoundDefinition::new(definition, model))
        .collect::<Result<_, _>>()?;
    check_vertices(model, rest_vertices)?;
    let body = RestBody { vertices: rest_vertices, joints: model.joints(rest_vertices) };
    let levels: Vec<Option<f64>> = bound
        .iter()
        .map(|definition| definition.take(&body, None).map(|taken| taken.level))
        .collect::<Result<_, _>>()?;
    let values_at = |component: usize, shift: f64| -> Result<Vec<f64>, MeasureError> {
        let vertices = shifted(model, rest_vertices, component, shift);
        let body = RestBody { vertices: &vertices, joints: model.joints(&vertices) };
        bound
            .iter()
            .zip(&levels)
            .map(|(definition, level)| definition.take(&body, *level).map(|taken| taken.value))
            .collect()
    };
    let derivatives: Vec<Vec<f64>> = (0..component_count)
        .into_par_iter()
        .map(|component| {
            let ahead = values_at(component, DIFFERENCE_STEP)?;
            let behind = values_at(component, -DIFFERENCE_STEP)?;
            Ok(ahead.iter().zip(&behind).map(|(a, b)| (a - b) / (2.0 * DIFFERENCE_STEP)).collect())
        })
        .collect::<Result<_, MeasureError>>()?;
    Ok((0..bound.len())
        .map(|index| {
            let gradient = DVector::from_iterator(component_count, derivatives.iter().map(|row| row[index]));
            gradient.dot(&(covariance * &gradient)).max(0.0).sqrt()
        })
        .collect())
}

/// The body with one coefficient changed; the space is linear.
fn shifted(model: &BodyModel, rest_vertices: &[DVec3], component: usize, shift: f64) -> Vec<DVec3> {
    let width = model.component_count();
    let direction = |vertex: usize| {
        let rows = model.surface().vertex_basis(vertex);
        DVec3::from_array([0, 1, 2].map(|axis| f64::from(rows[axis * width + component])))
    };
    rest_vertices.iter().enumerate().map(|(vertex, place)| *place + direction(vertex) * shift).collect()
}

fn measurement(bound: &BoundDefinition<'_>, taken: method::Taken) -> Measurement {
    Measurement {
        name: bound.definition.name.clone(),
        quantity: bound.quantity(),
        value: taken.value,
        plus_minus: None,
        curve: taken.curve,
        definition: bound.definition.definition.clone(),
    }
}

fn check_vertices(model: &BodyModel, vertices: &[DVec3]) -> Result<(), MeasureError> {
    if vertices.len() != model.vertex_count() {
        return Err(MeasureError::WrongVertexCount {
            found: vertices.len(),
            needed: model.vertex_count(),
            model: model.metadata().name.clone(),
        });
    }
    match vertices.iter().position(|vertex| !vertex.is_finite()) {
        None => Ok(()),
        Some(vertex) => Err(MeasureError::NotFinite { vertex }),
    }
}
