//! A raw scan with the landmarks that a person placed on it, in the scan's own frame and unit.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus_geometry::Surface;
use habitus_geometry::io::{ReadError, read_surface};
use thiserror::Error;

/// Why a scan or its landmarks cannot be read.
#[derive(Debug, Error)]
pub enum ScanError {
    /// The scan's file is broken.
    #[error(transparent)]
    Surface(#[from] ReadError),
    /// The file of landmarks cannot be read.
    #[error("{}: the landmarks cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A line of the landmarks is not what it should be.
    #[error("{}, line {line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1.
        line: usize,
        /// What is wrong and what is needed.
        reason: String,
    },
    /// The file's ending names no format of landmarks.
    #[error("{}: landmarks are read from .csv, .json and CAESAR .lnd files", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
}

/// Named points on a scan, in the scan's own frame and unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScanLandmarks {
    /// Names with positions, each name once.
    pub entries: Vec<(String, DVec3)>,
}

impl ScanLandmarks {
    /// Reads a table `landmark,x,y,z`, a JSON object from names to `[x, y, z]`, or a CAESAR `.lnd` file.
    pub fn read(path: &Path) -> Result<Self, ScanError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ScanError::Unreadable { path: path.to_path_buf(), source })?;
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let entries = match extension.as_str() {
            "csv" => read_csv(&text, path)?,
            "json" => read_json(&text, path)?,
            "lnd" => read_lnd(&text, path)?,
            _ => return Err(ScanError::UnknownFormat { path: path.to_path_buf() }),
        };
        Ok(Self { entries })
    }

    /// The position of a landmark.
    pub fn position(&self, name: &str) -> Option<DVec3> {
        self.entries.iter().find(|(known, _)| known == name).map(|(_, position)| *position)
    }

    /// The landmarks of a scan in a folder: the file with the scan's name and a known ending.
    pub fn find_in(folder: &Path, scan_name: &str) -> Option<PathBuf> {
        ["csv", "json", "lnd"]
            .iter()
            .map(|extension| folder.join(format!("{scan_name}.{extension}")))
            .find(|path| path.is_file())
    }
}

/// A raw scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// Name of its file without folder and ending.
    pub name: String,
    /// Its surface in its own frame and unit.
    pub surface: Surface,
    /// What is marked on it; may be empty.
    pub landmarks: ScanLandmarks,
}

impl Scan {
    /// Reads a scan and its landmarks.
    pub fn read(path: &Path, landmarks: Option<&Path>) -> Result<Self, ScanError> {
        let surface = read_surface(path)?;
        let landmarks = landmarks.map(ScanLandmarks::read).transpose()?.unwrap_or_default();
        Ok(Self { name: scan_name(path), surface, landmarks })
    }
}

/// The name of a scan's file without folder and ending.
pub fn scan_name(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn line_error(path: &Path, line: usize, reason: String) -> ScanError {
    ScanError::Line { path: path.to_path_buf(), line, reason }
}

/// Adds a landmark once.
fn add(
    entries: &mut Vec<(String, DVec3)>,
    name: &str,
    coordinates: [f64; 3],
    path: &Path,
    line: usize,
) -> Result<(), ScanError> {
    if !coordinates.iter().all(|value| value.is_finite()) {
        return Err(line_error(path, line, format!("the position of '{name}' is not finite")));
    }
    if entries.iter().any(|(known, _)| known == name) {
        return Err(line_error(path, line, format!("'{name}' is there twice; keep one")));
    }
    entries.push((name.to_string(), DVec3::from_array(coordinates)));
    Ok(())
}

fn numbers(words: &[&str]) -> Option<[f64; 3]> {
    let [x, y, z] = words else { return None };
    Some([x.trim().parse().ok()?, y.trim().parse().ok()?, z.trim().parse().ok()?])
}

fn read_csv(text: &str, path: &Path) -> Result<Vec<(String, DVec3)>, ScanError> {
    let mut entries = Vec::new();
    for (index, row) in text.lines().enumerate().filter(|(_, row)| !row.trim().is_empty()) {
        // Names may hold commas ("Axilla, Ant."); numbers never do.
        let mut words: Vec<&str> = row.trim_end_matches('\r').rsplitn(4, ',').collect();
        words.reverse();
        let [name, coordinates @ ..] = words.as_slice() else { continue };
        match numbers(coordinates) {
            Some(coordinates) => {
                add(&mut entries, name.trim().trim_matches('"'), coordinates, path, index + 1)?;
            }
            None if index == 0 => {}
            None => {
                return Err(line_error(path, index + 1, "columns landmark,x,y,z are needed".into()));
            }
        }
    }
    Ok(entries)
}

fn read_json(text: &str, path: &Path) -> Result<Vec<(String, DVec3)>, ScanError> {
    let table: BTreeMap<String, [f64; 3]> = serde_json::from_str(text)
        .map_err(|error| line_error(path, error.line(), format!("{error}; needed is name → [x, y, z]")))?;
    let mut entries = Vec::new();
    for (name, coordinates) in table {
        add(&mut entries, &name, coordinates, path, 1)?;
    }
    Ok(entries)
}

/// Rows of a CAESAR file: number, three words about the picture, x, y, z, name of one or more words.
fn read_lnd(text: &str, path: &Path) -> Result<Vec<(String, DVec3)>, ScanError> {
    const WORDS_BEFORE: usize = 4;
    let mut entries = Vec::new();
    for (index, row) in text.lines().enumerate() {
        let words: Vec<&str> = row.split_whitespace().collect();
        let is_numbered = words.first().is_some_and(|word| word.bytes().all(|byte| byte.is_ascii_digit()));
        if !is_numbered || words.len() < WORDS_BEFORE + 4 {
            continue;
        }
        let Some(coordinates) = numbers(&words[WORDS_BEFORE..WORDS_BEFORE + 3]) else {
            return Err(line_error(path, index + 1, "words 5 to 7 must be coordinates".into()));
        };
        add(&mut entries, &words[WORDS_BEFORE + 3..].join(" "), coordinates, path, index + 1)?;
    }
    Ok(entries)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, text: &str) -> Result<ScanLandmarks, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("writes");
        ScanLandmarks::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn the_three_formats_say_the_same() {
        let table = read("a.csv", "landmark,x,y,z\r\nSellion,0.5,-1e-1,2\nLt. Axilla, Ant.,1,2,3\n");
        let object = read("a.json", r#"{"Sellion": [0.5, -0.1, 2], "Lt. Axilla, Ant.": [1, 2, 3]}"#);
        let caesar = read(
            "a.lnd",
            "STD_LND = 2\nAUX =\n 1 218 512 0 0.5 -0.1 2.0 Sellion\n 2 1 2 0 1 2 3 Lt. Axilla, Ant.\nEND =\n",
        );
        for landmarks in [table, object, caesar] {
            let landmarks = landmarks.expect("is valid");
            assert_eq!(landmarks.entries.len(), 2);
            assert_eq!(landmarks.position("Sellion"), Some(DVec3::new(0.5, -0.1, 2.0)));
            assert_eq!(landmarks.position("Lt. Axilla, Ant."), Some(DVec3::new(1.0, 2.0, 3.0)));
        }
    }

    #[test]
    fn faults_name_their_line() {
        for (name, text, needle) in [
            ("a.csv", "landmark,x,y,z\nSellion,1,2\n", "line 2"),
            ("a.csv", "Sellion,1,2,NaN\n", "not finite"),
            ("a.csv", "Sellion,1,2,3\nSellion,1,2,3\n", "twice"),
            ("a.json", "{\"Sellion\": [1, 2]}", "line 1"),
            ("a.lnd", "1 0 0 0 1 x 3 Sellion\n", "line 1"),
            ("a.txt", "", ".lnd"),
        ] {
            let message = read(name, text).expect_err(text);
            assert!(message.contains(needle), "{message}");
        }
    }
}
