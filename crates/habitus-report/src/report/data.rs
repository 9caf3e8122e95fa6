//! What a report shows. All 3D data are in metres, y up, the person's left towards +x when facing +z.

use glam::{DAffine3, DVec3};
use serde::Serialize;

/// Everything that a report shows.
#[derive(Debug, Clone, Default, Serialize)]
pub struct ReportData {
    /// Title of the page: the name of the run.
    pub title: String,
    /// A line under the title: what was done to what.
    pub subtitle: String,
    /// Version of the program that made the run.
    pub version: String,
    /// What was said of units and axes, for example "millimetres, z up (guessed from the stature)".
    pub units: String,
    /// The few numbers that a reader wants first.
    pub headlines: Vec<Headline>,
    /// All frames of the run, in order.
    pub frames: Vec<FrameSummary>,
    /// Codes of the sequence as a whole.
    pub sequence_codes: Vec<String>,
    /// What codes mean, in words for a person.
    pub code_meanings: Vec<CodeMeaning>,
    /// Identity coefficients in standard deviations of the population.
    pub identity: Vec<IdentityCoefficient>,
    /// Body measurements.
    pub measurements: Vec<MeasurementRow>,
    /// Where the time went.
    pub timings: Vec<Timing>,
    /// Input, model, settings, seed, machine: free text, shown as it is.
    pub provenance: String,
    /// Comparison with known truth; empty when there is none.
    pub truth: Vec<TruthRow>,
    /// Captured frames per second, for playing.
    pub frames_per_second: f64,
    /// The 3D view, if there is one.
    #[serde(skip)]
    pub model: Option<ModelView>,
}

/// A number for the top of the page.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Headline {
    /// What it is.
    pub label: String,
    /// The number, as it shall be read.
    pub value: String,
    /// Its unit.
    pub unit: String,
    /// A short remark, or nothing.
    pub note: String,
}

/// Percentiles of a quantity over the body's vertices.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Percentiles {
    /// 5 % are smaller.
    pub p5: f64,
    /// 25 % are smaller.
    pub p25: f64,
    /// The median.
    pub p50: f64,
    /// 75 % are smaller.
    pub p75: f64,
    /// 95 % are smaller.
    pub p95: f64,
}

/// One frame of the run.
#[derive(Debug, Clone, Default, Serialize)]
pub struct FrameSummary {
    /// The frame's name: its file name.
    pub name: String,
    /// Whether the body of this frame may be used unseen.
    pub is_ok: bool,
    /// Codes that fired.
    pub codes: Vec<String>,
    /// Seconds spent on the frame.
    pub seconds: f64,
    /// Energies by name; every frame should have the same names.
    pub energies: Vec<(String, f64)>,
    /// Clearance from body to capture in mm, if known; negative: the body is outside.
    pub clearance_mm: Option<Percentiles>,
    /// Share 0–1 of the body's vertices more than 5 mm outside the capture, if known.
    pub outside_share: Option<f64>,
    /// Share 0–1 of the body's vertices with a compatible point on the capture, if known.
    pub inlier_share: Option<f64>,
}

/// What a code means.
#[derive(Debug, Clone, Default, Serialize)]
pub struct CodeMeaning {
    /// The code.
    pub code: String,
    /// Its meaning in a sentence.
    pub meaning: String,
}

/// One coefficient of the identity.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct IdentityCoefficient {
    /// Value in standard deviations.
    pub value: f64,
    /// Standard error in the same unit, if known.
    pub plus_minus: Option<f64>,
}

/// One measurement of the body.
#[derive(Debug, Clone, Default, Serialize)]
pub struct MeasurementRow {
    /// Its name.
    pub name: String,
    /// Value in mm (volumes: in the unit named by `unit`).
    pub value: f64,
    /// Unit: mm for lengths.
    pub unit: String,
    /// Standard error in the same unit, if known.
    pub plus_minus: Option<f64>,
    /// How it is taken.
    pub definition: String,
    /// Its course on the body at rest.
    #[serde(skip)]
    pub curve: Option<BodyCurve>,
}

/// A polyline on the body at rest; the view moves it with the nearest vertex.
#[derive(Debug, Clone, Default)]
pub struct BodyCurve {
    /// Corners in metres, rest pose.
    pub points: Vec<DVec3>,
    /// Whether the last corner joins the first.
    pub is_closed: bool,
}

/// Time spent on a stage.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Timing {
    /// The stage.
    pub stage: String,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// One comparison with known truth.
#[derive(Debug, Clone, Default, Serialize)]
pub struct TruthRow {
    /// What is compared.
    pub metric: String,
    /// The value.
    pub value: f64,
    /// Its unit.
    pub unit: String,
}

/// The 3D view: one body, and what was captured, frame by frame.
#[derive(Debug, Clone, Default)]
pub struct ModelView {
    /// The body at rest with its bones.
    pub body: BodyView,
    /// Frames that can be shown; the page takes an even selection when not all fit.
    pub frames: Vec<FrameView>,
}

/// A skinned body at rest.
#[derive(Debug, Clone, Default)]
pub struct BodyView {
    /// Rest vertices in metres.
    pub rest_vertices: Vec<DVec3>,
    /// Triangles, outward counter-clockwise.
    pub faces: Vec<[u32; 3]>,
    /// Four bones a vertex.
    pub skin_bones: Vec<[u8; 4]>,
    /// Their weights; each row sums to 1.
    pub skin_weights: Vec<[f32; 4]>,
    /// Rest joint of each bone in metres.
    pub joints: Vec<DVec3>,
    /// Parent of each bone; none for the root.
    pub parents: Vec<Option<usize>>,
}

/// One frame of the 3D view.
#[derive(Debug, Clone, Default)]
pub struct FrameView {
    /// Its number in [`ReportData::frames`].
    pub frame: usize,
    /// Transform of each bone from rest to this frame.
    pub posed_from_rest: Vec<DAffine3>,
    /// What was captured; empty when it could not be read.
    pub capture: CaptureView,
    /// Clearance of each body vertex in mm, negative outside; empty when unknown.
    pub clearance_mm: Vec<f32>,
    /// Landmarks found on the capture.
    pub landmarks: Vec<LandmarkView>,
}

/// A capture as a mesh, or as points when it has no faces.
#[derive(Debug, Clone, Default)]
pub struct CaptureView {
    /// Vertices in metres.
    pub positions: Vec<DVec3>,
    /// Triangles, outward counter-clockwise.
    pub faces: Vec<[u32; 3]>,
}

/// A landmark found on a capture.
#[derive(Debug, Clone, Default)]
pub struct LandmarkView {
    /// Its name.
    pub name: String,
    /// Position in metres.
    pub position: DVec3,
    /// 0 (guess) to 1 (seen).
    pub confidence: f64,
}

/// Limits of the page.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReportOptions {
    /// Largest size of the file in bytes.
    pub size_limit: usize,
    /// Largest number of vertices of a capture in the 3D view.
    pub capture_vertex_limit: usize,
    /// Rather than fewer vertices a capture than this, frames are left out of the 3D view.
    pub capture_vertex_floor: usize,
    /// Clearance in mm with the strongest warm colour (negative) and the strongest cool colour.
    pub clearance_range_mm: [f64; 2],
}

impl Default for ReportOptions {
    fn default() -> Self {
        Self {
            size_limit: 8_000_000,
            capture_vertex_limit: 4_000,
            capture_vertex_floor: 3_000,
            clearance_range_mm: [-20.0, 60.0],
        }
    }
}
