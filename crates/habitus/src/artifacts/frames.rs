//! A captured sequence: frames that need not fit in memory together.

use std::path::{Path, PathBuf};

use habitus_geometry::Surface;
use habitus_geometry::io::{ReadError, read_surface};
use thiserror::Error;

/// Why a frame or a sequence cannot be read.
#[derive(Debug, Error)]
pub enum FrameError {
    /// The folder cannot be listed.
    #[error("{}: the folder cannot be read ({reason})", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// There is nothing to read.
    #[error("{}: no frames found; needed are .ply, .obj, .stl, .off or .glb files", path.display())]
    Empty {
        /// The folder or pattern.
        path: PathBuf,
    },
    /// The frame's file is broken.
    #[error(transparent)]
    Read(#[from] ReadError),
}

/// A sequence of captures, read one at a time.
pub trait FrameSource: Sync {
    /// Number of frames.
    fn len(&self) -> usize;

    /// Whether there is no frame at all.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Name of a frame, unique in the sequence.
    fn name(&self, frame: usize) -> String;

    /// Reads a frame in the input's own coordinates.
    fn surface(&self, frame: usize) -> Result<Surface, FrameError>;
}

/// Mesh or cloud files of one folder in natural order (`frame_2` before `frame_10`).
#[derive(Clone, Debug, PartialEq)]
pub struct FrameFolder {
    files: Vec<PathBuf>,
}

/// File endings of captures.
const EXTENSIONS: [&str; 5] = ["ply", "obj", "stl", "off", "glb"];

impl FrameFolder {
    /// Lists a folder, or takes a single file, or a pattern with one `%d` or `%04d` in its file name.
    pub fn open(input: &Path) -> Result<Self, FrameError> {
        if input.is_file() {
            return Ok(Self { files: vec![input.to_path_buf()] });
        }
        let name = input.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let pattern = NumberPattern::parse(&name);
        let folder = match (&pattern, input.parent()) {
            (Some(_), Some(parent)) if parent.as_os_str().is_empty() => Path::new("."),
            (Some(_), Some(parent)) => parent,
            _ => input,
        };
        let entries = std::fs::read_dir(folder)
            .map_err(|error| FrameError::Folder { path: folder.to_path_buf(), reason: error.to_string() })?;
        let mut files: Vec<(String, PathBuf)> = entries
            .filter_map(Result::ok)
            .map(|entry| (entry.file_name().to_string_lossy().into_owned(), entry.path()))
            .filter(|(name, path)| path.is_file() && is_capture(name))
            .filter(|(name, _)| pattern.as_ref().is_none_or(|pattern| pattern.matches(name)))
            .collect();
        files.sort_by_cached_key(|(name, _)| natural_key(name));
        if files.is_empty() {
            return Err(FrameError::Empty { path: input.to_path_buf() });
        }
        Ok(Self { files: files.into_iter().map(|(_, path)| path).collect() })
    }

    /// The files in order.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// Keeps only some of the frames.
    #[must_use]
    pub fn select(&self, first: usize, last: Option<usize>, step: usize) -> Self {
        let end = last.map_or(self.files.len(), |last| last.saturating_add(1).min(self.files.len()));
        Self { files: self.files[first.min(end)..end].iter().step_by(step.max(1)).cloned().collect() }
    }
}

impl FrameSource for FrameFolder {
    fn len(&self) -> usize {
        self.files.len()
    }

    fn name(&self, frame: usize) -> String {
        self.files[frame].file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    }

    fn surface(&self, frame: usize) -> Result<Surface, FrameError> {
        Ok(read_surface(&self.files[frame])?)
    }
}

/// Frames held in memory.
pub struct FramesInMemory {
    /// The captures in order.
    pub surfaces: Vec<Surface>,
}

impl FrameSource for FramesInMemory {
    fn len(&self) -> usize {
        self.surfaces.len()
    }

    fn name(&self, frame: usize) -> String {
        format!("frame_{frame:04}")
    }

    fn surface(&self, frame: usize) -> Result<Surface, FrameError> {
        Ok(self.surfaces[frame].clone())
    }
}

fn is_capture(name: &str) -> bool {
    !name.starts_with('.')
        && name.rsplit_once('.').is_some_and(|(_, extension)| {
            EXTENSIONS.iter().any(|known| extension.eq_ignore_ascii_case(known))
        })
}

/// Digits compare as numbers, the rest as text; the text itself breaks ties.
fn natural_key(name: &str) -> (Vec<(String, u128)>, String) {
    let mut parts = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text_end = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(text_end);
        let digits_end = tail.find(|c: char| !c.is_ascii_digit()).unwrap_or(tail.len());
        let (digits, tail) = tail.split_at(digits_end);
        parts.push((text.to_lowercase(), digits.parse().unwrap_or(0)));
        rest = tail;
    }
    (parts, name.to_string())
}

struct NumberPattern {
    prefix: String,
    suffix: String,
    width: Option<usize>,
}

impl NumberPattern {
    fn parse(name: &str) -> Option<Self> {
        let (prefix, rest) = name.split_once('%')?;
        let (format, suffix) = rest.split_once('d')?;
        let width = match format {
            "" => None,
            digits if digits.starts_with('0') => Some(digits.parse().ok()?),
            _ => return None,
        };
        Some(Self { prefix: prefix.into(), suffix: suffix.into(), width })
    }

    fn matches(&self, name: &str) -> bool {
        name.strip_prefix(&self.prefix).and_then(|rest| rest.strip_suffix(&self.suffix)).is_some_and(
            |digits| {
                !digits.is_empty()
                    && digits.bytes().all(|byte| byte.is_ascii_digit())
                    && self.width.is_none_or(|width| digits.len() >= width)
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_sort_as_a_person_counts() {
        let mut names = vec!["f10.ply", "f9.ply", "f001.ply", "a2.ply"];
        names.sort_by_key(|name| natural_key(name));
        assert_eq!(names, ["a2.ply", "f001.ply", "f9.ply", "f10.ply"]);
    }

    #[test]
    fn a_pattern_selects_numbers_of_its_width() {
        let pattern = NumberPattern::parse("scan_%04d.ply").expect("a pattern");
        assert!(pattern.matches("scan_0012.ply"));
        assert!(!pattern.matches("scan_12.ply"));
        assert!(!pattern.matches("scan_00x2.ply"));
        assert!(NumberPattern::parse("plain.ply").is_none());
    }
}
