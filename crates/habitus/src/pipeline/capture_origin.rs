//! Where the captures of a run were, so that a report can show them again. Kept apart from the results, which name no
//! folder of any machine.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use habitus_geometry::io::{Format, ReadError};
use serde::{Deserialize, Serialize};

use super::run_folder::RunFolderError;
use super::sequence_run::RunError;
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
    pub fn frames(&self) -> Result<FrameFolder, RunError> {
        let all = FrameFolder::open(&self.input)?;
        if let Some(path) = all.files().iter().find(|path| Format::of_path(path).is_none()) {
            return Err(FrameError::Read(ReadError::UnknownFormat { path: path.clone() }).into());
        }
        let formats: BTreeSet<String> = all.files().iter().map(|path| extension(path)).collect();
        if formats.len() > 1 {
            // The same frames in two formats would be fitted twice, in an order that nobody meant.
            let formats = formats.into_iter().collect::<Vec<_>>().join(", ");
            return Err(RunError::MixedFormats { path: self.input.clone(), formats });
        }
        let count = all.files().len();
        let selected = all.select(self.first, self.last.map(|last| last.min(count)), self.step);
        if selected.files().is_empty() {
            return Err(RunError::NothingSelected {
                path: self.input.clone(),
                count,
                first: self.first,
                last: self.last.unwrap_or(count - 1),
            });
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

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::{CaptureOrigin, RunError};

    fn origin(input: &std::path::Path, first: usize, last: Option<usize>) -> CaptureOrigin {
        CaptureOrigin { input: input.to_path_buf(), first, last, step: 1, frame_rate: 30.0 }
    }

    #[test]
    fn two_formats_in_one_folder_are_refused_and_a_pattern_chooses() {
        let folder = tempfile::tempdir().expect("a folder");
        for name in ["a_1.ply", "a_1.obj", "a_2.PLY"] {
            std::fs::write(folder.path().join(name), b"").expect("writes");
        }
        let mixed = origin(folder.path(), 0, None).frames();
        assert!(matches!(mixed, Err(RunError::MixedFormats { .. })));
        let chosen = origin(&folder.path().join("a_%d.obj"), 0, None).frames().expect("one format");
        assert_eq!(chosen.files().len(), 1);
    }

    #[test]
    fn a_selection_beyond_the_last_frame_says_how_many_there_are() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("a.ply"), b"").expect("writes");
        for (first, last) in [(1, None), (3, Some(5)), (1, Some(0))] {
            let error = origin(folder.path(), first, last).frames().expect_err("selects nothing");
            assert!(error.to_string().contains("1 frames"), "{error}");
        }
    }

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
