//! Means of each sequence as horizontal bars (P2 Fig. 5, right).

use std::fmt::Write;

use super::Variant;
use crate::report::{escaped, nice_step, number};
use crate::shape_space::Figure;

const WIDTH: f64 = 480.0;
const LEFT: f64 = 190.0;
const RIGHT: f64 = 44.0;
const TOP: f64 = 34.0;
const BOTTOM: f64 = 44.0;
const BAR: f64 = 9.0;
const GAP: f64 = 6.0;
/// Same colours as the lines of the other figures (Okabe and Ito 2008).
const COLORS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];
/// About how many labelled lines cross the axis.
const TICKS: f64 = 5.0;

/// The mean landmark error of each sequence, one bar for each variant.
pub(super) fn landmarks_by_sequence(variants: &[Variant<'_>]) -> Option<Figure> {
    let mut names: Vec<&String> =
        variants.iter().flat_map(|variant| variant.metrics.sequences.keys()).collect();
    names.sort();
    names.dedup();
    let rows: Vec<(&str, Vec<Option<f64>>)> = names
        .into_iter()
        .map(|name| {
            let of = |variant: &Variant<'_>| {
                variant.metrics.sequences.get(name).and_then(|metrics| metrics.landmark_mm)
            };
            (name.as_str(), variants.iter().map(of).collect())
        })
        .collect();
    let most = rows.iter().flat_map(|(_, values)| values.iter().flatten()).copied().fold(0.0, f64::max);
    (most > 0.0).then(|| Figure {
        name: "landmarks_by_sequence".into(),
        caption: "Mean landmark error of each sequence (P2 Fig. 5, right).".into(),
        svg: svg(variants, &rows, most),
    })
}

fn svg(variants: &[Variant<'_>], rows: &[(&str, Vec<Option<f64>>)], most: f64) -> String {
    let row_height = BAR * variants.len() as f64 + GAP;
    let legend = if variants.len() > 1 { 16.0 * variants.len() as f64 } else { 0.0 };
    let floor = TOP + legend + row_height * rows.len() as f64;
    let height = floor + BOTTOM;
    let step = nice_step(most / TICKS);
    let high = (most / step).ceil().max(1.0) * step;
    let x = |value: f64| LEFT + (WIDTH - LEFT - RIGHT) * value / high;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"mean landmark error of each sequence\" font-family=\"system-ui,sans-serif\" font-size=\"11\" fill=\"#30343c\"><rect width=\"{WIDTH}\" height=\"{height}\" fill=\"#fff\"/><text x=\"8\" y=\"20\" font-size=\"13\" font-weight=\"600\">Landmark error of each sequence</text>"
    );
    if variants.len() > 1 {
        for (place, variant) in variants.iter().enumerate() {
            let y = TOP + 16.0 * place as f64;
            let _ = write!(
                out,
                "<rect x=\"{LEFT}\" y=\"{}\" width=\"12\" height=\"8\" fill=\"{}\"/><text x=\"{}\" y=\"{}\">{}</text>",
                y - 2.0,
                COLORS[place % COLORS.len()],
                LEFT + 18.0,
                y + 6.0,
                escaped(variant.name)
            );
        }
    }
    for tick in 0..=(high / step).round() as usize {
        let value = tick as f64 * step;
        let _ = write!(
            out,
            "<path d=\"M{0:.1} {1}V{floor}\" stroke=\"#dfe2e7\"/><text x=\"{0:.1}\" y=\"{2}\" text-anchor=\"middle\">{3}</text>",
            x(value),
            TOP + legend - 4.0,
            floor + 16.0,
            number(value, usize::from(step < 1.0))
        );
    }
    for (row, (name, values)) in rows.iter().enumerate() {
        let top = TOP + legend + row_height * row as f64;
        let _ = write!(
            out,
            "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LEFT - 6.0,
            top + 0.5 * (row_height - GAP) + 4.0,
            escaped(name)
        );
        for (place, value) in values.iter().enumerate().filter_map(|(place, value)| Some((place, (*value)?)))
        {
            let y = top + BAR * place as f64;
            let _ = write!(
                out,
                "<rect x=\"{LEFT}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{}\" fill=\"{}\"/><text x=\"{:.1}\" y=\"{:.1}\" font-size=\"9\">{}</text>",
                x(value) - LEFT,
                BAR - 1.0,
                COLORS[place % COLORS.len()],
                x(value) + 3.0,
                y + BAR - 1.5,
                number(value, 1)
            );
        }
    }
    let _ = writeln!(
        out,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">mean landmark error, mm</text></svg>",
        0.5 * (LEFT + WIDTH - RIGHT),
        height - 10.0
    );
    out
}
