//! How people stand in a scanner: an A-pose, each in their own way.

use glam::{DQuat, DVec3};
use habitus::body::{BodyModel, Pose};
use habitus::statistics::RandomStream;
use serde::{Deserialize, Serialize};

use crate::animate::posed_by_angles;
use crate::motion::{ArmAngles, LegAngles, Stance};

/// Standard deviations about the A-pose, degrees; each limb varies on its own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StanceSettings {
    /// Upper arms away from the body, smallest and largest, degrees.
    pub arm_abduction_deg: [f64; 2],
    /// Standard deviation between left and right arm and forwards, degrees.
    pub arm_spread_deg: f64,
    /// Bend of the elbows, smallest and largest, degrees.
    pub elbow_deg: [f64; 2],
    /// Standard deviation of twist, bend and bow of the trunk, degrees.
    pub trunk_spread_deg: f64,
    /// Thighs away from each other, smallest and largest for each leg, degrees.
    pub leg_abduction_deg: [f64; 2],
    /// Standard deviation of head, wrists, hips, knees and ankles, degrees.
    pub joint_spread_deg: f64,
    /// Largest turn from the scanner's front, degrees.
    pub heading_deg: f64,
    /// Largest offset from the scanner's middle, metres.
    pub offset: f64,
}

impl Default for StanceSettings {
    fn default() -> Self {
        Self {
            arm_abduction_deg: [18.0, 45.0],
            arm_spread_deg: 5.0,
            elbow_deg: [5.0, 30.0],
            trunk_spread_deg: 2.5,
            leg_abduction_deg: [4.0, 11.0],
            joint_spread_deg: 3.0,
            heading_deg: 180.0,
            offset: 0.15,
        }
    }
}

/// A standing pose with the soles on the floor (y = 0).
pub(super) fn standing_pose(
    model: &BodyModel,
    rest_vertices: &[DVec3],
    settings: &StanceSettings,
    random: &mut RandomStream,
) -> Pose {
    let degrees = |value: f64| value.to_radians();
    let abduction = random.between(settings.arm_abduction_deg[0], settings.arm_abduction_deg[1]);
    let mut arm = || ArmAngles {
        shoulder_flexion: degrees(random.normal() * settings.arm_spread_deg),
        shoulder_abduction: degrees(abduction + random.normal() * settings.arm_spread_deg),
        elbow_flexion: degrees(random.between(settings.elbow_deg[0], settings.elbow_deg[1])),
    };
    let arms = [arm(), arm()];
    let mut leg = || {
        let flexion = random.normal() * settings.joint_spread_deg;
        LegAngles {
            hip_flexion: degrees(flexion),
            hip_abduction: degrees(
                random.between(settings.leg_abduction_deg[0], settings.leg_abduction_deg[1]),
            ),
            knee_flexion: degrees((random.normal() * settings.joint_spread_deg).abs()),
            // The soles stay level with the floor, about.
            ankle_dorsiflexion: degrees(0.3 * random.normal() * settings.joint_spread_deg),
        }
    };
    let legs = [leg(), leg()];
    let stance = Stance {
        thorax_turn: degrees(random.normal() * settings.trunk_spread_deg),
        thorax_list: degrees(random.normal() * settings.trunk_spread_deg),
        thorax_flexion: degrees(random.normal() * settings.trunk_spread_deg),
        support: [1.0, 1.0],
        arms,
        legs,
        ..Stance::default()
    };
    let joints = model.joints(rest_vertices);
    let mut pose = posed_by_angles(model, &joints, &stance);
    let (lower, upper) = model.skeleton().pose_limits();
    let first_angle = pose.parameters().len() - model.skeleton().axes().len();
    for (index, axis) in model.skeleton().axes().iter().enumerate() {
        let is_free =
            ["neck", "wrist", "hip_twist", "shoulder_twist"].iter().any(|part| axis.name.contains(part));
        if is_free {
            let parameter = first_angle + index;
            let angle = &mut pose.parameters_mut()[parameter];
            *angle = (*angle + degrees(random.normal() * settings.joint_spread_deg))
                .clamp(lower[parameter], upper[parameter]);
        }
    }
    let heading =
        DQuat::from_rotation_y(degrees(random.between(-settings.heading_deg, settings.heading_deg)));
    let mut aside = || random.between(-settings.offset, settings.offset);
    let (x, z) = (aside(), aside());
    pose.set_root(heading, DVec3::ZERO);
    let posed = model.pose_vertices(rest_vertices, &model.skeleton().pose(&joints, pose.parameters()));
    let lowest = posed.iter().map(|vertex| vertex.y).fold(f64::INFINITY, f64::min);
    pose.set_root(heading, DVec3::new(x, -lowest, z));
    pose
}
