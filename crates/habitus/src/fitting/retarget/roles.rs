//! Which captured joint is which place of the body: the names that are in use.

use glam::{DMat3, DVec3};

use super::{RetargetError, UpAxis};
use crate::artifacts::motion_files::JointMotion;

/// A place of the body that directions are taken between.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub(super) enum Role {
    LeftHip,
    LeftKnee,
    LeftAnkle,
    LeftToe,
    RightHip,
    RightKnee,
    RightAnkle,
    RightToe,
    Neck,
    Head,
    LeftShoulder,
    LeftElbow,
    LeftWrist,
    LeftHand,
    RightShoulder,
    RightElbow,
    RightWrist,
    RightHand,
}

const ROLE_COUNT: usize = 18;

/// What a role is called in messages and in files, best name first; `*` stands for the side, in front or behind.
///
/// Our own bones, Mixamo and Unity, CMU's BVH and ASF, Bandai-Namco's, LAFAN's and AMASS's joints.
const NAMES: [(Role, &str, &[&str]); 10] = [
    (Role::LeftHip, "hip", &["*upleg", "*thigh", "upperleg*", "*upperleg", "*femur", "*hip"]),
    (
        Role::LeftKnee,
        "knee",
        &["*leg", "*shank", "lowerleg*", "*lowerleg", "*lowleg", "*tibia", "*shin", "*calf", "*knee"],
    ),
    (Role::LeftAnkle, "ankle", &["*ankle", "*foot", "foot*"]),
    (Role::LeftToe, "toes", &["*toebase", "*toe", "*toes", "toes*", "toe*", "*foot", "*footend"]),
    (Role::Neck, "neck", &["neck", "neck1", "lowerneck", "head"]),
    (Role::Head, "head", &["head", "headend", "upperneck"]),
    (Role::LeftShoulder, "shoulder", &["*arm", "*upperarm", "upperarm*", "*uparm", "*humerus", "*shoulder"]),
    (Role::LeftElbow, "elbow", &["*forearm", "lowerarm*", "*lowerarm", "*lowarm", "*radius", "*elbow"]),
    (Role::LeftWrist, "wrist", &["*hand", "hand*", "*wrist"]),
    (
        Role::LeftHand,
        "end of the hand",
        &["*fingers", "*handmiddle1", "*middle1", "*handend", "hand*end", "*wristend"],
    ),
];

/// Places of one body over time.
pub(super) struct CapturedBody {
    joints: [Option<usize>; ROLE_COUNT],
    positions: Vec<Vec<DVec3>>,
}

impl CapturedBody {
    /// Finds the places by the joints' names.
    pub(super) fn of(motion: &JointMotion) -> Result<Self, RetargetError> {
        let names: Vec<String> = motion.joints.iter().map(|joint| plain(&joint.name)).collect();
        let mut joints = [None; ROLE_COUNT];
        for (role, word, patterns) in NAMES {
            let sides: &[(usize, [&str; 2])] = if matches!(role, Role::Neck | Role::Head) {
                &[(0, ["", ""])]
            } else {
                &[(0, ["left", "l"]), (RIGHT_AFTER_LEFT[role as usize], ["right", "r"])]
            };
            for (shift, side) in sides {
                let slot = role as usize + shift;
                if joints[slot].is_some() {
                    continue;
                }
                let taken = joints;
                joints[slot] = patterns
                    .iter()
                    .flat_map(|pattern| side.map(|side| pattern.replace('*', side)))
                    .filter_map(|wanted| names.iter().position(|name| *name == wanted))
                    .find(|found| !taken.contains(&Some(*found)));
                let is_needed = !matches!(role, Role::Head | Role::LeftHand | Role::LeftToe);
                if joints[slot].is_none() && is_needed {
                    let found: Vec<&str> = motion.joints.iter().map(|joint| joint.name.as_str()).collect();
                    return Err(RetargetError::JointMissing {
                        motion: motion.name.clone(),
                        role: word,
                        example: patterns.first().copied().unwrap_or_default(),
                        found: found.join(", "),
                    });
                }
            }
        }
        Ok(Self { joints, positions: motion.positions.clone() })
    }

    pub(super) fn frame_count(&self) -> usize {
        self.positions.len()
    }

    /// Position of a place that every motion has.
    pub(super) fn place(&self, frame: usize, role: Role) -> DVec3 {
        self.find(frame, role).unwrap_or(DVec3::ZERO)
    }

    /// Position of a place, if the motion has it.
    pub(super) fn find(&self, frame: usize, role: Role) -> Option<DVec3> {
        self.joints[role as usize].map(|joint| self.positions[frame][joint])
    }

    pub(super) fn middle_of_hips(&self, frame: usize) -> DVec3 {
        (self.place(frame, Role::LeftHip) + self.place(frame, Role::RightHip)) * 0.5
    }

    /// Turns all positions so that y points up.
    pub(super) fn turn_up(&mut self, up: UpAxis) {
        let trunk: DVec3 = (0..self.frame_count())
            .map(|frame| (self.place(frame, Role::Neck) - self.middle_of_hips(frame)).normalize_or_zero())
            .sum();
        let is_z_up = match up {
            UpAxis::Found => trunk.z.abs() > trunk.y.abs(),
            UpAxis::Y => false,
            UpAxis::Z => true,
        };
        if is_z_up {
            let turn = DMat3::from_rotation_x(-std::f64::consts::FRAC_PI_2);
            for position in self.positions.iter_mut().flatten() {
                *position = turn * *position;
            }
        }
    }

    /// From hip to ankle along the bones: median over frames, mean of both sides, in the file's unit.
    pub(super) fn leg_length(&self) -> f64 {
        let lengths = (0..self.frame_count()).map(|frame| {
            let length = |from: Role, to: Role| self.place(frame, from).distance(self.place(frame, to));
            let left = length(Role::LeftHip, Role::LeftKnee) + length(Role::LeftKnee, Role::LeftAnkle);
            let right = length(Role::RightHip, Role::RightKnee) + length(Role::RightKnee, Role::RightAnkle);
            (left + right) * 0.5
        });
        median(lengths.collect()).unwrap_or(0.0)
    }

    pub(super) fn scale(&mut self, factor: f64) {
        for position in self.positions.iter_mut().flatten() {
            *position *= factor;
        }
    }
}

/// From a left role to its right one.
const RIGHT_AFTER_LEFT: [usize; ROLE_COUNT] = [4, 4, 4, 4, 0, 0, 0, 0, 0, 0, 4, 4, 4, 4, 0, 0, 0, 0];

/// A name without what differs between programs: prefixes such as `mixamorig:`, case, separators.
fn plain(name: &str) -> String {
    let name = name.rsplit(':').next().unwrap_or(name);
    let plain: String = name.chars().filter(|c| c.is_ascii_alphanumeric()).collect();
    plain.to_ascii_lowercase()
}

/// The middle value of a list.
pub(super) fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let (_, value, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifacts::motion_files::CapturedJoint;
    use crate::artifacts::rigged_sequence::FrameRate;

    fn motion(names: &[&str]) -> JointMotion {
        JointMotion {
            name: "take".into(),
            joints: names.iter().map(|name| CapturedJoint { name: (*name).into(), parent: None }).collect(),
            frame_rate: FrameRate::new(30.0).unwrap(),
            positions: vec![(0..names.len()).map(|k| DVec3::splat(k as f64)).collect()],
        }
    }

    /// Names in the order of the roles.
    const CONVENTIONS: [[&str; ROLE_COUNT]; 4] = [
        [
            "LeftUpLeg",
            "LeftLeg",
            "LeftFoot",
            "LeftToeBase",
            "RightUpLeg",
            "RightLeg",
            "RightFoot",
            "RightToeBase",
            "Neck",
            "Head",
            "LeftArm",
            "LeftForeArm",
            "LeftHand",
            "LeftHand_End",
            "RightArm",
            "RightForeArm",
            "RightHand",
            "RightHand_End",
        ],
        [
            "UpperLeg_L",
            "LowerLeg_L",
            "Foot_L",
            "Toes_L",
            "UpperLeg_R",
            "LowerLeg_R",
            "Foot_R",
            "Toes_R",
            "Neck",
            "Head",
            "UpperArm_L",
            "LowerArm_L",
            "Hand_L",
            "Hand_L_end",
            "UpperArm_R",
            "LowerArm_R",
            "Hand_R",
            "Hand_R_end",
        ],
        [
            "lfemur",
            "ltibia",
            "lfoot",
            "ltoes",
            "rfemur",
            "rtibia",
            "rfoot",
            "rtoes",
            "lowerneck",
            "head",
            "lhumerus",
            "lradius",
            "lhand",
            "lfingers",
            "rhumerus",
            "rradius",
            "rhand",
            "rfingers",
        ],
        [
            "left_hip",
            "left_knee",
            "left_ankle",
            "left_foot",
            "right_hip",
            "right_knee",
            "right_ankle",
            "right_foot",
            "neck",
            "head",
            "left_shoulder",
            "left_elbow",
            "left_wrist",
            "left_wrist_end",
            "right_shoulder",
            "right_elbow",
            "right_wrist",
            "right_wrist_end",
        ],
    ];

    #[test]
    fn every_convention_has_its_own_names_for_the_same_places() {
        for names in CONVENTIONS {
            let body = CapturedBody::of(&motion(&names)).unwrap();
            let found: Vec<Option<usize>> = body.joints.to_vec();
            let expected: Vec<Option<usize>> = (0..ROLE_COUNT).map(Some).collect();
            assert_eq!(found, expected, "{names:?}");
        }
    }

    #[test]
    fn a_missing_joint_is_named_with_what_is_there() {
        let names: Vec<&str> = CONVENTIONS[0].into_iter().filter(|name| *name != "RightLeg").collect();
        let error = CapturedBody::of(&motion(&names)).err().unwrap().to_string();
        assert!(error.contains("knee") && error.contains("LeftUpLeg, LeftLeg"), "{error}");
    }
}
