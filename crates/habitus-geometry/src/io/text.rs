//! Lines, words and numbers of text formats, with the place for messages.

use glam::DVec3;

use super::error::{Fault, Place, Problem, shortened};

/// The lines of a text file that are not blank, without comments.
pub(super) struct Lines<'a> {
    rest: &'a [u8],
    line: usize,
    joins_after_backslash: bool,
}

/// One line, being taken apart.
#[derive(Clone)]
pub(super) struct Line<'a> {
    text: std::borrow::Cow<'a, [u8]>,
    read: usize,
    pub place: Place,
}

impl<'a> Lines<'a> {
    /// Lines that end where they end.
    pub fn plain(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, line: 0, joins_after_backslash: false }
    }

    /// Lines that go on after a backslash, as in OBJ.
    pub fn continued(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, line: 0, joins_after_backslash: true }
    }

    /// The last line that was read.
    pub fn place(&self) -> Place {
        Place::Line(self.line.max(1))
    }

    /// The next line that holds something, or `None` at the end.
    pub fn next_line(&mut self) -> Option<Line<'a>> {
        loop {
            let first = self.next_physical()?;
            let place = self.place();
            let mut text = std::borrow::Cow::Borrowed(without_comment(first));
            while self.joins_after_backslash && text.ends_with(b"\\") {
                let mut joined = text.into_owned();
                joined.pop();
                joined.push(b' ');
                joined.extend_from_slice(without_comment(self.next_physical().unwrap_or_default()));
                text = std::borrow::Cow::Owned(joined);
            }
            if !text.trim_ascii().is_empty() {
                return Some(Line { text, read: 0, place });
            }
        }
    }

    fn next_physical(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        let length = self.rest.iter().position(|&byte| byte == b'\n').unwrap_or(self.rest.len());
        let text = self.rest[..length].trim_ascii_end();
        self.rest = &self.rest[(length + 1).min(self.rest.len())..];
        self.line += 1;
        Some(text)
    }
}

fn without_comment(text: &[u8]) -> &[u8] {
    let length = text.iter().position(|&byte| byte == b'#').unwrap_or(text.len());
    text[..length].trim_ascii_end()
}

impl Line<'_> {
    /// The next word, or `None` at the end of the line.
    pub fn next_word(&mut self) -> Option<&[u8]> {
        let rest = &self.text[self.read..];
        let start = self.read + rest.iter().position(|byte| !byte.is_ascii_whitespace())?;
        let length =
            self.text[start..].iter().position(u8::is_ascii_whitespace).unwrap_or(self.text.len() - start);
        self.read = start + length;
        Some(&self.text[start..start + length])
    }

    /// The next number, which must be there.
    pub fn next_number(&mut self, what: &'static str) -> Result<f64, Fault> {
        let place = self.place;
        match self.next_word() {
            Some(word) => number(word).ok_or_else(|| unexpected(place, "a number", word)),
            None => Err(missing(place, what)),
        }
    }

    /// The next three numbers, which must be there.
    pub fn next_vector(&mut self, what: &'static str) -> Result<DVec3, Fault> {
        Ok(DVec3::new(self.next_number(what)?, self.next_number(what)?, self.next_number(what)?))
    }

    /// The next whole number of 0 or more, which must be there.
    pub fn next_count(&mut self, what: &'static str) -> Result<u64, Fault> {
        let place = self.place;
        match self.next_word() {
            Some(word) => std::str::from_utf8(word)
                .ok()
                .and_then(|word| word.parse().ok())
                .ok_or_else(|| unexpected(place, "a whole number of 0 or more", word)),
            None => Err(missing(place, what)),
        }
    }
}

/// A number as text, infinities and NaN included.
pub(super) fn number(word: &[u8]) -> Option<f64> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

pub(super) fn unexpected(place: Place, expected: &'static str, word: &[u8]) -> Fault {
    Fault { place, problem: Problem::Unexpected { expected, found: shortened(word) } }
}

pub(super) fn missing(place: Place, what: &str) -> Fault {
    Fault { place, problem: Problem::Missing { what: what.to_owned() } }
}
