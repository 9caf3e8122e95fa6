//! The page of `evaluate clothing`: P3's tables, curves, bars, and where on the clothing a prediction is wrong.

mod bars;
mod error_maps;

use std::collections::BTreeMap;

use habitus::artifacts::synthesized_sequence::Penetration;
use habitus::evaluation::clothing_metrics::{ClothingErrorMap, ClothingMetrics, HemResponse, LeftOutKind};

pub use bars::BarChart;
pub use error_maps::error_maps_figure;

use crate::render::RenderError;
use crate::shape_space::{Figure, LineChart, Series, Table, figures_page};

/// Numbers of components in P3's Table 1.
const TABLE_COMPONENTS: [&str; 4] = ["1", "5", "40", "all"];

/// One self-contained HTML page.
///
/// # Errors
/// When a picture cannot be made.
pub fn clothing_page(metrics: &ClothingMetrics, maps: &[ClothingErrorMap]) -> Result<String, RenderError> {
    let title = format!("Clothing of {} sequences, {} frames", metrics.sequences.len(), metrics.frames);
    Ok(figures_page(&title, &metrics.sequences.join(", "), &figures(metrics, maps)?, &tables(metrics)))
}

/// The page's figures, each also a file of its own.
///
/// # Errors
/// When a picture cannot be made.
pub fn figures(metrics: &ClothingMetrics, maps: &[ClothingErrorMap]) -> Result<Vec<Figure>, RenderError> {
    let mut figures = vec![frame_errors(metrics)];
    figures.extend(left_out_bars(metrics));
    figures.extend(metrics.hem_response.iter().flat_map(|(name, response)| hem_curves(name, response)));
    if !maps.is_empty() {
        figures.push(Figure {
            name: "left_out_error_maps".into(),
            caption: "Mean error of each vertex over the frames of a sequence that was not learnt from, 0 to 50 mm; in \
                      each pair the default recipe, then the nearest frame."
                .into(),
            svg: error_maps_figure(maps)?,
        });
    }
    Ok(figures)
}

/// Error of each frame; the block that was set aside has a line of its own.
fn frame_errors(metrics: &ClothingMetrics) -> Figure {
    let errors: Vec<[f64; 2]> =
        metrics.frame_error_mm.iter().enumerate().map(|(frame, error)| [frame as f64, *error]).collect();
    let (learnt, aside) = errors.split_at(metrics.block_start.min(errors.len()));
    let series = |name: &str, points: &[[f64; 2]]| Series { name: name.into(), points: points.to_vec() };
    let chart = LineChart {
        title: "Error of each frame".into(),
        x_label: "frame: those learnt from, then those set aside".into(),
        y_label: "mean vertex error, mm".into(),
        series: vec![series("learnt from", learnt), series("set aside", aside)],
    };
    let caption = "Default recipe, the last fifth of each sequence set aside.".into();
    Figure { name: "frame_errors".into(), caption, svg: chart.svg() }
}

fn left_out_title(metrics: &ClothingMetrics) -> &'static str {
    match metrics.left_out_kind {
        LeftOutKind::Material => "Materials that were not learnt from",
        LeftOutKind::Size => "Sizes that were not learnt from",
        LeftOutKind::Sequence => "Sequences that were not learnt from",
    }
}

fn left_out_bars(metrics: &ClothingMetrics) -> Option<Figure> {
    let methods: Vec<String> = metrics.left_out.values().next()?.keys().cloned().collect();
    let values = |found: &BTreeMap<String, f64>| {
        methods.iter().map(|method| found.get(method).copied().unwrap_or(f64::NAN)).collect()
    };
    let chart = BarChart {
        title: left_out_title(metrics).into(),
        y_label: "prediction error, mm".into(),
        groups: metrics.left_out.iter().map(|(name, found)| (name.clone(), values(found))).collect(),
        series: methods,
    };
    let caption = "`components` is what the components of the other sequences can express at best.".into();
    Some(Figure { name: "left_out".into(), caption, svg: chart.svg() })
}

/// How long the borders are by a control, and how high where that is known.
fn hem_curves(control: &str, response: &HemResponse) -> Vec<Figure> {
    let curves = |what: &str, name: String, borders: &BTreeMap<String, Vec<f64>>| {
        let series = |(border, values): (&String, &Vec<f64>)| Series {
            name: border.clone(),
            points: response.values.iter().zip(values).map(|(x, y)| [*x, *y]).collect(),
        };
        let chart = LineChart {
            title: format!("Borders of the clothing by {control}"),
            x_label: control.into(),
            y_label: format!("{what} at rest, mm"),
            series: borders.iter().map(series).collect(),
        };
        Figure { name, caption: "The other controls at their means.".into(), svg: chart.svg() }
    };
    let mut figures = vec![curves("length", format!("hems_{control}"), &response.lengths_mm)];
    if !response.heights_mm.is_empty() {
        figures.push(curves("height", format!("hem_heights_{control}"), &response.heights_mm));
    }
    figures
}

fn tables(metrics: &ClothingMetrics) -> Vec<Table> {
    let mut tables = vec![components(metrics), regression(metrics)];
    tables.extend(left_out(metrics));
    tables.push(quality(metrics));
    tables.extend(controls(metrics));
    tables
}

fn head(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

fn components(metrics: &ClothingMetrics) -> Table {
    let row = |name: &str, errors: &BTreeMap<String, f64>| {
        let of = |count: &&str| errors.get(*count).copied().unwrap_or(f64::NAN);
        (name.to_owned(), TABLE_COMPONENTS.iter().map(of).collect())
    };
    Table {
        title: "Mean vertex error in mm by number of components (P3 Table 1)".into(),
        head: head(&["", "1", "5", "40", "all"]),
        rows: vec![
            row("poses settled on the surface", &metrics.pca_error_mm),
            row("poses as fitted", &metrics.pca_error_fitted_poses_mm),
        ],
    }
}

fn regression(metrics: &ClothingMetrics) -> Table {
    let mut rows = Vec::new();
    for (recipe, splits) in &metrics.regression {
        for (split, errors) in splits {
            rows.push((format!("{recipe}, {split}"), vec![errors.train_mm, errors.prediction_mm]));
        }
    }
    for (split, baselines) in &metrics.baselines {
        for (name, error) in baselines {
            rows.push((format!("{name}, {split}"), vec![f64::NAN, *error]));
        }
    }
    Table {
        title: "Mean vertex error in mm of frames learnt from and of frames set aside (P3 Table 2)".into(),
        head: head(&["recipe or baseline, split", "train", "prediction"]),
        rows,
    }
}

fn left_out(metrics: &ClothingMetrics) -> Option<Table> {
    let methods: Vec<&String> = metrics.left_out.values().next()?.keys().collect();
    let row = |(name, found): (&String, &BTreeMap<String, f64>)| {
        let values = methods.iter().map(|method| found.get(*method).copied().unwrap_or(f64::NAN));
        (name.clone(), values.collect())
    };
    Some(Table {
        title: format!("{}: prediction error in mm", left_out_title(metrics)),
        head: std::iter::once("left out".to_owned())
            .chain(methods.iter().map(|method| (*method).clone()))
            .collect(),
        rows: metrics.left_out.iter().map(row).collect(),
    })
}

fn quality(metrics: &ClothingMetrics) -> Table {
    let inside = |name: &str, found: &Penetration, error: f64| {
        let values = vec![100.0 * found.inside_share, found.mean_depth_mm, found.deepest_mm, error];
        (name.to_owned(), values)
    };
    Table {
        title: format!(
            "Predicted clothing inside the body, block set aside (normals {:.1}°, accelerations {:.2} m/s² off)",
            metrics.normal_error_deg, metrics.acceleration_error
        ),
        head: head(&["", "% of vertices", "mean depth, mm", "deepest, mm", "vertex error, mm"]),
        rows: vec![
            inside("before the push-out", &metrics.penetration_before, metrics.prediction_before_push_out_mm),
            inside("after it", &metrics.penetration_after, metrics.prediction_after_push_out_mm),
        ],
    }
}

/// What each slider moves: the matrix that shows whether sliders are disentangled.
fn controls(metrics: &ClothingMetrics) -> Option<Table> {
    let bones: Vec<&String> = metrics.control_response_mm.values().next()?.keys().collect();
    let row = |(name, found): (&String, &BTreeMap<String, f64>)| {
        (name.clone(), bones.iter().map(|bone| found.get(*bone).copied().unwrap_or(f64::NAN)).collect())
    };
    Some(Table {
        title: "What each slider moves: mm of the clothing on each bone, from the slider's smallest to its largest value"
            .into(),
        head: std::iter::once("slider".to_owned()).chain(bones.iter().map(|bone| (*bone).clone())).collect(),
        rows: metrics.control_response_mm.iter().map(row).collect(),
    })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn the_page_shows_every_number_and_no_name_breaks_it() {
        let mut metrics =
            ClothingMetrics { sequences: vec!["<walk>".into()], frames: 3, ..Default::default() };
        metrics.pca_error_mm = [("1", 26.51), ("5", 14.82), ("40", 3.07), ("all", 0.01)]
            .map(|(count, error)| (count.to_owned(), error))
            .into();
        metrics.left_out.insert("<walk>".into(), [("mean".to_owned(), 12.345)].into());
        metrics.left_out_kind = LeftOutKind::Material;
        metrics.frame_error_mm = vec![1.0, 2.0, 8.0];
        metrics.block_start = 2;
        let hems = HemResponse {
            values: vec![0.9, 1.3],
            lengths_mm: [("thigh", vec![400.0, 520.0]), ("pelvis", vec![900.0, 900.0])]
                .map(|(border, lengths)| (border.to_owned(), lengths))
                .into(),
            heights_mm: [("thigh".to_owned(), vec![610.0, 540.0])].into(),
        };
        metrics.hem_response.insert("width".into(), hems);
        let triangle = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let map = ClothingErrorMap {
            sequence: "<walk>".into(),
            vertices: triangle.clone(),
            body: triangle,
            body_faces: vec![[0, 1, 2]],
            faces: vec![[0, 1, 2]],
            errors_mm: vec![("default".into(), vec![0.0, 25.0, 60.0])],
        };
        let page = clothing_page(&metrics, &[map]).expect("is drawn");
        for needle in ["26.51", "14.82", "3.07", "12.3", "&lt;walk&gt;", "Materials", "thigh", "image/png"] {
            assert!(page.contains(needle), "{needle}");
        }
        assert!(!page.contains("<walk>") && !page.contains("NaN"));
    }
}
