//! One file per energy.

mod closest_points;
mod inside_clothing;
mod landmarks;
mod stay_near;

pub use closest_points::{ClosestPoints, DistanceForm};
pub use inside_clothing::InsideClothing;
pub use landmarks::{LandmarkPull, LandmarkTargets};
pub use stay_near::StayNear;
