//! A made-up person for tests: one capsule a bone, standing with the arms a little out.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DAffine3, DQuat, DVec3};

/// Parent of each of the 15 bones; the root names itself.
pub const PARENTS: [usize; 15] = [0, 0, 1, 2, 0, 4, 5, 0, 7, 7, 9, 10, 7, 12, 13];

/// Joint of each bone at rest, metres, y up, facing +z, left is +x.
pub const JOINTS: [[f64; 3]; 15] = [
    [0.0, 0.98, 0.0],
    [0.10, 0.92, 0.0],
    [0.11, 0.50, 0.0],
    [0.12, 0.09, -0.01],
    [-0.10, 0.92, 0.0],
    [-0.11, 0.50, 0.0],
    [-0.12, 0.09, -0.01],
    [0.0, 1.10, 0.0],
    [0.0, 1.50, 0.0],
    [0.20, 1.42, 0.0],
    [0.38, 1.20, 0.0],
    [0.54, 1.00, 0.02],
    [-0.20, 1.42, 0.0],
    [-0.38, 1.20, 0.0],
    [-0.54, 1.00, 0.02],
];

/// Two ends and the radius of each bone's capsule in metres.
const CAPSULES: [([f64; 3], [f64; 3], f64); 15] = [
    ([-0.07, 0.97, 0.0], [0.07, 0.97, 0.0], 0.13),
    ([0.10, 0.88, 0.0], [0.11, 0.52, 0.0], 0.085),
    ([0.11, 0.48, 0.0], [0.12, 0.11, -0.01], 0.055),
    ([0.12, 0.04, -0.02], [0.13, 0.04, 0.15], 0.04),
    ([-0.10, 0.88, 0.0], [-0.11, 0.52, 0.0], 0.085),
    ([-0.11, 0.48, 0.0], [-0.12, 0.11, -0.01], 0.055),
    ([-0.12, 0.04, -0.02], [-0.13, 0.04, 0.15], 0.04),
    ([0.0, 1.12, 0.0], [0.0, 1.34, 0.0], 0.155),
    ([0.0, 1.56, 0.01], [0.0, 1.68, 0.01], 0.09),
    ([0.21, 1.40, 0.0], [0.37, 1.21, 0.0], 0.048),
    ([0.39, 1.19, 0.0], [0.52, 1.02, 0.01], 0.038),
    ([0.55, 0.99, 0.02], [0.61, 0.90, 0.03], 0.03),
    ([-0.21, 1.40, 0.0], [-0.37, 1.21, 0.0], 0.048),
    ([-0.39, 1.19, 0.0], [-0.52, 1.02, 0.01], 0.038),
    ([-0.55, 0.99, 0.02], [-0.61, 0.90, 0.03], 0.03),
];

/// A mesh with the bone that moves each vertex.
#[derive(Clone)]
pub struct CapsuleMesh {
    pub positions: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
    pub bones: Vec<u8>,
}

/// The person at rest; `swell` is added to every radius (a capture with loose clothes), in metres.
pub fn capsule_person(swell: f64, sides: u32) -> CapsuleMesh {
    let mut mesh = CapsuleMesh { positions: Vec::new(), faces: Vec::new(), bones: Vec::new() };
    for (bone, (start, end, radius)) in CAPSULES.iter().enumerate() {
        let [start, end] = [start, end].map(|corner| DVec3::from_array(*corner));
        let radius = radius + if bone == 8 { 0.1 * swell } else { swell };
        add_capsule(&mut mesh, bone as u8, [start, end], radius, sides);
    }
    mesh
}

fn add_capsule(mesh: &mut CapsuleMesh, bone: u8, [start, end]: [DVec3; 2], radius: f64, sides: u32) {
    let axis = (end - start).normalize();
    let across = axis.any_orthonormal_vector();
    let other = axis.cross(across);
    let half_rings = sides / 2;
    let base = mesh.positions.len() as u32;
    mesh.positions.push(start - axis * radius);
    for ring in 1..2 * half_rings {
        let polar = f64::from(ring) / f64::from(2 * half_rings) * 2.0 * FRAC_PI_2;
        let center = if ring < half_rings { start } else { end } - axis * (radius * polar.cos());
        mesh.positions.extend((0..sides).map(|k| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(sides)).sin_cos();
            center + radius * polar.sin() * (across * cos + other * sin)
        }));
    }
    mesh.positions.push(end + axis * radius);
    let last = mesh.positions.len() as u32 - 1;
    for k in 0..sides {
        let next = (k + 1) % sides;
        mesh.faces.push([base, base + 1 + next, base + 1 + k]);
        for ring in 1..2 * half_rings - 1 {
            let [low, high] = [base + 1 + (ring - 1) * sides, base + 1 + ring * sides];
            mesh.faces.push([low + k, low + next, high + next]);
            mesh.faces.push([low + k, high + next, high + k]);
        }
        mesh.faces.push([last, last - sides + k, last - sides + next]);
    }
    mesh.bones.resize(mesh.positions.len(), bone);
}

/// The 15 bone transforms `posed_from_rest` of a walk at a phase in radians.
pub fn walking_bones(phase: f64) -> [DAffine3; 15] {
    let swing = 0.5 * phase.sin();
    let mut turns = [DQuat::IDENTITY; 15];
    turns[1] = DQuat::from_rotation_x(-swing);
    turns[2] = DQuat::from_rotation_x(0.5 * (1.0 - phase.cos()) * 0.8);
    turns[4] = DQuat::from_rotation_x(swing);
    turns[5] = DQuat::from_rotation_x(0.5 * (1.0 + phase.cos()) * 0.8);
    turns[7] = DQuat::from_rotation_y(0.3 * swing);
    turns[9] = DQuat::from_rotation_x(swing);
    turns[10] = DQuat::from_rotation_x(-0.4 - 0.3 * swing);
    turns[12] = DQuat::from_rotation_x(-swing);
    turns[13] = DQuat::from_rotation_x(-0.4 + 0.3 * swing);
    let mut bones = [DAffine3::IDENTITY; 15];
    for bone in 0..15 {
        let joint = DVec3::from_array(JOINTS[bone]);
        let about_joint = DAffine3::from_translation(joint)
            * DAffine3::from_quat(turns[bone])
            * DAffine3::from_translation(-joint);
        let forward = DAffine3::from_translation(DVec3::Z * 0.1 * phase);
        bones[bone] = if bone == 0 { forward } else { bones[PARENTS[bone]] * about_joint };
    }
    bones
}

/// The person's vertices moved by bones.
pub fn posed(mesh: &CapsuleMesh, bones: &[DAffine3; 15]) -> Vec<DVec3> {
    mesh.positions
        .iter()
        .zip(&mesh.bones)
        .map(|(p, &bone)| bones[bone as usize].transform_point3(*p))
        .collect()
}
