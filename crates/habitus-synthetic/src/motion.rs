//! Natural motion as joint angles over time: walking, turning and knee pulls (the motions of P2 §6.1).
//!
//! Angles are anatomical and independent of the skeleton's axes; [`crate::animate`] turns them into poses.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// What the person does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// Straight ahead.
    Walk,
    /// Along a circle.
    WalkAndTurn,
    /// Small steps while the body turns on the spot (P2 §6.1: "rotating the body").
    TurnOnSpot,
    /// One knee after the other is pulled up (P2 §6.1: "pulling the knees up").
    KneePulls,
}

/// Angles of one leg, radians, zero when standing straight.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LegAngles {
    /// Thigh forwards.
    pub hip_flexion: f64,
    /// Thigh outwards.
    pub hip_abduction: f64,
    /// Bend of the knee.
    pub knee_flexion: f64,
    /// Toes up.
    pub ankle_dorsiflexion: f64,
}

/// Angles of one arm, radians, zero when it hangs straight down.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ArmAngles {
    /// Upper arm forwards.
    pub shoulder_flexion: f64,
    /// Upper arm outwards.
    pub shoulder_abduction: f64,
    /// Bend of the elbow.
    pub elbow_flexion: f64,
}

/// The whole body at one time; pairs are left, right.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stance {
    /// Direction the person faces, radians from +z towards +x (a left turn grows it).
    pub heading: f64,
    /// Pelvis turned to the left against the heading.
    pub pelvis_turn: f64,
    /// Left side of the pelvis higher.
    pub pelvis_list: f64,
    /// Thorax turned to the left against the pelvis.
    pub thorax_turn: f64,
    /// Thorax leaning to the left against the pelvis.
    pub thorax_list: f64,
    /// Thorax bent forwards.
    pub thorax_flexion: f64,
    /// Legs.
    pub legs: [LegAngles; 2],
    /// Share of the weight that each foot may carry, 0 while it swings.
    pub support: [f64; 2],
    /// Arms.
    pub arms: [ArmAngles; 2],
}

/// Sagittal joint angles over one gait cycle from heel strike, degrees in tenths of the cycle: near the normative
/// curves of natural cadence in Winter, *The Biomechanics and Motor Control of Human Gait* (1991), with a little less
/// reach, because these feet do not roll over their toes.
const HIP_FLEXION: [f64; 10] = [22.0, 21.0, 16.0, 8.0, 0.0, -8.0, -8.0, 6.0, 19.0, 24.0];
const KNEE_FLEXION: [f64; 10] = [3.0, 11.0, 13.0, 9.0, 9.0, 21.0, 45.0, 62.0, 48.0, 15.0];
const ANKLE_DORSIFLEXION: [f64; 10] = [0.0, -4.0, 3.0, 7.0, 10.0, 10.0, 3.0, 1.0, 3.0, 3.0];
/// Duration of a gait cycle at natural cadence, seconds (Winter 1991: 105–115 steps per minute).
const CYCLE_SECONDS: f64 = 1.1;
/// A turn on the spot, radians per second: a quarter turn with each pair of steps.
const TURN_ON_SPOT_RATE: f64 = TAU / 4.0 / CYCLE_SECONDS;
/// Turning while walking, radians per second.
const WALK_TURN_RATE: f64 = 0.9;
/// Seconds from one knee pull to the next.
const KNEE_PULL_SECONDS: f64 = 1.4;

impl Motion {
    /// The motion as it stands in the names of files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Walk => "walk",
            Self::WalkAndTurn => "walk_and_turn",
            Self::TurnOnSpot => "turn",
            Self::KneePulls => "knees",
        }
    }

    /// The body at a time, seconds; `phase` in 0..1 shifts the cycle.
    pub fn at(self, time: f64, phase: f64) -> Stance {
        match self {
            Self::Walk => gait(time, phase, 1.0, 0.0),
            Self::WalkAndTurn => gait(time, phase, 1.0, WALK_TURN_RATE),
            Self::TurnOnSpot => gait(time, phase, 0.35, TURN_ON_SPOT_RATE),
            Self::KneePulls => knee_pulls(time, phase),
        }
    }
}

fn gait(time: f64, phase: f64, stride: f64, turn_rate: f64) -> Stance {
    let left_phase = (time / CYCLE_SECONDS + phase).rem_euclid(1.0);
    let leg = |cycle: f64| {
        // Short steps still lift the foot: the knee keeps two thirds of its bend where the hip hardly swings.
        let lift = stride.max(0.65);
        let knee = periodic(&KNEE_FLEXION, cycle) * lift;
        let hip_middle = 8.0;
        LegAngles {
            hip_flexion: ((periodic(&HIP_FLEXION, cycle) - hip_middle) * stride
                + hip_middle * stride
                + knee * 0.5 * (lift - stride))
                .to_radians(),
            hip_abduction: 1.5_f64.to_radians(),
            knee_flexion: knee.to_radians(),
            ankle_dorsiflexion: (periodic(&ANKLE_DORSIFLEXION, cycle) * stride
                + knee * 0.15 * (lift - stride))
                .to_radians(),
        }
    };
    // Heel strike of the left leg is at phase 0; the left arm is then furthest back.
    let swing = (TAU * left_phase).cos();
    let arm = |swing: f64| ArmAngles {
        shoulder_flexion: (4.0 + 20.0 * stride * swing).to_radians(),
        shoulder_abduction: 13.0_f64.to_radians(),
        elbow_flexion: (22.0 + 12.0 * stride * swing).to_radians(),
    };
    let list = (TAU * (left_phase - 0.15)).cos();
    Stance {
        heading: turn_rate * time,
        pelvis_turn: (-5.0 * stride * swing).to_radians(),
        pelvis_list: (3.0 * list).to_radians(),
        thorax_turn: (11.0 * stride * swing).to_radians(),
        thorax_list: (-2.0 * list).to_radians(),
        thorax_flexion: 3.0_f64.to_radians(),
        legs: [leg(left_phase), leg((left_phase + 0.5).fract())],
        support: [support(left_phase), support((left_phase + 0.5).fract())],
        arms: [arm(-swing), arm(swing)],
    }
}

/// One while a foot stands, zero while it swings, with smooth double support between (Winter 1991: 10 % each).
fn support(cycle: f64) -> f64 {
    let after_strike = (cycle / 0.08).min(1.0);
    let before_lift = ((0.60 - cycle) / 0.08).clamp(0.0, 1.0);
    let share = after_strike * before_lift;
    share * share * (3.0 - 2.0 * share)
}

fn knee_pulls(time: f64, phase: f64) -> Stance {
    let pulls = time / KNEE_PULL_SECONDS + phase * 2.0;
    let is_left = pulls.rem_euclid(2.0) < 1.0;
    // A raised cosine: up and down once per pull, at rest in between.
    let lift = 0.5 - 0.5 * (TAU * pulls.rem_euclid(1.0)).cos();
    let leg = |lift: f64| LegAngles {
        hip_flexion: (95.0 * lift).to_radians(),
        hip_abduction: 2.0_f64.to_radians(),
        knee_flexion: (4.0 + 100.0 * lift).to_radians(),
        ankle_dorsiflexion: (-10.0 * lift).to_radians(),
    };
    let arm = |lift: f64| ArmAngles {
        shoulder_flexion: (5.0 + 20.0 * lift).to_radians(),
        shoulder_abduction: (14.0 + 14.0 * lift).to_radians(),
        elbow_flexion: (20.0 + 45.0 * lift).to_radians(),
    };
    let side = if is_left { 1.0 } else { -1.0 };
    // A foot leaves the floor within the first tenth of the pull.
    let support_of = |lift: f64| (1.0 - lift * 10.0).max(0.0);
    let (left, right) = if is_left { (lift, 0.0) } else { (0.0, lift) };
    Stance {
        pelvis_list: (2.5 * lift * side).to_radians(),
        thorax_list: (-3.0 * lift * side).to_radians(),
        thorax_flexion: (2.0 + 5.0 * lift).to_radians(),
        legs: [leg(left), leg(right)],
        support: [support_of(left), support_of(right)],
        arms: [arm(right), arm(left)],
        ..Stance::default()
    }
}

/// A periodic curve through evenly spaced samples (Catmull–Rom), `phase` in 0..1.
fn periodic(samples: &[f64; 10], phase: f64) -> f64 {
    let place = phase.rem_euclid(1.0) * samples.len() as f64;
    let start = place.floor() as usize;
    let t = place - start as f64;
    let [a, b, c, d] = std::array::from_fn(|k| samples[(start + k + samples.len() - 1) % samples.len()]);
    b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gait_is_periodic_and_alternates() {
        let now = Motion::Walk.at(0.3, 0.1);
        let later = Motion::Walk.at(0.3 + CYCLE_SECONDS, 0.1);
        let half = Motion::Walk.at(0.3 + CYCLE_SECONDS / 2.0, 0.1);
        assert!((now.legs[0].knee_flexion - later.legs[0].knee_flexion).abs() < 1e-12);
        assert!((now.legs[0].hip_flexion - half.legs[1].hip_flexion).abs() < 1e-12);
        assert!((now.arms[0].elbow_flexion - half.arms[1].elbow_flexion).abs() < 1e-12);
    }

    #[test]
    fn curves_pass_through_their_samples() {
        for (tenth, &sample) in KNEE_FLEXION.iter().enumerate() {
            assert!((periodic(&KNEE_FLEXION, tenth as f64 / 10.0) - sample).abs() < 1e-12);
        }
    }

    #[test]
    fn a_knee_pull_lifts_one_thigh_to_the_horizontal() {
        let top = Motion::KneePulls.at(0.5 * KNEE_PULL_SECONDS, 0.0);
        assert!(top.legs[0].hip_flexion.to_degrees() > 90.0 && top.legs[1].hip_flexion.abs() < 1e-9);
    }
}
