//! Closest points of a capture on a regular grid: as exact as a cell, and as fast as a look-up.

use glam::DVec3;
use habitus_geometry::SurfaceIndex;
use rayon::prelude::*;

/// Edge of a cell in metres.
const CELL: f64 = 0.035;
/// How far the grid reaches beyond the capture, in metres.
const MARGIN: f64 = 0.25;

/// Closest capture points of the middles of cells.
pub(super) struct ClosestGrid {
    low: DVec3,
    counts: [usize; 3],
    cells: Vec<(DVec3, DVec3)>,
}

/// What the grid knows about a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearby {
    /// Distance squared in square metres, right to about a cell along the surface and better across it.
    pub distance_squared: f64,
    /// Along the normal, positive outside, in metres.
    pub signed_distance: f64,
    /// A point of the capture near the closest one.
    pub target: DVec3,
    /// Outward unit normal there.
    pub normal: DVec3,
}

impl ClosestGrid {
    pub fn new(index: &SurfaceIndex, bounds: [DVec3; 2]) -> Self {
        let low = bounds[0] - DVec3::splat(MARGIN);
        let size = bounds[1] + DVec3::splat(MARGIN) - low;
        let counts = [size.x, size.y, size.z].map(|length| (length / CELL).ceil().max(1.0) as usize);
        let [nx, ny, nz] = counts;
        let cells = (0..nz)
            .into_par_iter()
            .flat_map_iter(|z| {
                let mut face = None;
                (0..nx * ny).map(move |flat| {
                    // Back and forth, so that the next cell is a neighbour and its face a good hint.
                    let (y, x) = (flat / nx, flat % nx);
                    let middle = low + (DVec3::new(x as f64, y as f64, z as f64) + 0.5) * CELL;
                    let found = match face {
                        Some(hint) => index.closest_warm(middle, hint),
                        None => index.closest(middle),
                    };
                    face = Some(found.face);
                    (found.position, found.normal)
                })
            })
            .collect();
        Self { low, counts, cells }
    }

    pub fn at(&self, point: DVec3) -> Nearby {
        let place = (point - self.low) / CELL;
        let [nx, ny, nz] = self.counts;
        let cell = |value: f64, count: usize| (value.max(0.0) as usize).min(count - 1);
        let (x, y, z) = (cell(place.x, nx), cell(place.y, ny), cell(place.z, nz));
        let (target, normal) = self.cells[(z * ny + y) * nx + x];
        let offset = point - target;
        let signed_distance = offset.dot(normal);
        let across = signed_distance * signed_distance;
        // The closest point of the cell's middle lies up to a cell beside that of the point.
        let along = (offset.length_squared() - across - CELL * CELL).max(0.0);
        let target = if along > 0.0 { target } else { point - normal * signed_distance };
        Nearby { distance_squared: across + along, signed_distance, target, normal }
    }
}
