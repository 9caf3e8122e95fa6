//! Finished frames of a running stage, one JSON line each, so that a killed run loses nothing.

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Where finished items are kept while a stage runs.
pub struct Journal {
    file: Option<File>,
    finished: Vec<String>,
}

impl Journal {
    /// A journal that keeps nothing.
    pub fn none() -> Self {
        Self { file: None, finished: Vec::new() }
    }

    /// Opens a journal. Lines written under another `key` (other inputs, settings or version) are discarded, and so
    /// is a last line that a kill cut short.
    pub fn open(path: &Path, key: &str) -> std::io::Result<Self> {
        let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        let mut lines = Vec::new();
        let mut kept_bytes = 0_u64;
        let mut reader = BufReader::new(&file);
        let mut line = Vec::new();
        loop {
            line.clear();
            let length = reader.read_until(b'\n', &mut line)?;
            let Some(text) = line.strip_suffix(b"\n").and_then(|text| std::str::from_utf8(text).ok()) else {
                break;
            };
            if lines.is_empty() && text != key {
                break;
            }
            lines.push(text.to_string());
            kept_bytes += length as u64;
        }
        file.set_len(kept_bytes)?;
        file.seek(SeekFrom::Start(kept_bytes))?;
        if lines.is_empty() {
            writeln!(file, "{key}")?;
        } else {
            lines.remove(0);
        }
        Ok(Self { file: Some(file), finished: lines })
    }

    /// Items finished before, in order, up to the first that cannot be read as this type.
    pub fn finished<T: DeserializeOwned>(&self) -> Vec<T> {
        self.finished.iter().map_while(|line| serde_json::from_str(line).ok()).collect()
    }

    /// Adds a finished item and hands it to the system at once.
    pub fn append<T: Serialize>(&mut self, item: &T) -> std::io::Result<()> {
        if let Some(file) = &mut self.file {
            let mut line = serde_json::to_string(item).map_err(std::io::Error::other)?;
            line.push('\n');
            file.write_all(line.as_bytes())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_line_is_dropped_and_the_rest_is_kept_to_the_bit() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("journal");
        let values = [0.1 + 0.2, 1.0 / 3.0, f64::MIN_POSITIVE];
        let mut journal = Journal::open(&path, "key").expect("opens");
        for value in &values {
            journal.append(value).expect("appends");
        }
        drop(journal);
        let length = std::fs::metadata(&path).expect("exists").len();
        File::options().write(true).open(&path).expect("opens").set_len(length - 3).expect("cuts");
        let mut journal = Journal::open(&path, "key").expect("opens again");
        assert_eq!(journal.finished::<f64>(), values[..2]);
        journal.append(&7.0).expect("appends");
        drop(journal);
        let journal = Journal::open(&path, "key").expect("opens a third time");
        assert_eq!(journal.finished::<f64>(), [values[0], values[1], 7.0]);
    }

    #[test]
    fn another_key_starts_afresh() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("journal");
        Journal::open(&path, "one").expect("opens").append(&1).expect("appends");
        assert!(Journal::open(&path, "two").expect("opens").finished::<i32>().is_empty());
        assert!(Journal::open(&path, "one").expect("opens").finished::<i32>().is_empty());
    }
}
