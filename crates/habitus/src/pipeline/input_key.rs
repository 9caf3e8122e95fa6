//! One short key for all that a stage's result depends on.

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

    fn key(texts: &[&str]) -> String {
        let mut key = InputKey::new();
        texts.iter().for_each(|text| key.add_text(text));
        key.text()
    }

    #[test]
    fn any_changed_byte_and_the_order_change_the_key() {
        let long = "settings ".repeat(50);
        let first = key(&[&long, "two"]);
        assert_eq!(first, key(&[&long, "two"]));
        for place in 0..long.len() {
            let mut changed = long.clone();
            changed.replace_range(place..=place, "#");
            assert_ne!(first, key(&[&changed, "two"]), "byte {place}");
        }
        assert_ne!(first, key(&["two", &long]));
        assert_ne!(first, key(&[&long]));
    }

    #[test]
    fn trailing_zeros_and_the_cut_between_texts_count() {
        assert_ne!(key(&["ab", "c"]), key(&["a", "bc"]));
        assert_ne!(key(&["a"]), key(&["a\0"]));
    }
}
