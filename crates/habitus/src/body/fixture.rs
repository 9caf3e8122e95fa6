//! A small jointed figure of closed elliptic tubes with known girths: the body of this crate's tests.
//!
//! Its statistics are made up; its joints, girths and volumes can be written down by hand.

use std::f64::consts::TAU;
use std::path::Path;

use glam::DVec3;
use half::f16;

use super::file;
use super::model::BodyModel;
use crate::artifacts::npz::NpzWriter;

/// Names of the bones, parents first.
const BONES: [&str; 15] = [
    "pelvis",
    "left_thigh",
    "left_shank",
    "left_foot",
    "right_thigh",
    "right_shank",
    "right_foot",
    "thorax",
    "head",
    "left_upper_arm",
    "left_forearm",
    "left_hand",
    "right_upper_arm",
    "right_forearm",
    "right_hand",
];
const PARENTS: [i32; 15] = [-1, 0, 1, 2, 0, 4, 5, 0, 7, 7, 9, 10, 7, 12, 13];
/// Axis names by bone; a bone has 1 or 3.
const AXES: [(usize, &str, &[&str]); 12] = [
    (1, "left_hip", &["flexion", "abduction", "rotation"]),
    (2, "left_knee", &["flexion"]),
    (3, "left_ankle", &["flexion"]),
    (4, "right_hip", &["flexion", "abduction", "rotation"]),
    (5, "right_knee", &["flexion"]),
    (6, "right_ankle", &["flexion"]),
    (7, "thorax", &["flexion", "bending", "rotation"]),
    (8, "neck", &["flexion"]),
    (9, "left_shoulder", &["flexion", "abduction", "rotation"]),
    (10, "left_elbow", &["flexion"]),
    (11, "left_wrist", &["flexion"]),
    (12, "right_shoulder", &["flexion", "abduction", "rotation"]),
];
const LAST_AXES: [(usize, &str); 2] = [(13, "right_elbow"), (14, "right_wrist")];

/// One tube of the figure: its axis and the half axes of its elliptic section, in metres.
#[derive(Clone, Copy)]
pub(crate) struct Tube {
    /// The bone that it belongs to.
    pub bone: usize,
    /// Start of its axis: the bone's joint, except for the pelvis.
    pub start: DVec3,
    /// End of its axis.
    pub end: DVec3,
    /// Half axes across: sideways, then front to back.
    pub half_axes: [f64; 2],
}

/// Tubes of the middle and of the left side; the right side is their mirror image.
pub(crate) const TUBES: [Tube; 9] = [
    tube(0, [0.0, 0.84, 0.0], [0.0, 1.06, 0.0], [0.16, 0.11]),
    tube(1, [0.09, 0.90, 0.0], [0.10, 0.50, 0.0], [0.075, 0.08]),
    tube(2, [0.10, 0.50, 0.0], [0.11, 0.09, 0.0], [0.05, 0.055]),
    tube(3, [0.11, 0.08, 0.0], [0.12, 0.04, 0.18], [0.04, 0.03]),
    tube(7, [0.0, 1.08, 0.0], [0.0, 1.44, 0.0], [0.17, 0.12]),
    tube(8, [0.0, 1.50, 0.0], [0.0, 1.68, 0.0], [0.075, 0.095]),
    tube(9, [0.20, 1.42, 0.0], [0.38, 1.18, 0.0], [0.045, 0.05]),
    tube(10, [0.38, 1.18, 0.0], [0.54, 0.97, 0.0], [0.035, 0.04]),
    tube(11, [0.54, 0.97, 0.0], [0.63, 0.85, 0.0], [0.02, 0.04]),
];

const fn tube(bone: usize, start: [f64; 3], end: [f64; 3], half_axes: [f64; 2]) -> Tube {
    Tube { bone, start: DVec3::from_array(start), end: DVec3::from_array(end), half_axes }
}

/// Stations along a tube's axis: two of each rounded end lie beyond 0…1 (in half axes, not in lengths).
const STATIONS: [f64; 7] = [0.0, 0.125, 0.25, 0.5, 0.75, 0.875, 1.0];
/// Deviations of the made-up components in metres of the stacked vertex vector.
const DEVIATIONS: [f32; 6] = [1.2, 0.5, 0.4, 0.3, 0.2, 0.1];

#[derive(Default)]
struct Arrays {
    positions: Vec<DVec3>,
    faces: Vec<[i32; 3]>,
    mirror: Vec<i32>,
    skin_bones: Vec<[u8; 4]>,
    skin_weights: Vec<[f32; 4]>,
    joint_rings: Vec<Vec<i32>>,
}

/// The figure with tubes of 16 segments.
pub(crate) fn model() -> BodyModel {
    model_with_segments(16)
}

/// The figure with tubes of any even number of segments.
pub(crate) fn model_with_segments(segments: usize) -> BodyModel {
    file::read(file_bytes(segments), Path::new("figure.npz")).expect("the figure is a valid model")
}

/// The figure's model file.
pub(crate) fn file_bytes(segments: usize) -> Vec<u8> {
    file_bytes_with(segments, "", |_| {})
}

/// The figure's model file with its metadata passed through `change`.
pub(crate) fn file_bytes_with_metadata(change: impl Fn(serde_json::Value) -> serde_json::Value) -> Vec<u8> {
    file_bytes_with(4, "metadata", |file| {
        file.add_text("metadata", &change(metadata(&arrays(4))).to_string());
    })
}

/// The figure's model file with one array written by `replace`.
pub(crate) fn file_bytes_with(segments: usize, key: &str, replace: impl Fn(&mut NpzWriter)) -> Vec<u8> {
    let arrays = arrays(segments);
    let mut file = ArrayFile { file: NpzWriter::new(), left_out: key };
    replace(&mut file.file);
    if key != "metadata" {
        file.file.add_text("metadata", &metadata(&arrays).to_string());
    }
    add_arrays(&mut file, &arrays);
    file.file.into_bytes().expect("the figure can be written")
}

/// A writer that skips one array, which the caller has written in its own way.
struct ArrayFile<'a> {
    file: NpzWriter,
    left_out: &'a str,
}

impl ArrayFile<'_> {
    fn add<T: npyz::AutoSerialize + Copy>(&mut self, key: &str, shape: &[usize], values: &[T]) {
        if key != self.left_out {
            self.file.add(key, shape, values);
        }
    }
}

fn arrays(segments: usize) -> Arrays {
    let mut arrays = Arrays { joint_rings: vec![Vec::new(); BONES.len()], ..Arrays::default() };
    for tube in TUBES {
        let is_middle = matches!(tube.bone, 0 | 7 | 8);
        let first = arrays.positions.len();
        add_tube(&mut arrays, &tube, segments, !is_middle);
        let count = arrays.positions.len() - first;
        if is_middle {
            // Within a ring the angle φ and its mirror image π − φ.
            for local in 0..count {
                let (ring, segment) = (local / segments, local % segments);
                let is_pole = local >= count - 2;
                let image = if is_pole {
                    local
                } else {
                    ring * segments + (segments + segments / 2 - segment) % segments
                };
                arrays.mirror.push((first + image) as i32);
            }
        } else {
            add_mirror_image(&mut arrays, first, count);
        }
    }
    arrays
}

fn add_tube(arrays: &mut Arrays, tube: &Tube, segments: usize, blends_into_child: bool) {
    let axis = tube.end - tube.start;
    let direction = axis.normalize();
    let seed = if direction.x.abs() < 0.9 { DVec3::X } else { DVec3::Z };
    let across = (seed - direction * seed.dot(direction)).normalize();
    let other = direction.cross(across);
    let [a, b] = tube.half_axes;
    let cap = 0.5 * (a + b);
    let mut rings: Vec<(f64, DVec3, f64)> = Vec::new();
    for angle in [60.0_f64, 30.0] {
        let (sine, cosine) = angle.to_radians().sin_cos();
        rings.push((0.0, tube.start - direction * cap * sine, cosine));
    }
    rings.extend(STATIONS.map(|t| (t, tube.start + axis * t, 1.0)));
    for angle in [30.0_f64, 60.0] {
        let (sine, cosine) = angle.to_radians().sin_cos();
        rings.push((1.0, tube.end + direction * cap * sine, cosine));
    }
    let first = arrays.positions.len();
    let id = |ring: usize, segment: usize| (first + ring * segments + segment % segments) as i32;
    // The pelvis turns about its middle, every other bone about its start.
    let joint_ring = if tube.bone == 0 { 5 } else { 2 };
    arrays.joint_rings[tube.bone] = (0..segments).map(|segment| id(joint_ring, segment)).collect();
    for (station, centre, scale) in &rings {
        for segment in 0..segments {
            let (sine, cosine) = (TAU * segment as f64 / segments as f64).sin_cos();
            arrays.positions.push(*centre + across * (a * scale * cosine) + other * (b * scale * sine));
            add_weights(arrays, tube.bone, *station, blends_into_child);
        }
    }
    for ring in 0..rings.len() - 1 {
        for segment in 0..segments {
            let (p, q) = (id(ring, segment), id(ring, segment + 1));
            let (r, s) = (id(ring + 1, segment + 1), id(ring + 1, segment));
            arrays.faces.extend([[p, q, r], [p, r, s]]);
        }
    }
    for (station, end, ring) in
        [(0.0, tube.start - direction * cap, 0), (1.0, tube.end + direction * cap, rings.len() - 1)]
    {
        let pole = arrays.positions.len() as i32;
        arrays.positions.push(end);
        add_weights(arrays, tube.bone, station, blends_into_child);
        for segment in 0..segments {
            let (p, q) = (id(ring, segment), id(ring, segment + 1));
            arrays.faces.push(if ring == 0 { [q, p, pole] } else { [p, q, pole] });
        }
    }
}

/// Half parent at the joint, all its own a quarter of the way on, half child at the end of a limb bone.
fn add_weights(arrays: &mut Arrays, bone: usize, station: f64, blends_into_child: bool) {
    let parent = usize::try_from(PARENTS[bone]).unwrap_or(bone);
    let child = PARENTS.iter().position(|p| *p == bone as i32).filter(|_| blends_into_child).unwrap_or(bone);
    let of_parent = (0.5 - 2.0 * station).max(0.0);
    let of_child = (2.0 * station - 1.5).max(0.0);
    let (other, share) = if of_parent > 0.0 { (parent, of_parent) } else { (child, of_child) };
    let share = if other == bone { 0.0 } else { share as f32 };
    arrays.skin_bones.push([bone as u8, other as u8, 0, 0]);
    arrays.skin_weights.push([1.0 - share, share, 0.0, 0.0]);
}

fn right_of(bone: u8) -> u8 {
    match bone {
        1..=3 => bone + 3,
        9..=11 => bone + 3,
        other => other,
    }
}

fn add_mirror_image(arrays: &mut Arrays, first: usize, count: usize) {
    let shift = count as i32;
    for vertex in first..first + count {
        let position = arrays.positions[vertex];
        arrays.positions.push(DVec3::new(-position.x, position.y, position.z));
        arrays.skin_bones.push(arrays.skin_bones[vertex].map(right_of));
        arrays.skin_weights.push(arrays.skin_weights[vertex]);
    }
    arrays.mirror.extend((first..first + count).map(|vertex| vertex as i32 + shift));
    arrays.mirror.extend((first..first + count).map(|vertex| vertex as i32));
    let images: Vec<[i32; 3]> = arrays
        .faces
        .iter()
        .filter(|face| face[0] >= first as i32)
        .map(|face| [face[0] + shift, face[2] + shift, face[1] + shift])
        .collect();
    arrays.faces.extend(images);
    for bone in [1, 2, 3, 9, 10, 11] {
        let ring = arrays.joint_rings[bone].clone();
        if ring.first().is_some_and(|vertex| *vertex >= first as i32) {
            arrays.joint_rings[usize::from(right_of(bone as u8))] = ring.iter().map(|v| v + shift).collect();
        }
    }
}

/// Landmark targets on the left side or in the middle.
const LANDMARKS: [(&str, [f64; 3]); 8] = [
    ("forehead", [0.0, 1.66, 0.1]),
    ("shoulder", [0.22, 1.5, 0.0]),
    ("elbow", [0.40, 1.2, -0.05]),
    ("wrist", [0.56, 0.98, 0.05]),
    ("knee", [0.10, 0.5, 0.06]),
    ("toe", [0.12, 0.03, 0.25]),
    ("heel", [0.11, 0.05, -0.05]),
    ("abdomen", [0.0, 0.95, 0.11]),
];

fn landmarks(arrays: &Arrays) -> Vec<(String, i32)> {
    let mut named = Vec::new();
    for (name, target) in LANDMARKS {
        let vertex = nearest(arrays, DVec3::from_array(target));
        if matches!(name, "forehead" | "abdomen") {
            named.push((name.to_string(), vertex));
        } else {
            named.push((format!("left_{name}"), vertex));
            named.push((format!("right_{name}"), arrays.mirror[vertex as usize]));
        }
    }
    named
}

fn nearest(arrays: &Arrays, target: DVec3) -> i32 {
    let distance = |v: usize| arrays.positions[v].distance_squared(target);
    (0..arrays.positions.len()).min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(0) as i32
}

fn metadata(arrays: &Arrays) -> serde_json::Value {
    let vertex = |target: [f64; 3]| nearest(arrays, DVec3::from_array(target));
    let mirror = |vertex: i32| arrays.mirror[vertex as usize];
    let nipple = vertex([0.08, 1.26, 0.11]);
    let acromion = vertex([0.2, 1.48, 0.0]);
    serde_json::json!({
        "format": "habitus-body-model",
        "version": 1,
        "name": "figure of tubes",
        "license": "CC0-1.0",
        "provenance": {"made by": "fixture.rs"},
        "bones": BONES,
        "axes": axis_names(),
        "landmarks": landmarks(arrays).into_iter().map(|(name, _)| name).collect::<Vec<_>>(),
        "measurement_vertices": {
            "crown": vertex([0.0, 1.8, 0.0]),
            "crotch": vertex([0.0, 0.7, 0.0]),
            "left_nipple": nipple,
            "right_nipple": mirror(nipple),
            "left_acromion": acromion,
            "right_acromion": mirror(acromion),
        },
    })
}

fn axis_names() -> Vec<String> {
    let mut names: Vec<String> = AXES
        .iter()
        .flat_map(|(_, joint, motions)| motions.iter().map(move |motion| format!("{joint}_{motion}")))
        .collect();
    names.extend(LAST_AXES.iter().map(|(_, joint)| format!("{joint}_flexion")));
    names
}

fn add_arrays(file: &mut ArrayFile<'_>, arrays: &Arrays) {
    let vertex_count = arrays.positions.len();
    let flat = |points: &[DVec3]| -> Vec<f32> {
        points.iter().flat_map(|p| p.to_array().map(|x| x as f32)).collect()
    };
    file.add("mean", &[vertex_count, 3], &flat(&arrays.positions));
    let basis: Vec<f16> = basis(&arrays.positions).concat().into_iter().map(f16::from_f64).collect();
    file.add("basis", &[DEVIATIONS.len(), vertex_count, 3], &basis);
    file.add("standard_deviations", &[DEVIATIONS.len()], &DEVIATIONS);
    file.add("faces", &[arrays.faces.len(), 3], &arrays.faces.concat());
    file.add("skin_bones", &[vertex_count, 4], &arrays.skin_bones.concat());
    file.add("skin_weights", &[vertex_count, 4], &arrays.skin_weights.concat());
    let mut offsets = vec![0_i32];
    let mut values = Vec::new();
    for ring in &arrays.joint_rings {
        offsets.push(offsets.last().copied().unwrap_or(0) + ring.len() as i32);
        values.extend(ring.iter().map(|_| 1.0 / ring.len() as f32));
    }
    file.add("joint_regressor_offsets", &[offsets.len()], &offsets);
    file.add("joint_regressor_vertices", &[values.len()], &arrays.joint_rings.concat());
    file.add("joint_regressor_values", &[values.len()], &values);
    file.add("bone_parents", &[PARENTS.len()], &PARENTS);
    add_axes(file);
    let landmarks: Vec<i32> = landmarks(arrays).into_iter().map(|(_, vertex)| vertex).collect();
    file.add("landmark_vertices", &[landmarks.len()], &landmarks);
    file.add("mirror_vertices", &[vertex_count], &arrays.mirror);
    let labels: Vec<u8> = arrays
        .skin_bones
        .iter()
        .map(|bones| match bones[0] {
            8 => 1,
            11 | 14 => 2,
            3 | 6 => 3,
            _ => 0,
        })
        .collect();
    file.add("part_labels", &[vertex_count], &labels);
}

fn add_axes(file: &mut ArrayFile<'_>) {
    let (mut bones, mut directions, mut limits) = (Vec::<i32>::new(), Vec::<f32>::new(), Vec::<f32>::new());
    let mut add = |bone: usize, direction: [f32; 3]| {
        bones.push(bone as i32);
        directions.extend(direction);
        limits.extend([-2.5, 2.5]);
    };
    for (bone, _, motions) in AXES {
        for direction in [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]].into_iter().take(motions.len()) {
            add(bone, direction);
        }
    }
    for (bone, _) in LAST_AXES {
        add(bone, [0.6, 0.8, 0.0]);
    }
    file.add("axis_bones", &[bones.len()], &bones);
    file.add("axis_directions", &[bones.len(), 3], &directions);
    file.add("axis_limits", &[bones.len(), 2], &limits);
}

/// Orthonormal rows: taller, wider, longer legs, longer arms, deeper, and one asymmetric twist.
fn basis(positions: &[DVec3]) -> Vec<Vec<f64>> {
    let fields: [fn(DVec3) -> DVec3; 6] = [
        |p| DVec3::new(0.0, p.y, 0.0),
        |p| DVec3::new(p.x, 0.0, p.z),
        |p| DVec3::new(0.0, p.y.min(0.9), 0.0),
        |p| DVec3::new((p.x.abs() - 0.2).max(0.0) * p.x.signum(), 0.0, 0.0),
        |p| DVec3::new(0.0, 0.0, p.z),
        |p| DVec3::new(0.0, 0.1 * p.x, p.x),
    ];
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for field in fields {
        let mut row: Vec<f64> = positions.iter().flat_map(|p| field(*p).to_array()).collect();
        for earlier in &rows {
            let overlap: f64 = row.iter().zip(earlier).map(|(a, b)| a * b).sum();
            row.iter_mut().zip(earlier).for_each(|(a, b)| *a -= overlap * b);
        }
        let norm = row.iter().map(|a| a * a).sum::<f64>().sqrt();
        row.iter_mut().for_each(|a| *a /= norm);
        rows.push(row);
    }
    rows
}
