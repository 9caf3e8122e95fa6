//! What each code means for a person, and what that person can do.

use super::Code;

impl Code {
    /// All codes, in the order of their declaration.
    pub const ALL: [Self; 20] = [
        Self::UnreadableFrame,
        Self::TooFewInliers,
        Self::CaptureNotCovered,
        Self::BodyNotCovered,
        Self::BodyOutsideCapture,
        Self::JointAtLimit,
        Self::AmbiguousStart,
        Self::AmbiguousPose,
        Self::IdentityAtLimit,
        Self::TemporalJump,
        Self::CaptureRescaled,
        Self::ForeignObject,
        Self::UncertainFrameOfReference,
        Self::NotAPerson,
        Self::AlignmentRestarted,
        Self::ClothingOffCapture,
        Self::ClothingFolded,
        Self::SurfaceFolded,
        Self::SurfaceStretched,
        Self::LandmarksMissed,
    ];

    /// What it means, in a sentence.
    pub fn meaning(self) -> &'static str {
        match self {
            Self::UnreadableFrame => "The capture could not be read or has almost nothing on it.",
            Self::TooFewInliers => "Most of the body has no matching surface on the capture.",
            Self::CaptureNotCovered => "A part of the capture has no body near it.",
            Self::BodyNotCovered => {
                "Head, a hand or a foot has no capture near it, or a limb of the capture has no body in it."
            }
            Self::BodyOutsideCapture => "Too much of the body lies outside the capture.",
            Self::JointAtLimit => "A joint angle rests on its limit.",
            Self::AmbiguousStart => "Another first pose explains the capture almost as well.",
            Self::AmbiguousPose => {
                "Another pose, with an arm or a leg elsewhere, explains the capture almost as well."
            }
            Self::IdentityAtLimit => "The build of the person rests on the edge of the population.",
            Self::TemporalJump => "The pose jumps farther from one frame to the next than a person can move.",
            Self::CaptureRescaled => {
                "The capture has another scale than the other frames and was brought to theirs."
            }
            Self::ForeignObject => "Large parts of the capture belong to an object or to another person.",
            Self::UncertainFrameOfReference => "Unit or up axis were guessed and are not certain.",
            Self::NotAPerson => "The capture shows no person of plausible size and build.",
            Self::AlignmentRestarted => {
                "The dressed surface was aligned anew, from the template over its body."
            }
            Self::ClothingOffCapture => "The aligned dressed surface lies off its capture.",
            Self::ClothingFolded => "Parts of the aligned dressed surface are turned over.",
            Self::SurfaceFolded => "Faces of the registered surface lie folded over.",
            Self::SurfaceStretched => {
                "The registered surface is stretched or shrunk beyond what a body does."
            }
            Self::LandmarksMissed => "The registered surface is far from the landmarks of the scan.",
        }
    }

    /// What to do about it.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::UnreadableFrame => "export the frame again or leave it out",
            Self::TooFewInliers | Self::BodyOutsideCapture => {
                "look at the frame in the report; give landmarks for it with --landmarks"
            }
            Self::CaptureNotCovered => {
                "remove floor, objects and other people from the capture, and look whether its feet have feet in them"
            }
            Self::ForeignObject => "remove floor, objects and other people from the capture",
            Self::BodyNotCovered => "look whether the capture misses head or feet; trust those parts less",
            Self::JointAtLimit => "look at the frame in the report",
            Self::AmbiguousStart => "check front and back in the report; give landmarks for the first frame",
            Self::AmbiguousPose => {
                "look at arms and legs in the report; give landmarks for the frame with --landmarks"
            }
            Self::IdentityAtLimit => "trust measurements less; a model of another population may fit better",
            Self::TemporalJump => {
                "look at the frame and its neighbours; give landmarks or a higher frame rate"
            }
            Self::CaptureRescaled => "export all frames of the sequence in the same unit and place",
            Self::UncertainFrameOfReference => "say them with --unit and --up",
            Self::AlignmentRestarted => "look at the frame; no action if it is fine",
            Self::ClothingOffCapture | Self::ClothingFolded => {
                "leave the frame out of learning, or align with more nodes or another template frame"
            }
            Self::NotAPerson => "check the input; say --unit and --up if it is a person",
            Self::SurfaceFolded | Self::SurfaceStretched => {
                "look at the registration; reject it, or register again with a model of more people"
            }
            Self::LandmarksMissed => "look at the landmarks: left and right, or their names, may be swapped",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Code;

    #[test]
    fn every_code_is_listed_once() {
        let mut sorted = Code::ALL.to_vec();
        sorted.sort();
        sorted.dedup();
        assert_eq!(sorted, Code::ALL);
        // The last code of the enum is the last of the list, so that none is missing.
        assert_eq!(Code::ALL.last().map(|code| *code as usize), Some(Code::ALL.len() - 1));
    }
}
