//! Raw scans of standing people with known correspondence: what a lab has before it has a shape space (P1 §3–4).
//!
//! ```text
//! Population ─▶ rest body ─ stance ─▶ posed body ─ scanner ─▶ mesh of its own ─ faults ─▶ raw scan
//!                                        └─ truth in the template's topology, landmarks with placement error
//! ```
//! The people are no instances of the default space: see [`Population`].

mod depth_pair;
mod faults;
mod files;
mod landmarks;
mod people;
mod scanner;
mod stance;

use glam::DVec3;
use habitus::body::{BodyModel, Pose};
use habitus::geometry::TriangleMesh;
use habitus::statistics::RandomStream;
use serde::{Deserialize, Serialize};

use crate::error::SyntheticError;

pub use depth_pair::{DepthImage, DepthPair, DepthPairSettings, DepthView, Intrinsics, make_depth_pair};
pub use files::{TEMPLATE_FILE, TEMPLATE_LANDMARKS_FILE, subject_names, write_depth_pairs, write_raw_scans};
pub use landmarks::{LandmarkTable, PlacedLandmark};
pub use people::{PeopleSettings, Population};
pub use stance::StanceSettings;

use faults::add_faults;
use landmarks::place_landmarks;
use scanner::scan_body;
use stance::standing_pose;

/// All that a raw scan depends on besides the person's name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RawScanSettings {
    /// Start of all random numbers.
    pub seed: u64,
    /// Points of the scan before holes are cut, about.
    pub point_count: usize,
    /// Standard deviation of the noise along the line of sight where the surface is seen frontally, millimetres; it
    /// doubles towards grazing views.
    pub noise_mm: f64,
    /// Standard deviation by which each scanner head is out of place, millimetres.
    pub head_misalignment_mm: f64,
    /// Probability of each usual hole (crown, crotch, armpits, soles) beyond what no head sees.
    pub hole_probability: f64,
    /// Radius of those holes, smallest and largest, millimetres.
    pub hole_radius_mm: [f64; 2],
    /// Small holes anywhere, smallest and largest number.
    pub dropout_count: [usize; 2],
    /// Share of stray points that belong to nothing.
    pub stray_share: f64,
    /// Standard deviation of the placement of a landmark, millimetres (P1 §3.1: "unreliable placement").
    pub landmark_error_mm: f64,
    /// Probability that a landmark is missing.
    pub landmark_missing_probability: f64,
    /// The people.
    pub people: PeopleSettings,
    /// How they stand.
    pub stance: StanceSettings,
}

impl Default for RawScanSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            point_count: 50_000,
            noise_mm: 1.0,
            head_misalignment_mm: 0.3,
            hole_probability: 0.8,
            hole_radius_mm: [25.0, 60.0],
            dropout_count: [2, 8],
            stray_share: 0.002,
            landmark_error_mm: 3.0,
            landmark_missing_probability: 0.02,
            people: PeopleSettings::default(),
            stance: StanceSettings::default(),
        }
    }
}

impl RawScanSettings {
    pub(crate) fn check(&self) -> Result<(), SyntheticError> {
        let wrong = |setting, value: f64, expected: &str| {
            Err(SyntheticError::Setting { setting, value: value.to_string(), expected: expected.into() })
        };
        if !(2_000..=500_000).contains(&self.point_count) {
            return wrong("raw_scan.point_count", self.point_count as f64, "from 2,000 to 500,000");
        }
        let not_negative = [
            ("raw_scan.noise_mm", self.noise_mm),
            ("raw_scan.head_misalignment_mm", self.head_misalignment_mm),
            ("raw_scan.hole_probability", self.hole_probability),
            ("raw_scan.stray_share", self.stray_share),
            ("raw_scan.landmark_error_mm", self.landmark_error_mm),
            ("raw_scan.landmark_missing_probability", self.landmark_missing_probability),
        ];
        for (setting, value) in not_negative {
            if !(value >= 0.0 && value.is_finite()) {
                return wrong(setting, value, "zero or more");
            }
        }
        Ok(())
    }
}

/// A person who stands in the scanner's frame (metres, y up, floor at 0).
#[derive(Debug, Clone)]
pub struct StandingPerson {
    /// The body at rest in the template's topology.
    pub rest_vertices: Vec<DVec3>,
    /// How the person stands.
    pub pose: Pose,
    /// The standing body in the template's topology.
    pub vertices: Vec<DVec3>,
}

/// One raw scan with its truth.
#[derive(Debug, Clone)]
pub struct RawScan {
    /// The truth.
    pub person: StandingPerson,
    /// What the scanner gives: an open mesh of its own with noise, holes and stray pieces.
    pub mesh: TriangleMesh,
    /// Landmarks as a person would have placed them.
    pub landmarks: Vec<PlacedLandmark>,
}

/// The person of this name, standing; `occasion` tells apart several stances of one person.
pub fn standing_person(
    model: &BodyModel,
    population: &Population,
    settings: &RawScanSettings,
    name: &str,
    occasion: &str,
) -> StandingPerson {
    let rest_vertices = population.person(model, &settings.people, settings.seed, name);
    let mut random = RandomStream::named(settings.seed, &format!("{name} stands {occasion}"));
    let pose = standing_pose(model, &rest_vertices, &settings.stance, &mut random);
    let joints = model.joints(&rest_vertices);
    let vertices = model.pose_vertices(&rest_vertices, &model.skeleton().pose(&joints, pose.parameters()));
    StandingPerson { rest_vertices, pose, vertices }
}

/// Scans the person of this name.
pub fn make_raw_scan(
    model: &BodyModel,
    population: &Population,
    table: &LandmarkTable,
    settings: &RawScanSettings,
    name: &str,
) -> Result<RawScan, SyntheticError> {
    settings.check()?;
    let person = standing_person(model, population, settings, name, "for the scanner");
    let mut random = RandomStream::named(settings.seed, &format!("{name} is scanned"));
    let scanned = scan_body(&person.vertices, model.faces(), settings, &mut random);
    let (positions, faces) = add_faults(scanned, model, &person.vertices, settings, &mut random);
    let mesh = TriangleMesh::new(positions, faces)?;
    let mut random = RandomStream::named(settings.seed, &format!("{name} is marked"));
    let landmarks = place_landmarks(model, &person.vertices, table, settings, &mut random);
    Ok(RawScan { person, mesh, landmarks })
}

#[cfg(test)]
mod tests;
