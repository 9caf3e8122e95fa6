//! Measurements of a body: numbers with their curves and definitions, and their table as a file.

use std::path::Path;

use glam::DVec3;

use super::csv::CsvText;
use super::write_atomically;

/// What kind of number a measurement is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Quantity {
    /// A length in metres; shown in millimetres.
    Length,
    /// A volume in cubic metres; shown in litres.
    Volume,
}

impl Quantity {
    /// The unit in which people read it.
    pub fn display_unit(self) -> &'static str {
        match self {
            Self::Length => "mm",
            Self::Volume => "l",
        }
    }

    /// From metres or cubic metres to the displayed unit: both happen to be a thousand.
    pub fn to_display(self, value: f64) -> f64 {
        value * 1000.0
    }
}

/// One measurement of one body.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Its name, for example `waist_girth`.
    pub name: String,
    /// Length or volume.
    pub quantity: Quantity,
    /// Value in metres or cubic metres.
    pub value: f64,
    /// One standard deviation of the value in the same unit, if the identity's uncertainty is known.
    pub plus_minus: Option<f64>,
    /// Where it was taken: a polyline in rest space, in metres; a girth's ends where it begins.
    pub curve: Vec<DVec3>,
    /// What was measured, in words.
    pub definition: String,
}

/// The table `name,value,unit,plus_minus,definition`, lengths in mm and volumes in litres.
pub fn measurements_csv(measurements: &[Measurement]) -> String {
    let mut table = CsvText::with_header(&["name", "value", "unit", "plus_minus", "definition"]);
    for measurement in measurements {
        let quantity = measurement.quantity;
        let decimals = match quantity {
            Quantity::Length => 1,
            Quantity::Volume => 3,
        };
        let number = |value: f64| format!("{:.decimals$}", quantity.to_display(value));
        table.add_row([
            measurement.name.as_str(),
            &number(measurement.value),
            quantity.display_unit(),
            &measurement.plus_minus.map(number).unwrap_or_default(),
            &measurement.definition,
        ]);
    }
    table.into_text()
}

/// Writes the table of [`measurements_csv`] as a file.
pub fn write_measurements(path: &Path, measurements: &[Measurement]) -> std::io::Result<()> {
    write_atomically(path, measurements_csv(measurements).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::{Measurement, Quantity, measurements_csv};

    #[test]
    fn lengths_are_written_in_millimetres_and_volumes_in_litres() {
        let measurement = |name: &str, quantity, value, plus_minus| Measurement {
            name: name.into(),
            quantity,
            value,
            plus_minus,
            curve: Vec::new(),
            definition: "floor to crown, upright".into(),
        };
        let table = measurements_csv(&[
            measurement("stature", Quantity::Length, 1.75426, Some(0.0031)),
            measurement("volume", Quantity::Volume, 0.0712349, None),
        ]);
        assert_eq!(
            table,
            "name,value,unit,plus_minus,definition\n\
             stature,1754.3,mm,3.1,\"floor to crown, upright\"\n\
             volume,71.235,l,,\"floor to crown, upright\"\n"
        );
    }
}
