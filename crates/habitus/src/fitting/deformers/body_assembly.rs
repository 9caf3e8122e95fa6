//! Normal equations of a posed body, assembled bone by bone.
//!
//! A scalar residual with direction n at a vertex that bones j move with weights w_j depends on the pose
//! only through the wrenches F_j = w_j (x_j × n, n), where x_j is the vertex as bone j alone would move
//! it; the derivative by pose parameter k is Σ_j F_j · twist_k. On the identity it depends through the
//! rest-space direction q = R̄ᵀ n and through the same wrenches' forces, because the joints move with the
//! shape. So we sum 6 × 6 blocks for pairs of bones and apply the skeleton once at the end (P2 Eq. 3).

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use super::super::deformer::VertexResidual;
use crate::body::{BodySurface, PosedSkeleton};

/// A force and its moment about the origin, acting on one bone.
type Wrench = [f64; 6];

/// Which derivatives an assembly gathers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gather {
    /// Pose only; the identity is fixed.
    Pose,
    /// Pose and identity.
    PoseAndIdentity,
}

/// Sums over residuals of one posed body, before the skeleton is applied.
pub struct BodyAssembly {
    gather: Gather,
    with_matrix: bool,
    bone_count: usize,
    component_count: usize,
    /// Σ weight · residual².
    pub value: f64,
    wrench_gradient: Vec<Wrench>,
    /// Blocks (a, b) with a ≤ b at `a · bone_count + b`, row-major.
    wrench_blocks: Vec<[f64; 36]>,
    touched: Vec<bool>,
    /// For each bone 6 rows of component_count: Σ weight · wrench ⊗ (basisᵀ q).
    cross: Vec<f64>,
    moments: ShapeMoments,
    row: Vec<f64>,
}

/// For each vertex Σ weight · q qᵀ and Σ weight · residual · q, in rest space: the identity's share of the
/// normal equations before the basis is applied. It may be summed over many frames and applied once.
pub struct ShapeMoments {
    /// Six entries (xx, xy, xz, yy, yz, zz) for each vertex.
    pub second: Vec<[f64; 6]>,
    /// First moment for each vertex.
    pub first: Vec<DVec3>,
}

impl ShapeMoments {
    /// Zero moments.
    pub fn new(vertex_count: usize) -> Self {
        Self { second: vec![[0.0; 6]; vertex_count], first: vec![DVec3::ZERO; vertex_count] }
    }

    fn add(&mut self, vertex: usize, weight: f64, value: f64, q: DVec3) {
        let wq = q * weight;
        let second = &mut self.second[vertex];
        second[0] += wq.x * q.x;
        second[1] += wq.x * q.y;
        second[2] += wq.x * q.z;
        second[3] += wq.y * q.y;
        second[4] += wq.y * q.z;
        second[5] += wq.z * q.z;
        self.first[vertex] += wq * value;
    }

    /// Adds another sum of the same body.
    pub fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.second.iter_mut().zip(&other.second) {
            for (a, b) in mine.iter_mut().zip(theirs) {
                *a += b;
            }
        }
        for (mine, theirs) in self.first.iter_mut().zip(&other.first) {
            *mine += *theirs;
        }
    }

    /// Applies the basis: adds Σ Aᵀ M A to `matrix` and Σ Aᵀ m to `gradient`.
    pub fn apply(&self, surface: &BodySurface, matrix: Option<&mut DMatrix<f64>>, gradient: &mut [f64]) {
        let width = surface.component_count();
        for (vertex, first) in self.first.iter().enumerate() {
            if *first == DVec3::ZERO {
                continue;
            }
            let rows = surface.vertex_basis(vertex);
            for (axis, moment) in first.to_array().into_iter().enumerate() {
                for (sum, entry) in gradient.iter_mut().zip(&rows[axis * width..(axis + 1) * width]) {
                    *sum += moment * f64::from(*entry);
                }
            }
        }
        if let Some(matrix) = matrix {
            self.apply_second(surface, matrix);
        }
    }

    /// Aᵀ M A = (Lᵀ A)ᵀ (Lᵀ A) with M = L Lᵀ, stacked in panels so that one matrix product does the work.
    fn apply_second(&self, surface: &BodySurface, matrix: &mut DMatrix<f64>) {
        const PANEL_VERTICES: usize = 128;
        let width = surface.component_count();
        let active: Vec<usize> =
            (0..self.second.len()).filter(|vertex| self.second[*vertex] != [0.0; 6]).collect();
        for panel in active.chunks(PANEL_VERTICES) {
            // A moment of few residuals is singular: rows of zeros stay out of the product.
            let factors: Vec<[f64; 6]> =
                panel.iter().map(|vertex| lower_factor(&self.second[*vertex])).collect();
            let row_count = factors.iter().map(|factor| 1 + rank_beyond_one(factor)).sum();
            let columns = moving_components(surface, panel);
            let mut stacked = DMatrix::<f64>::zeros(row_count, columns.len());
            let mut first_row = 0;
            for (factor, vertex) in factors.iter().zip(panel) {
                let rank = 1 + rank_beyond_one(factor);
                let rows = surface.vertex_basis(*vertex);
                for (column, component) in columns.iter().enumerate() {
                    let a = [
                        f64::from(rows[*component]),
                        f64::from(rows[width + component]),
                        f64::from(rows[2 * width + component]),
                    ];
                    let products = [
                        factor[0] * a[0] + factor[1] * a[1] + factor[3] * a[2],
                        factor[2] * a[1] + factor[4] * a[2],
                        factor[5] * a[2],
                    ];
                    for (row, product) in products.into_iter().take(rank).enumerate() {
                        stacked[(first_row + row, column)] = product;
                    }
                }
                first_row += rank;
            }
            // Not gemm_tr, which is a loop of dot products.
            if columns.len() == width {
                matrix.gemm(1.0, &stacked.transpose(), &stacked, 1.0);
                continue;
            }
            let mut product = DMatrix::<f64>::zeros(columns.len(), columns.len());
            product.gemm(1.0, &stacked.transpose(), &stacked, 0.0);
            for (column, target) in columns.iter().enumerate() {
                for (row, other) in columns.iter().enumerate() {
                    matrix[(*other, *target)] += product[(row, column)];
                }
            }
        }
    }
}

/// Components that move any of these vertices: local shapes reach few, and their zeros stay out of the products.
fn moving_components(surface: &BodySurface, vertices: &[usize]) -> Vec<usize> {
    let width = surface.component_count();
    let mut moves = vec![false; width];
    for vertex in vertices {
        for row in surface.vertex_basis(*vertex).chunks_exact(width.max(1)) {
            moves.iter_mut().zip(row).for_each(|(moves, entry)| *moves |= *entry != 0.0);
        }
    }
    (0..width).filter(|component| moves[*component]).collect()
}

/// How many rows after the first a factor has that are not zero.
fn rank_beyond_one(factor: &[f64; 6]) -> usize {
    if factor[5] != 0.0 { 2 } else { usize::from(factor[2] != 0.0 || factor[4] != 0.0) }
}

/// Lower factor of a positive semidefinite 3 × 3 matrix: (l00, l10, l11, l20, l21, l22).
fn lower_factor(m: &[f64; 6]) -> [f64; 6] {
    let [xx, xy, xz, yy, yz, zz] = *m;
    let divide = |a: f64, b: f64| if b > 0.0 { a / b } else { 0.0 };
    let l00 = xx.max(0.0).sqrt();
    let (l10, l20) = (divide(xy, l00), divide(xz, l00));
    // Moments of one or two residuals are singular: rounding may leave a pivot below zero or dust above it.
    let dust = 1e-14 * (xx + yy + zz);
    let pivot = |value: f64| if value > dust { value.sqrt() } else { 0.0 };
    let l11 = pivot(yy - l10 * l10);
    let l21 = divide(yz - l20 * l10, l11);
    let l22 = pivot(zz - l20 * l20 - l21 * l21);
    [l00, l10, l11, l20, l21, l22]
}

/// Normal equations of one frame: pose first, then identity.
pub struct FrameEquations {
    /// Σ weight · residual².
    pub value: f64,
    /// Half gradient by the pose.
    pub pose_gradient: DVector<f64>,
    /// Pose × pose.
    pub pose_matrix: DMatrix<f64>,
    /// Half gradient by the identity without the shape moments' share.
    pub identity_gradient: DVector<f64>,
    /// Identity × identity without the shape moments' share.
    pub identity_matrix: DMatrix<f64>,
    /// Pose × identity.
    pub pose_identity: DMatrix<f64>,
}

impl BodyAssembly {
    /// An empty sum for one posed body.
    pub fn new(surface: &BodySurface, gather: Gather, with_matrix: bool) -> Self {
        let bone_count = surface.skeleton().bones().len();
        let component_count = if gather == Gather::Pose { 0 } else { surface.component_count() };
        let moment_count = if gather == Gather::Pose { 0 } else { surface.vertex_count() };
        Self {
            gather,
            with_matrix,
            bone_count,
            component_count,
            value: 0.0,
            wrench_gradient: vec![[0.0; 6]; bone_count],
            wrench_blocks: vec![[0.0; 36]; bone_count * bone_count],
            touched: vec![false; bone_count * bone_count],
            cross: vec![0.0; if with_matrix { bone_count * 6 * component_count } else { 0 }],
            moments: ShapeMoments::new(moment_count),
            row: vec![0.0; component_count],
        }
    }

    /// Adds residuals of a body with these rest and posed vertices.
    pub fn add(
        &mut self,
        surface: &BodySurface,
        posed: &PosedSkeleton,
        rest: &[DVec3],
        vertices: &[DVec3],
        residuals: &[VertexResidual],
    ) {
        for residual in residuals {
            let vertex = residual.vertex as usize;
            let value = residual.value(vertices[vertex]);
            self.value += residual.weight * value * value;
            let mut wrenches = [(0_usize, [0.0; 6]); 4];
            let mut wrench_count = 0;
            let mut q = DVec3::ZERO;
            for (bone, skin_weight) in surface.skin().of(vertex) {
                let rotation = &posed.rotations[bone];
                let position = *rotation * rest[vertex] + posed.translations[bone];
                let force = residual.direction * skin_weight;
                let moment = position.cross(force);
                wrenches[wrench_count] = (bone, [moment.x, moment.y, moment.z, force.x, force.y, force.z]);
                wrench_count += 1;
                if self.gather == Gather::PoseAndIdentity {
                    q += rotation.transpose() * force;
                }
            }
            let wrenches = &mut wrenches[..wrench_count];
            wrenches.sort_unstable_by_key(|(bone, _)| *bone);
            self.add_wrenches(wrenches, residual.weight, value);
            if self.gather == Gather::PoseAndIdentity {
                self.moments.add(vertex, residual.weight, value, q);
                self.add_cross(surface, vertex, wrenches, residual.weight, q);
            }
        }
    }

    fn add_wrenches(&mut self, wrenches: &[(usize, Wrench)], weight: f64, value: f64) {
        for (slot, (bone, wrench)) in wrenches.iter().enumerate() {
            let scaled = wrench.map(|entry| entry * weight);
            for (sum, entry) in self.wrench_gradient[*bone].iter_mut().zip(&scaled) {
                *sum += entry * value;
            }
            if !self.with_matrix {
                continue;
            }
            for (other, other_wrench) in &wrenches[slot..] {
                let pair = bone * self.bone_count + other;
                self.touched[pair] = true;
                let block = &mut self.wrench_blocks[pair];
                for (row, entry) in scaled.iter().enumerate() {
                    for (column, factor) in other_wrench.iter().enumerate() {
                        block[6 * row + column] += entry * factor;
                    }
                }
            }
        }
    }

    fn add_cross(
        &mut self,
        surface: &BodySurface,
        vertex: usize,
        wrenches: &[(usize, Wrench)],
        weight: f64,
        q: DVec3,
    ) {
        if !self.with_matrix {
            return;
        }
        let width = self.component_count;
        let rows = surface.vertex_basis(vertex);
        let (x, rest) = rows.split_at(width);
        let (y, z) = rest.split_at(width);
        let q = q * weight;
        for (k, sum) in self.row.iter_mut().enumerate() {
            *sum = q.x * f64::from(x[k]) + q.y * f64::from(y[k]) + q.z * f64::from(z[k]);
        }
        for (bone, wrench) in wrenches {
            for (axis, factor) in wrench.iter().enumerate() {
                let start = (bone * 6 + axis) * width;
                for (sum, entry) in self.cross[start..start + width].iter_mut().zip(&self.row) {
                    *sum += factor * entry;
                }
            }
        }
    }

    /// The identity's per-vertex moments.
    pub fn moments(&self) -> &ShapeMoments {
        &self.moments
    }

    /// Takes the identity's per-vertex moments.
    pub fn into_moments(self) -> ShapeMoments {
        self.moments
    }

    /// Applies the skeleton.
    pub fn equations(&self, surface: &BodySurface, posed: &PosedSkeleton) -> FrameEquations {
        let pose_count = posed.twists.len();
        let skeleton = surface.skeleton();
        let mut equations = FrameEquations {
            value: self.value,
            pose_gradient: DVector::zeros(pose_count),
            pose_matrix: DMatrix::zeros(pose_count, pose_count),
            identity_gradient: DVector::zeros(self.component_count),
            identity_matrix: DMatrix::zeros(self.component_count, self.component_count),
            pose_identity: DMatrix::zeros(pose_count, self.component_count),
        };
        let twists: Vec<Wrench> = posed
            .twists
            .iter()
            .map(|t| [t.angular.x, t.angular.y, t.angular.z, t.linear.x, t.linear.y, t.linear.z])
            .collect();
        for bone in 0..self.bone_count {
            for k in skeleton.chain(bone) {
                equations.pose_gradient[*k] += dot6(&twists[*k], &self.wrench_gradient[bone]);
            }
        }
        if self.with_matrix {
            for a in 0..self.bone_count {
                for b in a..self.bone_count {
                    if self.touched[a * self.bone_count + b] {
                        self.add_pose_block(surface, &twists, a, b, &mut equations.pose_matrix);
                    }
                }
            }
        }
        if self.component_count > 0 {
            self.add_identity(surface, posed, &twists, &mut equations);
        }
        equations
    }

    fn add_pose_block(
        &self,
        surface: &BodySurface,
        twists: &[Wrench],
        a: usize,
        b: usize,
        matrix: &mut DMatrix<f64>,
    ) {
        let block = &self.wrench_blocks[a * self.bone_count + b];
        for column in surface.skeleton().chain(b) {
            let image = multiply6(block, &twists[*column]);
            for row in surface.skeleton().chain(a) {
                let entry = dot6(&twists[*row], &image);
                matrix[(*row, *column)] += entry;
                if a != b {
                    matrix[(*column, *row)] += entry;
                }
            }
        }
    }

    /// The joints' share: d translation_j = d posed_joint_j − R_j d joint_j pulls on every wrench's force.
    ///
    /// With G the translations' derivatives, F the forces' share of `cross` and K the blocks between forces, the identity
    /// gets Fᵀ G + Gᵀ F + Gᵀ K G. All bones are stacked, so that a few matrix products do the work.
    fn add_identity(
        &self,
        surface: &BodySurface,
        posed: &PosedSkeleton,
        twists: &[Wrench],
        equations: &mut FrameEquations,
    ) {
        let width = self.component_count;
        let derivatives = translation_derivatives(surface, posed);
        let translations =
            DMatrix::from_fn(3 * self.bone_count, width, |row, k| derivatives[k][row / 3][row % 3]);
        let pulls =
            DVector::from_fn(3 * self.bone_count, |row, _| self.wrench_gradient[row / 3][3 + row % 3]);
        equations.identity_gradient.gemv_tr(1.0, &translations, &pulls, 1.0);
        if !self.with_matrix {
            return;
        }
        let mut wrenches = DMatrix::from_row_slice(6 * self.bone_count, width, &self.cross);
        let caused = self.wrenches_of_translations() * &translations;
        let half = DMatrix::from_fn(3 * self.bone_count, width, |row, k| {
            let force = 6 * (row / 3) + 3 + row % 3;
            wrenches[(force, k)] + 0.5 * caused[(force, k)]
        });
        let product = translations.transpose() * half;
        equations.identity_matrix += product.transpose();
        equations.identity_matrix += product;
        wrenches += caused;
        let mut motions = DMatrix::zeros(equations.pose_identity.nrows(), 6 * self.bone_count);
        for bone in 0..self.bone_count {
            for parameter in surface.skeleton().chain(bone) {
                for (axis, entry) in twists[*parameter].iter().enumerate() {
                    motions[(*parameter, 6 * bone + axis)] = *entry;
                }
            }
        }
        equations.pose_identity.gemm(1.0, &motions, &wrenches, 1.0);
    }

    /// The wrench on each bone (6 rows) that each bone's translation (3 columns) causes.
    fn wrenches_of_translations(&self) -> DMatrix<f64> {
        let mut matrix = DMatrix::zeros(6 * self.bone_count, 3 * self.bone_count);
        for a in 0..self.bone_count {
            for b in a..self.bone_count {
                if !self.touched[a * self.bone_count + b] {
                    continue;
                }
                let block = &self.wrench_blocks[a * self.bone_count + b];
                for row in 0..6 {
                    for axis in 0..3 {
                        matrix[(6 * a + row, 3 * b + axis)] = block[6 * row + 3 + axis];
                        matrix[(6 * b + row, 3 * a + axis)] = block[6 * (3 + axis) + row];
                    }
                }
            }
        }
        matrix
    }
}

/// `[component][bone]`: derivative of each bone's translation by each identity coefficient, in metres.
pub fn translation_derivatives(surface: &BodySurface, posed: &PosedSkeleton) -> Vec<Vec<DVec3>> {
    let bones = surface.skeleton().bones();
    surface
        .joint_map()
        .basis
        .iter()
        .take(surface.component_count())
        .map(|joints| {
            let mut posed_joints = vec![joints[0]; bones.len()];
            for (bone, parent) in bones.iter().enumerate().filter_map(|(b, bone)| Some((b, bone.parent?))) {
                posed_joints[bone] =
                    posed_joints[parent] + posed.rotations[parent] * (joints[bone] - joints[parent]);
            }
            (0..bones.len()).map(|bone| posed_joints[bone] - posed.rotations[bone] * joints[bone]).collect()
        })
        .collect()
}

fn dot6(a: &Wrench, b: &Wrench) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn multiply6(block: &[f64; 36], vector: &Wrench) -> Wrench {
    std::array::from_fn(|row| (0..6).map(|column| block[6 * row + column] * vector[column]).sum())
}

#[cfg(test)]
mod tests;
