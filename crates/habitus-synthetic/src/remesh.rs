//! The same surface with another connectivity, as if every frame had been reconstructed on its own.

use glam::{DMat3, DQuat, DVec3};
use habitus::geometry::{SurfaceIndex, TriangleMesh};
use habitus::statistics::RandomStream;
use rayon::prelude::*;

use crate::isosurface::ScalarGrid;

/// Around each face this many grid steps are sampled.
const BAND: f64 = 1.5;
/// Vertices farther than this many grid steps from the surface are no corners that surface nets have rounded off, but
/// sheets closer together than the grid tells apart; they stay where they are.
const REACH: f64 = 1.0;

/// A closed mesh remeshed by surface nets on a grid of this spacing (metres) in a random place and orientation. Its
/// vertices lie on the surface exactly; nothing of the vertices, their order or the edges is kept. `None` where nothing of
/// the surface is left on the grid.
pub fn remeshed(mesh: &TriangleMesh, spacing: f64, seed: u64) -> Option<TriangleMesh> {
    let mut random = RandomStream::named(seed, "remesh");
    let mut signed = || random.between(-1.0, 1.0);
    let turn = DQuat::from_xyzw(signed(), signed(), signed(), signed()).normalize();
    let shift = DVec3::new(signed(), signed(), signed()) * spacing;
    let grid_from_world = DMat3::from_quat(turn);

    let index = SurfaceIndex::of_mesh(mesh);
    let turned: Vec<DVec3> = mesh.positions().iter().map(|p| grid_from_world * *p).collect();
    let margin = DVec3::splat(4.0 * spacing);
    let low = turned.iter().copied().reduce(DVec3::min)? - margin + shift;
    let high = turned.iter().copied().reduce(DVec3::max)? + margin + shift;
    let mut grid = ScalarGrid::covering(low, high, spacing);
    let is_near = near_faces(&grid, &turned, mesh.faces());
    let (origin, [nx, ny, _]) = (grid.origin, grid.dimensions);
    grid.samples.par_chunks_mut(nx).enumerate().for_each(|(row, samples)| {
        let (y, z) = (row % ny, row / ny);
        // Away from the surface only the side matters; it is that of the last sample near it.
        let mut side = f32::MAX;
        for (x, sample) in samples.iter_mut().enumerate() {
            if is_near[row * nx + x] {
                let point = origin + DVec3::new(x as f64, y as f64, z as f64) * spacing;
                *sample = signed_distance(&index, grid_from_world.transpose() * point) as f32;
                side = f32::MAX.copysign(*sample);
            } else {
                *sample = side;
            }
        }
    });
    let (positions, faces) = grid.surface();
    let on_surface = positions
        .into_par_iter()
        .map(|position| {
            let world = grid_from_world.transpose() * position;
            index.closest_within(world, REACH * spacing).map_or(world, |closest| closest.position)
        })
        .collect();
    TriangleMesh::new(on_surface, faces).ok()
}

/// Distance to the surface, negative inside. Where limbs cut through one another the normal of the nearest face may
/// point into another limb and calls its inside air; how often the surface winds around the point does not.
fn signed_distance(index: &SurfaceIndex, point: DVec3) -> f64 {
    let distance = index.closest(point).distance_squared.sqrt();
    if index.winding_number(point) > 0 { -distance } else { distance }
}

fn near_faces(grid: &ScalarGrid, positions: &[DVec3], faces: &[[u32; 3]]) -> Vec<bool> {
    let mut is_near = vec![false; grid.samples.len()];
    let [nx, ny, nz] = grid.dimensions;
    for face in faces {
        let corners = face.map(|vertex| (positions[vertex as usize] - grid.origin) / grid.spacing);
        let low = (corners[0].min(corners[1]).min(corners[2]) - BAND).ceil().max(DVec3::ZERO);
        let high = (corners[0].max(corners[1]).max(corners[2]) + BAND).floor();
        for z in low.z as usize..=(high.z as usize).min(nz - 1) {
            for y in low.y as usize..=(high.y as usize).min(ny - 1) {
                let row = (z * ny + y) * nx;
                is_near[row + low.x as usize..=row + (high.x as usize).min(nx - 1)].fill(true);
            }
        }
    }
    is_near
}

#[cfg(test)]
mod tests {
    use habitus::geometry::{Topology, area_weighted_points};

    use super::*;

    /// A ball of radius 0.3 m as a closed mesh.
    fn ball() -> TriangleMesh {
        let mut grid = ScalarGrid::covering(DVec3::splat(-0.4), DVec3::splat(0.4), 0.025);
        let [nx, ny, nz] = grid.dimensions;
        for (sample, value) in grid.samples.iter_mut().enumerate() {
            let (x, y, z) = (sample % nx, sample / nx % ny, sample / (nx * ny) % nz);
            let point = grid.origin + DVec3::new(x as f64, y as f64, z as f64) * grid.spacing;
            *value = (point.length() - 0.3) as f32;
        }
        let (positions, faces) = grid.surface();
        TriangleMesh::new(positions, faces).expect("a ball")
    }

    #[test]
    fn a_remeshed_ball_is_the_same_surface_with_other_vertices() {
        let ball = ball();
        let first = remeshed(&ball, 0.02, 1).expect("remeshes");
        let again = remeshed(&ball, 0.02, 1).expect("remeshes");
        let other = remeshed(&ball, 0.02, 2).expect("remeshes");
        assert_eq!(first, again);
        assert_ne!(first.positions().len(), other.positions().len());
        assert!(Topology::of_mesh(&first).is_closed_manifold());
        let index = SurfaceIndex::of_mesh(&ball);
        assert!(first.positions().iter().all(|p| index.closest(*p).distance_squared < 1e-20));
        // A face of two centimetres sags by at most edge²/8r from the ball.
        let index = SurfaceIndex::of_mesh(&first);
        let worst = area_weighted_points(&ball, 2000, 3)
            .iter()
            .map(|(point, _)| index.closest(*point).distance_squared.sqrt())
            .fold(0.0, f64::max);
        assert!(worst < 1e-3, "{worst}");
    }
}
