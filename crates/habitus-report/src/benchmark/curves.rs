//! Cumulative curves and errors over time.

use habitus::evaluation::sequence_errors::SequenceErrors;
use habitus::evaluation::sequence_metrics::{cumulative, paper_protocol_distances};

use super::{Variant, styles};
use crate::shape_space::{Figure, LineChart, Series};

/// P2 Fig. 5 and 6 show errors up to about this.
const LARGEST_LANDMARK_ERROR_MM: usize = 100;
const LARGEST_SHAPE_ERROR_MM: usize = 50;

fn thresholds(largest_mm: usize) -> Vec<f64> {
    (0..=largest_mm).map(|millimetre| millimetre as f64).collect()
}

fn landmark_errors(chosen: &[&SequenceErrors]) -> Vec<f64> {
    let frames = chosen.iter().flat_map(|errors| &errors.frames);
    frames.flat_map(|frame| frame.landmarks_mm.iter().copied()).collect()
}

fn rest_errors(chosen: &[&SequenceErrors]) -> Vec<f64> {
    chosen.iter().flat_map(|errors| errors.rest_mm.iter().copied()).collect()
}

/// A line that is left out where there is nothing to count.
fn line(name: String, errors: &[f64], largest_mm: usize) -> Option<Series> {
    (!errors.is_empty()).then(|| Series { name, points: cumulative(errors, &thresholds(largest_mm)) })
}

fn figure(name: &str, title: &str, x_label: &str, caption: &str, series: Vec<Series>) -> Option<Figure> {
    let chart = LineChart {
        title: title.into(),
        x_label: x_label.into(),
        y_label: "share at most so large".into(),
        series,
    };
    let is_empty = chart.series.is_empty();
    (!is_empty).then(|| Figure { name: name.into(), caption: caption.into(), svg: chart.svg() })
}

/// Each style of each variant; variants are only named where there are several.
fn by_style(
    variants: &[Variant<'_>],
    largest_mm: usize,
    errors: impl Fn(&Variant<'_>, &[&SequenceErrors]) -> Vec<f64>,
) -> Vec<Series> {
    let mut series = Vec::new();
    for variant in variants {
        for style in styles(variant) {
            let name = if variants.len() > 1 { format!("{style}, {}", variant.name) } else { style.clone() };
            let chosen = variant.of(|errors| errors.label.style == style);
            series.extend(line(name, &errors(variant, &chosen), largest_mm));
        }
    }
    series
}

/// P2 Fig. 5, left: landmarks of walking people in tight clothing; and of all.
pub(super) fn landmark_figures(variants: &[Variant<'_>]) -> Vec<Figure> {
    let is_walk = |errors: &SequenceErrors| errors.label.style == "tight" && errors.label.motion == "walk";
    let walking = variants
        .iter()
        .filter_map(|variant| {
            let errors = landmark_errors(&variant.of(is_walk));
            line(variant.name.into(), &errors, LARGEST_LANDMARK_ERROR_MM)
        })
        .collect();
    let all = by_style(variants, LARGEST_LANDMARK_ERROR_MM, |_, chosen| landmark_errors(chosen));
    let label = "landmark error, mm";
    [
        figure(
            "landmarks_tight_walk",
            "Landmarks, walking in tight clothing",
            label,
            "Share of landmarks at most so far from the truth (P2 Fig. 5, left; there most are within 35 mm).",
            walking,
        ),
        figure(
            "landmarks_by_style",
            "Landmarks, all sequences",
            label,
            "The same over all motions, by style of clothing.",
            all,
        ),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// P2 Fig. 6, left: the shape against the true bodies, and by P2's own protocol.
pub(super) fn shape_figures(variants: &[Variant<'_>]) -> Vec<Figure> {
    let truth = by_style(variants, LARGEST_SHAPE_ERROR_MM, |_, chosen| rest_errors(chosen));
    let protocol = by_style(variants, LARGEST_SHAPE_ERROR_MM, |variant, chosen| {
        paper_protocol_distances(chosen, variant.errors)
    });
    let label = "vertex error in the rest pose, mm";
    [
        figure(
            "shape_truth",
            "Shape against the true bodies",
            label,
            "Share of vertices at most so far from the true rest body.",
            truth,
        ),
        figure(
            "shape_paper_protocol",
            "Shape by the paper's protocol",
            label,
            "The same against the body that was fitted to the same person walking in tight clothing (P2 Fig. 6, \
             left; there more than half are below 10 mm). This refers to the method itself.",
            protocol,
        ),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// P2 Fig. 3, middle: what a changed energy does to the shape.
pub(super) fn influence_figure(variants: &[Variant<'_>]) -> Option<Figure> {
    if variants.len() < 2 {
        return None;
    }
    let series = variants
        .iter()
        .filter_map(|variant| {
            let errors = rest_errors(&variant.of(|errors| errors.label.style != "tight"));
            line(variant.name.into(), &errors, LARGEST_SHAPE_ERROR_MM)
        })
        .collect();
    figure(
        "shape_by_variant",
        "Shape under layered and wide clothing",
        "vertex error in the rest pose, mm",
        "What each way to fit does to the shape under loose clothing, against the true bodies (P2 Fig. 3, middle).",
        series,
    )
}

/// Parts of a sequence that the drift is shown over.
const PARTS: usize = 12;

/// Joint error over the course of the sequences: a tracker that loses its way drifts upwards.
pub(super) fn drift_figure(variants: &[Variant<'_>]) -> Option<Figure> {
    let mut series = Vec::new();
    for variant in variants {
        let points: Vec<[f64; 2]> = (0..PARTS)
            .filter_map(|part| {
                let errors: Vec<f64> = variant
                    .errors
                    .iter()
                    .flat_map(|errors| {
                        let count = errors.frames.len();
                        &errors.frames[part * count / PARTS..(part + 1) * count / PARTS]
                    })
                    .map(|frame| frame.mpjpe_mm)
                    .collect();
                let middle = (part as f64 + 0.5) / PARTS as f64;
                (!errors.is_empty()).then(|| [middle, errors.iter().sum::<f64>() / errors.len() as f64])
            })
            .collect();
        if points.len() > 1 {
            series.push(Series { name: variant.name.into(), points });
        }
    }
    let chart = LineChart {
        title: "Joint error over time".into(),
        x_label: "share of the sequence".into(),
        y_label: "mean joint error, mm".into(),
        series,
    };
    let is_empty = chart.series.is_empty();
    (!is_empty).then(|| Figure {
        name: "drift".into(),
        caption: "Mean over all sequences; a line that rises would be drift.".into(),
        svg: chart.svg(),
    })
}
