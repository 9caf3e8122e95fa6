//! Where the fit happens: metres, y up, centred on the first frame and turned to its own horizontal axes.

use glam::{DMat3, DQuat, DVec3};
use habitus_geometry::Surface;
use serde::{Deserialize, Serialize};

use super::FitSequenceError;
use super::captured_frame::{FitFromInput, bounds_of, size_of};
use super::config::{FitSequenceConfig, UnitChoice, UpChoice};
use crate::artifacts::fitted_sequence::InputFrame;
use crate::artifacts::frames::FrameSource;
use crate::body::rotation_vector;

/// How the input lies and what unit it has.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Orientation {
    pub metres_per_unit: f64,
    /// From the input's axes to y up.
    pub internal_from_input: DMat3,
    #[serde(with = "fit_from_input_form")]
    pub fit_from_input: FitFromInput,
    pub is_certain: bool,
    pub report: Vec<String>,
}

mod fit_from_input_form {
    use super::FitFromInput;
    use glam::{DMat3, DVec3};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(value: &FitFromInput, serializer: S) -> Result<S::Ok, S::Error> {
        (value.scale, value.rotation, value.translation, value.usual_size).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<FitFromInput, D::Error> {
        let (scale, rotation, translation, usual_size) =
            <(f64, DMat3, DVec3, f64)>::deserialize(deserializer)?;
        Ok(FitFromInput { scale, rotation, translation, usual_size })
    }
}

/// A rigid motion `rotation · x + translation`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub rotation: DMat3,
    pub translation: DVec3,
}

impl Motion {
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }
}

impl Orientation {
    /// From the fit's coordinates to metres, y up, in the input's place.
    pub fn internal_from_fit(&self) -> Motion {
        let back = self.fit_from_input.rotation.transpose();
        let rotation = self.internal_from_input * back;
        Motion { rotation, translation: -(rotation * self.fit_from_input.translation) }
    }

    pub fn input_frame(&self) -> InputFrame {
        InputFrame {
            metres_per_unit: self.metres_per_unit,
            internal_from_input: self.internal_from_input,
            report: self.report.clone(),
        }
    }
}

/// Moves a posed body rigidly by changing its root: posed = R (v − j) + j + t for the root joint j.
pub(super) fn move_root(pose: &mut [f64], root_joint: DVec3, motion: &Motion) {
    let rotation = DQuat::from_scaled_axis(DVec3::from_slice(&pose[3..6]));
    let translation = DVec3::from_slice(&pose[..3]);
    let moved = DQuat::from_mat3(&motion.rotation) * rotation;
    let joint = motion.apply(root_joint + translation);
    pose[..3].copy_from_slice(&(joint - root_joint).to_array());
    pose[3..6].copy_from_slice(&rotation_vector(moved).to_array());
}

/// Extents along an axis below this share of the longest cannot be a standing person's height in any frame.
const SHORTEST_HEIGHT_SHARE: f64 = 0.75;
/// Frames that are read to find unit and up axis.
const PROBE_FRAMES: usize = 5;

/// Unit and candidates for the orientation, most likely first; the start search decides among them.
pub(super) fn candidates(
    source: &dyn FrameSource,
    config: &FitSequenceConfig,
) -> Result<Vec<Orientation>, FitSequenceError> {
    let (probes, usual_size) = probe(source)?;
    let longest = DVec3::AXES.into_iter().map(|axis| extents(&probes, axis)).fold(0.0, f64::max);
    let (metres_per_unit, unit_is_certain, unit_report) = unit(config.unit, longest);
    let ups: Vec<DVec3> = match config.up {
        UpChoice::X => vec![DVec3::X],
        UpChoice::Y => vec![DVec3::Y],
        UpChoice::Z => vec![DVec3::Z],
        UpChoice::Auto => [DVec3::Y, DVec3::Z, DVec3::X]
            .into_iter()
            .filter(|axis| extents(&probes, *axis) >= SHORTEST_HEIGHT_SHARE * longest)
            .flat_map(|axis| [axis, -axis])
            .collect(),
    };
    Ok(ups
        .into_iter()
        .map(|up| {
            let report = vec![unit_report.clone(), format!("up is {}", axis_name(up))];
            let mut found = orientation(&probes[0], metres_per_unit, up, unit_is_certain, report);
            found.fit_from_input.usual_size = usual_size;
            found
        })
        .collect())
}

fn orientation(
    first: &[DVec3],
    metres_per_unit: f64,
    up: DVec3,
    is_certain: bool,
    report: Vec<String>,
) -> Orientation {
    let internal_from_input = DMat3::from_quat(DQuat::from_rotation_arc(up, DVec3::Y));
    let internal: Vec<DVec3> =
        first.iter().map(|point| internal_from_input * *point * metres_per_unit).collect();
    let count = internal.len().max(1) as f64;
    let center = internal.iter().copied().sum::<DVec3>() / count;
    let (mut xx, mut xz, mut zz) = (0.0, 0.0, 0.0);
    for point in &internal {
        let d = *point - center;
        xx += d.x * d.x;
        xz += d.x * d.z;
        zz += d.z * d.z;
    }
    let yaw = 0.5 * (2.0 * xz).atan2(xx - zz);
    // Turns the widest horizontal direction onto x. Variances know it up to half a turn; the side to which the capture
    // is skewed decides, so that every heading gives the same numbers.
    let axis = DVec3::new(yaw.cos(), 0.0, yaw.sin());
    let skewness: f64 = internal.iter().map(|point| (*point - center).dot(axis).powi(3)).sum();
    let half_turn = if skewness < 0.0 { std::f64::consts::PI } else { 0.0 };
    let turn = DMat3::from_rotation_y(yaw + half_turn);
    let rotation = turn * internal_from_input;
    Orientation {
        metres_per_unit,
        internal_from_input,
        fit_from_input: FitFromInput {
            scale: metres_per_unit,
            rotation,
            translation: -(turn * center),
            usual_size: f64::NAN,
        },
        is_certain,
        report,
    }
}

/// Points of some frames, the first readable one first, and the median of their sizes.
fn probe(source: &dyn FrameSource) -> Result<(Vec<Vec<DVec3>>, f64), FitSequenceError> {
    let count = source.len();
    let mut probes = Vec::new();
    let mut sizes = Vec::new();
    let mut first_error = None;
    for frame in 0..count {
        // The first readable frame sets the coordinates; later ones are spread over the sequence.
        if !probes.is_empty() && frame % (count / PROBE_FRAMES).max(1) != 0 {
            continue;
        }
        match source.surface(frame) {
            Ok(surface) => {
                sizes.push(size_of(&surface));
                probes.push(points_of(&surface));
            }
            Err(error) => {
                first_error.get_or_insert(error);
            }
        }
    }
    sizes.sort_by(f64::total_cmp);
    match (probes.is_empty(), first_error) {
        (false, _) => Ok((probes, sizes[sizes.len() / 2])),
        (true, Some(error)) => Err(error.into()),
        (true, None) => Err(FitSequenceError::NoUsableFrame),
    }
}

fn points_of(surface: &Surface) -> Vec<DVec3> {
    match surface {
        Surface::Mesh(mesh) => mesh.faces().iter().map(|face| mesh.positions()[face[0] as usize]).collect(),
        Surface::Cloud(cloud) => cloud.positions().to_vec(),
    }
}

/// Median over frames of the extent along an axis.
fn extents(probes: &[Vec<DVec3>], axis: DVec3) -> f64 {
    let mut lengths: Vec<f64> = probes
        .iter()
        .map(|points| {
            let [low, high] = bounds_of(points);
            (high - low).dot(axis.abs())
        })
        .collect();
    lengths.sort_by(f64::total_cmp);
    lengths[lengths.len() / 2]
}

fn unit(choice: UnitChoice, longest: f64) -> (f64, bool, String) {
    match choice {
        UnitChoice::M => (1.0, true, "unit is metres, as told".into()),
        UnitChoice::Cm => (0.01, true, "unit is centimetres, as told".into()),
        UnitChoice::Mm => (0.001, true, "unit is millimetres, as told".into()),
        UnitChoice::Auto => {
            // A crouching or reaching person spans 0.8 to 2.6 m.
            let known = [(1.0, "metres"), (0.01, "centimetres"), (0.001, "millimetres")];
            for (metres, name) in known {
                let span = longest * metres;
                if (0.8..=2.6).contains(&span) {
                    let report = format!("unit guessed as {name}: the capture spans {span:.2} m");
                    return (metres, true, report);
                }
            }
            let report = format!(
                "unit is uncertain: the capture spans {longest:.4} units, which is no person in m, cm or mm; \
                 metres are assumed, use --unit to say otherwise"
            );
            (1.0, false, report)
        }
    }
}

fn axis_name(up: DVec3) -> &'static str {
    match up.to_array() {
        [x, _, _] if x > 0.5 => "+x",
        [x, _, _] if x < -0.5 => "-x",
        [_, y, _] if y > 0.5 => "+y",
        [_, y, _] if y < -0.5 => "-y",
        [_, _, z] if z > 0.0 => "+z",
        _ => "-z",
    }
}
