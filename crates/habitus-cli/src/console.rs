//! What a person reads: results on standard output, all else on standard error.

use std::fmt::Display;
use std::io::Write;

/// Where messages go.
#[derive(Clone, Copy, Debug)]
pub struct Console {
    is_quiet: bool,
}

impl Console {
    /// A console that shows results and errors only, or all.
    pub fn new(is_quiet: bool) -> Self {
        Self { is_quiet }
    }

    /// Whether only results and errors are wanted.
    pub fn is_quiet(&self) -> bool {
        self.is_quiet
    }

    /// A result: always shown. A reader that went away is no error.
    pub fn result(&self, text: impl Display) {
        let _ = writeln!(std::io::stdout(), "{text}");
    }

    /// News on the way.
    pub fn note(&self, text: impl Display) {
        if !self.is_quiet {
            let _ = writeln!(std::io::stderr(), "{text}");
        }
    }

    /// Something that went wrong without ending the run: shown even when quiet.
    pub fn warning(&self, text: impl Display) {
        let _ = writeln!(std::io::stderr(), "warning: {text}");
    }

    /// What ended the run: each cause once, since messages of the library often quote their cause.
    pub fn error(&self, error: &anyhow::Error) {
        let mut text = String::new();
        for cause in error.chain().map(ToString::to_string) {
            if !text.contains(&cause) {
                text = if text.is_empty() { cause } else { format!("{text}: {cause}") };
            }
        }
        let _ = writeln!(std::io::stderr(), "error: {text}");
    }
}
