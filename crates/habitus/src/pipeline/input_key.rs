//! One short key for all that a stage's result depends on: names, contents, settings, model and version.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use rayon::prelude::*;

use crate::body::BodyModel;

/// Bytes that are read at a time.
const BLOCK: usize = 1 << 16;
/// An odd constant with well-spread bits (2⁶⁴ / golden ratio).
const SPREAD: u64 = 0x9E37_79B9_7F4A_7C15;

/// Collects what a result depends on. The key tells changed inputs from unchanged ones, not friend from foe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputKey {
    state: u64,
    length: u64,
}

impl Default for InputKey {
    fn default() -> Self {
        Self::new()
    }
}

impl InputKey {
    /// A key of nothing yet.
    pub fn new() -> Self {
        Self { state: SPREAD, length: 0 }
    }

    /// Each step is a bijection of the state and of the word, so that a change of any one word changes the key.
    fn add_word(&mut self, word: u64) {
        self.state = (self.state.rotate_left(23) ^ word).wrapping_mul(SPREAD);
    }

    /// Adds bytes; two calls count as two things.
    pub fn add_bytes(&mut self, bytes: &[u8]) {
        let words = bytes.chunks_exact(8);
        let rest = words.remainder();
        for word in words {
            self.add_word(u64::from_le_bytes(word.try_into().unwrap_or_default()));
        }
        let mut last = [0; 8];
        last[..rest.len()].copy_from_slice(rest);
        self.add_word(u64::from_le_bytes(last));
        self.length = self.length.wrapping_add(bytes.len() as u64);
        self.add_word(self.length);
    }

    /// Adds a text.
    pub fn add_text(&mut self, text: &str) {
        self.add_bytes(text.as_bytes());
    }

    /// Adds names, sizes and contents of files in order. Their dates do not count. A file that cannot be read counts
    /// as such, and reading it later is what fails.
    pub fn add_files<P: AsRef<Path> + Sync>(&mut self, files: &[P]) {
        let keys: Vec<Option<Self>> =
            files.par_iter().map(|file| Self::of_content(file.as_ref()).ok()).collect();
        for (file, key) in files.iter().zip(keys) {
            self.add_text(&file.as_ref().file_name().unwrap_or_default().to_string_lossy());
            match key {
                Some(key) => {
                    self.add_word(key.length);
                    self.add_word(key.state);
                }
                None => self.add_text("unreadable"),
            }
        }
    }

    /// Adds what a body model does to bodies, wherever its numbers come from.
    pub fn add_model(&mut self, model: &BodyModel) {
        self.add_text(&serde_json::to_string(model.metadata()).unwrap_or_default());
        for vertex in model.mean_vertices() {
            vertex.to_array().iter().for_each(|value| self.add_word(value.to_bits()));
        }
        // One instance with all components mixed in unequal shares stands for the basis.
        let mixed: Vec<f64> = (0..model.component_count()).map(|k| 1.0 / (k + 1) as f64).collect();
        for vertex in model.rest_vertices(&mixed) {
            vertex.to_array().iter().for_each(|value| self.add_word(value.to_bits()));
        }
        for axis in model.skeleton().axes() {
            self.add_word(axis.bone as u64);
            axis.limits.iter().for_each(|limit| self.add_word(limit.to_bits()));
        }
    }

    fn of_content(path: &Path) -> std::io::Result<Self> {
        let mut file = File::open(path)?;
        let mut key = Self::new();
        let mut block = vec![0; BLOCK];
        loop {
            let mut filled = 0;
            // A short read is not the end of the file; blocks must not depend on how the system cuts them.
            while filled < BLOCK {
                match file.read(&mut block[filled..])? {
                    0 => break,
                    count => filled += count,
                }
            }
            key.add_bytes(&block[..filled]);
            if filled < BLOCK {
                return Ok(key);
            }
        }
    }

    /// The key as sixteen hexadecimal digits.
    pub fn text(&self) -> String {
        let mut last = *self;
        last.add_word(self.length);
        last.add_word(0);
        format!("{:016x}", last.state ^ (last.state >> 32))
    }
}

#[cfg(test)]
mod tests {
    use super::InputKey;

    fn key_of(files: &[(&str, &[u8])]) -> String {
        let folder = tempfile::tempdir().expect("a folder");
        let paths: Vec<_> = files.iter().map(|(name, _)| folder.path().join(name)).collect();
        for (path, (_, bytes)) in paths.iter().zip(files) {
            std::fs::write(path, bytes).expect("writes");
        }
        let mut key = InputKey::new();
        key.add_files(&paths);
        key.text()
    }

    #[test]
    fn any_changed_byte_name_or_order_changes_the_key() {
        let long = vec![7_u8; 200_000];
        let key = key_of(&[("a", &long), ("b", b"two")]);
        assert_eq!(key, key_of(&[("a", &long), ("b", b"two")]));
        for place in [0, 65_535, 65_536, 199_999] {
            let mut changed = long.clone();
            changed[place] ^= 1;
            assert_ne!(key, key_of(&[("a", &changed), ("b", b"two")]), "byte {place}");
        }
        assert_ne!(key, key_of(&[("a", &long[1..]), ("b", b"two")]));
        assert_ne!(key, key_of(&[("c", &long), ("b", b"two")]));
        assert_ne!(key, key_of(&[("b", b"two"), ("a", &long)]));
        assert_ne!(key, key_of(&[("a", &long)]));
    }

    #[test]
    fn trailing_zeros_and_the_cut_between_texts_count() {
        let key = |texts: &[&str]| {
            let mut key = InputKey::new();
            texts.iter().for_each(|text| key.add_text(text));
            key.text()
        };
        assert_ne!(key(&["ab", "c"]), key(&["a", "bc"]));
        assert_ne!(key(&["a"]), key(&["a\0"]));
    }
}
