//! Figures, tables and page of a benchmark of fits under clothing, after P2 Fig. 3, 5, 6 and 7.

mod bars;
mod curves;
mod pictures;
mod tables;

use habitus::evaluation::sequence_errors::SequenceErrors;
use habitus::evaluation::sequence_metrics::BenchmarkMetrics;

use crate::render::RenderError;
use crate::shape_space::{Figure, Table, figures_page};

pub use pictures::{Overlay, overlays_figure};

/// One way to fit, with its errors over the sequences of the benchmark.
#[derive(Debug, Clone, Copy)]
pub struct Variant<'a> {
    /// Its name: a recipe, or what was changed.
    pub name: &'a str,
    /// Errors of each sequence.
    pub errors: &'a [SequenceErrors],
    /// What they add up to.
    pub metrics: &'a BenchmarkMetrics,
}

impl<'a> Variant<'a> {
    fn of(&self, is: impl Fn(&SequenceErrors) -> bool) -> Vec<&'a SequenceErrors> {
        self.errors.iter().filter(|errors| is(errors)).collect()
    }
}

/// The mean body that errors are drawn on: vertices in metres, and faces.
#[derive(Debug, Clone, Copy)]
pub struct MeanBody<'a> {
    /// Vertices.
    pub vertices: &'a [glam::DVec3],
    /// Faces, outward counter-clockwise.
    pub faces: &'a [[u32; 3]],
}

/// Styles in the order of figures and tables; others follow by name.
const STYLES: [&str; 3] = ["tight", "layered", "wide"];

/// The styles that a variant has, from tight to wide.
fn styles(variant: &Variant<'_>) -> Vec<String> {
    let known = STYLES.iter().map(ToString::to_string);
    let others = variant.metrics.styles.keys().filter(|style| !STYLES.contains(&style.as_str())).cloned();
    known.filter(|style| variant.metrics.styles.contains_key(style)).chain(others).collect()
}

/// All figures except the overlays; each is a file of its own and a part of the page.
///
/// # Errors
/// When a picture cannot be made.
pub fn benchmark_figures(variants: &[Variant<'_>], body: MeanBody<'_>) -> Result<Vec<Figure>, RenderError> {
    let mut figures = curves::landmark_figures(variants);
    figures.extend(bars::landmarks_by_sequence(variants));
    figures.extend(curves::shape_figures(variants));
    figures.push(pictures::shape_map(variants, body)?);
    figures.extend(curves::influence_figure(variants));
    figures.extend(curves::drift_figure(variants));
    Ok(figures)
}

/// The page with all figures and tables.
pub fn benchmark_page(variants: &[Variant<'_>], figures: &[Figure]) -> String {
    let (sequences, frames) = variants.iter().fold((0, 0), |(sequences, frames), variant| {
        let overall = &variant.metrics.overall;
        (sequences.max(overall.sequences), frames.max(overall.frames))
    });
    let subtitle = format!("{sequences} sequences, {frames} frames, none left out, against the true bodies");
    let tables: Vec<Table> = tables::tables(variants);
    figures_page("Bodies under clothing", &subtitle, figures, &tables)
}

#[cfg(test)]
mod tests;
