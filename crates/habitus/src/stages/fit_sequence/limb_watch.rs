//! Whether a limb has gone astray: away from the capture, or into the trunk, where it costs next to nothing.

use glam::DVec3;

use super::body_levels::PreparedIdentity;
use super::captured_frame::CapturedFrame;
use super::clothed_surface::{is_extremity_missing, uncovered_limb_share};
use super::config::CodeThresholds;
use crate::body::{PosedSkeleton, Skeleton};
use crate::fitting::correspondence::ClosestField;

/// Vertices of a posed body with their normals, in any selection that covers it evenly.
pub(super) struct SpreadBody<'a> {
    pub vertices: &'a [DVec3],
    pub normals: &'a [DVec3],
    /// For each of them its heaviest bone.
    pub bones: &'a [u8],
}

/// Whether a part of the body is away from the capture, a limb of the capture from the body, or a limb of the body inside
/// its trunk.
pub(super) fn has_lost_a_limb(
    body: &PreparedIdentity<'_>,
    posed: &PosedSkeleton,
    field: &ClosestField,
    frame: &CapturedFrame,
    spread: &SpreadBody<'_>,
    codes: &CodeThresholds,
) -> bool {
    is_extremity_missing(body.level, field, codes.missing_distance, codes.missing_share)
        || uncovered_limb_share(frame, spread.vertices, codes.limb_distance) > codes.uncovered_limb_share
        || is_limb_inside_trunk(body.level.surface.skeleton(), posed, spread, codes.limb_depth)
}

/// Whether a forearm or a shank runs `depth` or deeper inside the trunk. Its bone is in the middle of it, so that an arm
/// that merely rests on the body is far from that.
fn is_limb_inside_trunk(
    skeleton: &Skeleton,
    posed: &PosedSkeleton,
    spread: &SpreadBody<'_>,
    depth: f64,
) -> bool {
    /// Where along the bone it is looked at; two of them must be inside.
    const PLACES: [f64; 3] = [0.3, 0.6, 0.9];
    /// Between the way to the nearest vertex and its normal.
    const LEAST_COSINE: f64 = 0.7;
    let bones = skeleton.bones();
    let children = |bone: usize| bones.iter().filter(|other| other.parent == Some(bone)).count();
    let is_trunk: Vec<bool> = (0..bones.len()).map(|bone| children(bone) > 1).collect();
    let is_inside = |point: DVec3| {
        (0..spread.vertices.len())
            .filter(|vertex| is_trunk[usize::from(spread.bones[*vertex])])
            .map(|vertex| (point.distance_squared(spread.vertices[vertex]), vertex))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .is_some_and(|(squared, vertex)| {
                // Under the nearest vertex, and not merely behind the plane of one that is far away at the trunk's end.
                let under = (spread.vertices[vertex] - point).dot(spread.normals[vertex]);
                under > depth && under > LEAST_COSINE * squared.sqrt()
            })
    };
    (0..bones.len()).filter(|tip| children(*tip) == 0).any(|tip| {
        let Some(limb) = bones[tip].parent.filter(|limb| !is_trunk[*limb]) else { return false };
        let (from, to) = (posed.joints[limb], posed.joints[tip]);
        PLACES.iter().filter(|place| is_inside(from.lerp(to, **place))).count() > 1
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::{BodyModel, ROOT_LENGTH};
    use crate::stages::fit_sequence::body_levels::BodyLevel;

    #[test]
    fn an_arm_inside_the_trunk_is_seen_and_one_beside_or_before_it_is_not() {
        let model = BodyModel::default_space().expect("the embedded model");
        let level = BodyLevel::spread(&model, 700, 1);
        let body = PreparedIdentity::new(&model, &level, &[0.0]);
        let skeleton = level.surface.skeleton();
        let bone = |name: &str| skeleton.bones().iter().position(|bone| bone.name == name).expect("a bone");
        let axes_of = |bone: usize| -> Vec<usize> {
            (0..skeleton.axes().len()).filter(|axis| skeleton.axes()[*axis].bone == bone).collect()
        };
        let (arm, forearm) = (axes_of(bone("left_upper_arm")), axes_of(bone("left_forearm")));
        let inside = |pose: &[f64]| {
            let posed = body.posed(pose);
            let (vertices, normals) = body.vertices_and_normals(&posed);
            let spread = SpreadBody { vertices: &vertices, normals: &normals, bones: &level.main_bones };
            is_limb_inside_trunk(skeleton, &posed, &spread, CodeThresholds::default().limb_depth)
        };
        let rest = vec![0.0; skeleton.pose_length()];
        assert!(!inside(&rest));
        // Legs through all of their flexion: shanks far below the trunk are behind the planes of some of its vertices.
        let (thigh, shank) = (axes_of(bone("left_thigh"))[0], axes_of(bone("left_shank"))[0]);
        for k in 0..64 {
            let mut pose = rest.clone();
            pose[ROOT_LENGTH + thigh] = -0.5 + 2.0 * f64::from(k / 8) / 7.0;
            pose[ROOT_LENGTH + shank] = 2.4 * f64::from(k % 8) / 7.0;
            assert!(!inside(&pose), "a false alarm at {pose:?}");
        }
        // Of many arm poses, that with the forearm's middle nearest to the middle of the trunk, and a few clear of it.
        let mut nearest = (f64::INFINITY, rest.clone());
        for k in 0..6_usize.pow(4) {
            let mut pose = rest.clone();
            let axes = [arm[0], arm[1], arm[2], forearm[0]];
            for (place, axis) in axes.into_iter().enumerate() {
                let [low, high] = skeleton.axes()[axis].limits;
                pose[ROOT_LENGTH + axis] =
                    low + (high - low) * (k / 6_usize.pow(place as u32) % 6) as f64 / 5.0;
            }
            let joints = body.posed(&pose).joints;
            let middle = joints[bone("left_forearm")].lerp(joints[bone("left_hand")], 0.6);
            let trunk = joints[bone("pelvis")].lerp(joints[bone("thorax")], 0.7);
            if middle.distance(trunk) < nearest.0 {
                nearest = (middle.distance(trunk), pose.clone());
            }
            let is_clear = [0.3, 0.6, 0.9].iter().all(|place| {
                let point = joints[bone("left_forearm")].lerp(joints[bone("left_hand")], *place);
                point.x > 0.35 || point.z > 0.3
            });
            assert!(!is_clear || !inside(&pose), "a false alarm at {pose:?}");
        }
        assert!(inside(&nearest.1), "the forearm's middle is {} m from that of the trunk", nearest.0);
    }
}
