//! Landmarks that a user gives: a table `frame,landmark,x,y,z` in the input's own frame and unit.

use std::path::{Path, PathBuf};

use glam::DVec3;
use thiserror::Error;

use crate::stages::fit_sequence::UserLandmark;

/// Why a table of landmarks cannot be used.
#[derive(Debug, Error)]
pub enum LandmarkFileError {
    /// The file cannot be read.
    #[error("{}: the landmarks cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A line is not what it should be.
    #[error("{}, line {line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1.
        line: usize,
        /// What is wrong and what is needed.
        reason: String,
    },
}

/// The columns that are read; others, such as a confidence, may follow.
const COLUMNS: [&str; 5] = ["frame", "landmark", "x", "y", "z"];

/// Reads the table. `frame_names` are the frames that it may speak of.
pub fn read_user_landmarks(
    path: &Path,
    frame_names: &[String],
) -> Result<Vec<UserLandmark>, LandmarkFileError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| LandmarkFileError::Unreadable { path: path.to_path_buf(), source })?;
    let at = |line: usize, reason: String| LandmarkFileError::Line { path: path.to_path_buf(), line, reason };
    let mut landmarks = Vec::new();
    for (index, row) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = index + 1;
        let fields = fields(row);
        if line == 1 {
            if !fields.iter().map(String::as_str).take(COLUMNS.len()).eq(COLUMNS) {
                return Err(at(line, format!("the first line must be the header {}", COLUMNS.join(","))));
            }
            continue;
        }
        if row.trim().is_empty() {
            continue;
        }
        let [frame, landmark, coordinates @ ..] = &fields[..] else {
            return Err(at(line, format!("five columns are needed: {}", COLUMNS.join(","))));
        };
        if !frame_names.contains(frame) {
            let example = frame_names.first().map(|name| format!(", for example '{name}'"));
            let example = example.unwrap_or_default();
            return Err(at(line, format!("there is no frame '{frame}'; name a file of the input{example}")));
        }
        let mut position = [0.0; 3];
        for (axis, value) in position.iter_mut().enumerate() {
            let word = coordinates.get(axis).map_or("", String::as_str);
            *value = word.trim().parse().ok().filter(|number: &f64| number.is_finite()).ok_or_else(|| {
                at(line, format!("{} is '{word}', but must be a finite number", COLUMNS[axis + 2]))
            })?;
        }
        landmarks.push(UserLandmark {
            frame: frame.clone(),
            landmark: landmark.clone(),
            position: DVec3::from_array(position),
        });
    }
    Ok(landmarks)
}

/// The fields of a row; a quoted field may hold commas and doubled quotes (RFC 4180), but no line break.
fn fields(row: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut is_quoted = false;
    let mut characters = row.trim_end_matches('\r').chars().peekable();
    while let Some(character) = characters.next() {
        match character {
            '"' if is_quoted && characters.peek() == Some(&'"') => {
                characters.next();
                fields.last_mut().into_iter().for_each(|field| field.push('"'));
            }
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => fields.push(String::new()),
            other => fields.last_mut().into_iter().for_each(|field| field.push(other)),
        }
    }
    fields
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::read_user_landmarks;

    fn read(text: &str) -> Result<Vec<super::UserLandmark>, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("marks.csv");
        std::fs::write(&path, text).expect("writes");
        let frames = ["a.ply", "b,c.ply"].map(String::from);
        read_user_landmarks(&path, &frames).map_err(|error| error.to_string())
    }

    #[test]
    fn rows_are_read_with_quotes_and_further_columns() {
        let text = "frame,landmark,x,y,z,confidence\r\na.ply,abdomen,1,2.5,-3e-1,0.5\r\n\n\"b,c.ply\",forehead,0,1,2\n";
        let landmarks = read(text).expect("is valid");
        assert_eq!(landmarks.len(), 2);
        assert_eq!(landmarks[0].position, DVec3::new(1.0, 2.5, -0.3));
        assert_eq!((landmarks[1].frame.as_str(), landmarks[1].landmark.as_str()), ("b,c.ply", "forehead"));
    }

    #[test]
    fn each_fault_names_its_line() {
        for (text, needle) in [
            ("", ""),
            ("landmark,frame,x,y,z\n", "line 1"),
            ("frame,landmark,x,y,z\na.ply,abdomen,1,2\n", "z is ''"),
            ("frame,landmark,x,y,z\na.ply,abdomen,1,2,NaN\n", "line 2"),
            ("frame,landmark,x,y,z\nz.ply,abdomen,1,2,3\n", "no frame 'z.ply'"),
            ("frame,landmark,x,y,z\nlonely\n", "five columns"),
        ] {
            match read(text) {
                Ok(landmarks) => assert!(text.is_empty() && landmarks.is_empty()),
                Err(message) => assert!(message.contains(needle) && !needle.is_empty(), "{message}"),
            }
        }
    }
}
