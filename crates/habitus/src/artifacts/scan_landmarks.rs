//! Landmarks that were found on single scans, as a table and as JSON, in each scan's own frame and unit.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::codes::Code;
use super::csv::CsvText;
use super::provenance::InputFile;
use super::write_atomically;

/// One landmark of one scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanLandmark {
    /// Name of the landmark in the model.
    pub name: String,
    /// Position in the scan's own coordinates.
    pub position: [f64; 3],
    /// 0 (guess) to 1 (seen and agreed on).
    pub confidence: f64,
}

/// What was found on a scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LandmarksFound {
    /// Whether they may be used unseen.
    pub is_ok: bool,
    /// Codes of the scan and of its body.
    pub codes: Vec<Code>,
    /// Metres in one unit of the scan's coordinates, as given or guessed.
    pub metres_per_unit: f64,
    /// The landmarks in the model's order.
    pub landmarks: Vec<ScanLandmark>,
}

/// A scan and what was found on it, or why nothing was.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanLandmarks {
    /// The scan's file.
    pub scan: InputFile,
    /// What was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub found: Option<LandmarksFound>,
    /// Why nothing was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

#[derive(Serialize, Deserialize)]
struct File {
    format: String,
    version: u32,
    scans: Vec<ScanLandmarks>,
}

const FORMAT: &str = "habitus-landmarks";
const VERSION: u32 = 1;

/// The table `frame,landmark,x,y,z,confidence`, which `fit-sequence --landmarks` reads; scans without landmarks have no row.
pub fn scan_landmarks_csv(scans: &[ScanLandmarks]) -> String {
    let mut table = CsvText::with_header(&["frame", "landmark", "x", "y", "z", "confidence"]);
    for scan in scans {
        for landmark in scan.found.iter().flat_map(|found| &found.landmarks) {
            let [x, y, z] = landmark.position.map(|value| value.to_string());
            table.add_row([
                &scan.scan.name,
                &landmark.name,
                &x,
                &y,
                &z,
                &format!("{:.3}", landmark.confidence),
            ]);
        }
    }
    table.into_text()
}

/// Writes `landmarks.csv` and `landmarks.json` into a folder.
pub fn write_scan_landmarks(folder: &Path, scans: &[ScanLandmarks]) -> std::io::Result<()> {
    write_atomically(&folder.join("landmarks.csv"), scan_landmarks_csv(scans).as_bytes())?;
    let file = File { format: FORMAT.into(), version: VERSION, scans: scans.to_vec() };
    let text = serde_json::to_string_pretty(&file).map_err(std::io::Error::other)? + "\n";
    write_atomically(&folder.join("landmarks.json"), text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::{
        File, LandmarksFound, ScanLandmark, ScanLandmarks, scan_landmarks_csv, write_scan_landmarks,
    };
    use crate::artifacts::codes::Code;
    use crate::artifacts::provenance::InputFile;

    fn scan(name: &str, found: Option<LandmarksFound>) -> ScanLandmarks {
        let error = found.is_none().then(|| "is empty".to_string());
        let scan = InputFile { name: name.into(), size: 7, fingerprint: "a".into() };
        ScanLandmarks { scan, found, error }
    }

    fn found() -> LandmarksFound {
        LandmarksFound {
            is_ok: false,
            codes: vec![Code::BodyNotCovered],
            metres_per_unit: 0.001,
            landmarks: vec![ScanLandmark {
                name: "left_toe".into(),
                position: [1.5, -20.25, 1e-7],
                confidence: 0.25,
            }],
        }
    }

    #[test]
    fn the_table_holds_what_was_found_and_the_json_also_what_was_not() {
        let scans = [scan("a, b.ply", Some(found())), scan("empty.ply", None)];
        assert_eq!(
            scan_landmarks_csv(&scans),
            "frame,landmark,x,y,z,confidence\n\"a, b.ply\",left_toe,1.5,-20.25,0.0000001,0.250\n"
        );
        let folder = tempfile::tempdir().expect("a folder");
        write_scan_landmarks(folder.path(), &scans).expect("writes");
        let text = std::fs::read_to_string(folder.path().join("landmarks.json")).expect("is there");
        let back: File = serde_json::from_str(&text).expect("is JSON");
        assert_eq!(back.scans, scans);
        assert!(text.contains("body_not_covered"));
    }
}
