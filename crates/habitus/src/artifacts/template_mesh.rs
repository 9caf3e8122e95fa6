//! A template without a body model: any mesh with named vertices.

use std::path::{Path, PathBuf};

use habitus_geometry::TriangleMesh;
use habitus_geometry::io::{ReadError, read_mesh};
use thiserror::Error;

/// Why a template cannot be used.
#[derive(Debug, Error)]
pub enum TemplateError {
    /// The mesh cannot be read.
    #[error(transparent)]
    Mesh(#[from] ReadError),
    /// The table of landmarks cannot be read.
    #[error(
        "{}: the template's landmarks cannot be read ({source}); needed is a table landmark,vertex beside the template or with --template-landmarks",
        path.display()
    )]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A line of the table is not what it should be.
    #[error("{}, line {line}: {reason}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1.
        line: usize,
        /// What is wrong.
        reason: String,
    },
}

/// A mesh and its landmarks, in metres or in whatever unit its landmarks' scans have.
#[derive(Clone, Debug, PartialEq)]
pub struct TemplateMesh {
    /// Name of the template.
    pub name: String,
    /// The mesh.
    pub mesh: TriangleMesh,
    /// Names with their vertices.
    pub landmarks: Vec<(String, u32)>,
}

impl TemplateMesh {
    /// Reads a mesh and a table `landmark,vertex`.
    pub fn read(mesh: &Path, landmarks: &Path) -> Result<Self, TemplateError> {
        let name = mesh.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mesh = read_mesh(mesh)?;
        let landmarks = read_landmark_vertices(landmarks, mesh.positions().len())?;
        Ok(Self { name, mesh, landmarks })
    }

    /// Where the table is looked for if it is not named: `<stem>_landmarks.csv` beside the mesh.
    pub fn default_landmarks_file(mesh: &Path) -> PathBuf {
        let stem = mesh.file_stem().unwrap_or_default().to_string_lossy();
        mesh.with_file_name(format!("{stem}_landmarks.csv"))
    }
}

/// Reads a table `landmark,vertex`.
pub fn read_landmark_vertices(path: &Path, vertex_count: usize) -> Result<Vec<(String, u32)>, TemplateError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| TemplateError::Unreadable { path: path.to_path_buf(), source })?;
    let mut landmarks: Vec<(String, u32)> = Vec::new();
    for (index, row) in text.lines().enumerate().filter(|(_, row)| !row.trim().is_empty()) {
        let fail = |reason: String| TemplateError::Line { path: path.to_path_buf(), line: index + 1, reason };
        // Names may hold commas; the vertex never does.
        let Some((name, word)) = row.trim_end_matches('\r').rsplit_once(',') else {
            return Err(fail("columns landmark,vertex are needed".into()));
        };
        let name = name.trim().trim_matches('"');
        match word.trim().parse::<u32>() {
            Ok(vertex) if (vertex as usize) < vertex_count => {
                if landmarks.iter().any(|(known, _)| known == name) {
                    return Err(fail(format!("'{name}' is there twice; keep one")));
                }
                landmarks.push((name.to_string(), vertex));
            }
            Ok(vertex) => {
                return Err(fail(format!(
                    "there are only {vertex_count} vertices, counted from 0, no {vertex}"
                )));
            }
            Err(_) if index == 0 => {}
            Err(_) => return Err(fail(format!("'{word}' is no vertex number"))),
        }
    }
    Ok(landmarks)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<(String, u32)>, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("marks.csv");
        std::fs::write(&path, text).expect("writes");
        read_landmark_vertices(&path, 10).map_err(|error| error.to_string())
    }

    #[test]
    fn names_may_hold_commas_and_faults_name_their_line() {
        let found = read("landmark,vertex\nLt. Axilla, Ant.,3\nSellion,9\n").expect("is valid");
        assert_eq!(found, [("Lt. Axilla, Ant.".to_string(), 3), ("Sellion".to_string(), 9)]);
        for (text, needle) in [
            ("a,10\n", "only 10"),
            ("a,1\na,2\n", "twice"),
            ("a,1\nb,x\n", "line 2"),
            ("lonely\n", "landmark,vertex"),
        ] {
            let message = read(text).expect_err(text);
            assert!(message.contains(needle), "{message}");
        }
    }
}
