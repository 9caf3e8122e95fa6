//! Fabrics: mass, stretch and bending, as our own named table and in the 39-number form of Wang et al. 2011 (P3 §5.2).
//!
//! The 39 numbers are `stretching`, six states by the four stiffnesses C11 (warp), C12 (coupling), C22 (weft) and C33
//! (shear) in N/m, and `bending`, three directions (warp, bias, weft) by five curvatures in N·m. Their JSON form also
//! names `density` in kg/m². We ship no measured fabric; a user's own files of that form load.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Numbers that describe a fabric's stretch and bending (P3 §5.2).
pub const FABRIC_TABLE_LENGTH: usize = STRETCH_STATES * STRETCH_COLUMNS + BEND_DIRECTIONS * BEND_CURVATURES;

const STRETCH_STATES: usize = 6;
const STRETCH_COLUMNS: usize = 4;
const BEND_DIRECTIONS: usize = 3;
const BEND_CURVATURES: usize = 5;

/// Smallest shear stiffness that is believed, N/m: measured tables hold negative ones, which no simulation bears.
const LEAST_STIFFNESS: f64 = 1.0;
/// Smallest bending rigidity that is believed, N·m.
const LEAST_RIGIDITY: f64 = 1e-7;

/// Why a fabric cannot be had.
#[derive(Debug, Error)]
pub enum FabricError {
    /// There is no fabric by that name.
    #[error("there is no fabric '{name}'; there are {known}, and files of the 39-number form (.json)")]
    Unknown {
        /// The name.
        name: String,
        /// The names that are known.
        known: String,
    },
    /// The file cannot be read.
    #[error("{}: the fabric cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file does not say what it must.
    #[error("{}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// A fabric in effective numbers: what a simulation needs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fabric {
    /// Name, lower case with hyphens.
    pub name: String,
    /// What it is used for.
    #[serde(default, rename = "use")]
    pub purpose: String,
    /// Mass per area, kg/m².
    pub density: f64,
    /// Stretch stiffness along the warp, N/m.
    pub stretch_warp: f64,
    /// Stretch stiffness along the weft, N/m.
    pub stretch_weft: f64,
    /// Stress along one that strain along the other causes, N/m.
    pub coupling: f64,
    /// Shear stiffness, N/m.
    pub shear: f64,
    /// Share by which stiffness grows from no stretch to the largest of the table.
    pub stiffening: f64,
    /// Bending rigidity along the warp, N·m.
    pub bend_warp: f64,
    /// Bending rigidity along the bias, N·m.
    pub bend_bias: f64,
    /// Bending rigidity along the weft, N·m.
    pub bend_weft: f64,
    /// Share by which bending rigidity falls from the smallest to the largest curvature of the table.
    pub bend_softening: f64,
    /// Share of its velocity against its neighbours' that a vertex loses 90 times a second: the fabric's own friction.
    pub damping: f64,
    /// Coulomb coefficient between cloth and skin.
    pub friction: f64,
}

#[derive(Deserialize)]
struct Table {
    fabric: Vec<Fabric>,
}

/// The 39-number form as others write it.
#[derive(Deserialize)]
struct FabricFile {
    density: f64,
    stretching: Vec<Vec<f64>>,
    bending: Vec<Vec<f64>>,
}

/// The fabrics of our own.
pub fn named_fabrics() -> Result<Vec<Fabric>, FabricError> {
    let table: Result<Table, _> = toml::from_str(include_str!("../../assets/fabrics.toml"));
    table.map(|table| table.fabric).map_err(|error| FabricError::Malformed {
        path: PathBuf::from("fabrics.toml (embedded)"),
        reason: error.message().into(),
    })
}

/// A fabric of our own by its name, or a user's `.json` file of the 39-number form.
pub fn find_fabric(name_or_file: &str) -> Result<Fabric, FabricError> {
    let fabrics = named_fabrics()?;
    if let Some(fabric) = fabrics.iter().find(|fabric| fabric.name == name_or_file) {
        return Ok(fabric.clone());
    }
    let path = Path::new(name_or_file);
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json")) {
        return read_fabric(path);
    }
    let known: Vec<String> = fabrics.into_iter().map(|fabric| fabric.name).collect();
    Err(FabricError::Unknown { name: name_or_file.into(), known: known.join(", ") })
}

/// The 39 numbers of a fabric of our own by its name, or those of a user's `.json` file as they stand there.
pub fn find_fabric_table(name_or_file: &str) -> Result<Vec<f64>, FabricError> {
    let path = Path::new(name_or_file);
    let is_file = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
    if is_file {
        return read_fabric_table(path).map(|(_, numbers)| numbers);
    }
    find_fabric(name_or_file).map(|fabric| fabric.table().to_vec())
}

/// Reads a `.json` file of the 39-number form into effective numbers: means over states and curvatures.
pub fn read_fabric(path: &Path) -> Result<Fabric, FabricError> {
    let malformed = |reason: String| FabricError::Malformed { path: path.to_path_buf(), reason };
    let (density, numbers) = read_fabric_table(path)?;
    let (stretch, bend) = numbers.split_at(STRETCH_STATES * STRETCH_COLUMNS);
    let column = |index: usize| {
        let states = stretch.chunks_exact(STRETCH_COLUMNS).map(|row| row[index]);
        states.sum::<f64>() / STRETCH_STATES as f64
    };
    let row = |index: usize| {
        let row = &bend[index * BEND_CURVATURES..][..BEND_CURVATURES];
        (row.iter().sum::<f64>() / BEND_CURVATURES as f64).max(LEAST_RIGIDITY)
    };
    if density <= 0.0 {
        return Err(malformed(format!("a density of {density} kg/m² is not possible")));
    }
    Ok(Fabric {
        name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        purpose: String::new(),
        density,
        stretch_warp: column(0).max(LEAST_STIFFNESS),
        coupling: column(1),
        stretch_weft: column(2).max(LEAST_STIFFNESS),
        shear: column(3).max(LEAST_STIFFNESS),
        stiffening: 0.0,
        bend_warp: row(0),
        bend_bias: row(1),
        bend_weft: row(2),
        bend_softening: 0.0,
        damping: 0.25,
        friction: 0.35,
    })
}

/// Density and the 39 numbers of a `.json` file.
pub fn read_fabric_table(path: &Path) -> Result<(f64, Vec<f64>), FabricError> {
    let malformed = |reason: String| FabricError::Malformed { path: path.to_path_buf(), reason };
    let text = std::fs::read_to_string(path)
        .map_err(|source| FabricError::Unreadable { path: path.to_path_buf(), source })?;
    let file: FabricFile = serde_json::from_str(&text)
        .map_err(|error| malformed(format!("is no fabric in the 39-number form ({error})")))?;
    let is_grid = |rows: &[Vec<f64>], height: usize, width: usize| {
        rows.len() == height && rows.iter().all(|row| row.len() == width)
    };
    if !is_grid(&file.stretching, STRETCH_STATES, STRETCH_COLUMNS) {
        return Err(malformed(format!("'stretching' must have {STRETCH_STATES} rows of {STRETCH_COLUMNS}")));
    }
    if !is_grid(&file.bending, BEND_DIRECTIONS, BEND_CURVATURES) {
        return Err(malformed(format!("'bending' must have {BEND_DIRECTIONS} rows of {BEND_CURVATURES}")));
    }
    Ok((file.density, file.stretching.into_iter().chain(file.bending).flatten().collect()))
}

impl Fabric {
    /// The 39 numbers (P3 §5.2): stretching row by row, then bending row by row.
    pub fn table(&self) -> [f64; FABRIC_TABLE_LENGTH] {
        let mut numbers = [0.0; FABRIC_TABLE_LENGTH];
        let (stretch, bend) = numbers.split_at_mut(STRETCH_STATES * STRETCH_COLUMNS);
        for (state, row) in stretch.chunks_exact_mut(STRETCH_COLUMNS).enumerate() {
            let factor = 1.0 + self.stiffening * state as f64 / (STRETCH_STATES - 1) as f64;
            let columns = [self.stretch_warp, self.coupling, self.stretch_weft, self.shear];
            row.copy_from_slice(&columns.map(|stiffness| stiffness * factor));
        }
        let rigidities = [self.bend_warp, self.bend_bias, self.bend_weft];
        for (row, rigidity) in bend.chunks_exact_mut(BEND_CURVATURES).zip(rigidities) {
            for (curvature, number) in row.iter_mut().enumerate() {
                let share = curvature as f64 / (BEND_CURVATURES - 1) as f64;
                *number = rigidity * (1.0 - self.bend_softening * share);
            }
        }
        numbers
    }

    /// Stretch stiffness along a direction, `cosine` its cosine with the warp, N/m: that of an orthotropic sheet,
    /// `1/E = c⁴/E_warp + s⁴/E_weft + c² s² / G`.
    pub fn stretch_along(&self, cosine: f64) -> f64 {
        let c = (cosine * cosine).min(1.0);
        let s = 1.0 - c;
        1.0 / (c * c / self.stretch_warp + s * s / self.stretch_weft + c * s / self.shear)
    }

    /// Bending rigidity along a direction, `cosine` its cosine with the warp, N·m: linear in the angle between warp,
    /// bias and weft.
    pub fn bend_along(&self, cosine: f64) -> f64 {
        let place = cosine.abs().min(1.0).acos() / std::f64::consts::FRAC_PI_4;
        if place < 1.0 {
            self.bend_warp + (self.bend_bias - self.bend_warp) * place
        } else {
            self.bend_bias + (self.bend_weft - self.bend_bias) * (place - 1.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_fabrics_differ_and_are_possible() {
        let fabrics = named_fabrics().unwrap();
        assert_eq!(fabrics.len(), 8);
        for (index, fabric) in fabrics.iter().enumerate() {
            let table = fabric.table();
            assert!(table.iter().all(|number| *number > 0.0), "{}", fabric.name);
            // A sheet that gains energy when stretched: the stiffness matrix is positive definite.
            assert!(fabric.coupling.powi(2) < fabric.stretch_warp * fabric.stretch_weft, "{}", fabric.name);
            assert!((0.05..0.5).contains(&fabric.density) && (0.0..1.0).contains(&fabric.friction));
            assert!(fabrics[..index].iter().all(|other| other.table() != table), "{}", fabric.name);
            assert_eq!(find_fabric(&fabric.name).unwrap(), *fabric);
        }
        let message = find_fabric("chainmail").unwrap_err().to_string();
        assert!(message.contains("cotton-poplin, linen"), "{message}");
    }

    #[test]
    fn a_sheet_is_as_stiff_as_its_yarns_along_them_and_soft_between() {
        let denim = find_fabric("denim").unwrap();
        assert!((denim.stretch_along(1.0) - denim.stretch_warp).abs() < 1e-9);
        assert!((denim.stretch_along(0.0) - denim.stretch_weft).abs() < 1e-9);
        // At 45°: 4 / (1/E_warp + 1/E_weft + 1/G).
        let bias = 4.0 / (1.0 / denim.stretch_warp + 1.0 / denim.stretch_weft + 1.0 / denim.shear);
        assert!((denim.stretch_along(0.5_f64.sqrt()) - bias).abs() < 1e-9);
        for (degrees, expected) in [(0.0, denim.bend_warp), (45.0, denim.bend_bias), (90.0, denim.bend_weft)]
        {
            assert!((denim.bend_along(f64::to_radians(degrees).cos()) - expected).abs() < 1e-12);
        }
    }

    fn write(text: &str) -> Result<Fabric, FabricError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("felt.json");
        std::fs::write(&path, text).unwrap();
        find_fabric(path.to_str().unwrap())
    }

    #[test]
    fn a_file_of_the_39_number_form_gives_means() {
        let rows: Vec<String> = (0..6).map(|row| format!("[{}, 8, 100, -6]", 90 + 4 * row)).collect();
        let text = format!(
            r#"{{"density": 0.2, "stretching": [{}], "bending": [[1e-5, 2e-5, 3e-5, 4e-5, 5e-5],
            [0, 0, 0, 0, 0], [2e-5, 2e-5, 2e-5, 2e-5, 2e-5]]}}"#,
            rows.join(",")
        );
        let felt = write(&text).unwrap();
        assert_eq!((felt.name.as_str(), felt.density), ("felt", 0.2));
        assert!((felt.stretch_warp - 100.0).abs() < 1e-9 && (felt.stretch_weft - 100.0).abs() < 1e-9);
        assert!((felt.bend_warp - 3e-5).abs() < 1e-12);
        assert_eq!((felt.shear, felt.bend_bias), (LEAST_STIFFNESS, LEAST_RIGIDITY));
        let fewer = text.replace("[90, 8, 100, -6],", "");
        assert!(write(&fewer).unwrap_err().to_string().contains("6 rows of 4"));
        assert!(write("{").unwrap_err().to_string().contains("felt.json"));
        assert!(write(&text.replace("0.2", "-1")).unwrap_err().to_string().contains("not possible"));
    }
}
