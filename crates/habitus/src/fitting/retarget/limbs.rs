//! The lines of a body whose directions follow the captured ones, and the small fit of one frame.

use glam::{DMat3, DQuat, DVec3};
use habitus_optimize::{Objective, Sink, Wanted};

use super::floor::Floor;
use super::roles::{CapturedBody, Role};
use super::{RetargetBody, RetargetError, RetargetSettings};
use crate::body::{BodyModel, Pose, PosedSkeleton, ROOT_LENGTH};

/// A point that rides on a bone.
#[derive(Clone, Copy, Debug)]
struct BonePoint {
    bone: usize,
    rest: DVec3,
}

impl BonePoint {
    fn posed(&self, posed: &PosedSkeleton) -> DVec3 {
        posed.rotations[self.bone] * self.rest + posed.translations[self.bone]
    }
}

/// From one point of the body to another.
#[derive(Clone, Copy, Debug)]
struct Line {
    kind: Kind,
    ends: [BonePoint; 2],
    captured: [Role; 2],
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Pelvis,
    Trunk,
    Shoulders,
    Limb,
    Foot,
    Hand,
    Head,
}

impl Line {
    fn rest_direction(&self) -> DVec3 {
        (self.ends[1].rest - self.ends[0].rest).normalize_or_zero()
    }
}

/// The lines of one body.
pub(super) struct Limbs {
    lines: Vec<Line>,
    hips: [BonePoint; 2],
    pub(super) leg_length: f64,
}

impl Limbs {
    pub(super) fn of(model: &BodyModel, rest: &[DVec3], joints: &[DVec3]) -> Result<Self, RetargetError> {
        let bone = |name: &'static str| {
            let found = model.skeleton().bones().iter().position(|bone| bone.name == name);
            found.ok_or(RetargetError::BoneMissing { bone: name })
        };
        let on = |bone: usize, rest: DVec3| BonePoint { bone, rest };
        let (pelvis, thorax, head) = (bone("pelvis")?, bone("thorax")?, bone("head")?);
        let middle_of_hips = (joints[bone("left_thigh")?] + joints[bone("right_thigh")?]) * 0.5;
        let hips = ["left_thigh", "right_thigh"].map(|name| bone(name).map(|hip| on(pelvis, joints[hip])));
        let [left_hip, right_hip] = hips;
        let hips = [left_hip?, right_hip?];
        let shoulder = |name| bone(name).map(|shoulder| on(thorax, joints[shoulder]));
        let line = |kind, ends, captured| Line { kind, ends, captured };
        let mut lines = vec![
            line(Kind::Pelvis, [hips[1], hips[0]], [Role::RightHip, Role::LeftHip]),
            line(
                Kind::Trunk,
                [on(pelvis, middle_of_hips), on(thorax, joints[head])],
                [Role::LeftHip, Role::Neck],
            ),
            line(
                Kind::Shoulders,
                [shoulder("right_upper_arm")?, shoulder("left_upper_arm")?],
                [Role::RightShoulder, Role::LeftShoulder],
            ),
            line(
                Kind::Head,
                [on(head, joints[head]), on(head, joints[head] + DVec3::Y)],
                [Role::Neck, Role::Head],
            ),
        ];
        let toe = |name: &str| {
            let landmark = model.metadata().landmarks.iter().position(|landmark| landmark == name);
            landmark.map(|landmark| rest[model.landmark_vertices()[landmark] as usize])
        };
        let chains = [
            (["left_thigh", "left_shank", "left_foot"], toe("left_toe"), LEFT_LEG, Kind::Foot),
            (["right_thigh", "right_shank", "right_foot"], toe("right_toe"), RIGHT_LEG, Kind::Foot),
            (["left_upper_arm", "left_forearm", "left_hand"], None, LEFT_ARM, Kind::Hand),
            (["right_upper_arm", "right_forearm", "right_hand"], None, RIGHT_ARM, Kind::Hand),
        ];
        for (names, end, roles, last_kind) in chains {
            let [upper, lower, last] = [bone(names[0])?, bone(names[1])?, bone(names[2])?];
            let end = end.unwrap_or_else(|| middle_of_bone(model, rest, last, joints[last]));
            let ends = [
                (upper, joints[lower], Kind::Limb),
                (lower, joints[last], Kind::Limb),
                (last, end, last_kind),
            ];
            for ((bone, end, kind), roles) in ends.into_iter().zip(roles.windows(2)) {
                lines.push(line(kind, [on(bone, joints[bone]), on(bone, end)], [roles[0], roles[1]]));
            }
        }
        let legs = lines.iter().filter(|line| {
            line.kind == Kind::Limb && matches!(line.captured[1], Role::LeftKnee | Role::LeftAnkle)
        });
        let leg_length = legs.map(|line| line.ends[0].rest.distance(line.ends[1].rest)).sum();
        Ok(Self { lines, hips, leg_length })
    }

    pub(super) fn middle_of_hips(&self, posed: &PosedSkeleton) -> DVec3 {
        (self.hips[0].posed(posed) + self.hips[1].posed(posed)) * 0.5
    }

    /// Direction that each line should have in each frame; none where the motion does not show it.
    pub(super) fn directions(
        &self,
        captured: &CapturedBody,
        floor: &Floor,
        settings: &RetargetSettings,
    ) -> Vec<Vec<Option<DVec3>>> {
        let mut columns: Vec<Vec<Option<DVec3>>> = Vec::with_capacity(self.lines.len());
        for line in &self.lines {
            let raw = (0..captured.frame_count()).map(|frame| raw_direction(line, captured, frame));
            let raw: Vec<Option<DVec3>> = raw.collect();
            columns.push(match line.kind {
                Kind::Foot => level_feet(line, raw, floor),
                Kind::Head => look_ahead(raw, captured),
                _ => raw,
            });
        }
        let is_used = |line: &Line| weight(line.kind, settings) > 0.0;
        (0..captured.frame_count())
            .map(|frame| {
                let lines = self.lines.iter().zip(&columns);
                lines.map(|(line, column)| column[frame].filter(|_| is_used(line))).collect()
            })
            .collect()
    }
}

const LEFT_LEG: [Role; 4] = [Role::LeftHip, Role::LeftKnee, Role::LeftAnkle, Role::LeftToe];
const RIGHT_LEG: [Role; 4] = [Role::RightHip, Role::RightKnee, Role::RightAnkle, Role::RightToe];
const LEFT_ARM: [Role; 4] = [Role::LeftShoulder, Role::LeftElbow, Role::LeftWrist, Role::LeftHand];
const RIGHT_ARM: [Role; 4] = [Role::RightShoulder, Role::RightElbow, Role::RightWrist, Role::RightHand];

fn weight(kind: Kind, settings: &RetargetSettings) -> f64 {
    match kind {
        Kind::Pelvis => settings.pelvis,
        Kind::Trunk => settings.trunk,
        Kind::Shoulders => settings.shoulders,
        Kind::Limb => settings.limbs,
        Kind::Foot => settings.feet,
        Kind::Hand => settings.hands,
        Kind::Head => settings.head,
    }
}

fn middle_of_bone(model: &BodyModel, rest: &[DVec3], bone: usize, otherwise: DVec3) -> DVec3 {
    let bones = model.dominant_bones();
    let own = rest.iter().zip(&bones).filter(|(_, owner)| **owner == bone);
    let (sum, count) = own.fold((DVec3::ZERO, 0.0), |(sum, count), (place, _)| (sum + *place, count + 1.0));
    if count > 0.0 { sum / count } else { otherwise }
}

fn raw_direction(line: &Line, captured: &CapturedBody, frame: usize) -> Option<DVec3> {
    let from = match line.kind {
        Kind::Trunk => Some(captured.middle_of_hips(frame)),
        _ => captured.find(frame, line.captured[0]),
    };
    (captured.find(frame, line.captured[1])? - from?).try_normalize()
}

/// A captured foot's line starts and ends at other heights of the foot than ours: what it shows when the foot stands is
/// level, whatever its slope.
fn level_feet(line: &Line, raw: Vec<Option<DVec3>>, floor: &Floor) -> Vec<Option<DVec3>> {
    let slope = |direction: DVec3| direction.y.clamp(-1.0, 1.0).asin();
    let is_left = line.captured[1] == Role::LeftToe;
    let standing = raw.iter().enumerate().filter(|(frame, _)| floor.stands(*frame, is_left));
    let slopes: Vec<f64> = standing.filter_map(|(_, direction)| direction.map(slope)).collect();
    let all = || raw.iter().filter_map(|direction| direction.map(slope)).collect();
    let slopes = if slopes.is_empty() { all() } else { slopes };
    let Some(level) = super::roles::median(slopes) else { return raw };
    let correction = slope(line.rest_direction()) - level;
    let turned = raw.into_iter().map(|direction| {
        let direction = direction?;
        let side = direction.cross(DVec3::Y).try_normalize()?;
        Some(DQuat::from_axis_angle(side, correction) * direction)
    });
    turned.collect()
}

/// Where a captured head begins and ends differs from file to file: on average it is upright between the shoulders.
fn look_ahead(raw: Vec<Option<DVec3>>, captured: &CapturedBody) -> Vec<Option<DVec3>> {
    let trunks: Vec<DMat3> = (0..captured.frame_count()).map(|frame| trunk(captured, frame)).collect();
    let local = raw.iter().zip(&trunks).filter_map(|(raw, trunk)| raw.map(|raw| trunk.transpose() * raw));
    let Some(mean) = local.sum::<DVec3>().try_normalize() else { return raw };
    let correction = DQuat::from_rotation_arc(mean, DVec3::Y);
    let turned = raw.iter().zip(&trunks);
    turned.map(|(raw, trunk)| raw.map(|raw| *trunk * (correction * (trunk.transpose() * raw)))).collect()
}

/// Axes of the trunk: left, along it, forwards.
fn trunk(captured: &CapturedBody, frame: usize) -> DMat3 {
    let along = captured.place(frame, Role::Neck) - captured.middle_of_hips(frame);
    let along = along.try_normalize().unwrap_or(DVec3::Y);
    let left = captured.place(frame, Role::LeftShoulder) - captured.place(frame, Role::RightShoulder);
    let left = (left - along * left.dot(along)).try_normalize();
    let left = left.unwrap_or_else(|| along.any_orthonormal_vector());
    DMat3::from_cols(left, along, left.cross(along))
}

/// One frame: Σ weight ‖direction of a line − the captured one‖², and weak pulls to rest and to the frame before.
pub(super) struct DirectionFit<'a> {
    body: &'a RetargetBody<'a>,
    wanted: &'a [Option<DVec3>],
    last: &'a Pose,
    settings: &'a RetargetSettings,
}

impl<'a> DirectionFit<'a> {
    pub(super) fn new(
        body: &'a RetargetBody<'a>,
        wanted: &'a [Option<DVec3>],
        last: &'a Pose,
        settings: &'a RetargetSettings,
    ) -> Self {
        Self { body, wanted, last, settings }
    }
}

impl Objective for DirectionFit<'_> {
    fn parameter_count(&self) -> usize {
        self.last.parameters().len()
    }

    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
        let skeleton = self.body.model.skeleton();
        let posed = skeleton.pose(&self.body.joints, parameters);
        let with_derivatives = sink.wanted() > Wanted::Value;
        sink.begin_part("directions");
        for (line, wanted) in self.body.limbs.lines.iter().zip(self.wanted) {
            let Some(wanted) = wanted else { continue };
            let scale = 1.0 / line.ends[0].rest.distance(line.ends[1].rest).max(1e-6);
            let [from, to] = line.ends.map(|end| end.posed(&posed));
            let residual = (to - from) * scale - *wanted;
            let mut columns = Vec::new();
            let mut jacobian = Vec::new();
            if with_derivatives {
                // The chain of one end of each line contains that of the other, except for the trunk's, which starts
                // at the pelvis: the thorax' chain contains the pelvis', too.
                columns.extend_from_slice(skeleton.chain(line.ends[1].bone));
                let derivative = |parameter: &usize| {
                    let twist = &posed.twists[*parameter];
                    let start = skeleton.chain(line.ends[0].bone).contains(parameter);
                    (twist.at(to) - if start { twist.at(from) } else { DVec3::ZERO }) * scale
                };
                let derivatives: Vec<DVec3> = columns.iter().map(derivative).collect();
                for axis in 0..3 {
                    jacobian.extend(derivatives.iter().map(|derivative| derivative[axis]));
                }
            }
            sink.add(weight(line.kind, self.settings), &residual.to_array(), &columns, &jacobian);
        }
        sink.begin_part("pulls");
        let last = self.last.parameters();
        for (parameter, value) in parameters.iter().enumerate() {
            let pulls = if parameter < 3 {
                // Directions do not see where the body is.
                [(1.0, last[parameter]), (0.0, 0.0)]
            } else if parameter < ROOT_LENGTH {
                [(0.0, 0.0); 2]
            } else {
                [(self.settings.smoothness, last[parameter]), (self.settings.rest, 0.0)]
            };
            for (weight, target) in pulls.into_iter().filter(|(weight, _)| *weight > 0.0) {
                sink.add(
                    weight,
                    &[value - target],
                    if with_derivatives { std::slice::from_ref(&parameter) } else { &[] },
                    if with_derivatives { &[1.0] } else { &[] },
                );
            }
        }
    }
}

#[cfg(test)]
impl Limbs {
    /// Where the last line of a bone ends, rest space.
    pub(super) fn end_of(&self, bone: usize) -> DVec3 {
        self.lines.iter().rev().find(|line| line.ends[1].bone == bone).unwrap().ends[1].rest
    }
}
