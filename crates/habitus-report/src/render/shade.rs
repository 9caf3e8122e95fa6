//! Light: a key and a fill lamp beside the camera, a bright sky, a soft gloss.

use glam::DVec3;

use super::Color;

/// Lamps of a picture, fixed to the camera so that every view is lit alike.
pub(crate) struct Studio {
    key: DVec3,
    fill: DVec3,
    up: DVec3,
}

impl Studio {
    /// Lamps for a camera with these right, up and backward directions.
    pub(crate) fn new([right, up, backwards]: [DVec3; 3], world_up: DVec3) -> Self {
        let key = (backwards * 0.75 + up * 0.75 - right * 0.65).normalize();
        let fill = (backwards * 0.6 + right * 0.9 + up * 0.1).normalize();
        Self { key, fill, up: world_up.normalize_or(DVec3::Y) }
    }

    /// Light that leaves a surface of this colour; `normal` and `toward_eye` are unit vectors on the same side.
    pub(crate) fn shade(&self, albedo: Color, normal: DVec3, toward_eye: DVec3) -> Color {
        // Wrapped cosine: the terminator fades softly, as under large lamps.
        let wrapped = |lamp: DVec3, wrap: f64| ((normal.dot(lamp) + wrap) / (1.0 + wrap)).max(0.0);
        let key = 0.84 * wrapped(self.key, 0.15).powf(1.2);
        let fill = 0.26 * wrapped(self.fill, 0.4);
        let sky = 0.23 + 0.12 * normal.dot(self.up);
        let halfway = (self.key + toward_eye).normalize_or(normal);
        let gloss = 0.06 * normal.dot(halfway).max(0.0).powi(24);
        let white = Color { red: 1.0, green: 1.0, blue: 1.0 };
        albedo.scaled((key + fill + sky) as f32).plus(white.scaled(gloss as f32))
    }
}
