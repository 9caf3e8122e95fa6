//! A body model as a deformer: identity and pose to vertices (P1 §3.2, P2 §4).

use std::borrow::Cow;

use glam::DVec3;
use habitus_optimize::{Sink, Wanted};
use nalgebra::DMatrix;

use super::super::deformer::{DeformedSurface, Deformer, DerivativeColumns, VertexResidual};
use super::body_assembly::{BodyAssembly, Gather, translation_derivatives};
use crate::body::{BodySurface, PosedSkeleton};

/// Which parameters are solved for, and what the fixed ones are.
#[derive(Clone, Debug)]
pub enum FreeParameters {
    /// Pose; the rest vertices and joints of the fixed identity are prepared once.
    Pose {
        /// Rest vertices in metres.
        rest: Vec<DVec3>,
        /// Rest joints in metres.
        joints: Vec<DVec3>,
    },
    /// Identity; the pose is fixed.
    Identity {
        /// The pose vector.
        pose: Vec<f64>,
    },
    /// Identity first, then pose.
    IdentityAndPose,
}

/// Identity and pose parameters of a body.
pub struct BodyParameters<'a> {
    surface: &'a BodySurface,
    free: FreeParameters,
}

impl<'a> BodyParameters<'a> {
    /// A deformer over `surface`.
    pub fn new(surface: &'a BodySurface, free: FreeParameters) -> Self {
        Self { surface, free }
    }

    /// A deformer over poses of one identity.
    pub fn of_pose(surface: &'a BodySurface, identity: &[f64]) -> Self {
        let rest = surface.rest_vertices(identity);
        Self { surface, free: FreeParameters::Pose { rest, joints: surface.rest_joints(identity) } }
    }

    fn identity_count(&self) -> usize {
        match self.free {
            FreeParameters::Pose { .. } => 0,
            _ => self.surface.component_count(),
        }
    }
}

impl Deformer for BodyParameters<'_> {
    fn parameter_count(&self) -> usize {
        let pose_length = self.surface.skeleton().pose_length();
        match self.free {
            FreeParameters::Pose { .. } => pose_length,
            FreeParameters::Identity { .. } => self.surface.component_count(),
            FreeParameters::IdentityAndPose => self.surface.component_count() + pose_length,
        }
    }

    fn deform<'b>(&'b self, parameters: &'b [f64]) -> Box<dyn DeformedSurface + 'b> {
        let (identity, own_pose) = parameters.split_at(self.identity_count());
        let (rest, joints, pose) = match &self.free {
            FreeParameters::Pose { rest, joints } => {
                (Cow::Borrowed(&rest[..]), Cow::Borrowed(&joints[..]), own_pose)
            }
            free => (
                Cow::Owned(self.surface.rest_vertices(identity)),
                Cow::Owned(self.surface.rest_joints(identity)),
                match free {
                    FreeParameters::Identity { pose } => &pose[..],
                    _ => own_pose,
                },
            ),
        };
        let posed = self.surface.skeleton().pose(&joints, pose);
        let vertices = self.surface.skin_vertices(&rest, &posed);
        Box::new(PosedBody { body: self, rest, posed, vertices })
    }
}

struct PosedBody<'a> {
    body: &'a BodyParameters<'a>,
    rest: Cow<'a, [DVec3]>,
    posed: PosedSkeleton,
    vertices: Vec<DVec3>,
}

impl PosedBody<'_> {
    fn has_free_pose(&self) -> bool {
        !matches!(self.body.free, FreeParameters::Identity { .. })
    }
}

impl DeformedSurface for PosedBody<'_> {
    fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    fn vertex_derivatives(&self, vertex: usize, columns: &mut DerivativeColumns) {
        let surface = self.body.surface;
        let identity_count = self.body.identity_count();
        if identity_count > 0 {
            let rotation = surface.blended_rotation(vertex, &self.posed);
            let rows = surface.vertex_basis(vertex);
            for (k, translations) in translation_derivatives(surface, &self.posed).iter().enumerate() {
                let direction = DVec3::new(
                    f64::from(rows[k]),
                    f64::from(rows[identity_count + k]),
                    f64::from(rows[2 * identity_count + k]),
                );
                let moved: DVec3 =
                    surface.skin().of(vertex).map(|(bone, weight)| translations[bone] * weight).sum();
                columns.push((k, rotation * direction + moved));
            }
        }
        if self.has_free_pose() {
            let mut derivatives = vec![DVec3::ZERO; self.posed.twists.len()];
            for (bone, weight) in surface.skin().of(vertex) {
                let position = self.posed.rotations[bone] * self.rest[vertex] + self.posed.translations[bone];
                for k in surface.skeleton().chain(bone) {
                    derivatives[*k] += self.posed.twists[*k].at(position) * weight;
                }
            }
            columns.extend(derivatives.into_iter().enumerate().map(|(k, d)| (identity_count + k, d)));
        }
    }

    fn add_vertex_residuals(&self, residuals: &[VertexResidual], sink: &mut dyn Sink) {
        let wanted = sink.wanted();
        if wanted == Wanted::Value {
            let value = residuals
                .iter()
                .map(|residual| {
                    let distance = residual.value(self.vertices[residual.vertex as usize]);
                    residual.weight * distance * distance
                })
                .sum();
            sink.add_assembled(value, &[], &[], None);
            return;
        }
        let surface = self.body.surface;
        let identity_count = self.body.identity_count();
        let gather = if identity_count > 0 { Gather::PoseAndIdentity } else { Gather::Pose };
        let with_matrix = wanted == Wanted::NormalEquations;
        let mut assembly = BodyAssembly::new(surface, gather, with_matrix);
        assembly.add(surface, &self.posed, &self.rest, &self.vertices, residuals);
        let mut equations = assembly.equations(surface, &self.posed);
        if identity_count > 0 {
            let matrix = with_matrix.then_some(&mut equations.identity_matrix);
            assembly.moments().apply(surface, matrix, equations.identity_gradient.as_mut_slice());
        }
        let pose_count = if self.has_free_pose() { equations.pose_gradient.len() } else { 0 };
        let total = identity_count + pose_count;
        let mut gradient = vec![0.0; total];
        gradient[..identity_count].copy_from_slice(equations.identity_gradient.as_slice());
        gradient[identity_count..].copy_from_slice(&equations.pose_gradient.as_slice()[..pose_count]);
        let matrix = with_matrix.then(|| {
            let mut matrix = DMatrix::zeros(total, total);
            let identity = (identity_count, identity_count);
            matrix.view_mut((0, 0), identity).copy_from(&equations.identity_matrix);
            if pose_count > 0 {
                let corner = (identity_count, identity_count);
                matrix.view_mut(corner, (pose_count, pose_count)).copy_from(&equations.pose_matrix);
                let lower = (pose_count, identity_count);
                matrix.view_mut((identity_count, 0), lower).copy_from(&equations.pose_identity);
                let upper = equations.pose_identity.transpose();
                matrix.view_mut((0, identity_count), (identity_count, pose_count)).copy_from(&upper);
            }
            matrix
        });
        let columns: Vec<usize> = (0..total).collect();
        sink.add_assembled(assembly.value, &columns, &gradient, matrix.as_ref());
    }
}
