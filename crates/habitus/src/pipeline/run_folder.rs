//! A run on disk: numbered folders of stages, used by one process at a time.

use std::fs::{File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::artifacts::journal::Journal;
use crate::artifacts::write_atomically;

/// Why a run folder cannot be used.
#[derive(Debug, Error)]
pub enum RunFolderError {
    /// A folder or a file in it cannot be made.
    #[error("{}: cannot be used as a run folder ({source}); name another with -o", path.display())]
    Unusable {
        /// The folder or file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Another process works in it.
    #[error("{}: another habitus works in this run folder; wait for it or name another folder with -o", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
    },
}

/// The stages that keep files in a run folder; the number says the order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageName {
    /// Captures that were made rather than given.
    Scans,
    /// Template brought onto raw scans.
    Register,
    /// Body model from registered scans.
    LearnShape,
    /// Identity and poses under clothing.
    FitSequence,
    /// Clothing layer over the fitted body.
    ExtractClothing,
    /// Clothing model from layers.
    LearnClothing,
    /// Dressed sequences from a clothing model.
    Synthesize,
}

impl StageName {
    /// Name of the stage's folder.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Scans => "0_scans",
            Self::Register => "1_register",
            Self::LearnShape => "2_learn_shape",
            Self::FitSequence => "3_fit_sequence",
            Self::ExtractClothing => "4_extract_clothing",
            Self::LearnClothing => "5_learn_clothing",
            Self::Synthesize => "6_synthesize",
        }
    }
}

/// A run folder that this process alone may write to; the system releases it, also after a kill.
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    _lock: File,
}

/// Name of the lock in a run folder.
const LOCK: &str = ".lock";
/// Name of the file that holds a finished stage's key.
const KEY: &str = ".key";

impl RunFolder {
    /// Makes the folder if needed and takes it for this process.
    pub fn open(path: &Path) -> Result<Self, RunFolderError> {
        let unusable = |place: &Path, source| RunFolderError::Unusable { path: place.to_path_buf(), source };
        std::fs::create_dir_all(path).map_err(|source| unusable(path, source))?;
        let place = path.join(LOCK);
        let lock = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&place)
            .map_err(|source| unusable(&place, source))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(RunFolderError::Busy { path: path.to_path_buf() }),
            // A file system without locks must not keep anyone from working.
            Err(TryLockError::Error(_)) => {}
        }
        Ok(Self { path: path.to_path_buf(), _lock: lock })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The folder of a stage, made if needed.
    pub fn stage(&self, stage: StageName) -> Result<StageFolder, RunFolderError> {
        let path = self.path.join(stage.folder());
        std::fs::create_dir_all(&path)
            .map_err(|source| RunFolderError::Unusable { path: path.clone(), source })?;
        Ok(StageFolder { path })
    }
}

/// The folder of one stage.
#[derive(Clone, Debug, PartialEq)]
pub struct StageFolder {
    path: PathBuf,
}

impl StageFolder {
    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file in it.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// Whether the stage was finished under this key.
    pub fn is_finished(&self, key: &str) -> bool {
        std::fs::read_to_string(self.file(KEY)).is_ok_and(|found| found.trim() == key)
    }

    /// Says that all files of the stage are written and belong to this key.
    pub fn mark_finished(&self, key: &str) -> Result<(), RunFolderError> {
        let path = self.file(KEY);
        write_atomically(&path, key.as_bytes()).map_err(|source| RunFolderError::Unusable { path, source })
    }

    /// Says that the files of the stage are about to change.
    pub fn mark_unfinished(&self) -> Result<(), RunFolderError> {
        self.remove(KEY)
    }

    /// Opens a journal of the stage; what it holds under another key is discarded.
    pub fn journal(&self, name: &str, key: &str) -> Result<Journal, RunFolderError> {
        let path = self.file(name);
        Journal::open(&path, key).map_err(|source| RunFolderError::Unusable { path, source })
    }

    /// Removes a file if it is there.
    pub fn remove(&self, name: &str) -> Result<(), RunFolderError> {
        let path = self.file(name);
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                Err(RunFolderError::Unusable { path, source })
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{RunFolder, RunFolderError, StageName};

    #[test]
    fn one_process_at_a_time_may_use_a_run_folder() {
        let folder = tempfile::tempdir().expect("a folder");
        let run = RunFolder::open(folder.path()).expect("opens");
        assert!(matches!(RunFolder::open(folder.path()), Err(RunFolderError::Busy { .. })));
        drop(run);
        RunFolder::open(folder.path()).expect("opens again");
    }

    #[test]
    fn a_stage_is_finished_under_its_own_key_only() {
        let folder = tempfile::tempdir().expect("a folder");
        let run = RunFolder::open(folder.path()).expect("opens");
        let stage = run.stage(StageName::FitSequence).expect("a stage");
        assert!(!stage.is_finished("one"));
        stage.mark_finished("one").expect("marks");
        assert!(stage.is_finished("one") && !stage.is_finished("two"));
        stage.mark_unfinished().expect("unmarks");
        assert!(!stage.is_finished("one"));
        stage.mark_unfinished().expect("is allowed twice");
    }

    #[test]
    fn a_file_in_the_place_of_the_folder_is_an_error_that_names_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("run");
        std::fs::write(&path, b"in the way").expect("writes");
        let message = RunFolder::open(&path).expect_err("is refused").to_string();
        assert!(message.contains("run") && message.contains("-o"), "{message}");
    }
}
