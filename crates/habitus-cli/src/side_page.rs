//! Pages beside a verb's results.

use std::path::Path;

use habitus::artifacts::write_atomically;

use crate::console::Console;

/// Name of a stage's page.
pub const REPORT_FILE: &str = "report.html";

/// What a run or file is called in the heading of its page: its name without ending.
pub fn title_of(path: &Path) -> String {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Writes a page; one that cannot be written must not cost the results.
pub fn write_side_page(path: &Path, html: &str, console: &Console) {
    if let Err(error) = write_atomically(path, html.as_bytes()) {
        console.warning(format!("{}: the page cannot be written ({error})", path.display()));
    }
}
