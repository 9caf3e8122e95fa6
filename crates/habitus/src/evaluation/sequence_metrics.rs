//! The numbers of a benchmark: errors of many sequences by style of clothing and over all (P2 §6).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::distribution::Distribution;
use super::sequence_accuracy::{distances_mm, mean, share_under_10mm};
use super::sequence_errors::SequenceErrors;

/// When a body counts as wrong.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SequenceMetricsSettings {
    /// Mean joint error from which a frame's body is wrong, millimetres: about the thickness of a limb.
    pub wrong_mpjpe_mm: f64,
}

impl Default for SequenceMetricsSettings {
    fn default() -> Self {
        Self { wrong_mpjpe_mm: 100.0 }
    }
}

/// P2's own protocol: the body fitted to the same person in tight clothing stands for the truth (P2 §6.2).
/// It refers to the method itself, so that errors common to both fits do not show.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperProtocol {
    /// Mean distance between corresponding vertices of the two fitted rest bodies.
    pub mean_mm: f64,
    /// Share of them below 10 mm. P2 §6.2: more than a half.
    pub under_10mm: f64,
}

/// Median and 95th percentile.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Half of all are below.
    pub p50: f64,
    /// 95 % of all are below.
    pub p95: f64,
}

/// How often measurements cover the truth, beside how often their ± says they do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Number of measurements.
    pub measurements: usize,
    /// Share within one standard deviation of the truth; 0.683 when ± is honest.
    pub within_one: f64,
    /// Share within two; 0.954 when ± is honest.
    pub within_two: f64,
    /// Root mean square of error over ±: the factor by which ± is too small.
    pub error_over_stated: f64,
}

/// The numbers of some sequences. Frames count alike in what is measured frame by frame, sequences alike in what
/// belongs to the identity; none is left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SequenceMetrics {
    /// How many sequences.
    pub sequences: usize,
    /// How many frames.
    pub frames: usize,
    /// Mean distance between corresponding vertices of the posed bodies.
    pub posed_mean_mm: f64,
    /// 95 % of these distances are below.
    pub posed_p95_mm: f64,
    /// Mean distance between corresponding vertices of the centred rest bodies (P2 §6.2).
    pub rest_mean_mm: f64,
    /// Share of these distances below 10 mm.
    pub rest_under_10mm: f64,
    /// Mean distance between corresponding vertices of the rest bodies, root joints brought together.
    pub rest_from_root_mean_mm: f64,
    /// Share of these distances below 10 mm.
    pub rest_from_root_under_10mm: f64,
    /// Mean distance between corresponding joints.
    pub mpjpe_mm: f64,
    /// Mean distance between landmark vertices and the true ones; none where the truth has no landmarks.
    pub landmark_mm: Option<f64>,
    /// Mean absolute error of chest, waist, hip, thigh and upper arm girth.
    pub girth_mean_error_mm: f64,
    /// Mean absolute error of the stature.
    pub stature_error_mm: f64,
    /// Mean share of body vertices more than 5 mm outside the capture, over readable frames.
    pub outside_share_5mm: f64,
    /// Mean second difference of fitted joints over that of true ones.
    pub jitter_ratio: Option<f64>,
    /// Share of frames whose body is no good: wrong, or marked by a code as not to be used unseen.
    pub failure_rate: f64,
    /// Share of frames that are marked although their body is not wrong.
    pub false_alarm_rate: f64,
    /// Share of frames that are wrong and not marked.
    pub miss_rate: f64,
    /// P2's own protocol; none for tight clothing, which it takes for the truth.
    pub paper_protocol: Option<PaperProtocol>,
    /// Seconds of tracking for each frame on the machine of the run.
    pub seconds_per_frame: Option<Percentiles>,
    /// Joint error in the last quarter of the frames minus that in the first: does tracking drift?
    pub drift_mm: Option<f64>,
    /// How often the ± of measurements covers the truth.
    pub uncertainty: Option<Coverage>,
}

/// A frame that is wrong and not marked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Miss {
    /// Name of the sequence.
    pub sequence: String,
    /// Name of the frame.
    pub frame: String,
    /// Its mean joint error.
    pub mpjpe_mm: f64,
}

/// The numbers of one way to fit: over all sequences, by style, and for each sequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BenchmarkMetrics {
    /// Over all sequences.
    pub overall: SequenceMetrics,
    /// By style of clothing.
    pub styles: BTreeMap<String, SequenceMetrics>,
    /// By motion.
    pub motions: BTreeMap<String, SequenceMetrics>,
    /// Each sequence alone.
    pub sequences: BTreeMap<String, SequenceMetrics>,
    /// Frames that are wrong and not marked.
    pub misses: Vec<Miss>,
}

/// Sums up the errors of one way to fit.
pub fn benchmark_metrics(all: &[SequenceErrors], settings: &SequenceMetricsSettings) -> BenchmarkMetrics {
    let sum_up = |of: &dyn Fn(&SequenceErrors) -> bool| {
        let chosen: Vec<&SequenceErrors> = all.iter().filter(|errors| of(errors)).collect();
        metrics(&chosen, all, settings)
    };
    let by = |key: fn(&SequenceErrors) -> &String| -> BTreeMap<String, SequenceMetrics> {
        let names = all.iter().map(|errors| key(errors).clone());
        names.map(|name| (name.clone(), sum_up(&|errors| *key(errors) == name))).collect()
    };
    let is_missed = |frame: &super::sequence_errors::FrameErrors| {
        frame.mpjpe_mm > settings.wrong_mpjpe_mm && !frame.is_marked
    };
    let misses = all.iter().flat_map(|errors| {
        errors.frames.iter().filter(|frame| is_missed(frame)).map(|frame| Miss {
            sequence: errors.label.name.clone(),
            frame: frame.name.clone(),
            mpjpe_mm: frame.mpjpe_mm,
        })
    });
    BenchmarkMetrics {
        overall: sum_up(&|_| true),
        styles: by(|errors| &errors.label.style),
        motions: by(|errors| &errors.label.motion),
        sequences: by(|errors| &errors.label.name),
        misses: misses.collect(),
    }
}

/// Name of the style that P2's protocol takes for the truth.
const REFERENCE_STYLE: &str = "tight";
/// Name of the motion that it is taken from where there is one. P2 §6.2: walking.
const REFERENCE_MOTION: &str = "walk";

/// The sequence whose fitted body stands for the truth of a subject in P2's protocol.
fn reference<'a>(all: &'a [SequenceErrors], subject: &str) -> Option<&'a SequenceErrors> {
    let tight = || {
        all.iter()
            .filter(move |errors| errors.label.subject == subject && errors.label.style == REFERENCE_STYLE)
    };
    tight().find(|errors| errors.label.motion == REFERENCE_MOTION).or_else(|| tight().next())
}

/// Distances of P2's protocol, mm, for all sequences in other than tight clothing.
pub fn paper_protocol_distances(chosen: &[&SequenceErrors], all: &[SequenceErrors]) -> Vec<f64> {
    chosen
        .iter()
        .filter(|errors| errors.label.style != REFERENCE_STYLE)
        .filter_map(|errors| {
            let reference = reference(all, &errors.label.subject)?;
            Some(distances_mm(&errors.rest_body, &reference.rest_body))
        })
        .flatten()
        .collect()
}

fn metrics(
    chosen: &[&SequenceErrors],
    all: &[SequenceErrors],
    settings: &SequenceMetricsSettings,
) -> SequenceMetrics {
    let frames: Vec<_> = chosen.iter().flat_map(|errors| &errors.frames).collect();
    let mut posed = Distribution::default();
    chosen.iter().for_each(|errors| posed.merge(&errors.posed));
    let rest: Vec<f64> = chosen.iter().flat_map(|errors| errors.rest_mm.iter().copied()).collect();
    let from_root: Vec<f64> =
        chosen.iter().flat_map(|errors| errors.rest_from_root_mm.iter().copied()).collect();
    let of_sequences =
        |value: fn(&SequenceErrors) -> f64| mean(&chosen.iter().map(|e| value(e)).collect::<Vec<_>>());
    let share = |is: &dyn Fn(&super::sequence_errors::FrameErrors) -> bool| {
        frames.iter().filter(|frame| is(frame)).count() as f64 / frames.len().max(1) as f64
    };
    let is_wrong = |frame: &super::sequence_errors::FrameErrors| frame.mpjpe_mm > settings.wrong_mpjpe_mm;
    let protocol = paper_protocol_distances(chosen, all);
    let landmarks: Vec<f64> = frames.iter().flat_map(|frame| frame.landmarks_mm.iter().copied()).collect();
    let outside: Vec<f64> = frames.iter().filter_map(|frame| frame.outside_share_5mm).collect();
    let drifts: Vec<f64> = chosen.iter().filter_map(|errors| drift(errors)).collect();
    SequenceMetrics {
        sequences: chosen.len(),
        frames: frames.len(),
        posed_mean_mm: posed.mean(),
        posed_p95_mm: posed.percentile(0.95),
        rest_mean_mm: mean(&rest),
        rest_under_10mm: share_under_10mm(&rest),
        rest_from_root_mean_mm: mean(&from_root),
        rest_from_root_under_10mm: share_under_10mm(&from_root),
        mpjpe_mm: mean(&frames.iter().map(|frame| frame.mpjpe_mm).collect::<Vec<_>>()),
        landmark_mm: (!landmarks.is_empty()).then(|| mean(&landmarks)),
        girth_mean_error_mm: of_sequences(|errors| errors.accuracy.girth_mean_error_mm),
        stature_error_mm: of_sequences(|errors| errors.accuracy.stature_error_mm),
        outside_share_5mm: mean(&outside),
        jitter_ratio: jitter_ratio(chosen),
        failure_rate: share(&|frame| is_wrong(frame) || frame.is_marked),
        false_alarm_rate: share(&|frame| !is_wrong(frame) && frame.is_marked),
        miss_rate: share(&|frame| is_wrong(frame) && !frame.is_marked),
        paper_protocol: (!protocol.is_empty())
            .then(|| PaperProtocol { mean_mm: mean(&protocol), under_10mm: share_under_10mm(&protocol) }),
        seconds_per_frame: percentiles(frames.iter().filter_map(|frame| frame.seconds).collect()),
        drift_mm: (!drifts.is_empty()).then(|| mean(&drifts)),
        uncertainty: coverage(chosen),
    }
}

/// Both jitters are means over frames, so that long sequences count for more.
fn jitter_ratio(chosen: &[&SequenceErrors]) -> Option<f64> {
    let sum = |place: usize| -> f64 {
        chosen.iter().map(|errors| errors.jitter_mm[place] * errors.frames.len() as f64).sum()
    };
    (sum(1) > 0.0).then(|| sum(0) / sum(1))
}

fn percentiles(mut values: Vec<f64>) -> Option<Percentiles> {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
    (!values.is_empty()).then(|| Percentiles { p50: at(0.5), p95: at(0.95) })
}

/// A quarter of fewer frames is no trend.
const FEWEST_FRAMES_OF_A_DRIFT: usize = 12;

fn drift(errors: &SequenceErrors) -> Option<f64> {
    let joints: Vec<f64> = errors.frames.iter().map(|frame| frame.mpjpe_mm).collect();
    let quarter = joints.len() / 4;
    (joints.len() >= FEWEST_FRAMES_OF_A_DRIFT)
        .then(|| mean(&joints[joints.len() - quarter..]) - mean(&joints[..quarter]))
}

fn coverage(chosen: &[&SequenceErrors]) -> Option<Coverage> {
    let ratios: Vec<f64> = chosen
        .iter()
        .flat_map(|errors| &errors.measurements)
        .map(|measurement| measurement.error.abs() / measurement.plus_minus)
        .collect();
    let within = |limit: f64| {
        ratios.iter().filter(|ratio| **ratio <= limit).count() as f64 / ratios.len().max(1) as f64
    };
    (!ratios.is_empty()).then(|| Coverage {
        measurements: ratios.len(),
        within_one: within(1.0),
        within_two: within(2.0),
        error_over_stated: mean(&ratios.iter().map(|ratio| ratio * ratio).collect::<Vec<_>>()).sqrt(),
    })
}

/// Mean rest error of each vertex over some sequences, mm (P2 Fig. 6, right).
pub fn mean_rest_errors_mm(chosen: &[&SequenceErrors]) -> Vec<f64> {
    let count = chosen.first().map_or(0, |errors| errors.rest_mm.len());
    let mut sums = vec![0.0; count];
    for errors in chosen {
        sums.iter_mut().zip(&errors.rest_mm).for_each(|(sum, error)| *sum += error);
    }
    sums.iter().map(|sum| sum / chosen.len().max(1) as f64).collect()
}

/// Share of errors at most as large as each of some thresholds: a cumulative curve (P2 Fig. 5 and 6, left).
pub fn cumulative(errors_mm: &[f64], thresholds_mm: &[f64]) -> Vec<[f64; 2]> {
    let mut sorted = errors_mm.to_vec();
    sorted.sort_by(f64::total_cmp);
    thresholds_mm
        .iter()
        .map(|threshold| {
            let below = sorted.partition_point(|error| error <= threshold);
            [*threshold, below as f64 / sorted.len().max(1) as f64]
        })
        .collect()
}

#[cfg(test)]
mod tests;
