//! The moving surface of a body: a linear identity space, skin weights and joints that follow the shape.

use glam::{DMat3, DVec3};

use super::skeleton::{PosedSkeleton, Skeleton};

/// Identity coefficients in standard deviations of the population (P2's β_i / σ_i), inside ±3.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct IdentityCoefficients(pub Vec<f64>);

impl IdentityCoefficients {
    /// P2 §4.1: the identity stays inside ±3σ.
    pub const LIMIT: f64 = 3.0;

    /// The mean body.
    pub fn mean(count: usize) -> Self {
        Self(vec![0.0; count])
    }
}

/// Up to four bones and their weights for each vertex; the weights of a vertex sum to one.
#[derive(Clone, Debug, PartialEq)]
pub struct SkinWeights {
    /// Bones of each vertex.
    pub bones: Vec<[u8; 4]>,
    /// Weights of those bones; unused slots are zero.
    pub weights: Vec<[f64; 4]>,
}

impl SkinWeights {
    /// The bones that move a vertex, with their weights.
    pub fn of(&self, vertex: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let weights = self.weights[vertex];
        self.bones[vertex]
            .into_iter()
            .zip(weights)
            .filter(|(_, weight)| *weight > 0.0)
            .map(|(bone, weight)| (usize::from(bone), weight))
    }

    /// P1 Eq. 2 / P2 Eq. 2: Σ ω_ij T_j(Θ) s_i, one posed vertex for each rest vertex, in metres.
    pub fn apply_into(&self, rest: &[DVec3], posed: &PosedSkeleton, vertices: &mut Vec<DVec3>) {
        assert_eq!(rest.len(), self.weights.len(), "one rest vertex for each row of weights");
        vertices.clear();
        vertices.extend(rest.iter().enumerate().map(|(vertex, position)| {
            let mut sum = DVec3::ZERO;
            for (bone, weight) in self.of(vertex) {
                sum += (posed.rotations[bone] * *position + posed.translations[bone]) * weight;
            }
            sum
        }));
    }
}

/// Joints as a linear function of the identity: the sparse regressor applied to the space.
#[derive(Clone, Debug, PartialEq)]
pub struct JointMap {
    /// Joints of the mean body in metres.
    pub mean: Vec<DVec3>,
    /// `basis[component][joint]`: metres per standard deviation.
    pub basis: Vec<Vec<DVec3>>,
}

/// Some or all vertices of a body model, with all that is needed to move them.
#[derive(Clone, Debug)]
pub struct BodySurface {
    pub(super) skeleton: Skeleton,
    pub(super) mean: Vec<DVec3>,
    /// `basis[(vertex · 3 + axis) · component_count + component]`, metres per standard deviation.
    /// Vertex-major, because both the instance and the normal equations walk vertex by vertex.
    pub(super) basis: Vec<f32>,
    pub(super) component_count: usize,
    pub(super) skin: SkinWeights,
    pub(super) joints: JointMap,
}

impl BodySurface {
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.mean.len()
    }

    /// Number of identity components.
    pub fn component_count(&self) -> usize {
        self.component_count
    }

    /// The skeleton that moves the surface.
    pub fn skeleton(&self) -> &Skeleton {
        &self.skeleton
    }

    /// Vertices of the mean body in metres.
    pub fn mean_vertices(&self) -> &[DVec3] {
        &self.mean
    }

    /// Skin weights.
    pub fn skin(&self) -> &SkinWeights {
        &self.skin
    }

    /// The joints as a function of the identity.
    pub fn joint_map(&self) -> &JointMap {
        &self.joints
    }

    /// The 3 × component_count block of the basis that moves one vertex, row by row.
    pub fn vertex_basis(&self, vertex: usize) -> &[f32] {
        let width = 3 * self.component_count;
        &self.basis[vertex * width..(vertex + 1) * width]
    }

    /// The same body with only the given vertices.
    pub fn subset(&self, vertices: &[u32]) -> Self {
        let pick = |v: &u32| *v as usize;
        Self {
            skeleton: self.skeleton.clone(),
            mean: vertices.iter().map(|v| self.mean[pick(v)]).collect(),
            basis: vertices.iter().flat_map(|v| self.vertex_basis(pick(v)).iter().copied()).collect(),
            component_count: self.component_count,
            skin: SkinWeights {
                bones: vertices.iter().map(|v| self.skin.bones[pick(v)]).collect(),
                weights: vertices.iter().map(|v| self.skin.weights[pick(v)]).collect(),
            },
            joints: self.joints.clone(),
        }
    }

    /// The same body with only the first components of the identity space.
    pub fn truncated(&self, component_count: usize) -> Self {
        let kept = component_count.min(self.component_count);
        let mut basis = Vec::with_capacity(self.mean.len() * 3 * kept);
        for row in self.basis.chunks_exact(self.component_count.max(1)) {
            basis.extend_from_slice(&row[..kept]);
        }
        Self {
            basis,
            component_count: kept,
            joints: JointMap { mean: self.joints.mean.clone(), basis: self.joints.basis[..kept].to_vec() },
            ..self.clone()
        }
    }

    /// The same body with further components behind its own: vertex directions and the joints' that follow from them,
    /// both in metres for a coefficient of one.
    pub fn with_components(&self, directions: &[Vec<DVec3>], joints: Vec<Vec<DVec3>>) -> Self {
        let own = self.component_count;
        let width = own + directions.len();
        let mut basis = Vec::with_capacity(3 * width * self.mean.len());
        for (vertex, rows) in self.basis.chunks_exact((3 * own).max(1)).enumerate() {
            for axis in 0..3 {
                basis.extend_from_slice(&rows[axis * own..(axis + 1) * own]);
                basis.extend(directions.iter().map(|direction| direction[vertex][axis] as f32));
            }
        }
        let mut all_joints = self.joints.basis.clone();
        all_joints.extend(joints);
        Self {
            basis,
            component_count: width,
            joints: JointMap { mean: self.joints.mean.clone(), basis: all_joints },
            ..self.clone()
        }
    }

    /// P1 Eq. 1 / P2 Eq. 1: rest vertices of an identity, in metres; missing coefficients are zero.
    pub fn rest_vertices(&self, identity: &[f64]) -> Vec<DVec3> {
        let width = self.component_count;
        let used = identity.len().min(width);
        if used == 0 {
            return self.mean.clone();
        }
        let coefficients = &identity[..used];
        self.mean
            .iter()
            .enumerate()
            .map(|(vertex, mean)| {
                let rows = self.vertex_basis(vertex);
                let offset = |axis: usize| dot(&rows[axis * width..axis * width + used], coefficients);
                *mean + DVec3::new(offset(0), offset(1), offset(2))
            })
            .collect()
    }

    /// Joints of an identity in rest space, in metres.
    pub fn rest_joints(&self, identity: &[f64]) -> Vec<DVec3> {
        let mut joints = self.joints.mean.clone();
        for (coefficient, directions) in identity.iter().zip(&self.joints.basis) {
            for (joint, direction) in joints.iter_mut().zip(directions) {
                *joint += *direction * *coefficient;
            }
        }
        joints
    }

    /// P1 Eq. 2 / P2 Eq. 2: linear blend skinning of rest vertices, in metres.
    pub fn skin_vertices_into(&self, rest: &[DVec3], posed: &PosedSkeleton, vertices: &mut Vec<DVec3>) {
        self.skin.apply_into(rest, posed, vertices);
    }

    /// Linear blend skinning of rest vertices, in metres.
    pub fn skin_vertices(&self, rest: &[DVec3], posed: &PosedSkeleton) -> Vec<DVec3> {
        let mut vertices = Vec::with_capacity(rest.len());
        self.skin_vertices_into(rest, posed, &mut vertices);
        vertices
    }

    /// Rotation part of the blended transform of a vertex (P3 Eq. 3's linear part).
    pub fn blended_rotation(&self, vertex: usize, posed: &PosedSkeleton) -> DMat3 {
        let mut sum = DMat3::ZERO;
        for (bone, weight) in self.skin.of(vertex) {
            sum += posed.rotations[bone] * weight;
        }
        sum
    }
}

/// The basis is stored in f32, but summed in f64: a rest vertex that jumps in steps of f32 has no derivative that
/// differences could confirm. Eight sums run side by side, so that the loop is vectorised.
fn dot(basis: &[f32], coefficients: &[f64]) -> f64 {
    const LANES: usize = 8;
    let (blocks, rest) = basis.as_chunks::<LANES>();
    let (coefficient_blocks, coefficient_rest) = coefficients.as_chunks::<LANES>();
    let mut lanes = [0.0; LANES];
    for (x, y) in blocks.iter().zip(coefficient_blocks) {
        for lane in 0..LANES {
            lanes[lane] += f64::from(x[lane]) * y[lane];
        }
    }
    let tail: f64 = rest.iter().zip(coefficient_rest).map(|(x, y)| f64::from(*x) * y).sum();
    tail + lanes.into_iter().sum::<f64>()
}

#[cfg(test)]
mod tests;
