//! What each verb's report says.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use habitus::artifacts::clothing_layer::ClothingLayer;
use habitus::artifacts::clothing_model::{ClothingModel, millimetres_per_coefficient};
use habitus::artifacts::synthesized_sequence::{Penetration, SynthesizedSequence};

use super::{ClipSource, DressedReport, layer_clip, model_clip, synthesized_clip};
use crate::clothing_stills::association_sheet;
use crate::render::RenderError;
use crate::shape_space::{Figure, LineChart, Series, Table};

/// Width and height of each panel of the association's picture in pixels.
const ASSOCIATION_PANEL: (usize, usize) = (200, 380);

/// The report of `extract-clothing`.
///
/// # Errors
/// When the association cannot be drawn.
pub fn extraction_report(title: &str, layer: &ClothingLayer) -> Result<DressedReport, RenderError> {
    let sheet = association_sheet(layer, 0, ASSOCIATION_PANEL.0, ASSOCIATION_PANEL.1)?;
    let (width, height) = (sheet.width(), sheet.height());
    let association = Figure {
        name: "association".into(),
        caption: "What hangs on what, as P3 Fig. 1: clothing and body in the colours of the association, then the body \
                  vertices of one clothing vertex for n_f of 1, 3, 9 and the layer's own."
            .into(),
        svg: format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\"><image width=\"{width}\" height=\"{height}\" href=\"data:image/png;base64,{}\"/></svg>",
            STANDARD.encode(sheet.to_png()?)
        ),
    };
    let of_frames = |value: &dyn Fn(usize) -> f64| -> Vec<[f64; 2]> {
        (0..layer.frames.len()).map(|frame| [frame as f64, value(frame)]).collect()
    };
    let mean_offset = |frame: usize| {
        let offsets = layer.frame_offsets(frame).as_chunks::<3>().0;
        let sum: f64 = offsets.iter().map(|[x, y, z]| f64::from(x * x + y * y + z * z).sqrt()).sum();
        1000.0 * sum / offsets.len().max(1) as f64
    };
    let chart = LineChart {
        title: "Frame by frame".into(),
        x_label: "frame".into(),
        y_label: "mm".into(),
        series: vec![
            Series { name: "mean offset from the body".into(), points: of_frames(&mean_offset) },
            Series {
                name: "surface to capture".into(),
                points: of_frames(&|frame| 1000.0 * layer.frames[frame].quality.mean_to_capture),
            },
            Series {
                name: "capture to surface".into(),
                points: of_frames(&|frame| 1000.0 * layer.frames[frame].quality.mean_from_capture),
            },
        ],
    };
    let caption = "Distances between surface and capture are zero where the captures were aligned already.";
    Ok(DressedReport {
        title: title.into(),
        subtitle: format!(
            "clothing layer of {} frames and {} vertices",
            layer.frames.len(),
            layer.clothing_vertex_count()
        ),
        clip: Some(layer_clip(layer)),
        figures: vec![
            association,
            Figure { name: "frames".into(), caption: caption.into(), svg: chart.svg() },
        ],
        tables: Vec::new(),
    })
}

/// The report of `learn-clothing`: the model plays the first motion that it was learnt from.
pub fn model_report(title: &str, model: &ClothingModel) -> DressedReport {
    let amounts = millimetres_per_coefficient(&model.space);
    let whole = model.space.total_variance().max(f64::MIN_POSITIVE);
    let mut sum = 0.0;
    let shares = model.space.standard_deviations().iter().enumerate().map(|(component, deviation)| {
        sum += deviation * deviation;
        [(component + 1) as f64, 100.0 * sum / whole]
    });
    let variance = LineChart {
        title: "Variance that the components hold".into(),
        x_label: "components".into(),
        y_label: "% of the variance".into(),
        series: vec![Series { name: "share".into(), points: shares.collect() }],
    };
    let deviations = LineChart {
        title: "Size of each component".into(),
        x_label: "component".into(),
        y_label: "root mean square over the vertices, mm".into(),
        series: vec![Series {
            name: "deviation".into(),
            points: amounts.iter().enumerate().map(|(k, mm)| [(k + 1) as f64, *mm]).collect(),
        }],
    };
    let figure = |name: &str, caption: &str, chart: &LineChart| Figure {
        name: name.into(),
        caption: caption.into(),
        svg: chart.svg(),
    };
    let record = &model.record;
    let mut tables = vec![Table {
        title: format!("Mean vertex error in mm, split {}", record.split),
        head: vec![String::new(), "frames learnt from".into(), "frames set aside".into()],
        rows: vec![(record.recipe.clone(), vec![record.train_mm, record.prediction_mm])],
    }];
    if !model.controls.is_empty() {
        tables.push(controls_table(model));
    }
    DressedReport {
        title: title.into(),
        subtitle: format!(
            "{} components of {} vertices from {} frames of {}",
            amounts.len(),
            model.dressed.clothing_vertex_count(),
            record.frames,
            record.sequences.join(", ")
        ),
        clip: model.motions.first().map(|(_, poses)| model_clip(model, poses)),
        figures: vec![
            figure("variance", "Of the offsets of all frames.", &variance),
            figure("components", "In standard deviations of the frames.", &deviations),
        ],
        tables,
    }
}

/// The controls of each sequence that was learnt from.
fn controls_table(model: &ClothingModel) -> Table {
    let names = model.controls.controls.iter().map(|control| control.name.clone());
    Table {
        title: "Controls of the sequences".into(),
        head: std::iter::once("sequence".to_owned()).chain(names).collect(),
        rows: model.controls.known.clone(),
    }
}

/// The report of `synthesize`: what the push-out changed.
pub fn synthesis_report(
    title: &str,
    sequence: &SynthesizedSequence,
    dressed: &ClothingLayer,
    source: ClipSource<'_>,
) -> DressedReport {
    let of = |frames: &[Penetration], value: fn(&Penetration) -> f64| -> Vec<[f64; 2]> {
        frames.iter().enumerate().map(|(frame, found)| [frame as f64, value(found)]).collect()
    };
    let chart = |title: &str, label: &str, value: fn(&Penetration) -> f64| LineChart {
        title: title.into(),
        x_label: "frame".into(),
        y_label: label.into(),
        series: vec![
            Series { name: "before the push-out".into(), points: of(&sequence.before, value) },
            Series { name: "after it".into(), points: of(&sequence.after, value) },
        ],
    };
    let deepest = chart("Deepest clothing inside the body", "mm", |found| found.deepest_mm);
    let share = chart("Clothing inside the body", "% of the vertices", |found| 100.0 * found.inside_share);
    let row = |name: &str, frames: &[Penetration]| {
        let all = Penetration::over(frames);
        (name.to_owned(), vec![100.0 * all.inside_share, all.mean_depth_mm, all.deepest_mm])
    };
    let figure = |name: &str, chart: &LineChart| Figure {
        name: name.into(),
        caption: "Frame by frame.".into(),
        svg: chart.svg(),
    };
    DressedReport {
        title: title.into(),
        subtitle: format!(
            "{} frames of {} clothing vertices, synthesized",
            sequence.clothing.len(),
            dressed.clothing_vertex_count()
        ),
        clip: Some(synthesized_clip(sequence, dressed, source)),
        figures: vec![figure("deepest", &deepest), figure("inside", &share)],
        tables: vec![Table {
            title: "Clothing inside the body".into(),
            head: ["", "% of vertices", "mean depth, mm", "deepest, mm"].map(str::to_owned).to_vec(),
            rows: vec![row("before the push-out", &sequence.before), row("after it", &sequence.after)],
        }],
    }
}
