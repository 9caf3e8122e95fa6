//! Arrays as the pages read them: little-endian, each padded to four bytes.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat3, DVec3};

/// Bones that move a vertex of the body in the shader.
const BODY_INFLUENCES: usize = 4;

/// Four strongest bones of each vertex as shares of 255.
pub(crate) fn body_skin(skin: &[Vec<(usize, f64)>]) -> (Vec<u8>, Vec<u8>) {
    let mut weights = Vec::with_capacity(skin.len() * BODY_INFLUENCES);
    let mut bones = Vec::with_capacity(skin.len() * BODY_INFLUENCES);
    for vertex in skin {
        let mut strongest = vertex.clone();
        strongest.sort_by(|a, b| b.1.total_cmp(&a.1));
        strongest.resize(BODY_INFLUENCES, (0, 0.0));
        weights.extend(strongest.iter().map(|(_, weight)| (weight * 255.0).round() as u8));
        bones.extend(strongest.iter().map(|(bone, _)| *bone as u8));
    }
    (weights, bones)
}

/// Arrays one after the other, each padded to four bytes.
#[derive(Default)]
pub(crate) struct Bytes(Vec<u8>);

impl Bytes {
    fn pad(&mut self) {
        self.0.resize(self.0.len().next_multiple_of(4), 0);
    }

    pub(crate) fn raw(&mut self, values: Vec<u8>) {
        self.0.extend(values);
        self.pad();
    }

    pub(crate) fn words(&mut self, values: &[u32]) {
        self.0.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }

    pub(crate) fn floats(&mut self, values: impl Iterator<Item = f64>) {
        self.0.extend(values.flat_map(|value| (value as f32).to_le_bytes()));
    }

    /// 16 bits an index where they suffice, as the script expects.
    pub(crate) fn faces(&mut self, faces: &[[u32; 3]], vertex_count: usize) {
        if vertex_count <= 1 << 16 {
            self.0.extend(faces.as_flattened().iter().flat_map(|vertex| (*vertex as u16).to_le_bytes()));
        } else {
            self.words(faces.as_flattened());
        }
        self.pad();
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.0
    }

    /// Rows of 3 × 4 of each bone of each frame.
    pub(crate) fn bones(&mut self, frames: &[Vec<(DMat3, DVec3)>]) {
        self.floats(frames.iter().flatten().flat_map(|(rotation, translation)| {
            let row = |k: usize| {
                let row = rotation.row(k);
                [row.x, row.y, row.z, translation[k]]
            };
            [row(0), row(1), row(2)].concat()
        }));
    }

    /// Millimetres as signed bytes.
    pub(crate) fn clearances<'a>(&mut self, millimetres: impl Iterator<Item = &'a f64>) {
        self.raw(millimetres.map(|value| value.round().clamp(-127.0, 127.0) as i8 as u8).collect());
    }

    /// The box of some places, then each coordinate as a share of it in 16 bits.
    pub(crate) fn quantized(&mut self, places: &[DVec3]) {
        let around = |(low, high): (DVec3, DVec3), place: &DVec3| (low.min(*place), high.max(*place));
        let (low, high) = places.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), around);
        let size = (high - low).max(DVec3::splat(1e-6));
        self.floats(low.to_array().into_iter().chain(size.to_array()));
        let share = |place: &DVec3| ((*place - low) / size * 65_535.0).round().to_array();
        let values = places.iter().flat_map(share).flat_map(|value| (value as u16).to_le_bytes());
        self.raw(values.collect());
    }

    /// As text for a page.
    pub(crate) fn base64(&self) -> String {
        STANDARD.encode(&self.0)
    }
}
