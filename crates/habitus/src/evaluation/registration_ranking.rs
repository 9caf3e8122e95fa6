//! Which registrations a person should look at first (P1 §3.3): the worst place counts, not the mean.
//!
//! P1: "low average fitting errors do not always correspond to good results, since the fitting of localized areas may
//! be inaccurate." Five parts, each over the value up to which it is acceptable, are joined by
//!
//! ```text
//! score = (Σ_k (part_k / acceptable_k)⁴)^¼
//! ```
//! so that one bad part cannot be paid for with good ones, several fair ones add up a little, and 1 is where a
//! registration that is perfect but for one part stops being acceptable.

mod patches;

use glam::DVec3;
use habitus_geometry::{Surface, SurfaceIndex, TriangleMesh, vertex_normals};
use serde::{Deserialize, Serialize};

pub use patches::{Patches, WorstPatch};

/// What counts as acceptable, and over which area residuals are averaged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RankingConfig {
    /// Distance over the template's edges up to which vertices belong to a patch, millimetres: about a shoulder cap.
    pub patch_radius_mm: f64,
    /// A vertex of the registration is compared with the scan's closest point if their normals are less than this apart
    /// (P1 §4.2: 60°), degrees: across a hole the closest point is often on the other side of a limb.
    pub compatible_angle_deg: f64,
    /// Points of the scan farther than this from the registration are strays or limbs that the template has folded
    /// away (open hands, P1 §4.1), and do not count; the registration's own distances always do. Millimetres.
    pub stray_distance_mm: f64,
    /// Distances up to which the share of registered vertices is counted, for curves as in P1 Fig. 1 and 2, millimetres.
    pub curve_mm: Vec<f64>,
    /// Largest acceptable mean residual of any patch, millimetres.
    pub acceptable_patch_mm: f64,
    /// Largest acceptable number of faces that lie inside out.
    pub acceptable_flipped_faces: f64,
    /// Largest acceptable stretch or squeeze of edges between template and registration at the 1st and 99th percentile,
    /// as a factor above 1.
    pub acceptable_edge_factor: f64,
    /// Largest acceptable root mean square of the identity's coefficients in the space that started the registration,
    /// in standard deviations; 1 is a typical member of the population.
    pub acceptable_mahalanobis: f64,
    /// Largest acceptable mean distance between landmarks and the vertices that they mark, millimetres.
    pub acceptable_landmark_mm: f64,
}

impl Default for RankingConfig {
    fn default() -> Self {
        Self {
            patch_radius_mm: 50.0,
            compatible_angle_deg: 60.0,
            stray_distance_mm: 60.0,
            curve_mm: vec![1.0, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0],
            acceptable_patch_mm: 6.0,
            acceptable_flipped_faces: 20.0,
            acceptable_edge_factor: 2.0,
            acceptable_mahalanobis: 2.5,
            acceptable_landmark_mm: 25.0,
        }
    }
}

/// What is known about a registration; what is not known does not count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RankingParts {
    /// Largest mean residual over a patch, millimetres; none if registration and scan could not be compared, which is
    /// as bad as can be.
    pub worst_patch_mm: Option<f64>,
    /// Vertex in the middle of that patch.
    pub worst_vertex: u32,
    /// Faces that lie inside out.
    pub flipped_faces: usize,
    /// Stretch or squeeze of edges, as a factor above 1: the larger of the 99th percentile of the ratio of lengths and
    /// of the inverse of the 1st.
    pub edge_factor: f64,
    /// Root mean square of the identity's coefficients, in standard deviations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mahalanobis: Option<f64>,
    /// Mean distance of landmarks, millimetres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub landmark_mm: Option<f64>,
    /// Whether a code says that the registration must not be used unseen: then its score is 1 at least.
    #[serde(default)]
    pub has_failure_code: bool,
}

/// One registration of a ranking.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RankedRegistration {
    /// Name of the scan.
    pub name: String,
    /// Fingerprint of the registered mesh.
    pub registration: String,
    /// Mean distance of the scan's points to the registration, millimetres: for comparison, as it deceives.
    pub mean_mm: f64,
    /// What the score is made of.
    pub parts: RankingParts,
    /// Share of the registered vertices over the scan that are within each of [`RankingConfig::curve_mm`] of it; empty if
    /// the two could not be compared.
    pub within: Vec<f64>,
}

/// Which part decides most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RankingPart {
    /// [`RankingParts::worst_patch_mm`].
    WorstPatch,
    /// [`RankingParts::flipped_faces`].
    FlippedFaces,
    /// [`RankingParts::edge_factor`].
    Edges,
    /// [`RankingParts::mahalanobis`].
    Mahalanobis,
    /// [`RankingParts::landmark_mm`].
    Landmarks,
    /// [`RankingParts::has_failure_code`].
    Code,
}

impl RankingPart {
    /// What it is, in a few words for a person.
    pub fn words(self) -> &'static str {
        match self {
            Self::WorstPatch => "a patch lies far from the scan",
            Self::FlippedFaces => "faces lie inside out",
            Self::Edges => "edges are stretched or squeezed",
            Self::Mahalanobis => "the shape is unusual for the space",
            Self::Landmarks => "landmarks are far off",
            Self::Code => "a code says that it must not be used unseen",
        }
    }
}

/// Share of a part that should be known and is not: worse than any that occurs.
const UNKNOWN_SHARE: f64 = 1e6;

impl RankingParts {
    /// Each part over what is acceptable, in the order of [`RankingPart`]. What is no number is as bad as can be.
    pub fn shares(&self, config: &RankingConfig) -> [(RankingPart, f64); 6] {
        let share = |value: f64, acceptable: f64| {
            let share = value / acceptable;
            if share.is_finite() { share.max(0.0) } else { UNKNOWN_SHARE }
        };
        [
            (
                RankingPart::WorstPatch,
                share(self.worst_patch_mm.unwrap_or(f64::NAN), config.acceptable_patch_mm),
            ),
            (RankingPart::FlippedFaces, share(self.flipped_faces as f64, config.acceptable_flipped_faces)),
            (RankingPart::Edges, share(self.edge_factor.ln(), config.acceptable_edge_factor.ln())),
            (
                RankingPart::Mahalanobis,
                self.mahalanobis.map_or(0.0, |value| share(value, config.acceptable_mahalanobis)),
            ),
            (
                RankingPart::Landmarks,
                self.landmark_mm.map_or(0.0, |value| share(value, config.acceptable_landmark_mm)),
            ),
            (RankingPart::Code, if self.has_failure_code { 1.0 } else { 0.0 }),
        ]
    }

    /// The score: 0 is perfect, 1 is where it stops being acceptable, and more is worse.
    pub fn score(&self, config: &RankingConfig) -> f64 {
        self.shares(config).iter().map(|(_, share)| share.powi(4)).sum::<f64>().powf(0.25)
    }

    /// The part that says most.
    pub fn worst_part(&self, config: &RankingConfig) -> RankingPart {
        let [first, rest @ ..] = self.shares(config);
        rest.iter().fold(first, |worst, one| if one.1 > worst.1 { *one } else { worst }).0
    }
}

/// Factor above 1 of edges whose length ratios, registration over template, have these percentiles.
pub fn edge_factor(p1: f64, p99: f64) -> f64 {
    p99.max(1.0 / p1.max(f64::MIN_POSITIVE))
}

/// Root mean square of coefficients in standard deviations; none if there are none.
pub fn mahalanobis(coefficients: &[f64]) -> Option<f64> {
    let squares: f64 = coefficients.iter().map(|coefficient| coefficient * coefficient).sum();
    (!coefficients.is_empty()).then(|| (squares / coefficients.len() as f64).sqrt())
}

/// How far a registration is from its scan at each vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Residuals {
    /// Signed distance from each vertex to the scan in metres, positive outside it. Not a number where the
    /// scan has a hole.
    pub signed_distance: Vec<f64>,
    /// What counts at each vertex, in metres: the larger of that distance and the mean distance of the scan's points
    /// that lie nearest to it. None where neither is known.
    pub residual: Vec<Option<f64>>,
    /// Signed distance from each of the scan's points to the registration in metres, positive outside the registration.
    pub scan_distance: Vec<f64>,
}

impl Residuals {
    /// Share of the vertices over the scan that are within each of these distances (millimetres) of it.
    pub fn within(&self, thresholds_mm: &[f64]) -> Vec<f64> {
        let known: Vec<f64> = self.signed_distance.iter().map(|value| value.abs() * 1000.0).collect();
        let known: Vec<f64> = known.into_iter().filter(|value| value.is_finite()).collect();
        let count = known.len().max(1) as f64;
        let share = |limit: &f64| known.iter().filter(|value| *value <= limit).count() as f64 / count;
        thresholds_mm.iter().map(share).collect()
    }
}

/// Compares a registration with its scan, both ways and with triangles wherever the scan has some.
pub fn residuals(registration: &TriangleMesh, scan: &Surface, config: &RankingConfig) -> Residuals {
    let signed_distance = distances_to_scan(registration, scan, config);
    let index = SurfaceIndex::of_mesh(registration);
    let mut closest = Vec::new();
    index.closest_many(scan.positions(), None, &mut closest);
    let mut sums = vec![(0.0, 0_u32); registration.positions().len()];
    let mut scan_distance = Vec::with_capacity(closest.len());
    for (point, found) in scan.positions().iter().zip(&closest) {
        let distance = found.distance_squared.sqrt();
        scan_distance.push(distance * sign(*point - found.position, found.normal));
        if distance * 1000.0 <= config.stray_distance_mm {
            let face = registration.faces()[found.face as usize];
            let corner = (0..3)
                .fold(0, |best, k| if found.barycentric[k] > found.barycentric[best] { k } else { best });
            let sum = &mut sums[face[corner] as usize];
            *sum = (sum.0 + distance, sum.1 + 1);
        }
    }
    let residual = signed_distance.iter().zip(&sums).map(|(own, (sum, count))| {
        let of_scan = (*count > 0).then(|| sum / f64::from(*count));
        let own = own.is_finite().then(|| own.abs());
        own.into_iter().chain(of_scan).reduce(f64::max)
    });
    Residuals { residual: residual.collect(), signed_distance, scan_distance }
}

fn sign(offset: DVec3, normal: DVec3) -> f64 {
    if offset.dot(normal) < 0.0 { -1.0 } else { 1.0 }
}

/// Metres beyond which a closest point that lies sideways rather than along the normal is taken for one at a border.
const BORDER_REACH: f64 = 0.01;

/// Signed distances of the registration's vertices. Where the scan has a hole it says nothing about the vertex: the
/// closest point is then on the border, lies sideways, or belongs to another side of the body.
fn distances_to_scan(registration: &TriangleMesh, scan: &Surface, config: &RankingConfig) -> Vec<f64> {
    let mut closest = Vec::new();
    let (border, has_normals) = match scan {
        Surface::Mesh(mesh) => {
            SurfaceIndex::of_mesh(mesh).closest_many(registration.positions(), None, &mut closest);
            (Some(patches::border_corners(mesh)), true)
        }
        Surface::Cloud(cloud) => {
            let none = vec![DVec3::ZERO; cloud.positions().len()];
            let index = SurfaceIndex::of_cloud(cloud.positions(), cloud.normals().unwrap_or(&none));
            index.closest_many(registration.positions(), None, &mut closest);
            (None, cloud.normals().is_some())
        }
    };
    let smallest_cosine = config.compatible_angle_deg.to_radians().cos();
    let normals = vertex_normals(registration.positions(), registration.faces());
    let vertices = registration.positions().iter().zip(&normals).zip(&closest);
    let signed = vertices.map(|((vertex, normal), found)| {
        let offset = *vertex - found.position;
        let distance = found.distance_squared.sqrt();
        let along = offset.dot(found.normal);
        let is_at_border = border
            .as_ref()
            .is_some_and(|border| patches::lies_on_border(border, found.face, found.barycentric));
        let is_sideways = distance > BORDER_REACH && along.abs() < 0.5 * distance;
        let is_other_side = normal.dot(found.normal) < smallest_cosine;
        if is_at_border || (has_normals && (is_sideways || is_other_side)) {
            f64::NAN
        } else if border.is_none() && has_normals {
            // Between points of a cloud the surface is their plane.
            along
        } else {
            distance * sign(offset, found.normal)
        }
    });
    signed.collect()
}

#[cfg(test)]
mod tests;
