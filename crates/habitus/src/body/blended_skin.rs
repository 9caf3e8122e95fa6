//! Points that hang on several body vertices: their blended transforms, and how to undo them (P3 Eq. 3).

use glam::{DMat3, DVec3};
use nalgebra::Matrix3;

use super::skeleton::PosedSkeleton;
use super::surface::SkinWeights;

/// Bone weights of points that hang on body vertices: Σ ω_k w_{l_k, bone}. As many bones as it takes; the weights of a
/// point sum to one.
#[derive(Clone, Debug, PartialEq)]
pub struct BlendedSkin {
    starts: Vec<u32>,
    bones: Vec<u8>,
    weights: Vec<f64>,
}

/// The transform of one hanging point: `posed = linear · offset + origin`, with the offset in rest space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carrier {
    /// Posed from rest, without translation.
    pub linear: DMat3,
    /// Where the point's anchor on the body is when posed, in metres.
    pub origin: DVec3,
    /// Whether the blend of the bones was so nearly singular that its stretch had to be limited.
    pub is_limited: bool,
}

impl Carrier {
    /// The posed point of an offset from the anchor in rest space, in metres.
    pub fn pose(&self, offset: DVec3) -> DVec3 {
        self.linear * offset + self.origin
    }

    /// P3 Eq. 3 and 4: the offset in rest space of a posed point, in metres.
    pub fn unpose(&self, posed: DVec3) -> DVec3 {
        self.linear.inverse() * (posed - self.origin)
    }
}

impl BlendedSkin {
    /// The skin of points of which point `i` hangs on the body vertices and weights `i · slots .. (i + 1) · slots`.
    pub fn new(skin: &SkinWeights, slots: usize, body_vertices: &[u32], weights: &[f64]) -> Self {
        assert_eq!(body_vertices.len(), weights.len(), "one weight for each body vertex");
        let mut blended = Self::without_points();
        let mut sums: Vec<(u8, f64)> = Vec::new();
        let slots = slots.max(1);
        for (vertices, weights) in body_vertices.chunks_exact(slots).zip(weights.chunks_exact(slots)) {
            sums.clear();
            for (vertex, weight) in vertices.iter().zip(weights).filter(|(_, weight)| **weight > 0.0) {
                for (bone, share) in skin.of(*vertex as usize) {
                    let bone = bone as u8;
                    match sums.iter_mut().find(|(known, _)| *known == bone) {
                        Some((_, sum)) => *sum += weight * share,
                        None => sums.push((bone, weight * share)),
                    }
                }
            }
            sums.sort_unstable_by_key(|(bone, _)| *bone);
            blended.push(sums.iter().copied());
        }
        blended
    }

    /// The skin of a full table: the weights of point `i` are `table[i · bone_count .. (i + 1) · bone_count]`.
    pub fn of_table(bone_count: usize, table: &[f64]) -> Self {
        let mut blended = Self::without_points();
        for row in table.chunks_exact(bone_count.max(1)) {
            blended.push((0..).zip(row.iter().copied()).filter(|(_, weight)| *weight != 0.0));
        }
        blended
    }

    /// What [`BlendedSkin::of_table`] takes.
    ///
    /// # Panics
    /// When a point hangs on a bone beyond `bone_count`.
    pub fn table(&self, bone_count: usize) -> Vec<f64> {
        let mut table = vec![0.0; self.point_count() * bone_count];
        for point in 0..self.point_count() {
            for (bone, weight) in self.of(point) {
                assert!(bone < bone_count, "bone {bone} of {bone_count}");
                table[point * bone_count + bone] = weight;
            }
        }
        table
    }

    fn without_points() -> Self {
        Self { starts: vec![0], bones: Vec::new(), weights: Vec::new() }
    }

    fn push(&mut self, bones: impl Iterator<Item = (u8, f64)>) {
        for (bone, weight) in bones {
            self.bones.push(bone);
            self.weights.push(weight);
        }
        self.starts.push(self.bones.len() as u32);
    }

    /// Number of points.
    pub fn point_count(&self) -> usize {
        self.starts.len() - 1
    }

    /// The bones that move a point, with their weights.
    pub fn of(&self, point: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[point] as usize..self.starts[point + 1] as usize;
        self.bones[range.clone()]
            .iter()
            .zip(&self.weights[range])
            .map(|(bone, weight)| (usize::from(*bone), *weight))
    }

    /// The blended transform of each point (P3 Eq. 3) about its anchor in rest space, in metres.
    ///
    /// A blend of turned bones shrinks, down to nothing between legs that point apart, and then cannot be undone.
    /// Deviation: singular values below `smallest_stretch` are raised to it: continuous in the pose, and exact elsewhere.
    pub fn carriers_into(
        &self,
        anchors: &[DVec3],
        posed: &PosedSkeleton,
        smallest_stretch: f64,
        carriers: &mut Vec<Carrier>,
    ) {
        assert_eq!(anchors.len(), self.point_count(), "one anchor for each point");
        carriers.clear();
        carriers.extend(anchors.iter().enumerate().map(|(point, anchor)| {
            let (mut linear, mut origin) = (DMat3::ZERO, DVec3::ZERO);
            for (bone, weight) in self.of(point) {
                linear += posed.rotations[bone] * weight;
                origin += posed.translations[bone] * weight;
            }
            origin += linear * *anchor;
            // A blend of rotations stretches nothing, so no singular value is smaller than the determinant.
            if linear.determinant() >= smallest_stretch {
                return Carrier { linear, origin, is_limited: false };
            }
            let (linear, is_limited) = with_limited_stretch(linear, smallest_stretch);
            Carrier { linear, origin, is_limited }
        }));
    }

    /// [`BlendedSkin::carriers_into`] with a list of its own.
    pub fn carriers(&self, anchors: &[DVec3], posed: &PosedSkeleton, smallest_stretch: f64) -> Vec<Carrier> {
        let mut carriers = Vec::with_capacity(anchors.len());
        self.carriers_into(anchors, posed, smallest_stretch, &mut carriers);
        carriers
    }
}

/// The same turn with every singular value at least `smallest`; also whether one was less.
fn with_limited_stretch(linear: DMat3, smallest: f64) -> (DMat3, bool) {
    let matrix = Matrix3::from_column_slice(&linear.to_cols_array());
    let decomposed = matrix.svd(true, true);
    let (Some(mut left), Some(right)) = (decomposed.u, decomposed.v_t) else {
        return (DMat3::IDENTITY, true);
    };
    let mut values = decomposed.singular_values;
    if left.determinant() * right.determinant() < 0.0 {
        // A mirrored blend: the smallest value is negative in truth, and is raised past zero.
        let least = values.imin();
        left.column_mut(least).neg_mut();
        values[least] = -values[least];
    }
    if values.min() >= smallest {
        return (linear, false);
    }
    let limited = left * Matrix3::from_diagonal(&values.map(|value| value.max(smallest))) * right;
    (DMat3::from_cols_slice(limited.as_slice()), true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::fixture;

    const SMALLEST: f64 = 0.2;

    /// Every point hangs on two body vertices far apart, so that most blends mix several bones.
    fn hanging() -> (crate::body::BodyModel, Vec<u32>, Vec<f64>) {
        let model = fixture::model();
        let count = model.vertex_count() as u32;
        let vertices = (0..60).flat_map(|k| [(k * 37) % count, (k * 53 + 11) % count]).collect();
        let weights =
            (0..60).flat_map(|k| [0.5 + 0.008 * f64::from(k), 0.5 - 0.008 * f64::from(k)]).collect();
        (model, vertices, weights)
    }

    fn anchors(rest: &[DVec3], vertices: &[u32], weights: &[f64]) -> Vec<DVec3> {
        let point = |(v, w): (&[u32], &[f64])| rest[v[0] as usize] * w[0] + rest[v[1] as usize] * w[1];
        vertices.chunks(2).zip(weights.chunks(2)).map(point).collect()
    }

    #[test]
    fn unposing_undoes_posing_in_extreme_poses_too() {
        let (model, vertices, weights) = hanging();
        let rest = model.mean_vertices();
        let skin = BlendedSkin::new(model.surface().skin(), 2, &vertices, &weights);
        let anchors = anchors(rest, &vertices, &weights);
        let mut limited = 0;
        for round in 0..20 {
            let pose: Vec<f64> = (0..30).map(|k| 3.0 * (1.3 * f64::from(round * 30 + k)).sin()).collect();
            let posed = model.skeleton().pose(&model.joints(rest), &pose);
            for (point, carrier) in skin.carriers(&anchors, &posed, SMALLEST).iter().enumerate() {
                let offset = DVec3::new(0.1, -0.05, 0.2) * (0.1 * point as f64).cos();
                assert!(carrier.unpose(carrier.pose(offset)).distance(offset) < 1e-9);
                limited += usize::from(carrier.is_limited);
            }
        }
        assert!(limited > 0, "the poses are extreme enough to meet the limit");
    }

    #[test]
    fn a_well_conditioned_blend_is_the_paper_s() {
        let (model, vertices, weights) = hanging();
        let rest = model.mean_vertices();
        let skin = BlendedSkin::new(model.surface().skin(), 2, &vertices, &weights);
        let anchors = anchors(rest, &vertices, &weights);
        let pose: Vec<f64> = (0..30).map(|k| 0.3 * (1.3 * f64::from(k)).sin()).collect();
        let posed = model.skeleton().pose(&model.joints(rest), &pose);
        let posed_at = |point: DVec3, vertex: u32| -> DVec3 {
            let bones = model.surface().skin().of(vertex as usize);
            bones.map(|(bone, w)| (posed.rotations[bone] * point + posed.translations[bone]) * w).sum()
        };
        for (point, carrier) in skin.carriers(&anchors, &posed, SMALLEST).iter().enumerate() {
            let offset = DVec3::new(0.1, -0.05, 0.2);
            let in_rest = anchors[point] + offset;
            let printed: DVec3 =
                (0..2).map(|k| posed_at(in_rest, vertices[2 * point + k]) * weights[2 * point + k]).sum();
            assert!(!carrier.is_limited && carrier.pose(offset).distance(printed) < 1e-12);
        }
    }

    #[test]
    fn the_limit_is_continuous_and_never_mirrors() {
        let between = |angle: f64| (DMat3::IDENTITY + DMat3::from_rotation_x(angle)) * 0.5;
        let mut before = between(2.0);
        for step in 0..=1000 {
            // Up to just below the straight angle, where the sense of turn is undecided.
            let (limited, _) = with_limited_stretch(between(2.0 + step as f64 * 1.141e-3), SMALLEST);
            assert!(limited.determinant() > 0.9 * SMALLEST * SMALLEST);
            assert!((limited - before).to_cols_array().iter().all(|value| value.abs() < 5e-3), "{step}");
            before = limited;
        }
    }
}
