//! Words of a text with their lines.

use std::path::Path;

use super::MotionFileError;

/// The words of a file, one after the other.
pub(super) struct Words<'a> {
    path: &'a Path,
    words: std::iter::Peekable<Box<dyn Iterator<Item = (usize, &'a str)> + 'a>>,
    line: usize,
}

impl<'a> Words<'a> {
    /// The words of a text; what follows `#` on a line is left out.
    pub(super) fn of(text: &'a str, path: &'a Path) -> Self {
        let lines = text.lines().enumerate();
        let words: Box<dyn Iterator<Item = (usize, &'a str)> + 'a> =
            Box::new(lines.flat_map(|(index, line)| {
                let content = line.split('#').next().unwrap_or_default();
                content.split_whitespace().map(move |word| (index + 1, word))
            }));
        Self { path, words: words.peekable(), line: 1 }
    }

    /// The next word, left where it is.
    pub(super) fn peek(&mut self) -> Option<&'a str> {
        self.words.peek().map(|(_, word)| *word)
    }

    /// Line of the next word; of the last one at the end of the file.
    pub(super) fn line_of_next(&mut self) -> usize {
        self.words.peek().map_or(self.line, |(line, _)| *line)
    }

    /// Takes the next word.
    pub(super) fn next(&mut self) -> Option<&'a str> {
        let (line, word) = self.words.next()?;
        self.line = line;
        Some(word)
    }

    /// Takes the next word, which must be there.
    pub(super) fn need(&mut self, what: &str) -> Result<&'a str, MotionFileError> {
        self.next().ok_or_else(|| self.fault(format!("the file ends where {what} must follow")))
    }

    /// Takes the next word, which must be this one.
    pub(super) fn expect(&mut self, word: &str) -> Result<(), MotionFileError> {
        let found = self.need(word)?;
        if found.eq_ignore_ascii_case(word) {
            return Ok(());
        }
        Err(self.fault(format!("'{word}' must stand where '{found}' does")))
    }

    /// Takes the next word, which must be a finite number.
    pub(super) fn number(&mut self, what: &str) -> Result<f64, MotionFileError> {
        let word = self.need(what)?;
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(self.fault(format!("{what} must be a finite number, not '{word}'"))),
        }
    }

    /// An error at the last word taken.
    pub(super) fn fault(&self, reason: String) -> MotionFileError {
        MotionFileError::Malformed { path: self.path.to_path_buf(), line: self.line, reason }
    }
}
