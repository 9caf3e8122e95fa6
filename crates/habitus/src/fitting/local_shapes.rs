//! Shapes that a space cannot express, for the fit of a model to a scan.
//!
//! A space learnt from few people misses much of the next person. What it misses looks locally like what it knows: where a
//! belly is fuller the navel sinks as it does in the belly of the space, whatever the rest of the person does. So the space
//! is cut into overlapping windows and each window may vary on its own. In terms of Gaussian processes the population's
//! covariance is multiplied by one that falls off with distance (Lüthi et al. 2018, localised kernels), beside a second,
//! isotropic one for what no component of the space shows anywhere.

use glam::DVec3;
use habitus_optimize::symmetric_eigen;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::body::{BodyModel, BodySurface};

/// Local shapes: displacements in windows around centres that are spread over the body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalShapeConfig {
    /// Number of centres; zero for none.
    pub centres: usize,
    /// Standard deviation of the fall-off of a window, millimetres; at 2.5 of them it ends.
    pub radius_mm: f64,
    /// Standard deviation of displacements along x, y and z in a window, millimetres; zero for none.
    pub amplitude_mm: f64,
    /// Directions in which the space itself varies most in a window; zero for none.
    pub space_directions: usize,
    /// Standard deviation of what varies along these directions, relative to the space's own.
    pub space_share: f64,
    /// Spaces with more components than this need no such directions: they only cost time.
    pub space_directions_up_to: usize,
}

impl Default for LocalShapeConfig {
    fn default() -> Self {
        Self {
            centres: 150,
            radius_mm: 90.0,
            amplitude_mm: 5.0,
            space_directions: 8,
            space_share: 1.5,
            space_directions_up_to: 60,
        }
    }
}

/// Where a window ends, in standard deviations.
const WINDOW_END: f64 = 2.5;

/// Vertices by which the directions of a window are found.
const DIRECTION_VERTICES: usize = 1500;

/// The model's surface with local shapes behind its first `own` components; `order` are vertices spread ever more densely.
pub(crate) fn with_local_shapes(
    model: &BodyModel,
    own: usize,
    order: &[u32],
    config: &LocalShapeConfig,
) -> BodySurface {
    let mean = model.mean_vertices();
    let centres = &order[..config.centres.min(order.len())];
    let windows: Vec<Vec<f64>> = centres
        .iter()
        .map(|centre| window(mean, mean[*centre as usize], config.radius_mm / 1000.0))
        .collect();
    // Windows that overlap add up to the whole population's variance, not to a multiple of it.
    let overlap: Vec<f64> = (0..mean.len())
        .map(|vertex| windows.iter().map(|window| window[vertex].powi(2)).sum::<f64>().sqrt().max(1e-6))
        .collect();
    let is_sparse = model.component_count() <= config.space_directions_up_to;
    let direction_count = if is_sparse { config.space_directions } else { 0 };
    let space = LocalSpace::new(model, &order[..DIRECTION_VERTICES.min(order.len())]);
    let mut directions = Vec::new();
    for window in &windows {
        let shares: Vec<f64> = window
            .iter()
            .zip(&overlap)
            .map(|(weight, overlap)| config.space_share * weight / overlap)
            .collect();
        directions.extend(space.directions(&shares, direction_count));
        if config.amplitude_mm > 0.0 {
            let amplitude = config.amplitude_mm / 1000.0;
            directions.extend(
                DVec3::AXES.map(|axis| {
                    window.iter().map(|weight| axis * (amplitude * weight)).collect::<Vec<DVec3>>()
                }),
            );
        }
    }
    let joints = directions.iter().map(|direction| model.joints(direction)).collect();
    model.surface().truncated(own).with_components(&directions, joints)
}

/// A Gaussian about a point that is lowered to end at a finite distance, one in the middle.
fn window(vertices: &[DVec3], middle: DVec3, radius: f64) -> Vec<f64> {
    let end = (-0.5 * WINDOW_END * WINDOW_END).exp();
    let weight = |vertex: &DVec3| {
        let gaussian = (-0.5 * vertex.distance_squared(middle) / (radius * radius)).exp();
        ((gaussian - end) / (1.0 - end)).max(0.0)
    };
    vertices.iter().map(weight).collect()
}

/// The model's space, seen through windows.
struct LocalSpace<'a> {
    surface: &'a BodySurface,
    vertices: &'a [u32],
    /// Factor of each component: those that shape the whole body, such as stature, would drown all others in every
    /// window, though the start has settled them.
    shares: Vec<f64>,
}

impl<'a> LocalSpace<'a> {
    fn new(model: &'a BodyModel, vertices: &'a [u32]) -> Self {
        let deviations = model.standard_deviations();
        let limit = deviations.get(deviations.len() / 4).copied().unwrap_or(0.0);
        let shares = deviations.iter().map(|deviation| (limit / deviation.max(1e-12)).min(1.0)).collect();
        Self { surface: model.surface(), vertices, shares }
    }

    /// The leading principal directions of the windowed space, scaled to their standard deviations, metres.
    fn directions(&self, window: &[f64], count: usize) -> Vec<Vec<DVec3>> {
        let width = self.surface.component_count();
        let count = count.min(width);
        if count == 0 {
            return Vec::new();
        }
        let seen: Vec<u32> =
            self.vertices.iter().copied().filter(|vertex| window[*vertex as usize] > 0.0).collect();
        let mut rows = DMatrix::<f64>::zeros(3 * seen.len(), width);
        for (slot, vertex) in seen.iter().enumerate() {
            let basis = self.surface.vertex_basis(*vertex as usize);
            for (axis, row) in basis.chunks_exact(width).enumerate() {
                for (component, entry) in row.iter().enumerate() {
                    rows[(3 * slot + axis, component)] =
                        window[*vertex as usize] * self.shares[component] * f64::from(*entry);
                }
            }
        }
        let (_, mixtures) = symmetric_eigen(&(rows.transpose() * &rows));
        let mixture = |direction: usize| -> Vec<f64> {
            self.shares.iter().enumerate().map(|(k, share)| share * mixtures[(k, direction)]).collect()
        };
        (0..count).map(|direction| self.mixed(window, &mixture(direction))).collect()
    }

    /// A mixture of components in a window.
    fn mixed(&self, window: &[f64], mixture: &[f64]) -> Vec<DVec3> {
        let width = mixture.len();
        let displacement = |(vertex, weight): (usize, &f64)| {
            if *weight == 0.0 {
                return DVec3::ZERO;
            }
            let rows = self.surface.vertex_basis(vertex);
            let along = |axis: usize| -> f64 {
                let row = &rows[axis * width..(axis + 1) * width];
                row.iter().zip(mixture).map(|(entry, share)| f64::from(*entry) * share).sum()
            };
            DVec3::new(along(0), along(1), along(2)) * *weight
        };
        window.iter().enumerate().map(displacement).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::fixture;
    use habitus_geometry::farthest_points;

    /// The sum of squares of all directions at a vertex: the variance that they give it.
    fn variances(surface: &BodySurface, first: usize) -> Vec<f64> {
        let width = surface.component_count();
        let square = |vertex| -> f64 {
            let rows = surface.vertex_basis(vertex).chunks_exact(width);
            rows.flat_map(|row| &row[first..]).map(|entry| f64::from(*entry).powi(2)).sum()
        };
        (0..surface.vertex_count()).map(square).collect()
    }

    #[test]
    fn all_windows_of_all_directions_together_vary_as_much_as_the_space() {
        let model = fixture::model();
        let own = model.component_count();
        let order = farthest_points(model.mean_vertices(), 40);
        let config = LocalShapeConfig {
            centres: 40,
            radius_mm: 150.0,
            amplitude_mm: 0.0,
            space_directions: own,
            space_share: 1.0,
            space_directions_up_to: own,
        };
        let surface = with_local_shapes(&model, model.component_count(), &order, &config);
        assert_eq!(surface.component_count(), own + 40 * own);
        let shares = LocalSpace::new(&model, &order).shares;
        let limit = shares.iter().copied().fold(1.0, f64::min);
        let [local, space] = [variances(&surface, own), variances(model.surface(), 0)];
        for (local, space) in local.iter().zip(&space) {
            // Components of great variance are held back, by `limit` at most; f32 rounds.
            assert!(*local <= space * 1.0001 && *local >= limit * limit * space * 0.9999, "{local} {space}");
        }
    }

    #[test]
    fn a_window_moves_nothing_beyond_its_end() {
        let model = fixture::model();
        let order = farthest_points(model.mean_vertices(), 30);
        let config = LocalShapeConfig { centres: 5, radius_mm: 60.0, ..LocalShapeConfig::default() };
        let surface = with_local_shapes(&model, model.component_count(), &order, &config);
        let own = model.component_count();
        let per_centre = (surface.component_count() - own) / 5;
        assert_eq!(per_centre, config.space_directions.min(own) + 3);
        for (vertex, position) in model.mean_vertices().iter().enumerate() {
            for row in surface.vertex_basis(vertex).chunks_exact(surface.component_count()) {
                for (slot, centre) in order[..5].iter().enumerate() {
                    let far = position.distance(model.mean_vertices()[*centre as usize]) > 0.15;
                    let start = own + slot * per_centre;
                    assert!(!far || row[start..start + per_centre].iter().all(|entry| *entry == 0.0));
                }
            }
        }
    }

    #[test]
    fn a_space_of_many_components_gets_the_three_axes_alone() {
        let model = fixture::model();
        let order = farthest_points(model.mean_vertices(), 30);
        let config =
            LocalShapeConfig { centres: 4, space_directions_up_to: 0, ..LocalShapeConfig::default() };
        let surface = with_local_shapes(&model, model.component_count(), &order, &config);
        assert_eq!(surface.component_count(), model.component_count() + 12);
    }
}
