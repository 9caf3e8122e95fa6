//! The motion with what is too fast for a body taken out of it.
//!
//! Loose cloth moves on its own, and where it alone holds a limb the limb trembles with it. Around each frame a parabola in
//! time is laid through the poses, and its middle is where the last pose rounds begin and are drawn to.

use std::ops::Range;

use glam::{DQuat, DVec3};

use super::config::RefineConfig;
use crate::body::{ROOT_LENGTH, rotation_vector};

/// Poses smoothed over `config.smoothing_reach` frames on both sides, fewer at the ends and where a frame is not joined to
/// the next: steady acceleration passes unchanged. Root rotations are averaged as rotations about that of the frame.
pub(super) fn smoothed(
    poses: &[Vec<f64>],
    is_joined: &dyn Fn(usize) -> bool,
    config: &RefineConfig,
) -> Vec<Vec<f64>> {
    let smoothed_frame = |frame: usize| {
        let reach = usable_reach(frame, poses.len(), is_joined, config.smoothing_reach);
        let mut pose = poses[frame].clone();
        let rotation_of = |pose: &[f64]| DQuat::from_scaled_axis(DVec3::from_slice(&pose[3..6]));
        let own = rotation_of(&pose);
        let mut turn = DVec3::ZERO;
        for (weight, other) in parabola_weights(reach).into_iter().zip(&poses[frame - reach..]) {
            turn += weight * rotation_vector(rotation_of(other) * own.inverse());
            for (value, (other, centre)) in pose.iter_mut().zip(other.iter().zip(&poses[frame])) {
                *value += weight * (other - centre);
            }
        }
        let rotation = rotation_vector(DQuat::from_scaled_axis(turn) * own);
        pose[3..6].copy_from_slice(&rotation.to_array());
        let [angle, length] = config.largest_tremble;
        let within = |range: Range<usize>, most: f64| {
            range.into_iter().all(|k| (pose[k] - poses[frame][k]).abs() <= most)
        };
        let trembles =
            turn.length() <= angle && within(0..3, length) && within(ROOT_LENGTH..pose.len(), angle);
        if trembles { pose } else { poses[frame].clone() }
    };
    (0..poses.len()).map(smoothed_frame).collect()
}

/// How far the frames on both sides may be used.
fn usable_reach(frame: usize, count: usize, is_joined: &dyn Fn(usize) -> bool, reach: usize) -> usize {
    let most = reach.min(frame).min(count - 1 - frame);
    (1..=most).take_while(|step| is_joined(frame - step) && is_joined(frame + step - 1)).count()
}

/// Weights with which the values at −reach … reach give the middle of their least-squares parabola (Savitzky and Golay
/// 1964); they sum to one.
fn parabola_weights(reach: usize) -> Vec<f64> {
    let m = reach as f64;
    if reach < 2 {
        // A parabola goes through three points as they are.
        return (0..=2 * reach).map(|place| f64::from(u8::from(place == reach))).collect();
    }
    let scale = 3.0 / ((2.0 * m - 1.0) * (2.0 * m + 1.0) * (2.0 * m + 3.0));
    (0..=2 * reach)
        .map(|place| {
            let k = place as f64 - m;
            scale * (3.0 * m * m + 3.0 * m - 1.0 - 5.0 * k * k)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steady acceleration of everything, with turns through more than half a circle.
    fn steady(frame: usize) -> Vec<f64> {
        let t = frame as f64;
        let turn = DQuat::from_axis_angle(DVec3::Y, 0.3 * t);
        let mut pose: Vec<f64> =
            (0..12).map(|k| 0.1 * k as f64 + 0.02 * t + 0.001 * k as f64 * t * t).collect();
        pose[3..6].copy_from_slice(&rotation_vector(turn).to_array());
        pose
    }

    fn rotation_of(pose: &[f64]) -> DQuat {
        DQuat::from_scaled_axis(DVec3::from_slice(&pose[3..6]))
    }

    #[test]
    fn steady_acceleration_passes_unchanged() {
        let poses: Vec<Vec<f64>> = (0..30).map(steady).collect();
        for (found, pose) in smoothed(&poses, &|_| true, &RefineConfig::default()).iter().zip(&poses) {
            assert!(rotation_of(found).angle_between(rotation_of(pose)) < 1e-6);
            for k in (0..3).chain(6..12) {
                assert!((found[k] - pose[k]).abs() < 1e-12, "{} {}", found[k], pose[k]);
            }
        }
    }

    #[test]
    fn trembling_shrinks_and_what_a_jump_parts_stays_apart() {
        let mut poses: Vec<Vec<f64>> =
            (0..24).map(|frame| vec![if frame % 2 == 0 { 0.02 } else { -0.02 }; 8]).collect();
        // Exported elsewhere from frame 12 on.
        poses[12..].iter_mut().for_each(|pose| pose[0] += 7.0);
        let found = smoothed(&poses, &|frame| frame != 11, &RefineConfig::default());
        for frame in [5, 6, 17, 18] {
            assert!(found[frame][7].abs() < 0.01, "{found:?}");
        }
        for (found, pose) in found.iter().zip(&poses) {
            assert!((found[0] - pose[0]).abs() < 0.05, "{found:?}");
        }
    }

    #[test]
    fn what_is_too_fast_for_the_frame_rate_stays() {
        let poses: Vec<Vec<f64>> = (0..11).map(|frame| vec![if frame == 5 { 1.5 } else { 0.0 }; 8]).collect();
        assert_eq!(smoothed(&poses, &|_| true, &RefineConfig::default())[5], poses[5]);
    }

    #[test]
    fn weights_are_those_of_the_tables() {
        let expected = [-3.0, 12.0, 17.0, 12.0, -3.0].map(|weight| weight / 35.0);
        for (weight, expected) in parabola_weights(2).iter().zip(expected) {
            assert!((weight - expected).abs() < 1e-15);
        }
        assert_eq!(parabola_weights(0), [1.0]);
    }
}
