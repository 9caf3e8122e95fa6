//! The fit error of P1 §4.2: from each registered vertex to the nearest vertex of its scan, where their distance and the
//! angle of their normals are credible; as a curve over distances and as a mean for each vertex of the template.
//!
//! Between two points of a scan even a perfect registration is some millimetres from both (half of 1/√density), and one that
//! snaps its vertices to points is better by this number and worse in truth. It is here for comparison with P1; distances to
//! the surface of held-out points stand beside it.

use glam::DVec3;
use habitus_geometry::{Surface, SurfaceIndex, TriangleMesh, vertex_normals};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::artifacts::registered_scan::DistanceSummary;

/// What is compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FitErrorSettings {
    /// Vertices farther than this from their neighbour do not count (P1 §4.2: 50), millimetres.
    pub distance_mm: f64,
    /// Nor do those whose normals are farther apart (P1 §4.2: 60), degrees.
    pub angle_deg: f64,
    /// Distances at which the curve is taken (P1 Fig. 1a, 2a: up to 50), millimetres.
    pub thresholds_mm: Vec<f64>,
}

impl Default for FitErrorSettings {
    fn default() -> Self {
        let thresholds_mm = (0..=20).map(f64::from).chain([25.0, 30.0, 35.0, 40.0, 45.0, 50.0]).collect();
        Self { distance_mm: 50.0, angle_deg: 60.0, thresholds_mm }
    }
}

/// Fit error over many registrations.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FitError {
    /// Registrations that were compared with their scans.
    pub registrations: usize,
    /// Share of all vertices that have a credible neighbour.
    pub compared_share: f64,
    /// Mean over those, millimetres.
    pub mean_mm: f64,
    /// Distances of the curve, millimetres.
    pub thresholds_mm: Vec<f64>,
    /// Share of the compared vertices that are nearer.
    pub share: Vec<f64>,
    /// Points of the scans that the fits never saw, to the registered surface: means over registrations.
    pub held_out_mm: DistanceSummary,
    /// Mean at each vertex of the template, millimetres; not a number where none was compared. Drawn, not written.
    #[serde(skip)]
    pub vertex_mean_mm: Vec<f64>,
}

/// Sums that [`FitError`] is made of.
#[derive(Clone, Debug, Default)]
pub struct FitErrorSums {
    registrations: usize,
    vertices: usize,
    counts: Vec<u32>,
    sums_mm: Vec<f64>,
    within: Vec<usize>,
    held_out: [f64; 2],
}

impl FitErrorSums {
    /// Adds one registration and its scan, both in metres, with what its record says of held-out points.
    pub fn add(
        &mut self,
        distances: &[Option<f64>],
        held_out: &DistanceSummary,
        settings: &FitErrorSettings,
    ) {
        self.registrations += 1;
        self.vertices += distances.len();
        self.counts.resize(distances.len().max(self.counts.len()), 0);
        self.sums_mm.resize(self.counts.len(), 0.0);
        self.within.resize(settings.thresholds_mm.len(), 0);
        for (vertex, distance) in distances.iter().enumerate() {
            let Some(distance) = distance else { continue };
            self.counts[vertex] += 1;
            self.sums_mm[vertex] += distance * 1000.0;
            for (count, threshold) in self.within.iter_mut().zip(&settings.thresholds_mm) {
                *count += usize::from(distance * 1000.0 <= *threshold);
            }
        }
        self.held_out[0] += held_out.mean;
        self.held_out[1] += held_out.p95;
    }

    /// Sums up what was added.
    pub fn finished(self, settings: &FitErrorSettings) -> FitError {
        let compared: usize = self.counts.iter().map(|count| *count as usize).sum();
        let over = |value: f64, count: usize| value / count.max(1) as f64;
        let vertex_mean =
            |(sum, count): (&f64, &u32)| if *count == 0 { f64::NAN } else { sum / f64::from(*count) };
        FitError {
            registrations: self.registrations,
            compared_share: over(compared as f64, self.vertices),
            mean_mm: over(self.sums_mm.iter().sum(), compared),
            thresholds_mm: settings.thresholds_mm.clone(),
            share: self.within.iter().map(|count| over(*count as f64, compared)).collect(),
            held_out_mm: DistanceSummary {
                mean: over(self.held_out[0], self.registrations),
                p95: over(self.held_out[1], self.registrations),
            },
            vertex_mean_mm: self.sums_mm.iter().zip(&self.counts).map(vertex_mean).collect(),
        }
    }
}

/// For each registered vertex the distance to the nearest vertex of the scan, metres; none where it is not credible.
pub fn vertex_distances(
    registration: &TriangleMesh,
    scan: &Surface,
    settings: &FitErrorSettings,
) -> Vec<Option<f64>> {
    let scan_normals = match scan {
        Surface::Mesh(mesh) => Some(vertex_normals(mesh.positions(), mesh.faces())),
        Surface::Cloud(cloud) => cloud.normals().map(<[DVec3]>::to_vec),
    };
    let points = scan.positions();
    let index = SurfaceIndex::of_cloud(points, &vec![DVec3::Y; points.len()]);
    let smallest_cosine = settings.angle_deg.to_radians().cos();
    let normals = vertex_normals(registration.positions(), registration.faces());
    registration
        .positions()
        .par_iter()
        .zip(&normals)
        .with_min_len(512)
        .map(|(vertex, normal)| {
            let found = index.closest_within(*vertex, settings.distance_mm / 1000.0)?;
            let other = scan_normals.as_ref().map(|normals| normals[found.face as usize]);
            let is_compatible = other.is_none_or(|other| normal.dot(other) >= smallest_cosine);
            is_compatible.then(|| vertex.distance(points[found.face as usize]))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn far_and_turned_neighbours_do_not_count() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let registration = TriangleMesh::new(corners.to_vec(), vec![[0, 1, 2]]).expect("valid");
        // One point 10 mm above the first corner, one turned at the second; the third has none within 50 mm.
        let place = |point: DVec3| point + DVec3::Z * 0.01;
        let scan = habitus_geometry::PointCloud::new(
            vec![place(DVec3::ZERO), place(DVec3::X), DVec3::Y * 1.2],
            Some(vec![DVec3::Z, -DVec3::Z, DVec3::Z]),
        );
        let settings = FitErrorSettings::default();
        let found = vertex_distances(&registration, &Surface::Cloud(scan.expect("valid")), &settings);
        assert!((found[0].expect("is near") - 0.01).abs() < 1e-12);
        assert_eq!(found[1..], [None, None]);
        let mut sums = FitErrorSums::default();
        let held_out = DistanceSummary { mean: 1.0, p95: 2.0 };
        sums.add(&found, &held_out, &settings);
        sums.add(&[Some(0.02), Some(0.03), None], &held_out, &settings);
        let error = sums.finished(&settings);
        assert!((error.mean_mm - 20.0).abs() < 1e-9 && (error.compared_share - 0.5).abs() < 1e-12);
        assert!((error.vertex_mean_mm[0] - 15.0).abs() < 1e-9 && error.vertex_mean_mm[2].is_nan());
        let share_at = |limit: f64| {
            error.share[error.thresholds_mm.iter().position(|t| *t == limit).expect("is a threshold")]
        };
        assert!((share_at(15.0) - 1.0 / 3.0).abs() < 1e-12 && share_at(50.0) == 1.0);
        assert_eq!(error.held_out_mm, held_out);
    }
}
