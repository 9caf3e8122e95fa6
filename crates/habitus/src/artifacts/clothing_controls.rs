//! Named controls of a clothing model besides the motion: fabrics and sizes (P3 §5.2, 5.3).
//!
//! A table has one row a sequence. Columns `fabric_00 … fabric_38` are one table of stretch and bending and become a few
//! standardised components; every other column, such as a ratio of garment to body, is a control of its own.

use std::path::{Path, PathBuf};

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::statistics::standardization::Standardization;
use crate::statistics::{LinearSpace, LinearSpaceError, LinearSpaceSettings, SampleMatrix};

/// Columns with this beginning and a number are the numbers of one fabric table.
const FABRIC_PREFIX: &str = "fabric_";

/// Why a table of parameters cannot be used.
#[derive(Debug, Error)]
pub enum ControlsError {
    /// The file cannot be read.
    #[error("{}: the parameters cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A line does not say what it must.
    #[error("{}, line {line}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// A sequence has no row.
    #[error("the parameters have no row for the sequence '{name}'; the first column must hold its name")]
    NoRow {
        /// The sequence.
        name: String,
    },
    /// The fabrics do not vary, or are not numbers.
    #[error("the fabrics cannot be reduced to components: {0}")]
    Fabrics(#[from] LinearSpaceError),
    /// There is no such control or fabric.
    #[error("there is no {what} '{name}'; the model has {known}")]
    Unknown {
        /// Control or fabric.
        what: &'static str,
        /// Its name.
        name: String,
        /// The names that there are.
        known: String,
    },
    /// A fabric of another form.
    #[error("the fabric has {found} numbers, the model was learnt with {needed}")]
    FabricLength {
        /// Numbers given.
        found: usize,
        /// Numbers needed.
        needed: usize,
    },
}

/// Semantic parameters as they are given: a row of numbers for each sequence.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterTable {
    /// Names of the columns after the first.
    pub columns: Vec<String>,
    /// Name of the sequence and its numbers.
    pub rows: Vec<(String, Vec<f64>)>,
}

impl ParameterTable {
    /// Reads `sequence,NAME,…` with one row a sequence.
    pub fn read(path: &Path) -> Result<Self, ControlsError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ControlsError::Unreadable { path: path.to_path_buf(), source })?;
        let malformed =
            |line: usize, reason: String| ControlsError::Malformed { path: path.to_path_buf(), line, reason };
        let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let (_, header) = lines.next().ok_or_else(|| malformed(1, "the file is empty".into()))?;
        let columns: Vec<String> = header.split(',').skip(1).map(|name| name.trim().to_owned()).collect();
        if columns.is_empty() {
            return Err(malformed(1, "needs the name of a sequence and at least one parameter".into()));
        }
        let mut rows = Vec::new();
        for (index, line) in lines {
            let mut words = line.split(',').map(str::trim);
            let name = words.next().unwrap_or_default().to_owned();
            let numbers: Option<Vec<f64>> =
                words.map(|word| word.parse().ok().filter(|value: &f64| value.is_finite())).collect();
            match numbers {
                Some(numbers) if numbers.len() == columns.len() => rows.push((name, numbers)),
                _ => {
                    let reason = format!("needs a name and {} finite numbers", columns.len());
                    return Err(malformed(index + 1, reason));
                }
            }
        }
        Ok(Self { columns, rows })
    }

    /// Places of the columns that are one fabric table, and of all others.
    fn fabric_and_own_columns(&self) -> (Vec<usize>, Vec<usize>) {
        let is_fabric = |name: &str| {
            name.strip_prefix(FABRIC_PREFIX).is_some_and(|rest| rest.bytes().all(|b| b.is_ascii_digit()))
        };
        (0..self.columns.len()).partition(|column| is_fabric(&self.columns[*column]))
    }

    fn row(&self, name: &str) -> Result<&[f64], ControlsError> {
        let found = self.rows.iter().find(|(known, _)| known == name);
        found.map(|(_, row)| row.as_slice()).ok_or_else(|| ControlsError::NoRow { name: name.into() })
    }
}

/// A fabric table in few numbers: each number standardised over the fabrics, then principal components. Without
/// standardising, the two stiffest fabrics are all that the components see. Stiffness and rigidity span decades: what is
/// positive in all fabrics is compared by its logarithm, so that a fabric beyond the others is not far beyond them.
///
/// Deviation: P3 §5.2 names neither; see book/src/deviations.md.
#[derive(Clone, Debug, PartialEq)]
pub struct FabricSpace {
    /// Which numbers are compared by their logarithms.
    pub is_logarithmic: Vec<bool>,
    /// Mean and deviation over the fabrics of each number, or of its logarithm.
    pub scale: Standardization,
    /// Components of the standardised numbers.
    pub space: LinearSpace,
}

/// Deviations below the mean logarithm where a number that is not positive is put, if all that were learnt from were.
const NOT_POSITIVE: f64 = 3.0;

impl FabricSpace {
    /// Components of fabrics, at most `components`.
    pub fn learn(tables: &[Vec<f64>], components: usize) -> Result<Self, LinearSpaceError> {
        let width = tables.first().map_or(0, Vec::len);
        let is_logarithmic: Vec<bool> =
            (0..width).map(|k| tables.iter().all(|table| table[k] > 0.0)).collect();
        let compared = |row: usize, k: usize| -> f64 {
            if is_logarithmic[k] { tables[row][k].ln() } else { tables[row][k] }
        };
        let rows = DMatrix::from_fn(tables.len(), width, compared);
        let scale = Standardization::of(&rows);
        let samples = SampleMatrix::from(scale.apply(&rows).transpose());
        let space = LinearSpace::learn(&samples, &LinearSpaceSettings::with_components(components))?;
        Ok(Self { is_logarithmic, scale, space })
    }

    /// The components of a fabric, in standard deviations.
    pub fn components(&self, table: &[f64]) -> Result<Vec<f64>, ControlsError> {
        if table.len() != self.scale.width() {
            return Err(ControlsError::FabricLength { found: table.len(), needed: self.scale.width() });
        }
        let compared = |(k, value): (usize, &f64)| match self.is_logarithmic[k] {
            false => *value,
            true if *value > 0.0 => value.ln(),
            true => self.scale.means[k] - NOT_POSITIVE * self.scale.deviations[k],
        };
        let compared: Vec<f64> = table.iter().enumerate().map(compared).collect();
        let row = self.scale.apply(&DMatrix::from_row_slice(1, table.len(), &compared));
        Ok(self.space.coefficients(&row.iter().copied().collect::<Vec<_>>()))
    }
}

/// The controls that a row of a table says: components of its fabric, then its other columns.
fn values_of(
    table: &ParameterTable,
    row: &[f64],
    fabrics: Option<&FabricSpace>,
) -> Result<Vec<f64>, ControlsError> {
    let (fabric_columns, own_columns) = table.fabric_and_own_columns();
    let mut values = match fabrics {
        Some(space) => space.components(&fabric_columns.iter().map(|k| row[*k]).collect::<Vec<f64>>())?,
        None => Vec::new(),
    };
    values.extend(own_columns.iter().map(|k| row[*k]));
    Ok(values)
}

/// One control.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Control {
    /// Its name: a column's, or `fabric 1` and so on.
    pub name: String,
    /// Smallest value that was learnt from.
    pub minimum: f64,
    /// Largest value that was learnt from.
    pub maximum: f64,
    /// Mean value that was learnt from: the default.
    pub default: f64,
}

/// The controls of a model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClothingControls {
    /// The controls in the order of the regressor's inputs: fabric components first.
    pub controls: Vec<Control>,
    /// Fabrics in few numbers, if there were any.
    pub fabrics: Option<FabricSpace>,
    /// The controls of each sequence that was learnt from, by its name.
    pub known: Vec<(String, Vec<f64>)>,
}

impl ClothingControls {
    /// The controls of sequences by their names; fabrics become at most `fabric_components` numbers.
    pub fn learn(
        table: &ParameterTable,
        sequences: &[String],
        fabric_components: usize,
    ) -> Result<Self, ControlsError> {
        let (fabric_columns, own_columns) = table.fabric_and_own_columns();
        let rows: Vec<&[f64]> = sequences.iter().map(|name| table.row(name)).collect::<Result<_, _>>()?;
        let fabric_of = |row: &[f64]| fabric_columns.iter().map(|k| row[*k]).collect::<Vec<f64>>();
        let fabrics = if fabric_columns.is_empty() {
            None
        } else {
            let tables: Vec<Vec<f64>> = rows.iter().map(|row| fabric_of(row)).collect();
            Some(FabricSpace::learn(&tables, fabric_components)?)
        };
        let mut known = Vec::new();
        for (name, row) in sequences.iter().zip(&rows) {
            known.push((name.clone(), values_of(table, row, fabrics.as_ref())?));
        }
        let fabric_count = fabrics.as_ref().map_or(0, |fabrics| fabrics.space.component_count());
        let names = (1..=fabric_count)
            .map(|k| format!("{FABRIC_PREFIX}{k}"))
            .chain(own_columns.iter().map(|k| table.columns[*k].clone()));
        let control = |(index, name): (usize, String)| {
            let values = || known.iter().map(|(_, values): &(String, Vec<f64>)| values[index]);
            Control {
                name,
                minimum: values().fold(f64::INFINITY, f64::min),
                maximum: values().fold(f64::NEG_INFINITY, f64::max),
                default: values().sum::<f64>() / known.len().max(1) as f64,
            }
        };
        let controls = names.enumerate().map(control).collect();
        Ok(Self { controls, fabrics, known })
    }

    /// Makes a further sequence known, whose fabric is seen with the components of the others.
    pub fn add_sequence(&mut self, table: &ParameterTable, name: &str) -> Result<(), ControlsError> {
        let values = values_of(table, table.row(name)?, self.fabrics.as_ref())?;
        self.known.push((name.into(), values));
        Ok(())
    }

    /// Number of controls.
    pub fn len(&self) -> usize {
        self.controls.len()
    }

    /// Whether the model answers to the motion alone.
    pub fn is_empty(&self) -> bool {
        self.controls.is_empty()
    }

    /// The default of each control.
    pub fn defaults(&self) -> Vec<f64> {
        self.controls.iter().map(|control| control.default).collect()
    }

    /// The controls of a sequence that was learnt from.
    pub fn of_sequence(&self, name: &str) -> Option<&[f64]> {
        self.known.iter().find(|(known, _)| known == name).map(|(_, values)| values.as_slice())
    }

    /// Sets one control by its name.
    pub fn set(&self, values: &mut [f64], name: &str, value: f64) -> Result<(), ControlsError> {
        let index = self.controls.iter().position(|control| control.name == name);
        let index = index.ok_or_else(|| {
            let known: Vec<&str> = self.controls.iter().map(|control| control.name.as_str()).collect();
            let known = if known.is_empty() { "none".into() } else { known.join(", ") };
            ControlsError::Unknown { what: "control", name: name.into(), known }
        })?;
        values[index] = value;
        Ok(())
    }

    /// Sets the fabric to one that was learnt from, by its sequence's name.
    pub fn set_known_fabric(&self, values: &mut [f64], name: &str) -> Result<(), ControlsError> {
        let count = self.fabric_component_count();
        let found = self.of_sequence(name).filter(|_| count > 0).ok_or_else(|| {
            let known: Vec<&str> = self.known.iter().map(|(name, _)| name.as_str()).collect();
            let known = if count == 0 { "no fabrics".into() } else { known.join(", ") };
            ControlsError::Unknown { what: "fabric", name: name.into(), known }
        })?;
        values[..count].copy_from_slice(&found[..count]);
        Ok(())
    }

    /// Sets the fabric to one given by its table.
    pub fn set_fabric(&self, values: &mut [f64], table: &[f64]) -> Result<(), ControlsError> {
        let Some(fabrics) = &self.fabrics else {
            return Err(ControlsError::FabricLength { found: table.len(), needed: 0 });
        };
        let components = fabrics.components(table)?;
        values[..components.len()].copy_from_slice(&components);
        Ok(())
    }

    /// Number of controls that are components of a fabric; they come first.
    pub fn fabric_component_count(&self) -> usize {
        self.fabrics.as_ref().map_or(0, |fabrics| fabrics.space.component_count())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> ParameterTable {
        let fabric = |stiffness: f64, bend: f64| vec![stiffness, 2.0 * stiffness, 1e-5 * bend];
        let row = |name: &str, stiffness, bend, width| {
            (name.to_owned(), [fabric(stiffness, bend), vec![width]].concat())
        };
        ParameterTable {
            columns: ["fabric_00", "fabric_01", "fabric_02", "hem_width"].map(str::to_owned).to_vec(),
            rows: vec![
                row("denim", 900.0, 7.0, 1.1),
                row("silk", 80.0, 1.0, 1.3),
                row("rib", 60.0, 4.0, 1.6),
            ],
        }
    }

    fn names() -> Vec<String> {
        ["denim", "silk", "rib"].map(str::to_owned).to_vec()
    }

    #[test]
    fn fabrics_become_components_and_sizes_stay_as_they_are() {
        let controls = ClothingControls::learn(&table(), &names(), 2).unwrap();
        let found: Vec<&str> = controls.controls.iter().map(|control| control.name.as_str()).collect();
        assert_eq!(found, ["fabric_1", "fabric_2", "hem_width"]);
        let hem = &controls.controls[2];
        assert!((hem.minimum, hem.maximum) == (1.1, 1.6) && (hem.default - 4.0 / 3.0).abs() < 1e-12);
        let mut values = controls.defaults();
        controls.set_fabric(&mut values, &[80.0, 160.0, 1e-5]).unwrap();
        let silk = controls.of_sequence("silk").unwrap();
        assert!((values[0] - silk[0]).abs() < 1e-9 && (values[1] - silk[1]).abs() < 1e-9);
        controls.set(&mut values, "hem_width", 1.5).unwrap();
        assert_eq!(values[2], 1.5);
        controls.set_known_fabric(&mut values, "denim").unwrap();
        assert_eq!(values[..2], controls.of_sequence("denim").unwrap()[..2]);
    }

    #[test]
    fn a_sequence_that_joins_later_is_seen_with_the_components_of_the_others() {
        let others = ["denim", "silk"].map(str::to_owned);
        let mut controls = ClothingControls::learn(&table(), &others, 2).unwrap();
        let before = controls.clone();
        controls.add_sequence(&table(), "rib").unwrap();
        assert_eq!((&controls.controls, &controls.fabrics), (&before.controls, &before.fabrics));
        let rib = controls.of_sequence("rib").unwrap();
        assert_eq!((rib.len(), rib[rib.len() - 1]), (controls.len(), 1.6));
        assert!(controls.add_sequence(&table(), "felt").is_err());
    }

    #[test]
    fn a_unit_of_a_fabric_s_number_does_not_matter() {
        let mut scaled = table();
        scaled.rows.iter_mut().for_each(|(_, row)| row[2] *= 1e6);
        let plain = ClothingControls::learn(&table(), &names(), 2).unwrap();
        let other = ClothingControls::learn(&scaled, &names(), 2).unwrap();
        for ((_, a), (_, b)) in plain.known.iter().zip(&other.known) {
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9));
        }
    }

    #[test]
    fn factors_between_stiffnesses_count_and_a_fabric_that_is_not_positive_has_a_place() {
        let tables: Vec<Vec<f64>> = [10.0, 100.0, 1000.0].map(|stiffness| vec![stiffness, -1.0]).to_vec();
        let space = FabricSpace::learn(&tables, 1).unwrap();
        let [low, middle, high] = [0, 1, 2].map(|row| space.components(&tables[row]).unwrap()[0]);
        assert!(((high - middle) - (middle - low)).abs() < 1e-9, "ten times as stiff is one step");
        let further = space.components(&[1e4, -1.0]).unwrap()[0];
        assert!(((further - high) - (high - middle)).abs() < 1e-9);
        let odd = space.components(&[-5.0, -1.0]).unwrap()[0];
        assert!(odd.is_finite() && (odd - middle) * (low - middle) > 0.0, "below the softest: {odd}");
    }

    #[test]
    fn unknown_names_are_refused_with_the_known_ones() {
        let controls = ClothingControls::learn(&table(), &names(), 2).unwrap();
        let mut values = controls.defaults();
        let message = controls.set(&mut values, "sleeve", 1.0).unwrap_err().to_string();
        assert!(message.contains("sleeve") && message.contains("hem_width"), "{message}");
        let message = controls.set_known_fabric(&mut values, "felt").unwrap_err().to_string();
        assert!(message.contains("felt") && message.contains("denim"), "{message}");
        let missing = ClothingControls::learn(&table(), &["wool".to_owned()], 2).unwrap_err();
        assert!(matches!(missing, ControlsError::NoRow { .. }));
    }

    #[test]
    fn a_table_is_read_and_its_faults_are_placed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("parameters.csv");
        std::fs::write(&path, "sequence,a,b\none,1,2\n\ntwo,3,4.5\n").unwrap();
        let table = ParameterTable::read(&path).unwrap();
        assert_eq!(table.columns, ["a", "b"]);
        assert_eq!(table.rows[1], ("two".to_owned(), vec![3.0, 4.5]));
        std::fs::write(&path, "sequence,a,b\none,1,2\ntwo,3\n").unwrap();
        let message = ParameterTable::read(&path).unwrap_err().to_string();
        assert!(message.contains("line 3"), "{message}");
    }
}
