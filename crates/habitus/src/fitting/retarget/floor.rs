//! Where the floor is, when a captured foot stands on it, and how high that puts our soles.

use glam::DVec3;

use super::roles::{CapturedBody, Role};
use super::{RetargetBody, RetargetError, RetargetSettings};
use crate::artifacts::rigged_sequence::FrameRate;
use crate::body::{BodyModel, Pose};

/// The share of frames in which an ankle is at its lowest: noise lies below, steps above.
const LOWEST_SHARE: f64 = 0.05;

/// Heights of the captured feet above their own floor.
pub(super) struct Floor {
    /// How high the lower foot is, for each frame; 0: it stands.
    lifts: Vec<f64>,
    /// Whether the left and the right foot stand.
    stands: Vec<[bool; 2]>,
}

impl Floor {
    pub(super) fn of(captured: &CapturedBody, rate: FrameRate, settings: &RetargetSettings) -> Self {
        let places = [[Role::LeftAnkle, Role::LeftToe], [Role::RightAnkle, Role::RightToe]];
        let frames = 0..captured.frame_count();
        // Ankles have one level and toes another: each stands at its own height above the sole.
        let levels = [0, 1].map(|end| {
            let heights = frames.clone().flat_map(|frame| {
                places
                    .into_iter()
                    .filter_map(move |side| captured.find(frame, side[end]).map(|place| place.y))
            });
            lowest_level(heights.collect())
        });
        let height = |frame: usize, side: usize, end: usize| {
            captured.find(frame, places[side][end]).map(|place| place.y - levels[end])
        };
        let lifts = frames.clone().map(|frame| {
            let ends = [(0, 0), (0, 1), (1, 0), (1, 1)];
            let heights = ends.into_iter().filter_map(|(side, end)| height(frame, side, end));
            (heights.fold(f64::INFINITY, f64::min) - settings.standing_height).max(0.0)
        });
        let stands = frames.clone().map(|frame| {
            [0, 1].map(|side| {
                let before = captured.place(frame.saturating_sub(1), places[side][0]);
                let after = captured.place((frame + 1).min(frames.end - 1), places[side][0]);
                let speed = before.distance(after) * rate.frames_per_second() / 2.0;
                let heights = (0..2).filter_map(|end| height(frame, side, end));
                speed < settings.standing_speed
                    && heights.fold(f64::NEG_INFINITY, f64::max) < settings.standing_height
            })
        });
        Self { lifts: lifts.collect(), stands: stands.collect() }
    }

    pub(super) fn stands(&self, frame: usize, is_left: bool) -> bool {
        self.stands[frame][usize::from(!is_left)]
    }

    /// What to add to each frame's height, so that soles at `heights` are as high as the captured ones.
    pub(super) fn shifts(&self, heights: &[f64], rate: FrameRate, settings: &RetargetSettings) -> Vec<f64> {
        let raw: Vec<f64> = self.lifts.iter().zip(heights).map(|(lift, height)| lift - height).collect();
        smooth(&raw, settings.height_smoothing_seconds * rate.frames_per_second())
    }
}

fn lowest_level(mut heights: Vec<f64>) -> f64 {
    let place = (heights.len() as f64 * LOWEST_SHARE) as usize;
    if heights.is_empty() {
        return 0.0;
    }
    *heights.select_nth_unstable_by(place, f64::total_cmp).1
}

/// Gaussian smoothing; at the ends the weights that are left are used.
fn smooth(values: &[f64], deviation: f64) -> Vec<f64> {
    if deviation <= 0.0 {
        return values.to_vec();
    }
    let reach = (3.0 * deviation).ceil() as usize;
    (0..values.len())
        .map(|frame| {
            let first = frame.saturating_sub(reach);
            let window = &values[first..(frame + reach + 1).min(values.len())];
            let (mut sum, mut total) = (0.0, 0.0);
            for (place, value) in window.iter().enumerate() {
                let distance = ((first + place) as f64 - frame as f64) / deviation;
                let weight = (-0.5 * distance * distance).exp();
                sum += weight * value;
                total += weight;
            }
            sum / total
        })
        .collect()
}

/// The vertices of both feet.
pub(super) struct Soles {
    vertices: Vec<(usize, DVec3)>,
}

impl Soles {
    pub(super) fn of(model: &BodyModel, rest: &[DVec3]) -> Result<Self, RetargetError> {
        let bones = model.skeleton().bones();
        let foot = |name: &'static str| {
            let found = bones.iter().position(|bone| bone.name == name);
            found.ok_or(RetargetError::BoneMissing { bone: name })
        };
        let feet = [foot("left_foot")?, foot("right_foot")?];
        let owners = model.dominant_bones().into_iter().zip(rest);
        let vertices = owners.filter(|(bone, _)| feet.contains(bone)).map(|(bone, place)| (bone, *place));
        Ok(Self { vertices: vertices.collect() })
    }

    /// Height of the lowest point of both feet, metres.
    pub(super) fn lowest(&self, body: &RetargetBody<'_>, pose: &Pose) -> f64 {
        let posed = body.model.skeleton().pose(&body.joints, pose.parameters());
        let heights = self
            .vertices
            .iter()
            .map(|(bone, rest)| (posed.rotations[*bone] * *rest + posed.translations[*bone]).y);
        heights.fold(f64::INFINITY, f64::min)
    }
}
