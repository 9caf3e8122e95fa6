//! Points sorted into cubes, for nearest-point queries with a condition. Quick to build, so that it pays even for points
//! that move with every round of a fit.

use glam::{DVec3, IVec3};

/// A few hundred to a few hundred thousand points in cubes of equal size.
pub struct PointGrid<'a> {
    points: &'a [DVec3],
    low: DVec3,
    cell_size: f64,
    counts: IVec3,
    /// Where each cell's points begin in `order`; one more than there are cells.
    starts: Vec<u32>,
    /// Indices of the points, cell by cell, rising inside a cell.
    order: Vec<u32>,
}

/// Cells for each point at most: more of them would cost more to pass through than they save.
const CELLS_PER_POINT: f64 = 8.0;

impl<'a> PointGrid<'a> {
    /// Sorts finite points; cells are as large as the points are apart if they lie on the surface of their bounding box.
    pub fn new(points: &'a [DVec3]) -> Self {
        let (low, high) = points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), point| {
            (low.min(*point), high.max(*point))
        });
        let extent = if points.is_empty() { DVec3::ZERO } else { high - low };
        let low = if points.is_empty() { DVec3::ZERO } else { low };
        let count = points.len().max(1) as f64;
        let area = 2.0 * (extent.x * extent.y + extent.y * extent.z + extent.z * extent.x);
        let of_area = (area / count).sqrt();
        let of_volume = (extent.x * extent.y * extent.z / (CELLS_PER_POINT * count)).cbrt();
        let of_length = extent.max_element() / (CELLS_PER_POINT * count);
        let cell_size = of_area.max(of_volume).max(of_length).max(f64::MIN_POSITIVE);
        let counts = (extent / cell_size).floor().as_ivec3() + IVec3::ONE;
        let mut grid =
            Self { points, low, cell_size, counts, starts: Vec::new(), order: vec![0; points.len()] };
        let cells: Vec<usize> =
            points.iter().map(|point| grid.slot(grid.cell(*point).min(counts - IVec3::ONE))).collect();
        let mut starts = vec![0_u32; grid.slot(counts - IVec3::ONE) + 2];
        for cell in &cells {
            starts[cell + 1] += 1;
        }
        for cell in 1..starts.len() {
            starts[cell] += starts[cell - 1];
        }
        let mut next = starts.clone();
        for (index, cell) in cells.iter().enumerate() {
            grid.order[next[*cell] as usize] = index as u32;
            next[*cell] += 1;
        }
        grid.starts = starts;
        grid
    }

    /// The cell of any position, also outside the grid; one very far away gets a nearer cell in the same direction.
    fn cell(&self, position: DVec3) -> IVec3 {
        const FAR: f64 = 1e8;
        ((position - self.low) / self.cell_size)
            .floor()
            .clamp(DVec3::splat(-FAR), DVec3::splat(FAR))
            .as_ivec3()
    }

    fn slot(&self, cell: IVec3) -> usize {
        ((cell.z * self.counts.y + cell.y) * self.counts.x + cell.x) as usize
    }

    /// The nearest point that `accepts` its index, with its squared distance; of equally near ones the first.
    pub fn nearest_where(&self, position: DVec3, accepts: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
        self.nearest_within(position, f64::INFINITY, accepts)
    }

    /// Whether a point is nearer than `distance`.
    pub fn has_within(&self, position: DVec3, distance: f64) -> bool {
        self.nearest_within(position, distance, |_| true).is_some()
    }

    /// The nearest acceptable point that is nearer than `distance`.
    fn nearest_within(
        &self,
        position: DVec3,
        distance: f64,
        accepts: impl Fn(usize) -> bool,
    ) -> Option<(usize, f64)> {
        let mut limit = distance * distance;
        let mut best: Option<usize> = None;
        let center = self.cell(position);
        let last = self.counts - IVec3::ONE;
        // Rings of cells around the position, from the first that touches the grid to the last.
        let outside = (-center).max(center - last).max(IVec3::ZERO).max_element();
        let farthest = center.abs().max((last - center).abs()).max_element();
        for ring in outside..=farthest {
            // Ring r is at least r - 1 whole cells away.
            let gap = f64::from((ring - 1).max(0)) * self.cell_size;
            if gap * gap >= limit {
                break;
            }
            self.visit_ring(center, ring, |index| {
                let squared = self.points[index].distance_squared(position);
                let is_nearer =
                    squared < limit || (squared == limit && best.is_some_and(|best| index < best));
                if is_nearer && accepts(index) {
                    limit = squared;
                    best = Some(index);
                }
            });
        }
        best.map(|index| (index, limit))
    }

    /// Visits the points in cells whose largest offset from `center` along an axis is `ring`.
    fn visit_ring(&self, center: IVec3, ring: i32, mut visit: impl FnMut(usize)) {
        let low = (center - IVec3::splat(ring)).max(IVec3::ZERO);
        let high = (center + IVec3::splat(ring)).min(self.counts - IVec3::ONE);
        let mut visit_row = |z: i32, y: i32, from: i32, to: i32| {
            if from <= to {
                let first = self.starts[self.slot(IVec3::new(from, y, z))];
                let end = self.starts[self.slot(IVec3::new(to, y, z)) + 1];
                for index in &self.order[first as usize..end as usize] {
                    visit(*index as usize);
                }
            }
        };
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                if (z - center.z).abs() == ring || (y - center.y).abs() == ring {
                    visit_row(z, y, low.x, high.x);
                } else {
                    // Only the two ends of the row are on the ring.
                    for x in [center.x - ring, center.x + ring] {
                        if (low.x..=high.x).contains(&x) {
                            visit_row(z, y, x, x);
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points without order from a linear congruence.
    fn points(count: usize, seed: u64) -> Vec<DVec3> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..count).map(|_| DVec3::new(next(), 2.0 * next(), 0.4 * next())).collect()
    }

    fn brute_force(
        points: &[DVec3],
        position: DVec3,
        accepts: impl Fn(usize) -> bool,
    ) -> Option<(usize, f64)> {
        let mut best: Option<(usize, f64)> = None;
        for (index, point) in points.iter().enumerate().filter(|(index, _)| accepts(*index)) {
            let squared = point.distance_squared(position);
            if best.is_none_or(|(_, smallest)| squared < smallest) {
                best = Some((index, squared));
            }
        }
        best
    }

    #[test]
    fn the_nearest_point_is_that_of_brute_force_inside_and_far_outside() {
        let mut cloud = points(700, 1);
        cloud.extend_from_within(..50); // ties
        let grid = PointGrid::new(&cloud);
        for (k, query) in points(300, 2).into_iter().enumerate() {
            let query =
                (query - DVec3::new(0.5, 1.0, 0.2)) * [1.0, 1.3, 20.0][k % 3] + DVec3::new(0.5, 1.0, 0.2);
            for stride in [1, 3, 40] {
                let accepts = |index: usize| index.is_multiple_of(stride);
                assert_eq!(grid.nearest_where(query, accepts), brute_force(&cloud, query, accepts));
            }
            let nearest = brute_force(&cloud, query, |_| true).expect("a point").1.sqrt();
            assert!(grid.has_within(query, nearest * 1.001) && !grid.has_within(query, nearest * 0.999));
            assert_eq!(grid.nearest_where(query, |_| false), None);
        }
    }

    #[test]
    fn no_point_one_point_and_points_in_a_plane_or_on_a_line_are_fine() {
        assert_eq!(PointGrid::new(&[]).nearest_where(DVec3::ONE, |_| true), None);
        let one = [DVec3::new(3.0, 4.0, 0.0)];
        assert_eq!(PointGrid::new(&one).nearest_where(DVec3::ZERO, |_| true), Some((0, 25.0)));
        let flat: Vec<DVec3> = points(200, 3).into_iter().map(|p| p.with_z(0.0)).collect();
        let line: Vec<DVec3> = flat.iter().map(|p| p.with_x(0.0)).collect();
        for cloud in [flat, line] {
            let grid = PointGrid::new(&cloud);
            for query in points(50, 4) {
                assert_eq!(grid.nearest_where(query, |_| true), brute_force(&cloud, query, |_| true));
            }
        }
    }
}
