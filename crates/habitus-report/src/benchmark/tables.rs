//! The numbers of the benchmark as tables.

use habitus::evaluation::sequence_metrics::SequenceMetrics;

use super::{Variant, styles};
use crate::shape_space::Table;

/// A column: its head and where its number comes from.
type Column = (&'static str, fn(&SequenceMetrics) -> Option<f64>);

const ACCURACY: [Column; 13] = [
    ("frames", |metrics| Some(metrics.frames as f64)),
    ("posed mm", |metrics| Some(metrics.posed_mean_mm)),
    ("posed p95 mm", |metrics| Some(metrics.posed_p95_mm)),
    ("rest mm", |metrics| Some(metrics.rest_mean_mm)),
    ("rest < 10 mm, %", |metrics| Some(100.0 * metrics.rest_under_10mm)),
    ("rest from root mm", |metrics| Some(metrics.rest_from_root_mean_mm)),
    ("< 10 mm, %", |metrics| Some(100.0 * metrics.rest_from_root_under_10mm)),
    ("joints mm", |metrics| Some(metrics.mpjpe_mm)),
    ("landmarks mm", |metrics| metrics.landmark_mm),
    ("girths mm", |metrics| Some(metrics.girth_mean_error_mm)),
    ("stature mm", |metrics| Some(metrics.stature_error_mm)),
    ("paper protocol mm", |metrics| metrics.paper_protocol.map(|protocol| protocol.mean_mm)),
    ("< 10 mm, %", |metrics| metrics.paper_protocol.map(|protocol| 100.0 * protocol.under_10mm)),
];

const TRUST: [Column; 11] = [
    ("outside > 5 mm, %", |metrics| Some(100.0 * metrics.outside_share_5mm)),
    ("jitter / truth's", |metrics| metrics.jitter_ratio),
    ("drift mm", |metrics| metrics.drift_mm),
    ("failed, %", |metrics| Some(100.0 * metrics.failure_rate)),
    ("false alarms, %", |metrics| Some(100.0 * metrics.false_alarm_rate)),
    ("missed, %", |metrics| Some(100.0 * metrics.miss_rate)),
    ("within ±1σ, %", |metrics| metrics.uncertainty.map(|coverage| 100.0 * coverage.within_one)),
    ("within ±2σ, %", |metrics| metrics.uncertainty.map(|coverage| 100.0 * coverage.within_two)),
    ("error / σ", |metrics| metrics.uncertainty.map(|coverage| coverage.error_over_stated)),
    ("s a frame, p50", |metrics| metrics.seconds_per_frame.map(|seconds| seconds.p50)),
    ("p95", |metrics| metrics.seconds_per_frame.map(|seconds| seconds.p95)),
];

pub(super) fn tables(variants: &[Variant<'_>]) -> Vec<Table> {
    let rows = rows_by_style(variants);
    let mut tables = vec![
        table("Accuracy by style of clothing", &ACCURACY, &rows),
        table("Trust and time by style of clothing", &TRUST, &rows),
    ];
    for variant in variants {
        let rows: Vec<(String, &SequenceMetrics)> =
            variant.metrics.sequences.iter().map(|(name, metrics)| (name.clone(), metrics)).collect();
        tables.push(table(&format!("Each sequence, {}", variant.name), &ACCURACY, &rows));
    }
    tables
}

fn rows_by_style<'a>(variants: &[Variant<'a>]) -> Vec<(String, &'a SequenceMetrics)> {
    let mut rows = Vec::new();
    for variant in variants {
        for style in styles(variant) {
            rows.push((format!("{}, {style}", variant.name), &variant.metrics.styles[&style]));
        }
        rows.push((format!("{}, all", variant.name), &variant.metrics.overall));
    }
    rows
}

fn table(title: &str, columns: &[Column], rows: &[(String, &SequenceMetrics)]) -> Table {
    let head = std::iter::once(String::new()).chain(columns.iter().map(|(name, _)| (*name).into()));
    let rows = rows.iter().map(|(name, metrics)| {
        let values = columns.iter().map(|(_, value)| value(metrics).unwrap_or(f64::NAN));
        (name.clone(), values.collect())
    });
    Table { title: title.into(), head: head.collect(), rows: rows.collect() }
}
