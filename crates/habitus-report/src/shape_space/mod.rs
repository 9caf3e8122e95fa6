//! Figures and page about a shape space, after P1 Fig. 1 to 4.

mod chart;
mod heat_map;
mod modes;
mod picture;

use std::fmt::Write;

pub use chart::{LineChart, Series};
pub use heat_map::{HeatMap, heat_map_figure};
pub use modes::modes_figure;

use crate::report::{STYLE, escaped, number};

/// A figure: a file of its own and a part of the page.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Name of its file without ending.
    pub name: String,
    /// One sentence below it.
    pub caption: String,
    /// The SVG document.
    pub svg: String,
}

/// A table: a head and rows of text and numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Title above it.
    pub title: String,
    /// Names of the columns.
    pub head: Vec<String>,
    /// Rows: what the row is, then its numbers.
    pub rows: Vec<(String, Vec<f64>)>,
}

/// The page: everything inside one file, nothing loaded and no script.
pub fn figures_page(title: &str, subtitle: &str, figures: &[Figure], tables: &[Table]) -> String {
    let body = sheets(figures, tables);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'\">\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<meta name=\"color-scheme\" content=\"light dark\">\n<title>{title} – habitus</title>\n<link rel=\"icon\" href=\"data:,\">\n<style>\n{}\n{SHEET_STYLE}\n</style>\n</head>\n<body>\n<header class=\"masthead\"><div class=\"masthead-text\"><p class=\"brand\">habitus <span>{}</span></p><h1>{title}</h1><p class=\"subtitle\">{}</p></div></header>\n<main><div class=\"sheets\">{body}</div></main>\n<footer><p>Everything on this page is inside this one file: it loads nothing from the network and sends nothing.</p></footer>\n</body>\n</html>\n",
        STYLE,
        env!("CARGO_PKG_VERSION"),
        escaped(subtitle),
        title = escaped(title),
    )
}

/// Rules for figures and tables side by side.
pub(crate) const SHEET_STYLE: &str = ".sheets{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,26rem),1fr));gap:1rem}.wide{grid-column:1/-1}.sheets section{grid-column:1/-1;overflow-x:auto}.sheet{margin:0;align-self:start;background:#fff;color:#30343c;border-radius:8px;padding:.6rem}.sheet svg{width:100%;height:auto}.sheet figcaption{font-size:.85rem;padding:.3rem .2rem}table td{text-align:right;font-variant-numeric:tabular-nums;padding:.15rem .6rem}table th{text-align:right;padding:.15rem .6rem}table td:first-child,table th:first-child{text-align:left}";

/// Figures, then tables, as parts of a page.
pub(crate) fn sheets(figures: &[Figure], tables: &[Table]) -> String {
    let mut body = String::new();
    for figure in figures {
        let _ = write!(
            body,
            "<figure class=\"sheet{}\">{}<figcaption>{}</figcaption></figure>",
            if is_wide(&figure.svg) { " wide" } else { "" },
            figure.svg,
            escaped(&figure.caption)
        );
    }
    for table in tables {
        let head: String = table.head.iter().map(|name| format!("<th>{}</th>", escaped(name))).collect();
        let rows: String = table.rows.iter().map(row).collect();
        let _ = write!(
            body,
            "<section class=\"wide\"><h2>{}</h2><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></section>",
            escaped(&table.title)
        );
    }
    body
}

/// Whether a figure is so much wider than high that it takes a row for itself.
fn is_wide(svg: &str) -> bool {
    const WIDE: f64 = 2.5;
    let sizes = svg.split("viewBox=\"0 0 ").nth(1).unwrap_or_default();
    let mut sizes = sizes.split([' ', '"']).map(|word| word.parse::<f64>().unwrap_or(0.0));
    let (width, height) = (sizes.next().unwrap_or(0.0), sizes.next().unwrap_or(0.0));
    width > WIDE * height
}

fn row((name, values): &(String, Vec<f64>)) -> String {
    let cells: String = values
        .iter()
        .map(|value| {
            let decimals = if value.abs() >= 100.0 || value.fract() == 0.0 { 0 } else { 2 };
            format!("<td>{}</td>", number(*value, decimals))
        })
        .collect();
    format!("<tr><td>{}</td>{cells}</tr>", escaped(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_holds_its_figures_and_tables_and_loads_nothing() {
        let figure = Figure {
            name: "a".into(),
            caption: "one & two".into(),
            svg: "<svg viewBox=\"0 0 500 100\"></svg>".into(),
        };
        let table = Table {
            title: "numbers".into(),
            head: vec!["".into(), "mm".into()],
            rows: vec![("<b>".into(), vec![1.234])],
        };
        let page = figures_page("space", "of 3 bodies", &[figure], &[table]);
        assert!(
            page.contains("sheet wide")
                && page.contains("one &amp; two")
                && page.contains("1.23")
                && page.contains("&lt;b&gt;")
        );
        assert!(!page.contains("<script") && !page.contains("http://") && !page.contains("https://"));
    }
}
