//! Random points on surfaces and the seeded numbers behind them.

use glam::DVec3;

use crate::mesh::TriangleMesh;
use crate::normals::doubled_area_vector;

/// `count` points spread evenly by area, each with its face; the same seed gives the same points.
pub fn area_weighted_points(mesh: &TriangleMesh, count: usize, seed: u64) -> Vec<(DVec3, u32)> {
    let mut cumulative_area = Vec::with_capacity(mesh.faces().len());
    let mut total_area = 0.0;
    for face in mesh.faces() {
        total_area += 0.5 * doubled_area_vector(mesh.positions(), *face).length();
        cumulative_area.push(total_area);
    }
    let mut random = SplitMix::new(seed);
    (0..count)
        .map(|_| {
            let area = random.unit() * total_area;
            let face = cumulative_area.partition_point(|&up_to| up_to <= area).min(mesh.faces().len() - 1);
            let [a, b, c] = mesh.corners(face);
            // Osada et al. 2002, Eq. 1: the square root makes the density even.
            let (side, along) = (random.unit().sqrt(), random.unit());
            (a * (1.0 - side) + b * (side * (1.0 - along)) + c * (side * along), face as u32)
        })
        .collect()
}

/// Indices of `count` points, the first one first, each the farthest from those picked before it.
pub fn farthest_points(points: &[DVec3], count: usize) -> Vec<u32> {
    let mut distances = vec![f64::INFINITY; points.len()];
    let mut picked = Vec::with_capacity(count.min(points.len()));
    let mut next = 0;
    while picked.len() < count.min(points.len()) {
        picked.push(next as u32);
        let center = points[next];
        let mut farthest = (0, -1.0);
        for (index, (point, distance)) in points.iter().zip(&mut distances).enumerate() {
            *distance = distance.min(point.distance_squared(center));
            if *distance > farthest.1 {
                farthest = (index, *distance);
            }
        }
        next = farthest.0;
    }
    picked
}

/// Steele, Lea and Flood 2014: a small generator whose sequence never changes with a dependency.
#[derive(Debug, Clone)]
pub struct SplitMix {
    state: u64,
}

impl SplitMix {
    /// A generator that starts from this seed.
    pub fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// The next 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.state;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// The next number, evenly spread over `[0, 1)`.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_triangles() -> TriangleMesh {
        let positions =
            vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::Z + DVec3::X * 3.0, DVec3::Z + DVec3::Y];
        TriangleMesh::new(positions, vec![[0, 1, 2], [3, 4, 5]]).unwrap()
    }

    #[test]
    fn points_lie_on_their_faces_in_proportion_to_area() {
        let points = area_weighted_points(&two_triangles(), 20_000, 7);
        for (point, face) in &points {
            assert!((point.z - *face as f64).abs() < 1e-12);
        }
        // Three quarters of the area is the second face; four standard deviations of the share are 0.0122.
        let share = points.iter().filter(|(_, face)| *face == 1).count() as f64 / points.len() as f64;
        assert!((share - 0.75).abs() < 0.0122, "{share}");
        // The centroid of an even sample is the triangle's own; four standard deviations of the mean are 0.0134.
        let first: Vec<_> = points.iter().filter(|(_, face)| *face == 0).map(|(p, _)| *p).collect();
        let mean = first.iter().sum::<DVec3>() / first.len() as f64;
        assert!(mean.distance(DVec3::new(1.0, 1.0, 0.0) / 3.0) < 0.0134, "{mean}");
    }

    #[test]
    fn the_seed_decides() {
        let mesh = two_triangles();
        assert_eq!(area_weighted_points(&mesh, 9, 1), area_weighted_points(&mesh, 9, 1));
        assert_ne!(area_weighted_points(&mesh, 9, 1), area_weighted_points(&mesh, 9, 2));
    }

    #[test]
    fn farthest_points_are_ends_before_they_are_middles_and_never_more_than_there_are() {
        let line: Vec<DVec3> = (0..9).map(|x| DVec3::X * f64::from(x)).collect();
        assert_eq!(farthest_points(&line, 4), [0, 8, 4, 2]);
        assert_eq!(farthest_points(&line, 20).len(), 9);
        assert!(farthest_points(&[], 3).is_empty());
    }
}
