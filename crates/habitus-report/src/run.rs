//! From a finished fit and its captures to what the report shows.
//!
//! Captures are read once more, a few at a time, for the frames that the 3D view can hold: each gives the clearance
//! of every vertex and a simplified mesh. The other frames have their clearance from the fit.

use glam::DAffine3;
use habitus::artifacts::codes::Code;
use habitus::artifacts::fitted_sequence::FittedFrame;
use habitus::artifacts::frames::FrameSource;
use habitus::artifacts::measurements::{Measurement, Quantity};
use habitus::artifacts::rigged_sequence::RiggedSequence;
use habitus::evaluation::sequence_accuracy::SequenceAccuracy;
use rayon::prelude::*;

use crate::captured_body::CapturedBody;
use crate::report::{
    BodyCurve, BodyView, CodeMeaning, FrameSummary, FrameView, Headline, IdentityCoefficient, LandmarkView,
    MeasurementRow, ModelView, Percentiles, ReportData, ReportOptions, Timing, TruthRow, decimated,
    view_frames,
};

/// A finished run, as far as its report needs it.
pub struct FinishedRun<'a> {
    /// Title of the page.
    pub title: String,
    /// A line under the title.
    pub subtitle: String,
    /// Version of the program that made the run.
    pub version: String,
    /// Identity, poses and the rig that they move.
    pub fit: &'a RiggedSequence,
    /// The captures that were fitted, in the same order.
    pub captures: &'a dyn FrameSource,
    /// Measurements of the rest body.
    pub measurements: &'a [Measurement],
    /// Where the time went.
    pub timings: Vec<Timing>,
    /// The run's provenance as text.
    pub provenance: String,
    /// Comparison with the truth, where it is known.
    pub accuracy: Option<&'a SequenceAccuracy>,
    /// Captured frames per second.
    pub frames_per_second: f64,
}

/// Names of the measurements that stand at the top of the page.
const HEADLINE_MEASUREMENTS: [&str; 4] = ["stature", "chest_girth", "waist_girth", "hip_girth"];

/// What the report of a run shows; captures that cannot be read leave gaps.
pub fn report_of_run(run: &FinishedRun<'_>, options: &ReportOptions) -> ReportData {
    let sequence = &run.fit.sequence;
    let bone_count = sequence.rest_joints.len();
    let shown = view_frames(sequence.frames.len(), bone_count, sequence.rest_vertices.len(), options);
    let (frames, views): (Vec<_>, Vec<_>) = (0..sequence.frames.len())
        .into_par_iter()
        .map(|frame| frame_of_run(run, frame, shown.binary_search(&frame).is_ok(), options))
        .unzip();
    let measurements: Vec<MeasurementRow> = run.measurements.iter().map(measurement_row).collect();
    ReportData {
        title: run.title.clone(),
        subtitle: run.subtitle.clone(),
        version: run.version.clone(),
        units: units(run),
        headlines: headlines(run),
        frames,
        sequence_codes: sequence.codes.iter().map(|code| code.name().to_owned()).collect(),
        code_meanings: code_meanings(run),
        identity: identity(run),
        measurements,
        timings: run.timings.clone(),
        provenance: run.provenance.clone(),
        truth: run.accuracy.map_or(Vec::new(), truth_rows),
        frames_per_second: run.frames_per_second,
        model: Some(ModelView { body: body_view(run.fit), frames: views.into_iter().flatten().collect() }),
    }
}

/// One frame's row, and its 3D view where that is asked for and its pose is usable.
fn frame_of_run(
    run: &FinishedRun<'_>,
    frame: usize,
    is_shown: bool,
    options: &ReportOptions,
) -> (FrameSummary, Option<FrameView>) {
    let fitted = &run.fit.sequence.frames[frame];
    // A frame that the 3D view leaves out needs its capture only if the fit has not kept its clearance.
    if let (false, Some(known)) = (is_shown, fitted.clearance_percentiles) {
        let [p5, p25, p50, p75, p95] = known.map(|metres| metres * 1000.0);
        return (frame_summary(fitted, Some(Percentiles { p5, p25, p50, p75, p95 })), None);
    }
    let surface = if frame < run.captures.len() { run.captures.surface(frame).ok() } else { None };
    let captured = CapturedBody::new(run.fit, frame, surface.as_ref());
    let clearance_mm = captured.clearance_mm.unwrap_or_default();
    let summary = frame_summary(fitted, percentiles(&clearance_mm));
    let posed = run.fit.posed_skeleton(frame);
    let bones = posed.rotations.iter().zip(&posed.translations);
    let posed_from_rest: Vec<DAffine3> = bones
        .map(|(rotation, translation)| DAffine3 { matrix3: *rotation, translation: *translation })
        .collect();
    if !is_shown || posed_from_rest.iter().any(|transform| !transform.is_finite()) {
        return (summary, None);
    }
    let capture = captured.capture.unwrap_or_default();
    let landmarks = fitted.landmarks.iter().enumerate().filter(|(_, landmark)| landmark.position.is_finite());
    let view = FrameView {
        frame,
        posed_from_rest,
        capture: decimated(&capture, options.capture_vertex_limit),
        clearance_mm: clearance_mm.iter().map(|mm| *mm as f32).collect(),
        landmarks: landmarks
            .map(|(number, landmark)| LandmarkView {
                name: run.fit.rig.landmarks.get(number).cloned().unwrap_or_default(),
                position: landmark.position,
                confidence: landmark.confidence,
            })
            .collect(),
    };
    (summary, Some(view))
}

fn frame_summary(fitted: &FittedFrame, clearance_mm: Option<Percentiles>) -> FrameSummary {
    let is_readable = !fitted.codes.contains(&Code::UnreadableFrame);
    FrameSummary {
        name: fitted.name.clone(),
        is_ok: fitted.is_ok(),
        codes: fitted.codes.iter().map(|code| code.name().to_owned()).collect(),
        seconds: fitted.seconds,
        energies: if is_readable { vec![("per vertex, m²".to_owned(), fitted.energy)] } else { Vec::new() },
        clearance_mm,
        outside_share: is_readable.then_some(fitted.outside_share_5mm),
        inlier_share: is_readable.then_some(fitted.inlier_share),
    }
}

/// Percentiles over vertices; nothing when nothing is known.
fn percentiles(values: &[f64]) -> Option<Percentiles> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let at = |share: f64| sorted[(share * last as f64).round() as usize];
    Some(Percentiles { p5: at(0.05), p25: at(0.25), p50: at(0.5), p75: at(0.75), p95: at(0.95) })
}

fn body_view(fit: &RiggedSequence) -> BodyView {
    let sequence = &fit.sequence;
    let skin: Vec<Vec<(usize, f64)>> =
        (0..sequence.rest_vertices.len()).map(|vertex| fit.rig.skin.of(vertex).collect()).collect();
    let slot = |row: &[(usize, f64)], number: usize| row.get(number).copied().unwrap_or((0, 0.0));
    BodyView {
        rest_vertices: sequence.rest_vertices.clone(),
        faces: fit.rig.faces.clone(),
        skin_bones: skin.iter().map(|row| std::array::from_fn(|k| slot(row, k).0 as u8)).collect(),
        skin_weights: skin.iter().map(|row| std::array::from_fn(|k| slot(row, k).1 as f32)).collect(),
        joints: sequence.rest_joints.clone(),
        parents: fit.rig.skeleton.bones().iter().map(|bone| bone.parent).collect(),
    }
}

fn measurement_row(measurement: &Measurement) -> MeasurementRow {
    let shown = |value: f64| measurement.quantity.to_display(value);
    let points = &measurement.curve;
    let is_drawable = points.len() > 1 && points.iter().all(|point| point.is_finite());
    MeasurementRow {
        name: in_words(&measurement.name),
        value: shown(measurement.value),
        unit: measurement.quantity.display_unit().to_owned(),
        plus_minus: measurement.plus_minus.map(shown),
        definition: measurement.definition.clone(),
        // A girth's curve ends where it begins, so no curve needs closing.
        curve: is_drawable.then(|| BodyCurve { points: points.clone(), is_closed: false }),
    }
}

/// `left_thigh_girth` as "Left thigh girth".
fn in_words(name: &str) -> String {
    let mut words = name.replace('_', " ");
    if let Some(first) = words.get_mut(..1) {
        first.make_ascii_uppercase();
    }
    words
}

fn headlines(run: &FinishedRun<'_>) -> Vec<Headline> {
    let named = |name: &&str| run.measurements.iter().find(|measurement| measurement.name == **name);
    let mut tiles: Vec<Headline> = HEADLINE_MEASUREMENTS
        .iter()
        .filter_map(named)
        .filter(|measurement| measurement.quantity == Quantity::Length)
        .map(|measurement| Headline {
            label: in_words(&measurement.name),
            value: format!("{:.0}", 1000.0 * measurement.value),
            unit: "mm".to_owned(),
            note: measurement.plus_minus.map_or(String::new(), |value| format!("± {:.0} mm", 1000.0 * value)),
        })
        .collect();
    let mut seconds: Vec<f64> = run.fit.sequence.frames.iter().map(|frame| frame.seconds).collect();
    seconds.sort_unstable_by(f64::total_cmp);
    if let Some(median) = seconds.get(seconds.len() / 2).filter(|median| **median > 0.0) {
        tiles.push(Headline {
            label: "Time a frame".to_owned(),
            value: format!("{:.0}", 1000.0 * median),
            unit: "ms".to_owned(),
            note: "median".to_owned(),
        });
    }
    tiles
}

fn identity(run: &FinishedRun<'_>) -> Vec<IdentityCoefficient> {
    let sequence = &run.fit.sequence;
    let covariance = &sequence.identity_covariance;
    let plus_minus =
        |number: usize| covariance.get((number, number)).map(|variance| variance.max(0.0).sqrt());
    let coefficients = sequence.identity.iter().enumerate();
    coefficients
        .map(|(number, value)| IdentityCoefficient { value: *value, plus_minus: plus_minus(number) })
        .collect()
}

fn units(run: &FinishedRun<'_>) -> String {
    let report = &run.fit.sequence.input_frame.report;
    if report.is_empty() { "metres, y up".to_owned() } else { report.join("; ") }
}

fn truth_rows(accuracy: &SequenceAccuracy) -> Vec<TruthRow> {
    let row =
        |metric: &str, value: f64, unit: &str| TruthRow { metric: metric.into(), value, unit: unit.into() };
    let mut rows = vec![
        row("Posed body, mean vertex distance", accuracy.posed_mean_mm, "mm"),
        row("Rest body, mean vertex distance", accuracy.rest_mean_mm, "mm"),
        row("Rest vertices under 10 mm", 100.0 * accuracy.rest_under_10mm, "%"),
        row("Joints, mean distance", accuracy.mpjpe_mm, "mm"),
        row("Stature, error", accuracy.stature_error_mm, "mm"),
        row("Girths, mean error", accuracy.girth_mean_error_mm, "mm"),
    ];
    rows.extend(accuracy.jitter_ratio.map(|ratio| row("Jitter over that of the truth", ratio, "")));
    rows
}

/// Meanings of the codes that fired, in the order of the codes.
fn code_meanings(run: &FinishedRun<'_>) -> Vec<CodeMeaning> {
    let sequence = &run.fit.sequence;
    let mut codes: Vec<Code> = sequence.frames.iter().flat_map(|frame| &frame.codes).copied().collect();
    codes.extend(&sequence.codes);
    codes.sort_unstable();
    codes.dedup();
    codes
        .iter()
        .map(|code| CodeMeaning {
            code: code.name().into(),
            meaning: format!("{} What to do: {}.", code.meaning(), code.remedy()),
        })
        .collect()
}
