//! Curves over frames as inline SVG, with the same numbers as JSON for the cursor.

use std::fmt::Write;

use serde::Serialize;

use super::markup::{escaped, number};
use super::{FrameSummary, ReportData};

const WIDTH: f64 = 440.0;
const HEIGHT: f64 = 164.0;
const LEFT: f64 = 40.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 26.0;
/// About how many labelled lines cross a plot.
const TICKS: f64 = 5.0;

/// One plot: lines over frames, and bands behind them.
#[derive(Debug, Serialize)]
pub(crate) struct Plot {
    title: String,
    unit: String,
    note: &'static str,
    /// Lower and upper border, widest band first.
    #[serde(skip)]
    bands: Vec<[Vec<f64>; 2]>,
    /// The line that is drawn first, then values that only the readout names.
    lines: Vec<Vec<f64>>,
}

/// The plots that the data allow: a curve needs two frames.
pub(crate) fn plots(data: &ReportData) -> Vec<Plot> {
    if data.frames.len() < 2 {
        return Vec::new();
    }
    let column = |value: &dyn Fn(&FrameSummary) -> Option<f64>| -> Vec<f64> {
        data.frames.iter().map(|frame| value(frame).unwrap_or(f64::NAN)).collect()
    };
    let mut plots = Vec::new();
    if data.frames.iter().any(|frame| frame.clearance_mm.is_some()) {
        let p5 = column(&|f| Some(f.clearance_mm?.p5));
        let p95 = column(&|f| Some(f.clearance_mm?.p95));
        let quarters = [column(&|f| Some(f.clearance_mm?.p25)), column(&|f| Some(f.clearance_mm?.p75))];
        let median = column(&|f| Some(f.clearance_mm?.p50));
        plots.push(Plot {
            title: "Clearance".to_owned(),
            unit: "mm".to_owned(),
            note: "body to capture; line: median, bands: middle half and 5 to 95 %",
            lines: vec![median, p5.clone(), p95.clone()],
            bands: vec![[p5, p95], quarters],
        });
    }
    let single = |title: &str, unit: &str, note, values: Vec<f64>| Plot {
        title: title.to_owned(),
        unit: unit.to_owned(),
        note,
        bands: Vec::new(),
        lines: vec![values],
    };
    if data.frames.iter().any(|frame| frame.outside_share.is_some()) {
        let values = column(&|f| f.outside_share.map(|share| 100.0 * share));
        plots.push(single(
            "Body outside the capture",
            "%",
            "share of vertices more than 5 mm outside",
            values,
        ));
    }
    if data.frames.iter().any(|frame| frame.inlier_share.is_some()) {
        let values = column(&|f| f.inlier_share.map(|share| 100.0 * share));
        plots.push(single("Inliers", "%", "share of vertices with a compatible point", values));
    }
    let mut names: Vec<&str> = Vec::new();
    for (name, _) in data.frames.iter().flat_map(|frame| &frame.energies) {
        if !names.contains(&name.as_str()) {
            names.push(name);
        }
    }
    for name in names {
        let values = column(&|f| f.energies.iter().find(|(n, _)| n == name).map(|(_, value)| *value));
        let (unit, values) = in_powers_of_ten(values);
        plots.push(single(&format!("Energy: {name}"), &unit, "at the end of the frame", values));
    }
    if data.frames.iter().any(|frame| frame.seconds > 0.0) {
        let values = column(&|f| Some(1e3 * f.seconds));
        plots.push(single("Time", "ms", "a frame", values));
    }
    plots
}

/// All plots as figures.
pub(crate) fn figures(plots: &[Plot], frames: &[FrameSummary]) -> String {
    plots.iter().enumerate().map(|(number, plot)| figure(plot, number, frames)).collect()
}

fn figure(plot: &Plot, index: usize, frames: &[FrameSummary]) -> String {
    let unit = if plot.unit.is_empty() {
        String::new()
    } else {
        format!(" <span class=\"unit\">{}</span>", plot.unit)
    };
    let axes = Axes::around(plot, frames.len());
    format!(
        "<figure class=\"plot\" data-plot=\"{index}\" data-left=\"{}\" data-right=\"{}\" data-top=\"{TOP}\" data-bottom=\"{}\" data-low=\"{}\" data-high=\"{}\"><figcaption><span class=\"plot-title\">{}{unit}</span>\
         <output class=\"plot-readout\" aria-live=\"off\"></output><span class=\"plot-note\">{}</span></figcaption>{}</figure>",
        LEFT / WIDTH,
        (WIDTH - RIGHT) / WIDTH,
        HEIGHT - BOTTOM,
        axes.low,
        axes.high,
        escaped(&plot.title),
        plot.note,
        svg(plot, frames, &axes)
    )
}

/// Data to the plot's own coordinates.
struct Axes {
    low: f64,
    high: f64,
    step: f64,
    last: f64,
}

impl Axes {
    /// Axes that hold all lines, with zero: a curve that looks flat is flat.
    fn around(plot: &Plot, frame_count: usize) -> Self {
        let values = plot.lines.iter().flatten().copied().filter(|value| value.is_finite());
        let (least, most) =
            values.fold((0.0f64, 0.0f64), |(least, most), value| (least.min(value), most.max(value)));
        let step = nice_step((most - least).max(1e-12) / TICKS);
        let high = ((most / step).ceil() * step).max(step);
        Self { low: (least / step).floor() * step, high, step, last: (frame_count - 1) as f64 }
    }

    fn x(&self, frame: usize) -> f64 {
        LEFT + (WIDTH - LEFT - RIGHT) * frame as f64 / self.last.max(1.0)
    }

    fn y(&self, value: f64) -> f64 {
        TOP + (HEIGHT - TOP - BOTTOM) * (self.high - value) / (self.high - self.low)
    }

    /// A path through the values; gaps where a value is not finite.
    fn path(&self, values: &[f64]) -> String {
        let mut path = String::new();
        let mut is_drawing = false;
        for (frame, value) in values.iter().enumerate() {
            if value.is_finite() {
                let command = if is_drawing { 'L' } else { 'M' };
                let _ = write!(path, "{command}{:.1} {:.1}", self.x(frame), self.y(*value));
            }
            is_drawing = value.is_finite();
        }
        path
    }

    /// The area between two borders, one closed piece a run of finite values.
    fn area(&self, low: &[f64], high: &[f64]) -> String {
        let is_whole: Vec<bool> = low.iter().zip(high).map(|(l, h)| l.is_finite() && h.is_finite()).collect();
        let mut path = String::new();
        let mut start = 0;
        while start < is_whole.len() {
            let length = is_whole[start..].iter().take_while(|whole| **whole).count();
            let run = start..start + length;
            for (i, frame) in run.clone().chain(run.rev()).enumerate() {
                let value = if i < length { high[frame] } else { low[frame] };
                let _ = write!(
                    path,
                    "{}{:.1} {:.1}",
                    if i == 0 { 'M' } else { 'L' },
                    self.x(frame),
                    self.y(value)
                );
            }
            path.push_str(if length > 0 { "Z" } else { "" });
            start += length.max(1);
        }
        path
    }
}

fn svg(plot: &Plot, frames: &[FrameSummary], axes: &Axes) -> String {
    let step = axes.step;
    let mut out = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{} over {} frames\">",
        escaped(&plot.title),
        frames.len()
    );
    let (right, floor) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
    for tick in 0..=((axes.high - axes.low) / step).round() as usize {
        let value = axes.low + tick as f64 * step;
        let y = axes.y(value);
        let class = if value.abs() < 1e-9 * step { "zero" } else { "grid" };
        let _ = write!(out, "<path class=\"{class}\" d=\"M{LEFT} {y:.1}H{right}\"/>");
        let label = number(value, tick_decimals(step));
        let _ = write!(
            out,
            "<text class=\"tick\" x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
            LEFT - 7.0,
            y + 3.5
        );
    }
    let frame_step = nice_step((axes.last / 6.0).max(1.0)).ceil() as usize;
    for frame in (0..frames.len()).filter(|frame| *frame == 0 || (frame + 1).is_multiple_of(frame_step)) {
        let x = axes.x(frame);
        let _ = write!(
            out,
            "<text class=\"tick\" x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
            HEIGHT - 7.0,
            frame + 1
        );
    }
    for (number, [low, high]) in plot.bands.iter().enumerate() {
        let _ = write!(out, "<path class=\"band band-{number}\" d=\"{}\"/>", axes.area(low, high));
    }
    if let Some(line) = plot.lines.first() {
        let _ = write!(out, "<path class=\"line\" d=\"{}\"/>", axes.path(line));
    }
    for (class, is_marked) in [("flagged", false), ("failed", true)] {
        let marked = frames
            .iter()
            .enumerate()
            .filter(|(_, f)| if is_marked { !f.is_ok } else { f.is_ok && !f.codes.is_empty() });
        let ticks: String = marked.map(|(frame, _)| format!("M{:.1} {floor}v5", axes.x(frame))).collect();
        if !ticks.is_empty() {
            let _ = write!(out, "<path class=\"mark {class}\" d=\"{ticks}\"/>");
        }
    }
    let _ = write!(
        out,
        "<path class=\"cursor\" d=\"M0 {TOP}V{floor}\"/><circle class=\"cursor-dot\" r=\"3.5\"/></svg>"
    );
    out
}

/// Values that read well: very small or large ones are divided by a power of ten, which becomes their unit.
fn in_powers_of_ten(values: Vec<f64>) -> (String, Vec<f64>) {
    let largest =
        values.iter().filter(|value| value.is_finite()).fold(0.0f64, |most, value| most.max(value.abs()));
    let power = largest.log10().floor();
    if largest == 0.0 || (-2.0..5.0).contains(&power) {
        return (String::new(), values);
    }
    let raised = |digit: char| match digit {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        other => char::from_u32('⁰' as u32 + other.to_digit(10).unwrap_or(0)).unwrap_or(other),
    };
    let exponent: String = format!("{power}").chars().map(raised).collect();
    (format!("×10{exponent}"), values.iter().map(|value| value / 10f64.powf(power)).collect())
}

/// Digits after the point that tell neighbouring ticks apart.
fn tick_decimals(step: f64) -> usize {
    (-(step * (1.0 + 1e-9)).log10().floor()).max(0.0) as usize
}

/// The smallest of 1, 2, 5 × 10ⁿ that is at least `step`.
pub(crate) fn nice_step(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    let factors = [1.0, 2.0, 5.0, 10.0];
    power * factors.into_iter().find(|factor| factor * power >= step * (1.0 - 1e-9)).unwrap_or(10.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round_numbers() {
        for (step, nice) in [(1.0, 1.0), (1.1, 2.0), (3.0, 5.0), (0.07, 0.1), (600.0, 1000.0)] {
            assert!((nice_step(step) / nice - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn tiny_energies_read_in_powers_of_ten() {
        let (unit, values) = in_powers_of_ten(vec![2.5e-14, 1e-14, f64::NAN]);
        assert_eq!(unit, "×10⁻¹⁴");
        assert!((values[0] - 2.5).abs() < 1e-9 && values[2].is_nan());
        assert_eq!(in_powers_of_ten(vec![12.0]), (String::new(), vec![12.0]));
        assert_eq!([0.2, 1.0, 50.0, 0.05].map(tick_decimals), [1, 0, 0, 2]);
    }

    #[test]
    fn lines_break_where_a_value_is_missing() {
        let axes = Axes { low: 0.0, high: 1.0, step: 0.5, last: 4.0 };
        let values = [0.0, 1.0, f64::NAN, 0.5, 0.5];
        assert_eq!(axes.path(&values).matches('M').count(), 2);
        assert_eq!(axes.area(&values, &values).matches('Z').count(), 2);
    }
}
