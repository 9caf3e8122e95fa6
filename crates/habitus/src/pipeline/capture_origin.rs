//! Where the captures of a run were, so that a report can show them again. Kept apart from the results, which name no
//! folder of any machine.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::run_folder::RunFolderError;
use crate::artifacts::frames::{FrameError, FrameFolder};
use crate::artifacts::write_atomically;

/// The captures of a run: a folder, file or pattern, and which of its frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CaptureOrigin {
    /// Folder, file or pattern.
    pub input: PathBuf,
    /// First frame, counted from 0.
    pub first: usize,
    /// Last frame, if not the last of all.
    pub last: Option<usize>,
    /// Every how many frames one is taken.
    pub step: usize,
    /// Captured frames per second.
    pub frame_rate: f64,
}

/// Name of the file in the run folder.
const FILE: &str = ".captures.toml";

impl CaptureOrigin {
    /// Lists the frames.
    pub fn frames(&self) -> Result<FrameFolder, FrameError> {
        let all = FrameFolder::open(&self.input)?;
        let selected = all.select(self.first, self.last, self.step);
        if selected.files().is_empty() {
            return Err(FrameError::Empty { path: self.input.clone() });
        }
        Ok(selected)
    }

    /// Remembers the captures in a run folder. Paths inside the run stay relative to it, so that it can be moved.
    pub fn write(&self, run: &Path) -> Result<(), RunFolderError> {
        let path = run.join(FILE);
        let unusable = |source| RunFolderError::Unusable { path: path.clone(), source };
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
        let input = absolute(&self.input);
        let input = input.strip_prefix(absolute(run)).map(Path::to_path_buf).unwrap_or(input);
        let text = toml::to_string(&Self { input, ..self.clone() })
            .map_err(|error| unusable(std::io::Error::other(error)))?;
        write_atomically(&path, text.as_bytes()).map_err(unusable)
    }

    /// What a run folder remembers, if anything.
    pub fn read(run: &Path) -> Option<Self> {
        let text = std::fs::read_to_string(run.join(FILE)).ok()?;
        let origin: Self = toml::from_str(&text).ok()?;
        Some(Self { input: run.join(&origin.input), ..origin })
    }
}

#[cfg(test)]
mod tests {
    use super::CaptureOrigin;

    #[test]
    fn captures_inside_the_run_are_found_after_it_moved() {
        let folder = tempfile::tempdir().expect("a folder");
        let (old, new) = (folder.path().join("old"), folder.path().join("new"));
        std::fs::create_dir(&old).expect("makes");
        let origin =
            CaptureOrigin { input: old.join("0_scans"), first: 2, last: None, step: 3, frame_rate: 30.0 };
        origin.write(&old).expect("writes");
        assert_eq!(CaptureOrigin::read(&old), Some(origin.clone()));
        std::fs::rename(&old, &new).expect("moves");
        assert_eq!(CaptureOrigin::read(&new), Some(CaptureOrigin { input: new.join("0_scans"), ..origin }));
        assert_eq!(CaptureOrigin::read(folder.path()), None);
    }
}
