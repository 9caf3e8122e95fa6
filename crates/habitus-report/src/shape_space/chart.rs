//! Line charts as self-contained SVG: axes, a line for each series, a legend.

use std::fmt::Write;

use crate::report::{escaped, nice_step, number};

/// One line of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Points in rising order of x; values that are not finite are left out.
    pub points: Vec<[f64; 2]>,
}

/// A chart.
#[derive(Debug, Clone, PartialEq)]
pub struct LineChart {
    /// Title above the chart.
    pub title: String,
    /// What x is, with its unit.
    pub x_label: String,
    /// What y is, with its unit.
    pub y_label: String,
    /// The lines.
    pub series: Vec<Series>,
}

const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 320.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 34.0;
const BOTTOM: f64 = 48.0;
/// About how many labelled lines cross an axis.
const TICKS: f64 = 5.0;
/// Colours that are told apart by all readers (Okabe and Ito 2008).
const COLORS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

struct Axis {
    high: f64,
    step: f64,
}

impl Axis {
    /// From zero: a curve that looks flat is flat.
    fn up_to(most: f64) -> Self {
        let step = nice_step(most.max(1e-12) / TICKS);
        Self { high: (most / step - 1e-9).ceil().max(1.0) * step, step }
    }

    fn ticks(&self) -> impl Iterator<Item = f64> + '_ {
        (0..=(self.high / self.step).round() as usize).map(|tick| tick as f64 * self.step)
    }

    fn label(&self, value: f64) -> String {
        number(value, (-(self.step * (1.0 + 1e-9)).log10().floor()).max(0.0) as usize)
    }
}

impl LineChart {
    /// The chart as an SVG document.
    pub fn svg(&self) -> String {
        let finite = |point: &&[f64; 2]| point[0].is_finite() && point[1].is_finite();
        let points = || self.series.iter().flat_map(|series| series.points.iter().filter(finite));
        let most = |axis: usize| points().map(|point| point[axis]).fold(0.0_f64, f64::max);
        let (x_axis, y_axis) = (Axis::up_to(most(0)), Axis::up_to(most(1)));
        let x = |value: f64| LEFT + (WIDTH - LEFT - RIGHT) * value / x_axis.high;
        let y = |value: f64| HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * value / y_axis.high;
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\" font-family=\"system-ui,sans-serif\" font-size=\"11\" fill=\"#30343c\"><rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"#fff\"/><text x=\"{LEFT}\" y=\"20\" font-size=\"13\" font-weight=\"600\">{}</text>",
            escaped(&self.title),
            escaped(&self.title)
        );
        let (right, floor) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for value in y_axis.ticks() {
            let at = y(value);
            let _ = write!(
                out,
                "<path d=\"M{LEFT} {at:.1}H{right}\" stroke=\"#dfe2e7\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                LEFT - 6.0,
                at + 3.5,
                y_axis.label(value)
            );
        }
        for value in x_axis.ticks() {
            let at = x(value);
            let _ = write!(
                out,
                "<path d=\"M{at:.1} {floor}v4\" stroke=\"#8a8f99\"/><text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                floor + 16.0,
                x_axis.label(value)
            );
        }
        let _ = write!(
            out,
            "<path d=\"M{LEFT} {floor}H{right}\" stroke=\"#8a8f99\"/><text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text><text transform=\"translate(14 {})rotate(-90)\" text-anchor=\"middle\">{}</text>",
            0.5 * (LEFT + right),
            HEIGHT - 12.0,
            escaped(&self.x_label),
            0.5 * (TOP + floor),
            escaped(&self.y_label)
        );
        for (index, series) in self.series.iter().enumerate() {
            let color = COLORS[index % COLORS.len()];
            let mut path = String::new();
            for (place, point) in series.points.iter().filter(finite).enumerate() {
                let _ = write!(
                    path,
                    "{}{:.1} {:.1}",
                    if place == 0 { 'M' } else { 'L' },
                    x(point[0]),
                    y(point[1])
                );
            }
            let _ = write!(
                out,
                "<path d=\"{path}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\" stroke-linejoin=\"round\"/>"
            );
        }
        let (mut sum, mut count) = (0.0, 0.0);
        for point in points().filter(|point| point[0] > 0.5 * x_axis.high) {
            sum += point[1];
            count += 1.0;
        }
        self.add_legend(&mut out, sum > 0.6 * y_axis.high * count);
        out.push_str("</svg>\n");
        out
    }

    /// In the upper right corner, where falling curves leave room, or in the lower right one below rising curves.
    fn add_legend(&self, out: &mut String, is_high_on_the_right: bool) {
        if self.series.len() < 2 {
            return;
        }
        let longest = self.series.iter().map(|series| series.name.chars().count()).max().unwrap_or(0) as f64;
        let width = 34.0 + 6.2 * longest;
        let left = WIDTH - RIGHT - width;
        let height = 16.0 * self.series.len() as f64;
        let top = if is_high_on_the_right { HEIGHT - BOTTOM - height - 4.0 } else { TOP };
        let _ = write!(
            out,
            "<rect x=\"{left:.1}\" y=\"{}\" width=\"{width:.1}\" height=\"{}\" fill=\"#fff\" fill-opacity=\"0.85\"/>",
            top - 2.0,
            height + 4.0
        );
        for (index, series) in self.series.iter().enumerate() {
            let at = top + 9.0 + 16.0 * index as f64;
            let _ = write!(
                out,
                "<path d=\"M{:.1} {at}h18\" stroke=\"{}\" stroke-width=\"2\"/><text x=\"{:.1}\" y=\"{}\">{}</text>",
                left + 4.0,
                COLORS[index % COLORS.len()],
                left + 27.0,
                at + 3.5,
                escaped(&series.name)
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_escaped_and_every_series_has_a_line() {
        let series =
            |name: &str| Series { name: name.into(), points: vec![[0.0, 1.0], [1.0, f64::NAN], [2.0, 3.0]] };
        let chart = LineChart {
            title: "a < b".into(),
            x_label: "components".into(),
            y_label: "mm".into(),
            series: vec![series("x & y"), series("<script>")],
        };
        let svg = chart.svg();
        assert!(!svg.contains("<script>") && svg.contains("x &amp; y") && svg.contains("a &lt; b"));
        assert_eq!(svg.matches("stroke-linejoin").count(), 2);
        assert!(!svg.contains("NaN"));
    }
}
