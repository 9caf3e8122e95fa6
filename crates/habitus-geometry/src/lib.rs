//! Meshes, point clouds and queries on them; knows no body.

pub mod cleaning;
pub mod cloud_normals;
pub mod frame_of_reference;
pub mod geodesics;
pub mod io;
pub mod mesh;
pub mod normals;
pub mod point_grid;
pub mod rigid;
pub mod sampling;
pub mod surface_index;
pub mod topology;
mod triangle;
pub mod weld;

pub use glam;

pub use cleaning::{ComponentReport, FloorReport, drop_floor_plane, remove_small_components};
pub use cloud_normals::estimate_cloud_normals;
pub use frame_of_reference::{
    FrameOfReference, LengthUnit, SignedAxis, UnitGuess, UpCandidate, guess_unit, guess_up_axis,
};
pub use geodesics::{GeodesicWorkspace, Geodesics};
pub use mesh::{MeshError, PointCloud, Surface, TriangleMesh};
pub use normals::{face_normals, vertex_normals, vertex_normals_into};
pub use point_grid::PointGrid;
pub use rigid::{RigidTransform, best_rotation, procrustes};
pub use sampling::{area_weighted_points, farthest_points};
pub use surface_index::{RayHit, SurfaceIndex, SurfacePoint};
pub use topology::{Topology, components};
pub use weld::{Welded, weld};
