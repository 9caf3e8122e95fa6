//! Normals of bare point clouds: planes through neighbours, turned to agree with each other (Hoppe et al. 1992, §3.2–3.3).

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::DVec3;
use nalgebra::{Matrix3, SymmetricEigen};
use rayon::prelude::*;

use crate::surface_index::SurfaceIndex;

/// Points per parallel piece.
const CHUNK: usize = 1024;

/// Unit normals of a bare cloud from planes through `neighbours` points (at least 3; 12 is usual), all turned outwards.
///
/// Each connected piece of the neighbourhood graph is turned so that its outermost point looks outwards, and the turn
/// spreads along the edges where normals agree best. A point without a plane (a lonely one, or one on a line) gets the
/// direction away from its piece's middle.
pub fn estimate_cloud_normals(positions: &[DVec3], neighbours: usize) -> Vec<DVec3> {
    if positions.is_empty() {
        return Vec::new();
    }
    let neighbours = neighbours.max(3);
    let index = SurfaceIndex::of_cloud(positions, &vec![DVec3::ZERO; positions.len()]);
    let per_point: Vec<(DVec3, Vec<u32>)> = positions
        .par_iter()
        .with_min_len(CHUNK)
        .map_init(Vec::new, |found, position| {
            // The point itself comes first or among its duplicates.
            index.nearest_few(*position, neighbours + 1, found);
            let around: Vec<u32> = found.iter().map(|(_, point)| *point).collect();
            (plane_normal(positions, &around), around)
        })
        .collect();
    let (mut normals, around): (Vec<DVec3>, Vec<Vec<u32>>) = per_point.into_iter().unzip();
    orient(positions, &mut normals, &NeighbourGraph::new(&around));
    normals
}

/// The direction in which these points vary least; zero where they do not span a plane.
fn plane_normal(positions: &[DVec3], points: &[u32]) -> DVec3 {
    let at = |point: &u32| positions[*point as usize];
    let mean = points.iter().map(at).sum::<DVec3>() / points.len() as f64;
    let mut covariance = Matrix3::<f64>::zeros();
    for point in points {
        let offset = (at(point) - mean).to_array();
        for row in 0..3 {
            for column in 0..3 {
                covariance[(row, column)] += offset[row] * offset[column];
            }
        }
    }
    let Some(eigen) = SymmetricEigen::try_new(covariance, f64::EPSILON, 100) else { return DVec3::ZERO };
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    // On a line two directions vary equally little, and neither is the normal.
    if eigen.eigenvalues[order[1]] <= 1e-12 * eigen.eigenvalues[order[2]] {
        return DVec3::ZERO;
    }
    let column = eigen.eigenvectors.column(order[0]);
    DVec3::new(column[0], column[1], column[2]).normalize_or_zero()
}

/// Who neighbours whom, in both directions.
struct NeighbourGraph {
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
}

impl NeighbourGraph {
    fn new(around: &[Vec<u32>]) -> Self {
        let mut links: Vec<(u32, u32)> = around
            .iter()
            .enumerate()
            .flat_map(|(point, near)| {
                near.iter().flat_map(move |&near| [(point as u32, near), (near, point as u32)])
            })
            .filter(|(from, to)| from != to)
            .collect();
        links.sort_unstable();
        links.dedup();
        let mut offsets = vec![0; around.len() + 1];
        for (from, _) in &links {
            offsets[*from as usize + 1] += 1;
        }
        for point in 0..around.len() {
            offsets[point + 1] += offsets[point];
        }
        Self { offsets, neighbours: links.into_iter().map(|(_, to)| to).collect() }
    }

    fn of(&self, point: u32) -> &[u32] {
        &self.neighbours[self.offsets[point as usize] as usize..self.offsets[point as usize + 1] as usize]
    }

    /// The points that can be reached from one, which are marked.
    fn piece(&self, start: u32, is_reached: &mut [bool]) -> Vec<u32> {
        let mut piece = vec![start];
        is_reached[start as usize] = true;
        let mut next = 0;
        while next < piece.len() {
            for &neighbour in self.of(piece[next]) {
                if !std::mem::replace(&mut is_reached[neighbour as usize], true) {
                    piece.push(neighbour);
                }
            }
            next += 1;
        }
        piece
    }
}

fn orient(positions: &[DVec3], normals: &mut [DVec3], graph: &NeighbourGraph) {
    let mut is_reached = vec![false; positions.len()];
    let mut is_turned = vec![false; positions.len()];
    for start in 0..positions.len() as u32 {
        if is_reached[start as usize] {
            continue;
        }
        let piece = graph.piece(start, &mut is_reached);
        let middle = piece.iter().map(|point| positions[*point as usize]).sum::<DVec3>() / piece.len() as f64;
        let outwards = |point: u32| positions[point as usize] - middle;
        for &point in &piece {
            if normals[point as usize] == DVec3::ZERO {
                normals[point as usize] = outwards(point).try_normalize().unwrap_or(DVec3::Y);
            }
        }
        // Where a closed surface is farthest from its middle it faces straight away from it.
        let outermost = piece.iter().copied().fold(start, |far, point| {
            if outwards(point).length_squared() > outwards(far).length_squared() { point } else { far }
        });
        if normals[outermost as usize].dot(outwards(outermost)) < 0.0 {
            normals[outermost as usize] *= -1.0;
        }
        spread(outermost, normals, graph, &mut is_turned);
    }
}

/// Prim's minimum spanning tree over `1 − |nᵢ·nⱼ|` (Hoppe §3.3), turning each point as it joins.
fn spread(start: u32, normals: &mut [DVec3], graph: &NeighbourGraph, is_turned: &mut [bool]) {
    let mut links = BinaryHeap::from([Link { disagreement: 0.0, from: start, to: start }]);
    while let Some(Link { from, to, .. }) = links.pop() {
        if std::mem::replace(&mut is_turned[to as usize], true) {
            continue;
        }
        if normals[to as usize].dot(normals[from as usize]) < 0.0 {
            normals[to as usize] *= -1.0;
        }
        for &next in graph.of(to) {
            if !is_turned[next as usize] {
                let agreement = normals[to as usize].dot(normals[next as usize]).abs();
                links.push(Link { disagreement: 1.0 - agreement, from: to, to: next });
            }
        }
    }
}

/// An edge of the graph; the greatest in the heap's sense is the one whose ends disagree least.
struct Link {
    disagreement: f64,
    from: u32,
    to: u32,
}

impl Ord for Link {
    fn cmp(&self, other: &Self) -> Ordering {
        other
            .disagreement
            .total_cmp(&self.disagreement)
            .then_with(|| (other.to, other.from).cmp(&(self.to, self.from)))
    }
}

impl PartialOrd for Link {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Link {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Link {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::SplitMix;
    use std::f64::consts::TAU;

    #[test]
    fn normals_of_a_sphere_point_away_from_its_centre() {
        let mut random = SplitMix::new(1);
        let centre = DVec3::new(5.0, -3.0, 2.0);
        let directions: Vec<DVec3> = (0..4000)
            .map(|_| {
                let (angle, height) = (TAU * random.unit(), 2.0 * random.unit() - 1.0);
                let ring = (1.0 - height * height).sqrt();
                DVec3::new(ring * angle.cos(), ring * angle.sin(), height)
            })
            .collect();
        let positions: Vec<DVec3> = directions.iter().map(|direction| centre + *direction * 0.3).collect();
        for (normal, truth) in estimate_cloud_normals(&positions, 12).iter().zip(&directions) {
            // Neighbours are up to 9° away, the plane through them leans by a part of that.
            assert!(normal.dot(*truth) > 0.97, "{normal} is not {truth}");
        }
    }

    #[test]
    fn normals_of_a_torus_agree_also_in_its_hole() {
        let mut positions = Vec::new();
        let mut truths = Vec::new();
        for i in 0..120 {
            for j in 0..40 {
                let (u, v) = (TAU * f64::from(i) / 120.0, TAU * f64::from(j) / 40.0);
                let normal = DVec3::new(v.cos() * u.cos(), v.cos() * u.sin(), v.sin());
                positions.push(DVec3::new(u.cos(), u.sin(), 0.0) * 0.7 + normal * 0.25);
                truths.push(normal);
            }
        }
        for (normal, truth) in estimate_cloud_normals(&positions, 10).iter().zip(&truths) {
            assert!(normal.dot(*truth) > 0.99, "{normal} is not {truth}");
        }
    }

    #[test]
    fn odd_clouds_get_unit_normals() {
        let line: Vec<DVec3> = (0..9).map(|place| DVec3::X * f64::from(place)).collect();
        let clouds = [vec![], vec![DVec3::ONE], vec![DVec3::ONE; 20], vec![DVec3::ZERO, DVec3::X], line];
        for cloud in clouds {
            let normals = estimate_cloud_normals(&cloud, 8);
            assert_eq!(normals.len(), cloud.len());
            assert!(normals.iter().all(|normal| (normal.length() - 1.0).abs() < 1e-9));
        }
    }
}
