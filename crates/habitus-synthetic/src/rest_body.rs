//! A body at rest with what a tailor needs to know about it: joints, bones and its surface lookup.

use glam::DVec3;
use habitus::body::BodyModel;
use habitus::geometry::{SurfaceIndex, TriangleMesh};

use crate::error::SyntheticError;

/// The bones of the default skeleton, in its order (P2 §5: N_b = 15).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs, reason = "the names say it")]
#[repr(usize)]
pub enum Bone {
    Pelvis,
    LeftThigh,
    LeftShank,
    LeftFoot,
    RightThigh,
    RightShank,
    RightFoot,
    Thorax,
    Head,
    LeftUpperArm,
    LeftForearm,
    LeftHand,
    RightUpperArm,
    RightForearm,
    RightHand,
}

impl Bone {
    /// Number of bones.
    pub const COUNT: usize = 15;
    /// All bones in order.
    pub const ALL: [Self; Self::COUNT] = [
        Self::Pelvis,
        Self::LeftThigh,
        Self::LeftShank,
        Self::LeftFoot,
        Self::RightThigh,
        Self::RightShank,
        Self::RightFoot,
        Self::Thorax,
        Self::Head,
        Self::LeftUpperArm,
        Self::LeftForearm,
        Self::LeftHand,
        Self::RightUpperArm,
        Self::RightForearm,
        Self::RightHand,
    ];

    /// One value per bone.
    pub(crate) fn table(value: impl Fn(Self) -> f64) -> [f64; Self::COUNT] {
        Self::ALL.map(value)
    }

    /// Thigh, shank or foot.
    pub fn is_leg(self) -> bool {
        (Self::LeftThigh..=Self::RightFoot).contains(&self)
    }

    /// Upper arm, forearm or hand.
    pub fn is_arm(self) -> bool {
        self >= Self::LeftUpperArm
    }

    fn is_torso_or_thigh(self) -> bool {
        matches!(self, Self::Pelvis | Self::Thorax | Self::LeftThigh | Self::RightThigh)
    }
}

/// The middle line of a part of the body.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BoneLine {
    pub(crate) bone: Bone,
    pub(crate) start: DVec3,
    pub(crate) end: DVec3,
}

impl BoneLine {
    pub(crate) fn direction(&self) -> DVec3 {
        (self.end - self.start).normalize_or_zero()
    }

    /// Nearest point of the line.
    pub(crate) fn nearest(&self, position: DVec3) -> DVec3 {
        let way = self.end - self.start;
        let share = (position - self.start).dot(way) / way.length_squared().max(1e-12);
        self.start + way * share.clamp(0.0, 1.0)
    }

    pub(crate) fn distance(&self, position: DVec3) -> f64 {
        self.nearest(position).distance(position)
    }
}

/// One person in the rest pose.
pub struct RestBody {
    positions: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    joints: Vec<DVec3>,
    bones: Vec<Bone>,
    is_bare: Vec<bool>,
    index: SurfaceIndex,
}

impl RestBody {
    /// A body given by its rest vertices in the model's topology; it need not lie in the model's space.
    pub fn new(model: &BodyModel, rest_vertices: Vec<DVec3>) -> Result<Self, SyntheticError> {
        let joints = model.joints(&rest_vertices);
        let mesh = TriangleMesh::new(rest_vertices.clone(), model.faces().to_vec())?;
        let index = SurfaceIndex::of_mesh(&mesh);
        Ok(Self {
            joints,
            faces: model.faces().to_vec(),
            bones: model.dominant_bones().into_iter().map(|bone| Bone::ALL[bone]).collect(),
            is_bare: model.part_labels().iter().map(|label| label.is_bare()).collect(),
            positions: rest_vertices,
            index,
        })
    }

    /// Rest vertices, metres.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Faces, outward counter-clockwise.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Rest joints, metres.
    pub fn joints(&self) -> &[DVec3] {
        &self.joints
    }

    /// The bone that moves each vertex most.
    pub fn bones(&self) -> &[Bone] {
        &self.bones
    }

    /// The joint that a bone turns about.
    pub fn joint(&self, bone: Bone) -> DVec3 {
        self.joints[bone as usize]
    }

    pub(crate) fn index(&self) -> &SurfaceIndex {
        &self.index
    }

    pub(crate) fn is_bare(&self, vertex: u32) -> bool {
        self.is_bare[vertex as usize]
    }

    /// The lines that trunk and limbs lie along, all pointing downwards or outwards.
    pub(crate) fn bone_lines(&self) -> Vec<BoneLine> {
        let hips = self.middle(Bone::LeftThigh, Bone::RightThigh);
        let line = |bone: Bone, start: DVec3, end: DVec3| BoneLine { bone, start, end };
        let mut lines = vec![
            line(Bone::Thorax, self.joint(Bone::Head), self.joint(Bone::Thorax)),
            line(Bone::Pelvis, self.joint(Bone::Thorax), hips),
        ];
        let pairs = [
            (Bone::LeftThigh, Bone::LeftShank),
            (Bone::LeftShank, Bone::LeftFoot),
            (Bone::RightThigh, Bone::RightShank),
            (Bone::RightShank, Bone::RightFoot),
            (Bone::LeftUpperArm, Bone::LeftForearm),
            (Bone::LeftForearm, Bone::LeftHand),
            (Bone::RightUpperArm, Bone::RightForearm),
            (Bone::RightForearm, Bone::RightHand),
        ];
        lines.extend(pairs.map(|(bone, next)| line(bone, self.joint(bone), self.joint(next))));
        lines
    }

    pub(crate) fn middle(&self, first: Bone, second: Bone) -> DVec3 {
        (self.joint(first) + self.joint(second)) * 0.5
    }

    pub(crate) fn bounds(&self) -> (DVec3, DVec3) {
        self.positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &position| {
            (low.min(position), high.max(position))
        })
    }

    /// A value per bone, interpolated over a face.
    pub(crate) fn interpolate(&self, face: u32, barycentric: [f64; 3], values: &[f64; Bone::COUNT]) -> f64 {
        let corners = self.faces[face as usize];
        corners
            .iter()
            .zip(barycentric)
            .map(|(&vertex, share)| values[self.bones[vertex as usize] as usize] * share)
            .sum()
    }

    /// The bone of the nearest corner of a face.
    pub(crate) fn bone_at(&self, face: u32, barycentric: [f64; 3]) -> Bone {
        let [first, second, third] = barycentric;
        let corner = if first >= second && first >= third {
            0
        } else if second >= third {
            1
        } else {
            2
        };
        self.bones[self.faces[face as usize][corner] as usize]
    }

    pub(crate) fn nearest_bone(&self, position: DVec3) -> Bone {
        let nearest = self.index.closest(position);
        self.bone_at(nearest.face, nearest.barycentric)
    }

    /// Metres left along the arm before a cut; `cut` is 0 at the shoulder, 1 at the elbow, 2 at the wrist.
    pub(crate) fn before_on_arm(&self, position: DVec3, bone: Bone, cut: f64) -> f64 {
        if !bone.is_arm() {
            return f64::INFINITY;
        }
        let chain = if bone >= Bone::RightUpperArm {
            [Bone::RightUpperArm, Bone::RightForearm, Bone::RightHand]
        } else {
            [Bone::LeftUpperArm, Bone::LeftForearm, Bone::LeftHand]
        };
        let upper = usize::from(cut >= 1.0);
        let (start, end) = (self.joint(chain[upper]), self.joint(chain[upper + 1]));
        let direction = (end - start).normalize_or_zero();
        (start.lerp(end, cut - upper as f64) - position).dot(direction)
    }

    /// Middle and half extents (x, z) of the trunk and thighs at a height.
    pub(crate) fn torso_slice(&self, height: f64) -> (DVec3, f64, f64) {
        self.widest_torso_slice(height - 0.015, height + 0.015)
    }

    /// Middle and half extents (x, z) of the trunk and thighs between two heights.
    pub(crate) fn widest_torso_slice(&self, low_height: f64, high_height: f64) -> (DVec3, f64, f64) {
        let is_in_slice = |&(position, bone): &(&DVec3, &Bone)| {
            bone.is_torso_or_thigh() && position.y >= low_height && position.y <= high_height
        };
        let (low, high) = self
            .positions
            .iter()
            .zip(&self.bones)
            .filter(is_in_slice)
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), (&position, _)| {
                (low.min(position), high.max(position))
            });
        let middle = (low + high) * 0.5;
        let height = (low_height + high_height) * 0.5;
        (DVec3::new(middle.x, height, middle.z), (high.x - low.x) * 0.5, (high.z - low.z) * 0.5)
    }
}
