//! From names to places: the points that definitions refer to, on one body.

use glam::DVec3;

use super::definitions::PointReference;
use crate::body::BodyModel;

/// A point reference with its names looked up in one model.
#[derive(Clone, Debug)]
pub(super) enum Point {
    Floor,
    Top,
    Vertex(usize),
    Joint(usize),
    Between(Box<[Point; 2]>, f64),
}

/// One body: its rest vertices and joints.
pub(super) struct RestBody<'a> {
    /// Rest vertices in metres.
    pub(super) vertices: &'a [DVec3],
    /// Joints in metres.
    pub(super) joints: Vec<DVec3>,
}

impl Point {
    /// Looks the names up; fails with the name that the model does not have.
    pub(super) fn resolve(reference: &PointReference, model: &BodyModel) -> Result<Self, String> {
        match reference {
            PointReference::Between { between, at } => {
                let [first, second] = between.as_ref();
                let ends = [Self::resolve(first, model)?, Self::resolve(second, model)?];
                Ok(Self::Between(Box::new(ends), *at))
            }
            PointReference::Named(name) => named(name, model).ok_or_else(|| name.clone()),
        }
    }

    /// The place on a body, in metres.
    pub(super) fn on(&self, body: &RestBody<'_>) -> DVec3 {
        let by_height = |a: &&DVec3, b: &&DVec3| a.y.total_cmp(&b.y);
        match self {
            Self::Floor => body.vertices.iter().min_by(by_height).copied().unwrap_or_default(),
            Self::Top => body.vertices.iter().max_by(by_height).copied().unwrap_or_default(),
            Self::Vertex(vertex) => body.vertices[*vertex],
            Self::Joint(bone) => body.joints[*bone],
            Self::Between(ends, at) => ends[0].on(body).lerp(ends[1].on(body), *at),
        }
    }
}

fn named(name: &str, model: &BodyModel) -> Option<Point> {
    match name.split_once(':') {
        None if name == "floor" => Some(Point::Floor),
        None if name == "top" => Some(Point::Top),
        Some(("vertex", vertex)) => model.measurement_vertex(vertex).map(Point::Vertex),
        Some(("landmark", landmark)) => model
            .metadata()
            .landmarks
            .iter()
            .position(|name| name == landmark)
            .map(|index| Point::Vertex(model.landmark_vertices()[index] as usize)),
        Some(("joint", bone)) => bone_index(bone, model).map(Point::Joint),
        _ => None,
    }
}

/// Index of a bone by name.
pub(super) fn bone_index(name: &str, model: &BodyModel) -> Option<usize> {
    model.skeleton().bones().iter().position(|bone| bone.name == name)
}
