//! One file per energy.

mod closest_points;
mod graph_regularity;
mod inside_clothing;
mod landmarks;
mod smooth_affines;
mod stay_near;

pub use closest_points::{ClosestPoints, DistanceForm};
pub use graph_regularity::{GraphRigidity, GraphSmoothness};
pub use inside_clothing::InsideClothing;
pub use landmarks::{LandmarkPull, LandmarkTargets};
pub use smooth_affines::{AffineMetric, SmoothAffines};
pub use stay_near::StayNear;
