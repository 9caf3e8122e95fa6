//! A run as one self-contained HTML file: plots, tables and a playable 3D view, readable offline.
//!
//! [`ReportData`] is everything that the page shows; [`write_report`] turns it into the page. Meshes go in as
//! quantised binary blocks within a size limit; the 3D view is a small WebGL2 module of our own (`assets/`).

pub(crate) mod blocks;
mod check;
mod data;
mod decimate;
pub(crate) mod markup;
mod page;
mod plan;
mod plots;
mod tables;

use std::path::{Path, PathBuf};

use habitus::artifacts::write_atomically;
use thiserror::Error;

pub use data::{
    BodyCurve, BodyView, CaptureView, CodeMeaning, FrameSummary, FrameView, Headline, IdentityCoefficient,
    LandmarkView, MeasurementRow, ModelView, Percentiles, ReportData, ReportOptions, Timing, TruthRow,
};
pub(crate) use decimate::decimated;
pub(crate) use markup::{escaped, number, script_json};
pub(crate) use page::STYLE;
pub use page::page;
pub(crate) use plan::view_frames;
pub(crate) use plots::nice_step;

/// Why a report could not be written.
#[derive(Debug, Error)]
pub enum ReportError {
    /// Two parts of the data that belong together have different lengths.
    #[error("{place}: {found} given, {expected} needed")]
    Count {
        /// Which part, of which frame.
        place: String,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// A number points at something that does not exist.
    #[error("{place}: number {found} is out of range, only {limit} exist")]
    OutOfRange {
        /// Which part, of which frame.
        place: String,
        /// The offending number.
        found: usize,
        /// How many exist.
        limit: usize,
    },
    /// A value is NaN or infinite where the 3D view needs a number.
    #[error("{place}: a value is not finite")]
    NotFinite {
        /// Which part, of which frame.
        place: String,
    },
    /// The data could not be turned into JSON.
    #[error("the report's data cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// The file could not be written.
    #[error("cannot write the report {path}: {source}")]
    Write {
        /// File that was to be written.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// Writes the page of a run; a kill at any moment leaves the old file or the new one.
///
/// # Errors
/// When the data contradict themselves or the file cannot be written.
pub fn write_report(path: &Path, data: &ReportData, options: &ReportOptions) -> Result<(), ReportError> {
    let html = page(data, options)?;
    write_atomically(path, html.as_bytes())
        .map_err(|source| ReportError::Write { path: path.to_owned(), source })
}
