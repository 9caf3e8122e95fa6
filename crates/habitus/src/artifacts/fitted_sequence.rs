//! The result of `fit_sequence`: one identity, a pose for each frame, and what is known of their quality.

use glam::{DMat3, DVec3};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::codes::Code;

/// How the input's coordinates relate to ours: `internal = metres_per_unit · internal_from_input · input`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputFrame {
    /// Metres in one unit of the input.
    pub metres_per_unit: f64,
    /// Rotation from the input's axes to ours (y up).
    pub internal_from_input: DMat3,
    /// What was guessed, and why, in words for a person.
    pub report: Vec<String>,
}

impl InputFrame {
    /// From the input's coordinates to metres, y up.
    pub fn to_internal(&self, point: DVec3) -> DVec3 {
        self.internal_from_input * point * self.metres_per_unit
    }

    /// From metres, y up, to the input's coordinates.
    pub fn to_input(&self, point: DVec3) -> DVec3 {
        self.internal_from_input.transpose() * point / self.metres_per_unit
    }
}

/// A landmark of one frame in metres, y up, with a confidence between 0 and 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Landmark {
    /// Position in metres.
    pub position: DVec3,
    /// 0 (guess) to 1 (seen and agreed on).
    pub confidence: f64,
}

/// What finds the first pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StartMethod {
    /// Pose clusters in all headings, fitted and halved.
    #[default]
    Search,
    /// The part-based puppet (P2 §4.2).
    Puppet,
    /// Landmarks that a person gives for the first frame.
    Landmarks,
}

/// What the puppet said about a start that the search was unsure of.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SecondOpinion {
    /// Whether its best start was the search's own.
    pub agrees: bool,
    /// Energy of the start that was taken over that of the search's best; below one, the puppet's was better.
    pub energy_ratio: f64,
}

/// How the first pose was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StartReport {
    /// What found the start that was taken.
    pub method: StartMethod,
    /// The second opinion, if one was asked for.
    pub second_opinion: Option<SecondOpinion>,
    /// Energy of the second-best start over that of the best.
    pub rival_ratio: f64,
    /// Landmarks of the start on the first usable frame, before tracking, in metres, y up; all of confidence 1.
    pub landmarks: Vec<Landmark>,
}

/// One frame's pose and quality.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FittedFrame {
    /// The frame's name: its file name.
    pub name: String,
    /// Pose parameters in metres and radians, y up.
    pub pose: Vec<f64>,
    /// Landmarks in the model's order.
    pub landmarks: Vec<Landmark>,
    /// Codes that fired.
    pub codes: Vec<Code>,
    /// Share of body vertices with a compatible point on the capture.
    pub inlier_share: f64,
    /// Share of body vertices more than 5 mm outside the capture.
    pub outside_share_5mm: f64,
    /// Mean depth outside the capture over all body vertices, in metres.
    pub outside_mean: f64,
    /// Clearance below which 5, 25, 50, 75 and 95 % of the body vertices lie, in metres at the size of the body, negative
    /// outside; none where the frame was not fitted.
    pub clearance_percentiles: Option<[f64; 5]>,
    /// Energy per vertex at the end, in square metres.
    pub energy: f64,
    /// How much larger this frame's capture is than the rest of the sequence; the body lies in the capture divided by
    /// this factor. 1 unless frames were exported at different scales.
    pub capture_scale: f64,
    /// Seconds spent on the frame; the library keeps no clock, whoever does fills it in.
    pub seconds: f64,
}

impl FittedFrame {
    /// Whether the body of this frame may be used unseen.
    pub fn is_ok(&self) -> bool {
        !self.codes.iter().any(|code| code.is_failure())
    }
}

/// One identity and a pose for each frame, in metres, y up.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedSequence {
    /// How the input relates to metres, y up.
    pub input_frame: InputFrame,
    /// Identity coefficients in standard deviations.
    pub identity: Vec<f64>,
    /// Covariance of the coefficients' errors, from the curvature of the energy, in the same unit squared.
    pub identity_covariance: DMatrix<f64>,
    /// Rest vertices in model space, metres: the identity's, and what local shapes add to it.
    pub rest_vertices: Vec<DVec3>,
    /// Rest joints in model space, metres.
    pub rest_joints: Vec<DVec3>,
    /// How the first pose was found; none for sequences that no search has started.
    pub start: Option<StartReport>,
    /// Smallest clearance of each vertex over the trusted frames, in metres; negative: outside the capture.
    pub smallest_clearance: Vec<f64>,
    /// The frames in order.
    pub frames: Vec<FittedFrame>,
    /// Codes of the sequence as a whole.
    pub codes: Vec<Code>,
}
