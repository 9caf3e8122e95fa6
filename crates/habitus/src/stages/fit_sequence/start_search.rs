//! Finds the first pose without landmarks: many coarse hypotheses, fitted a little, halved, fitted more.
//!
//! Deviation: P2 §4.2 starts from landmarks of the Stitched Puppet. Hypotheses are pose clusters × headings; front and
//! back, left and right twins of the winner stay to the end, where bare parts decide.

use glam::{DQuat, DVec3};
use habitus_optimize::{Bounds, GaussNewtonSettings, Silent, gauss_newton};
use rayon::prelude::*;

use super::body_levels::{BodyLevel, turned_normals};
use super::captured_frame::CapturedFrame;
use super::clothed_surface::{robust_energy, robust_weight};
use super::config::StartConfig;
use super::pose_solver::{landmark_term, normalise_root};
use crate::body::{BodyModel, ROOT_LENGTH, Skeleton};
use crate::fitting::correspondence::{ClosestField, Correspondence};
use crate::fitting::deformers::{BodyParameters, FreeParameters};
use crate::fitting::terms::{ClosestPoints, DistanceForm, StayNear};
use crate::fitting::{Deformer, Fit};

/// A start: identity (first components) and pose, with its energy in square metres per point.
#[derive(Clone, Debug)]
pub(super) struct Start {
    /// Which of the captures it explains: the same frame in another orientation.
    pub capture: usize,
    pub identity: Vec<f64>,
    pub pose: Vec<f64>,
    pub energy: f64,
}

/// Searches starts; what depends on the model alone is prepared once.
pub(super) struct StartSearch<'a> {
    level: BodyLevel,
    rest_normals: Vec<DVec3>,
    clusters: Vec<Vec<f64>>,
    config: &'a StartConfig,
}

/// Weight of the tangential part of a pair: enough to draw limbs along, too little to stop sliding.
const TANGENTIAL_WEIGHT: f64 = 0.1;

/// Share of the search after which a start from elsewhere joins it.
const FINISH_FROM: f64 = 0.5;

impl<'a> StartSearch<'a> {
    pub fn new(model: &'a BodyModel, config: &'a StartConfig) -> Self {
        let level = BodyLevel::spread(model, config.coarse_vertex_count, config.component_count);
        let normals = habitus_geometry::vertex_normals(model.mean_vertices(), model.faces());
        let rest_normals = level.vertices.iter().map(|v| normals[*v as usize]).collect();
        let clusters = pose_clusters(model);
        Self { level, rest_normals, clusters, config }
    }

    /// The body of the search.
    pub fn level(&self) -> &BodyLevel {
        &self.level
    }

    /// The poses that hypotheses come from.
    pub fn clusters(&self) -> &[Vec<f64>] {
        &self.clusters
    }

    /// The vertices of a start at the level of the search, in metres.
    pub fn vertices(&self, start: &Start) -> Vec<DVec3> {
        let surface = &self.level.surface;
        let posed = surface.skeleton().pose(&surface.rest_joints(&start.identity), &start.pose);
        surface.skin_vertices(&surface.rest_vertices(&start.identity), &posed)
    }

    /// The last steps of the search for a start from elsewhere.
    pub fn finish(&self, frame: &CapturedFrame, start: Start) -> Start {
        let steps = self.config.halvings.last().map_or(0, |halving| halving.steps);
        self.improve(frame, start, false, steps, [FINISH_FROM, 1.0])
    }

    /// The best starts, best first. `captures` are one frame in the orientations that are possible; they compete in
    /// one pool. `known_identity` fixes the identity; `hints` are poses worth trying.
    pub fn search(
        &self,
        captures: &[CapturedFrame],
        known_identity: Option<&[f64]>,
        hints: &[Vec<f64>],
    ) -> Vec<Start> {
        let identity = match known_identity {
            Some(identity) => identity[..self.config.component_count.min(identity.len())].to_vec(),
            None => vec![0.0; self.level.surface.component_count()],
        };
        let mut starts: Vec<Start> = Vec::new();
        for (capture, frame) in captures.iter().enumerate() {
            let poses = self.hypotheses(frame, &identity).into_iter().chain(hints.iter().cloned());
            starts.extend(poses.map(|pose| Start {
                capture,
                identity: identity.clone(),
                pose,
                energy: f64::INFINITY,
            }));
        }
        let halvings = &self.config.halvings;
        let total: usize = halvings.iter().map(|halving| halving.steps).sum();
        let mut done = 0;
        for (index, halving) in halvings.iter().enumerate() {
            if index + 1 == halvings.len() {
                let twins: Vec<Start> = starts.iter().take(2).map(|start| self.facing_twin(start)).collect();
                starts.extend(twins);
                let recombined: Vec<Start> = starts
                    .par_iter()
                    .take(2)
                    .map(|start| self.recombine(&captures[start.capture], start, &starts))
                    .collect();
                starts.extend(recombined);
            }
            let shares = [done, done + halving.steps].map(|steps| steps as f64 / total.max(1) as f64);
            starts = starts
                .into_par_iter()
                .map(|start| {
                    let frame = &captures[start.capture];
                    self.improve(frame, start, known_identity.is_some(), halving.steps, shares)
                })
                .collect();
            starts.sort_by(|a, b| a.energy.total_cmp(&b.energy));
            starts = distinct(starts, halving.keep);
            done += halving.steps;
        }
        starts
    }

    /// Pose clusters × headings, standing on the capture's floor under its middle.
    fn hypotheses(&self, frame: &CapturedFrame, identity: &[f64]) -> Vec<Vec<f64>> {
        let [low, high] = frame.bounds;
        let count = frame.samples.len().max(1) as f64;
        let middle = frame.samples.iter().map(|sample| sample.position).sum::<DVec3>() / count;
        let surface = &self.level.surface;
        let rest = surface.rest_vertices(identity);
        let joints = surface.rest_joints(identity);
        let mut poses = Vec::new();
        for cluster in &self.clusters {
            for step in 0..self.config.yaw_count {
                let yaw = std::f64::consts::TAU * step as f64 / self.config.yaw_count as f64;
                let mut pose = cluster.clone();
                pose[3..6].copy_from_slice(&[0.0, yaw, 0.0]);
                normalise_root(&mut pose);
                let posed = surface.skin_vertices(&rest, &surface.skeleton().pose(&joints, &pose));
                let [body_low, body_high] = super::captured_frame::bounds_of(&posed);
                let body_middle = posed.iter().copied().sum::<DVec3>() / posed.len().max(1) as f64;
                pose[0] += middle.x - body_middle.x;
                pose[2] += middle.z - body_middle.z;
                pose[1] += 0.5 * (low.y + high.y - body_low.y - body_high.y);
                poses.push(pose);
            }
        }
        poses
    }

    /// Gauss–Newton steps with fresh pairs, both directions, the robust scale shrinking over `shares` of the search.
    fn improve(
        &self,
        frame: &CapturedFrame,
        mut start: Start,
        identity_is_known: bool,
        steps: usize,
        shares: [f64; 2],
    ) -> Start {
        let surface = &self.level.surface;
        let identity_count = if identity_is_known { 0 } else { surface.component_count() };
        let deformer = if identity_is_known {
            BodyParameters::of_pose(surface, &start.identity)
        } else {
            BodyParameters::new(surface, FreeParameters::IdentityAndPose)
        };
        let (mut lower, mut upper) = (vec![-3.0; identity_count], vec![3.0; identity_count]);
        let limits = surface.skeleton().pose_limits();
        lower.extend(limits.0);
        upper.extend(limits.1);
        let Ok(bounds) = Bounds::new(lower, upper) else { return start };
        let settings = GaussNewtonSettings { max_iterations: 1, initial_damping: 1e-2, ..Default::default() };
        let count = surface.vertex_count() as f64;
        let identity_prior = StayNear::new(
            0,
            &vec![0.0; identity_count],
            &vec![self.config.identity_stiffness * count; identity_count],
        );
        let angles = start.pose[ROOT_LENGTH..].to_vec();
        let pose_prior = StayNear::new(
            identity_count + ROOT_LENGTH,
            &angles,
            &vec![self.config.pose_stiffness * count; angles.len()],
        );
        let landmarks = landmark_term(&self.level, &frame.landmarks);
        let mut parameters = start.identity[..identity_count].to_vec();
        parameters.extend(&start.pose);
        let [first_scale, last_scale] = self.config.robust_scale;
        for step in 0..steps {
            let share = shares[0] + (shares[1] - shares[0]) * step as f64 / steps as f64;
            let scale = first_scale * (last_scale / first_scale).powf(share);
            let Some(pairs) = self.pairs(frame, &deformer, &start, &parameters, scale) else { return start };
            let planes = ClosestPoints::new(&pairs, DistanceForm::Plane);
            let points = ClosestPoints::new(&pairs, DistanceForm::Point);
            let fit = Fit::new(&deformer)
                .with(1.0 - TANGENTIAL_WEIGHT, &planes)
                .with(TANGENTIAL_WEIGHT, &points)
                .with(1.0, &landmarks)
                .with(1.0, &identity_prior)
                .with(1.0, &pose_prior);
            if gauss_newton(&fit, &mut parameters, &bounds, &settings, &mut Silent).is_err() {
                return start;
            }
            normalise_root(&mut parameters[identity_count..]);
        }
        start.identity[..identity_count].copy_from_slice(&parameters[..identity_count]);
        start.pose.copy_from_slice(&parameters[identity_count..]);
        start.energy = self.energy(frame, &start);
        start
    }

    fn pairs(
        &self,
        frame: &CapturedFrame,
        deformer: &BodyParameters<'_>,
        start: &Start,
        parameters: &[f64],
        scale: f64,
    ) -> Option<Vec<Correspondence>> {
        let surface = &self.level.surface;
        let (identity, pose) = parameters.split_at(parameters.len() - start.pose.len());
        let identity = if identity.is_empty() { &start.identity[..] } else { identity };
        let deformed = deformer.deform(parameters);
        let vertices = deformed.vertices();
        if vertices.iter().any(|vertex| !vertex.is_finite()) {
            return None;
        }
        let posed = surface.skeleton().pose(&surface.rest_joints(identity), pose);
        let normals = turned_normals(surface, &self.rest_normals, &posed);
        let mut pairs = Vec::with_capacity(2 * vertices.len());
        for (vertex, (position, normal)) in vertices.iter().zip(&normals).enumerate() {
            let point = frame.index.closest(*position);
            if normal.dot(point.normal) > 0.0 {
                pairs.push(Correspondence {
                    vertex: vertex as u32,
                    target: point.position,
                    normal: point.normal,
                    is_outside: false,
                    signed_distance: 0.0,
                    weight: self.part_weight(vertex) * robust_weight(point.distance_squared, scale),
                });
            }
        }
        let stride = frame.samples.len().div_ceil(self.config.coarse_sample_count.max(1));
        pairs.extend(super::clothed_surface::capture_pairs(frame, stride, vertices, &normals, 1.0, scale).0);
        Some(pairs)
    }

    /// Head, hands and feet are seen through most clothing and tell front from back.
    fn part_weight(&self, vertex: usize) -> f64 {
        if self.level.parts[vertex].is_bare() { 2.0 } else { 1.0 }
    }

    /// Mean robust energy of both directions at the last scale, normals included: a pair whose normals disagree
    /// counts as not explained; landmarks that the user gives count in full. All starts are compared by this one number.
    pub fn energy(&self, frame: &CapturedFrame, start: &Start) -> f64 {
        let scale = self.config.robust_scale[1];
        let surface = &self.level.surface;
        let posed = surface.skeleton().pose(&surface.rest_joints(&start.identity), &start.pose);
        let vertices = surface.skin_vertices(&surface.rest_vertices(&start.identity), &posed);
        let normals = turned_normals(surface, &self.rest_normals, &posed);
        let field = ClosestField::find(&frame.index, &vertices, None);
        let (mut sum, mut weight_sum) = (0.0, 0.0);
        for (vertex, point) in field.points.iter().enumerate() {
            let weight = self.part_weight(vertex);
            let agreement = normals[vertex].dot(point.normal);
            let unexplained = 0.5 * (1.0 - agreement) * scale * scale;
            sum += weight * (robust_energy(point.distance_squared, scale) + unexplained);
            weight_sum += weight;
        }
        let (_, uncovered) = super::clothed_surface::capture_pairs(frame, 1, &vertices, &normals, 1.0, scale);
        let missed: f64 = frame
            .landmarks
            .iter()
            .filter_map(|given| {
                let slot = self.level.vertices.binary_search(&given.vertex).ok()?;
                Some(vertices[slot].distance_squared(given.position))
            })
            .sum();
        sum / weight_sum + uncovered + missed / frame.landmarks.len().max(1) as f64
    }

    /// Tries the limbs of the other starts and of the clusters on this start, limb by limb, and keeps what explains the
    /// frame better: a start that is right but for one arm need not come up as a whole.
    fn recombine(&self, frame: &CapturedFrame, start: &Start, others: &[Start]) -> Start {
        let mut best = start.clone();
        best.energy = self.energy(frame, &best);
        let skeleton = self.level.surface.skeleton();
        for limb in ["left_upper_arm", "right_upper_arm", "left_thigh", "right_thigh"] {
            let parameters = limb_parameters(skeleton, limb);
            let candidates = others.iter().map(|other| &other.pose).chain(&self.clusters);
            for candidate in candidates {
                let mut trial = best.clone();
                for parameter in &parameters {
                    trial.pose[*parameter] = candidate[*parameter];
                }
                trial.energy = self.energy(frame, &trial);
                if trial.energy < best.energy {
                    best = trial;
                }
            }
        }
        best
    }

    /// Largest distance between the joints of two starts in metres; infinite between orientations.
    pub fn joint_distance(&self, a: &Start, b: &Start) -> f64 {
        if a.capture != b.capture {
            return f64::INFINITY;
        }
        let joints = |start: &Start| {
            let surface = &self.level.surface;
            surface.skeleton().pose(&surface.rest_joints(&start.identity), &start.pose).joints
        };
        joints(a).iter().zip(joints(b)).map(|(p, q)| p.distance(q)).fold(0.0, f64::max)
    }

    /// The same limbs seen from behind: turned by half a turn, with left and right exchanged.
    fn facing_twin(&self, start: &Start) -> Start {
        let skeleton = self.level.surface.skeleton();
        let joints = self.level.surface.rest_joints(&start.identity);
        let posed = skeleton.pose(&joints, &start.pose);
        let mut twin = start.clone();
        let rotation = DQuat::from_rotation_y(std::f64::consts::PI)
            * DQuat::from_scaled_axis(DVec3::from_slice(&start.pose[3..6]));
        let vector = crate::body::rotation_vector(rotation);
        twin.pose[3..6].copy_from_slice(&vector.to_array());
        for bone in 1..skeleton.bones().len() {
            let Some(child) = end_of(skeleton, bone) else { continue };
            let other = mirrored_bone(skeleton, bone);
            let Some(other_child) = end_of(skeleton, other) else { continue };
            let direction = posed.joints[other_child] - posed.joints[other];
            aim(skeleton, &joints, &mut twin.pose, bone, child, direction);
        }
        twin.energy = f64::INFINITY;
        twin
    }
}

/// Poses that differ by less than this (metres or radians in any parameter) are the same start.
const SAME_POSE: f64 = 0.15;

impl Start {
    /// Whether any pose parameter differs by more than `limit`, or the orientation does.
    pub fn differs(&self, other: &Self, limit: f64) -> bool {
        self.capture != other.capture || self.pose.iter().zip(&other.pose).any(|(a, b)| (a - b).abs() > limit)
    }
}

/// The first `keep` starts that differ from one another in more than rounding.
fn distinct(starts: Vec<Start>, keep: usize) -> Vec<Start> {
    let mut kept: Vec<Start> = Vec::with_capacity(keep);
    for start in starts {
        if kept.len() == keep {
            break;
        }
        if kept.iter().all(|other| other.differs(&start, SAME_POSE)) {
            kept.push(start);
        }
    }
    kept
}

/// The bone whose joint ends this one.
fn end_of(skeleton: &Skeleton, bone: usize) -> Option<usize> {
    (0..skeleton.bones().len()).find(|child| skeleton.bones()[*child].parent == Some(bone))
}

/// Pose parameters of a bone and of all bones below it.
fn limb_parameters(skeleton: &Skeleton, bone_name: &str) -> Vec<usize> {
    let bones = skeleton.bones();
    let belongs = |mut bone: usize| loop {
        if bones[bone].name == bone_name {
            return true;
        }
        match bones[bone].parent {
            Some(parent) => bone = parent,
            None => return false,
        }
    };
    (0..skeleton.axes().len())
        .filter(|axis| belongs(skeleton.axes()[*axis].bone))
        .map(|axis| ROOT_LENGTH + axis)
        .collect()
}

fn mirrored_bone(skeleton: &Skeleton, bone: usize) -> usize {
    let name = &skeleton.bones()[bone].name;
    let other = if let Some(rest) = name.strip_prefix("left_") {
        format!("right_{rest}")
    } else if let Some(rest) = name.strip_prefix("right_") {
        format!("left_{rest}")
    } else {
        return bone;
    };
    skeleton.bones().iter().position(|bone| bone.name == other).unwrap_or(bone)
}

/// Turns a bone by its own axes, within their limits, until its end points along `direction` (posed space).
fn aim(skeleton: &Skeleton, joints: &[DVec3], pose: &mut [f64], bone: usize, child: usize, direction: DVec3) {
    const SWEEPS: usize = 3;
    const STEPS: usize = 48;
    let wanted = direction.normalize_or_zero();
    let axes: Vec<usize> =
        (0..skeleton.axes().len()).filter(|axis| skeleton.axes()[*axis].bone == bone).collect();
    let error = |pose: &[f64]| {
        let posed = skeleton.pose(joints, pose);
        let current = (posed.joints[child] - posed.joints[bone]).normalize_or_zero();
        // A small cost on the angles themselves leaves twist, which cannot help, at zero.
        let size: f64 = axes.iter().map(|axis| pose[ROOT_LENGTH + axis].powi(2)).sum();
        -current.dot(wanted) + 1e-3 * size
    };
    for _ in 0..SWEEPS {
        for axis in &axes {
            let [low, high] = skeleton.axes()[*axis].limits;
            let mut best = (pose[ROOT_LENGTH + axis], error(pose));
            for step in 0..=STEPS {
                pose[ROOT_LENGTH + axis] = low + (high - low) * step as f64 / STEPS as f64;
                let candidate = error(pose);
                if candidate < best.1 {
                    best = (pose[ROOT_LENGTH + axis], candidate);
                }
            }
            pose[ROOT_LENGTH + axis] = best.0;
        }
    }
}

/// Where limbs point in a cluster, for the left side of a person who faces +z: upper arm, forearm, thigh, shank.
struct LimbDirections {
    left: [[f64; 3]; 4],
    right: [[f64; 3]; 4],
}

const DOWN: [f64; 3] = [0.15, -1.0, 0.0];
const SLANT: [f64; 3] = [0.7, -0.7, 0.0];
const SIDE: [f64; 3] = [1.0, 0.0, 0.0];
const FRONT: [f64; 3] = [0.1, -0.1, 1.0];
const FRONT_DOWN: [f64; 3] = [0.1, -0.8, 0.6];
const BACK_DOWN: [f64; 3] = [0.1, -0.9, -0.4];
const UP: [f64; 3] = [0.3, 1.0, 0.0];
const INWARD: [f64; 3] = [-0.8, -0.2, 0.6];
const LEG: [f64; 3] = [0.05, -1.0, 0.0];
const LEG_WIDE: [f64; 3] = [0.35, -1.0, 0.0];
const LEG_FRONT: [f64; 3] = [0.05, -1.0, 0.45];
const LEG_BACK: [f64; 3] = [0.05, -1.0, -0.35];
const KNEE_UP: [f64; 3] = [0.05, -0.2, 1.0];

const CLUSTERS: [LimbDirections; 14] = [
    LimbDirections { left: [SLANT, SLANT, LEG, LEG], right: [SLANT, SLANT, LEG, LEG] },
    LimbDirections { left: [DOWN, DOWN, LEG, LEG], right: [DOWN, DOWN, LEG, LEG] },
    LimbDirections { left: [SIDE, SIDE, LEG, LEG], right: [SIDE, SIDE, LEG, LEG] },
    LimbDirections { left: [FRONT, FRONT, LEG, LEG], right: [FRONT, FRONT, LEG, LEG] },
    LimbDirections { left: [UP, UP, LEG, LEG], right: [UP, UP, LEG, LEG] },
    LimbDirections { left: [DOWN, FRONT, LEG, LEG], right: [DOWN, FRONT, LEG, LEG] },
    LimbDirections { left: [SLANT, INWARD, LEG_WIDE, LEG], right: [SLANT, INWARD, LEG_WIDE, LEG] },
    LimbDirections {
        left: [BACK_DOWN, DOWN, LEG_FRONT, LEG],
        right: [FRONT_DOWN, FRONT_DOWN, LEG_BACK, LEG_BACK],
    },
    LimbDirections {
        left: [FRONT_DOWN, FRONT_DOWN, LEG_BACK, LEG_BACK],
        right: [BACK_DOWN, DOWN, LEG_FRONT, LEG],
    },
    LimbDirections { left: [DOWN, DOWN, KNEE_UP, LEG], right: [DOWN, DOWN, LEG, LEG] },
    LimbDirections { left: [DOWN, DOWN, LEG, LEG], right: [DOWN, DOWN, KNEE_UP, LEG] },
    LimbDirections {
        left: [FRONT_DOWN, FRONT, KNEE_UP, LEG_BACK],
        right: [FRONT_DOWN, FRONT, KNEE_UP, LEG_BACK],
    },
    LimbDirections { left: [UP, UP, LEG, LEG], right: [DOWN, DOWN, LEG, LEG] },
    LimbDirections { left: [DOWN, DOWN, LEG, LEG], right: [UP, UP, LEG, LEG] },
];

fn pose_clusters(model: &BodyModel) -> Vec<Vec<f64>> {
    let skeleton = model.skeleton();
    let joints = model.surface().rest_joints(&[]);
    let limbs = ["upper_arm", "forearm", "thigh", "shank"];
    CLUSTERS
        .iter()
        .map(|cluster| {
            let mut pose = vec![0.0; skeleton.pose_length()];
            for (side, directions, sign) in [("left", &cluster.left, 1.0), ("right", &cluster.right, -1.0)] {
                for (limb, direction) in limbs.iter().zip(directions) {
                    let name = format!("{side}_{limb}");
                    let Some(bone) = skeleton.bones().iter().position(|bone| bone.name == name) else {
                        continue;
                    };
                    let Some(child) = end_of(skeleton, bone) else { continue };
                    let wanted = DVec3::new(sign * direction[0], direction[1], direction[2]);
                    aim(skeleton, &joints, &mut pose, bone, child, wanted);
                }
            }
            pose
        })
        .collect()
}
