//! What arithmetic and memory alone would cost, from counts and stated machine rates.

use habitus::body::BodySurface;
use habitus::stages::fit_sequence::FitSequenceConfig;

/// Rates of one quiet core, measured by copying and by matrix products of tuned libraries.
const COPY_BYTES_PER_SECOND: f64 = 24e9;
const F64_FLOPS: f64 = 79e9;
const F32_FLOPS: f64 = 164e9;

/// Work that cannot be avoided.
#[derive(Clone, Copy, Default)]
pub struct Work {
    pub bytes: f64,
    pub f32_flops: f64,
    pub f64_flops: f64,
}

impl Work {
    /// Milliseconds on one core if memory and arithmetic overlap perfectly.
    pub fn floor_ms(self) -> f64 {
        let arithmetic = self.f32_flops / F32_FLOPS + self.f64_flops / F64_FLOPS;
        1e3 * arithmetic.max(self.bytes / COPY_BYTES_PER_SECOND)
    }

    fn times(self, count: f64) -> Self {
        Self {
            bytes: self.bytes * count,
            f32_flops: self.f32_flops * count,
            f64_flops: self.f64_flops * count,
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            bytes: self.bytes + other.bytes,
            f32_flops: self.f32_flops + other.f32_flops,
            f64_flops: self.f64_flops + other.f64_flops,
        }
    }
}

/// Closest points in a four-wide tree: `nodes` of four boxes and `packets` of four triangles seen by each query.
fn closest(queries: usize, nodes: f64, packets: f64) -> Work {
    // A box costs 11 operations and 28 bytes, the bound of a triangle 55 and 40; the answer is 96 bytes.
    let query = Work {
        bytes: nodes * 4.0 * 28.0 + packets * 4.0 * 40.0 + 96.0,
        f32_flops: nodes * 4.0 * 11.0 + packets * 4.0 * 55.0,
        f64_flops: 0.0,
    };
    query.times(queries as f64)
}

/// From the root: one path of six levels for 40k triangles, and as many nodes again beside it.
pub fn closest_cold(queries: usize) -> Work {
    closest(queries, 12.0, 4.0)
}

/// With the last answer as the bound, hardly more than one path.
pub fn closest_warm(queries: usize) -> Work {
    closest(queries, 7.0, 2.0)
}

/// Bones that move a vertex, on average.
fn bones_per_vertex(surface: &BodySurface) -> f64 {
    let count: usize = (0..surface.vertex_count()).map(|vertex| surface.skin().of(vertex).count()).sum();
    count as f64 / surface.vertex_count() as f64
}

/// A matrix times a point, added with a weight: 21 operations for each bone; rest, posed, bones and weights move.
pub fn skinning(surface: &BodySurface) -> Work {
    let vertex =
        Work { bytes: 24.0 + 24.0 + 36.0, f64_flops: 21.0 * bones_per_vertex(surface), f32_flops: 0.0 };
    vertex.times(surface.vertex_count() as f64)
}

/// The whole basis is read once.
pub fn identity(surface: &BodySurface) -> Work {
    let entries = 3.0 * surface.component_count() as f64;
    let vertex = Work { bytes: 4.0 * entries + 48.0, f32_flops: 2.0 * entries, f64_flops: 0.0 };
    vertex.times(surface.vertex_count() as f64)
}

/// One residual for each vertex: a wrench for each bone (30 operations) and a symmetric 6 × 6 block for each pair of them.
pub fn pose_equations(surface: &BodySurface) -> Work {
    let bones = bones_per_vertex(surface);
    let pairs = bones * (bones + 1.0) / 2.0;
    let vertex = Work { bytes: 72.0 + 84.0, f64_flops: 30.0 * bones + 72.0 * pairs, f32_flops: 0.0 };
    vertex.times(surface.vertex_count() as f64)
}

/// The same with the identity's direction of each residual: Aᵀq, and its product with each bone's wrench.
pub fn joint_equations(surface: &BodySurface) -> Work {
    let width = surface.component_count() as f64;
    let flops = 6.0 * width + 12.0 * width * bones_per_vertex(surface);
    let vertex = Work { bytes: 12.0 * width, f64_flops: flops, f32_flops: 0.0 };
    pose_equations(surface).plus(vertex.times(surface.vertex_count() as f64))
}

/// Σ Aᵀ M A over vertices: half of a product of 3V × K with itself.
pub fn identity_equations(surface: &BodySurface) -> Work {
    let width = surface.component_count() as f64;
    let vertex = Work { bytes: 12.0 * width, f64_flops: 3.0 * width * (width + 1.0), f32_flops: 0.0 };
    vertex.times(surface.vertex_count() as f64)
}

/// Coarse rounds, fine rounds and the last look at the result; `coarse` stands for the vertices of the coarse rounds.
pub fn tracked_frame(coarse: &BodySurface, fine: &BodySurface, config: &FitSequenceConfig) -> Work {
    let round = |surface: &BodySurface| {
        let moved = skinning(surface).plus(pose_equations(surface));
        moved.plus(closest_warm(surface.vertex_count()))
    };
    let look = skinning(fine).plus(closest_warm(fine.vertex_count()));
    let coarse_rounds = round(coarse).times(config.track.coarse_rounds as f64);
    coarse_rounds.plus(round(fine).times(config.track.fine_rounds as f64)).plus(look)
}

/// Pose rounds, then the equations of pose and identity; the basis is applied once a pass, not once a frame.
pub fn refined_frame(fine: &BodySurface, config: &FitSequenceConfig) -> Work {
    let moved = skinning(fine).plus(closest_warm(fine.vertex_count()));
    let rounds = moved.plus(pose_equations(fine)).times(config.refine.pose_rounds as f64);
    rounds.plus(moved).plus(joint_equations(fine))
}

/// The file is read, the mesh written.
pub fn ply(file_bytes: usize, vertices: usize, faces: usize) -> Work {
    Work { bytes: (file_bytes + 24 * vertices + 12 * faces) as f64, ..Work::default() }
}
