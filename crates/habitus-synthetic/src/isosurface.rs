//! The zero level of a sampled scalar field as a mesh of even triangles (surface nets, Gibson 1998).
//!
//! One vertex per cell that the surface crosses, at the mean of its edge crossings: garments are cut from it and
//! captures are extracted with it, because its triangles are far more even than those of marching cubes.

use glam::DVec3;

/// Samples of a scalar field on a regular grid, x fastest, negative inside.
#[derive(Debug, Clone)]
pub struct ScalarGrid {
    /// Position of sample (0, 0, 0).
    pub origin: DVec3,
    /// Distance between neighbouring samples, metres.
    pub spacing: f64,
    /// Number of samples along x, y and z.
    pub dimensions: [usize; 3],
    /// The samples, `dimensions` product of them.
    pub samples: Vec<f32>,
}

/// Vertex positions and faces, outward counter-clockwise.
pub type Triangles = (Vec<DVec3>, Vec<[u32; 3]>);

const NO_VERTEX: u32 = u32::MAX;

/// The twelve edges of a cell as pairs of corners; a corner's bits are its x, y and z offsets.
const CELL_EDGES: [(usize, usize); 12] =
    [(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)];

impl ScalarGrid {
    /// An all-positive grid that covers a box.
    pub fn covering(low: DVec3, high: DVec3, spacing: f64) -> Self {
        let count = |extent: f64| (extent.max(0.0) / spacing).ceil() as usize + 1;
        let extent = high - low;
        let dimensions = [count(extent.x), count(extent.y), count(extent.z)];
        let samples = vec![f32::MAX; dimensions.iter().product()];
        Self { origin: low, spacing, dimensions, samples }
    }

    /// The zero level; empty where the field has one sign.
    pub fn surface(&self) -> Triangles {
        let [nx, ny, nz] = self.dimensions;
        if nx < 2 || ny < 2 || nz < 2 {
            return (Vec::new(), Vec::new());
        }
        let (positions, cell_vertices) = self.cell_vertices();
        let faces = self.quads(&positions, &cell_vertices);
        (positions, faces)
    }

    fn cell_vertices(&self) -> (Vec<DVec3>, Vec<u32>) {
        let [nx, ny, nz] = self.dimensions;
        let mut positions = Vec::new();
        let mut cell_vertices = vec![NO_VERTEX; nx * ny * nz];
        for z in 0..nz - 1 {
            for y in 0..ny - 1 {
                let row = (z * ny + y) * nx;
                for x in 0..nx - 1 {
                    let corner = |bits: usize| {
                        self.samples[row + x + (bits & 1) + (bits >> 1 & 1) * nx + (bits >> 2) * nx * ny]
                    };
                    let inside = (0..8).filter(|&bits| corner(bits) < 0.0).count();
                    if inside == 0 || inside == 8 {
                        continue;
                    }
                    let values: [f32; 8] = std::array::from_fn(corner);
                    let offset = mean_edge_crossing(&values);
                    cell_vertices[row + x] = positions.len() as u32;
                    positions.push(
                        self.origin + (DVec3::new(x as f64, y as f64, z as f64) + offset) * self.spacing,
                    );
                }
            }
        }
        (positions, cell_vertices)
    }

    /// One quad around every grid edge whose ends differ in sign.
    fn quads(&self, positions: &[DVec3], cell_vertices: &[u32]) -> Vec<[u32; 3]> {
        let [nx, ny, nz] = self.dimensions;
        let strides = [1, nx, nx * ny];
        let mut faces = Vec::with_capacity(positions.len() * 2);
        for z in 0..nz - 1 {
            for y in 0..ny - 1 {
                for x in 0..nx - 1 {
                    let sample = (z * ny + y) * nx + x;
                    let is_inside = self.samples[sample] < 0.0;
                    for axis in 0..3 {
                        let (second, third) = ((axis + 1) % 3, (axis + 2) % 3);
                        let place = [x, y, z];
                        if place[second] == 0 || place[third] == 0 {
                            continue;
                        }
                        if is_inside == (self.samples[sample + strides[axis]] < 0.0) {
                            continue;
                        }
                        let quad = [
                            cell_vertices[sample],
                            cell_vertices[sample - strides[second]],
                            cell_vertices[sample - strides[second] - strides[third]],
                            cell_vertices[sample - strides[third]],
                        ];
                        split_quad(positions, quad, is_inside, &mut faces);
                    }
                }
            }
        }
        faces
    }
}

fn mean_edge_crossing(values: &[f32; 8]) -> DVec3 {
    let place = |bits: usize| DVec3::new((bits & 1) as f64, (bits >> 1 & 1) as f64, (bits >> 2) as f64);
    let mut sum = DVec3::ZERO;
    let mut count = 0.0;
    for (start, end) in CELL_EDGES {
        if (values[start] < 0.0) == (values[end] < 0.0) {
            continue;
        }
        let fraction = f64::from(values[start]) / (f64::from(values[start]) - f64::from(values[end]));
        sum += place(start).lerp(place(end), fraction);
        count += 1.0;
    }
    sum / count
}

/// Cuts a quad along its shorter diagonal.
fn split_quad(positions: &[DVec3], quad: [u32; 4], keep_order: bool, faces: &mut Vec<[u32; 3]>) {
    let [a, b, c, d] = if keep_order { quad } else { [quad[0], quad[3], quad[2], quad[1]] };
    let length = |from: u32, to: u32| positions[from as usize].distance_squared(positions[to as usize]);
    if length(a, c) <= length(b, d) {
        faces.extend([[a, b, c], [a, c, d]]);
    } else {
        faces.extend([[a, b, d], [b, c, d]]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(radius: f64, spacing: f64) -> ScalarGrid {
        let half = DVec3::splat(radius + 3.0 * spacing);
        let mut grid = ScalarGrid::covering(-half, half, spacing);
        let [nx, ny, nz] = grid.dimensions;
        for z in 0..nz {
            for y in 0..ny {
                for x in 0..nx {
                    let place = grid.origin + DVec3::new(x as f64, y as f64, z as f64) * spacing;
                    grid.samples[(z * ny + y) * nx + x] = (place.length() - radius) as f32;
                }
            }
        }
        grid
    }

    #[test]
    fn a_sphere_comes_back_closed_and_facing_out() {
        let (radius, spacing) = (0.3, 0.02);
        let (positions, faces) = sphere(radius, spacing).surface();
        let volume: f64 = faces
            .iter()
            .map(|face| {
                let [a, b, c] = face.map(|vertex| positions[vertex as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        let expected = 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
        // A mesh of chords of length h loses about h²/R² of the volume.
        assert!((volume / expected - 1.0).abs() < (spacing / radius).powi(2) * 2.0, "{volume} {expected}");
        assert_eq!(positions.len() as i64 - faces.len() as i64 / 2, 2, "Euler characteristic of a sphere");
        for position in &positions {
            assert!((position.length() - radius).abs() < spacing / 8.0);
        }
    }
}
