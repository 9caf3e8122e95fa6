//! Surfaces for odd scenes, written as OBJ.

use std::fmt::Write;
use std::path::Path;

use habitus::body::BodyModel;
use habitus::geometry::glam::DVec3;

/// Vertices and faces.
#[derive(Clone)]
pub struct Shape {
    pub vertices: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
}

impl Shape {
    /// The mean person, standing with arms and legs apart, metres, y up.
    pub fn person() -> Self {
        let model = BodyModel::default_space().expect("the default space");
        Self { vertices: model.mean_vertices().to_vec(), faces: model.faces().to_vec() }
    }

    /// A box of these side lengths, each side a grid.
    pub fn cuboid(sides: DVec3) -> Self {
        const CELLS: usize = 12;
        let mut shape = Self { vertices: Vec::new(), faces: Vec::new() };
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                let base = shape.vertices.len() as u32;
                let at = |index: usize| 2.0 * index as f64 / CELLS as f64 - 1.0;
                for i in 0..=CELLS {
                    for j in 0..=CELLS {
                        let mut corner = DVec3::ZERO;
                        corner[axis] = sign;
                        corner[(axis + 1) % 3] = at(i);
                        corner[(axis + 2) % 3] = at(j);
                        shape.vertices.push(0.5 * sides * corner);
                    }
                }
                for cell in 0..CELLS * CELLS {
                    let a = base + (cell / CELLS * (CELLS + 1) + cell % CELLS) as u32;
                    let row = CELLS as u32 + 1;
                    let [b, c, d] = [a + row, a + row + 1, a + 1];
                    let quad = if sign > 0.0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
                    shape.faces.extend(quad);
                }
            }
        }
        shape
    }

    /// Every vertex moved.
    pub fn moved(mut self, place: impl Fn(DVec3) -> DVec3) -> Self {
        self.vertices.iter_mut().for_each(|vertex| *vertex = place(*vertex));
        self
    }

    /// Both in one scene.
    pub fn with(mut self, other: Self) -> Self {
        let offset = self.vertices.len() as u32;
        self.vertices.extend(other.vertices);
        self.faces.extend(other.faces.iter().map(|face| face.map(|vertex| vertex + offset)));
        self
    }

    /// The faces whose corners all satisfy a condition.
    pub fn part(mut self, keep: impl Fn(DVec3) -> bool) -> Self {
        let vertices = &self.vertices;
        self.faces.retain(|face| face.iter().all(|vertex| keep(vertices[*vertex as usize])));
        self
    }

    /// Writes an OBJ file.
    pub fn write(&self, path: &Path) {
        let mut text = String::new();
        for vertex in &self.vertices {
            let _ = writeln!(text, "v {} {} {}", vertex.x, vertex.y, vertex.z);
        }
        for [a, b, c] in &self.faces {
            let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
        }
        std::fs::write(path, text).expect("writes");
    }
}
