//! Typed codes: why a frame or a sequence should not be trusted blindly. No wrong body goes out unmarked.

mod advice;

use std::fmt;

use serde::{Deserialize, Serialize};

/// What is suspicious about one frame or one sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Code {
    /// The capture of this frame could not be read or is unusable.
    UnreadableFrame,
    /// Too few body vertices have a compatible point on the capture.
    TooFewInliers,
    /// A part of the capture has no body near it.
    CaptureNotCovered,
    /// A part of the body has no capture near it.
    BodyNotCovered,
    /// Too much of the body lies outside the capture.
    BodyOutsideCapture,
    /// A joint angle rests on its limit.
    JointAtLimit,
    /// Another start explains the frame almost as well.
    AmbiguousStart,
    /// Another pose, with a joint elsewhere, explains the frame almost as well.
    AmbiguousPose,
    /// An identity coefficient rests on ±3 standard deviations.
    IdentityAtLimit,
    /// The pose jumps from the frame before by more than a person can move.
    TemporalJump,
    /// The capture of this frame has another scale than the others; it was brought to theirs before fitting.
    CaptureRescaled,
    /// Large parts of the capture belong to something else: an object, or another person.
    ForeignObject,
    /// The unit or the up axis was guessed and is not certain.
    UncertainFrameOfReference,
    /// The capture shows no person of plausible size and build.
    NotAPerson,
    /// The dressed surface of this frame had to be aligned anew, from the template over its body.
    AlignmentRestarted,
    /// The aligned surface lies off its capture.
    ClothingOffCapture,
    /// Parts of the aligned surface are turned over.
    ClothingFolded,
    /// Faces of a registered surface lie folded over.
    SurfaceFolded,
    /// Edges of a registered surface are stretched or shrunk beyond what a body does.
    SurfaceStretched,
    /// The registered surface is far from the landmarks.
    LandmarksMissed,
}

impl Code {
    /// Whether a frame with this code counts as failed: its body must not be used unseen.
    pub fn is_failure(self) -> bool {
        matches!(
            self,
            Self::UnreadableFrame
                | Self::TooFewInliers
                | Self::BodyOutsideCapture
                | Self::BodyNotCovered
                | Self::NotAPerson
                | Self::SurfaceFolded
                | Self::SurfaceStretched
                | Self::LandmarksMissed
        )
    }

    /// The code as it stands in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::UnreadableFrame => "unreadable_frame",
            Self::TooFewInliers => "too_few_inliers",
            Self::CaptureNotCovered => "capture_not_covered",
            Self::BodyNotCovered => "body_not_covered",
            Self::BodyOutsideCapture => "body_outside_capture",
            Self::JointAtLimit => "joint_at_limit",
            Self::AmbiguousStart => "ambiguous_start",
            Self::AmbiguousPose => "ambiguous_pose",
            Self::IdentityAtLimit => "identity_at_limit",
            Self::TemporalJump => "temporal_jump",
            Self::CaptureRescaled => "capture_rescaled",
            Self::ForeignObject => "foreign_object",
            Self::UncertainFrameOfReference => "uncertain_frame_of_reference",
            Self::NotAPerson => "not_a_person",
            Self::AlignmentRestarted => "alignment_restarted",
            Self::ClothingOffCapture => "clothing_off_capture",
            Self::ClothingFolded => "clothing_folded",
            Self::SurfaceFolded => "surface_folded",
            Self::SurfaceStretched => "surface_stretched",
            Self::LandmarksMissed => "landmarks_missed",
        }
    }
}

impl fmt::Display for Code {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}
