//! Bar charts as self-contained SVG: a group of bars for each item, a colour for each method.

use std::fmt::Write;

use crate::report::{escaped, nice_step, number};

/// A chart.
#[derive(Debug, Clone, PartialEq)]
pub struct BarChart {
    /// Title above the chart.
    pub title: String,
    /// What y is, with its unit.
    pub y_label: String,
    /// Names of the bars of a group.
    pub series: Vec<String>,
    /// Items and the value of each of their bars; values that are not finite have no bar.
    pub groups: Vec<(String, Vec<f64>)>,
}

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 340.0;
const LEFT: f64 = 50.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 58.0;
const BOTTOM: f64 = 64.0;
const TICKS: f64 = 5.0;
/// Colours that are told apart by all readers (Okabe and Ito 2008).
const COLORS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];

impl BarChart {
    /// The chart as an SVG document.
    pub fn svg(&self) -> String {
        let values = self.groups.iter().flat_map(|(_, values)| values);
        let most = values.copied().filter(|value| value.is_finite()).fold(1e-9, f64::max);
        let step = nice_step(most / TICKS);
        let high = (most / step - 1e-9).ceil().max(1.0) * step;
        let y = |value: f64| HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * value / high;
        let title = escaped(&self.title);
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{title}\" font-family=\"system-ui,sans-serif\" font-size=\"11\" fill=\"#30343c\"><rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"#fff\"/><text x=\"{LEFT}\" y=\"20\" font-size=\"13\" font-weight=\"600\">{title}</text><text transform=\"translate(14 {})rotate(-90)\" text-anchor=\"middle\">{}</text>",
            0.5 * (TOP + HEIGHT - BOTTOM),
            escaped(&self.y_label)
        );
        let decimals = (-(step * (1.0 + 1e-9)).log10().floor()).max(0.0) as usize;
        for tick in 0..=(high / step).round() as usize {
            let value = tick as f64 * step;
            let at = y(value);
            let _ = write!(
                out,
                "<path d=\"M{LEFT} {at:.1}H{}\" stroke=\"#dfe2e7\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                WIDTH - RIGHT,
                LEFT - 6.0,
                at + 3.5,
                number(value, decimals)
            );
        }
        let group_width = (WIDTH - LEFT - RIGHT) / self.groups.len().max(1) as f64;
        let bar_width = 0.84 * group_width / self.series.len().max(1) as f64;
        for (index, (name, values)) in self.groups.iter().enumerate() {
            let left = LEFT + group_width * index as f64;
            for (place, value) in values.iter().enumerate().filter(|(_, value)| value.is_finite()) {
                let _ = write!(
                    out,
                    "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{}\"><title>{}: {}</title></rect>",
                    left + 0.08 * group_width + bar_width * place as f64,
                    y(*value),
                    0.92 * bar_width,
                    HEIGHT - BOTTOM - y(*value),
                    COLORS[place % COLORS.len()],
                    self.series.get(place).map_or_else(String::new, |name| escaped(name)),
                    number(*value, 2)
                );
            }
            let _ = write!(
                out,
                "<text transform=\"translate({:.1} {})rotate(-24)\" text-anchor=\"end\">{}</text>",
                left + 0.6 * group_width,
                HEIGHT - BOTTOM + 16.0,
                escaped(name)
            );
        }
        self.add_legend(&mut out);
        out.push_str("</svg>\n");
        out
    }

    /// A row below the title.
    fn add_legend(&self, out: &mut String) {
        let mut left = LEFT;
        for (place, name) in self.series.iter().enumerate() {
            let _ = write!(
                out,
                "<rect x=\"{left:.1}\" y=\"32\" width=\"12\" height=\"12\" fill=\"{}\"/><text x=\"{:.1}\" y=\"42\">{}</text>",
                COLORS[place % COLORS.len()],
                left + 16.0,
                escaped(name)
            );
            left += 32.0 + 6.4 * name.chars().count() as f64;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finite_value_has_a_bar_and_names_are_escaped() {
        let chart = BarChart {
            title: "a < b".into(),
            y_label: "mm".into(),
            series: vec!["x & y".into(), "z".into()],
            groups: vec![("<script>".into(), vec![1.0, f64::NAN]), ("silk".into(), vec![2.0, 3.5])],
        };
        let svg = chart.svg();
        assert_eq!(svg.matches("<title>").count(), 3);
        assert!(!svg.contains("<script>") && svg.contains("x &amp; y") && !svg.contains("NaN"));
    }
}
