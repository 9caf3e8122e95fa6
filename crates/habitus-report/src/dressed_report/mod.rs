//! Reports of `extract-clothing`, `learn-clothing` and `synthesize`: the dressed person plays, with figures and tables below.
//!
//! One block, little-endian, each array padded to four bytes: body faces, weights and bones; clothing faces; body at rest;
//! bones of all frames; the clothing of each frame as 16 bits a coordinate in its own box, and the clearance of all
//! frames; the same once more for the clothing before the push-out.

mod clip;
mod pages;

use glam::DVec3;

pub(crate) use clip::signed_mm;
pub use clip::{ClipSource, layer_clip, model_clip, synthesized_clip};
pub use pages::{extraction_report, model_report, synthesis_report};

use crate::dressing_room::{Bytes, SkinnedSurface, VIEWER, body_skin};
use crate::render::ColorScale;
use crate::report::{STYLE, escaped, script_json};
use crate::shape_space::{Figure, SHEET_STYLE, Table, sheets};

const ROOM_STYLE: &str = include_str!("../../assets/dressing_room.css");
const SCRIPTS: [&str; 7] = [
    include_str!("../../assets/linear_algebra.js"),
    include_str!("../../assets/blocks.js"),
    include_str!("../../assets/shaders.js"),
    include_str!("../../assets/viewer.js"),
    include_str!("../../assets/controls.js"),
    include_str!("../../assets/dressed_stage.js"),
    include_str!("../../assets/dressed_report.js"),
];
/// Bytes of 3D data at most: what every browser opens at once.
const SIZE_LIMIT: usize = 9 << 20;
/// Steps of the heat map's colour table.
const HEAT_STEPS: usize = 256;

/// Clothing in one frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameShape {
    /// Vertices, metres.
    pub clothing: Vec<DVec3>,
    /// Signed distance of each from the skin, millimetres, negative inside; empty: unknown.
    pub clearance_mm: Vec<f64>,
}

/// A dressed person who plays in a report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DressedClip {
    /// The body.
    pub body: SkinnedSurface,
    /// The body at rest, metres.
    pub rest_vertices: Vec<DVec3>,
    /// Triangles of the clothing.
    pub clothing_faces: Vec<[u32; 3]>,
    /// Frames a second of what is shown.
    pub frames_per_second: f64,
    /// Rotation and translation of each bone for each frame.
    pub bones: Vec<Vec<(glam::DMat3, DVec3)>>,
    /// The clothing of each frame.
    pub shown: Vec<FrameShape>,
    /// The clothing of each frame before it was pushed out of the body; empty: there was no push-out.
    pub before: Vec<FrameShape>,
}

/// A page: everything inside one file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DressedReport {
    /// Heading.
    pub title: String,
    /// A line below it.
    pub subtitle: String,
    /// What plays, if anything does.
    pub clip: Option<DressedClip>,
    /// Figures.
    pub figures: Vec<Figure>,
    /// Tables.
    pub tables: Vec<Table>,
}

/// Every how many of `frame_count` frames fit into a page, with `variants` shapes of the clothing each.
pub(crate) fn frame_step(frame_count: usize, clothing_vertices: usize, variants: usize) -> usize {
    let bytes = variants.max(1) * clothing_vertices * 7;
    let fitting = (SIZE_LIMIT / bytes.max(1)).max(2);
    frame_count.div_ceil(fitting).max(1)
}

impl DressedReport {
    /// The page as HTML.
    pub fn html(&self) -> String {
        let title = escaped(&self.title);
        let (stage, script) = match &self.clip {
            Some(clip) if !clip.shown.is_empty() => (
                format!(
                    "<section class=\"stage dressing without-controls\">{VIEWER}</section><div class=\"stage-notes\"><p class=\"keys\"><kbd>space</kbd> play <kbd>←</kbd> <kbd>→</kbd> frame <kbd>c</kbd> clothing <kbd>b</kbd> body <kbd>h</kbd> clearance <kbd>p</kbd> penetration <kbd>u</kbd> before the push-out <kbd>f</kbd> follow</p></div>"
                ),
                clip.script(),
            ),
            _ => (String::new(), String::new()),
        };
        format!(
            "<!doctype html>\n<html lang=\"en\" data-state=\"loading\">\n<head>\n<meta charset=\"utf-8\">\n<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'\">\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<meta name=\"color-scheme\" content=\"light dark\">\n<title>{title} – habitus</title>\n<link rel=\"icon\" href=\"data:,\">\n<style>\n{STYLE}\n{ROOM_STYLE}\n{SHEET_STYLE}\n</style>\n</head>\n<body>\n<header class=\"masthead\"><div class=\"masthead-text\"><p class=\"brand\">habitus <span>{}</span></p><h1>{title}</h1><p class=\"subtitle\">{}</p></div></header>\n<main>{stage}<div class=\"sheets\">{}</div></main>\n<footer><p>Everything on this page is inside this one file: it loads nothing from the network and sends nothing.</p></footer>\n{script}</body>\n</html>\n",
            env!("CARGO_PKG_VERSION"),
            escaped(&self.subtitle),
            sheets(&self.figures, &self.tables),
        )
    }
}

impl DressedClip {
    fn script(&self) -> String {
        let scale = ColorScale::CLEARANCE;
        let has_clearance = self.shown.iter().all(|shape| !shape.clearance_mm.is_empty());
        let head = serde_json::json!({
            "body": {
                "vertexCount": self.body.vertex_count,
                "faceCount": self.body.faces.len(),
                "boneCount": self.bones.first().map_or(0, Vec::len),
                "rootVertex": self.body.root_vertex(),
            },
            "clothing": {
                "vertexCount": self.clothing_vertex_count(),
                "faceCount": self.clothing_faces.len(),
                "frameCount": self.shown.len(),
                "hasClearance": has_clearance,
                "hasBefore": !self.before.is_empty(),
            },
            "framesPerSecond": self.frames_per_second,
            "heatRange": [scale.low_mm, scale.high_mm],
            "heatColors": scale.table(HEAT_STEPS),
        });
        // A value of numbers always has a form in JSON.
        let head = script_json(&head).unwrap_or_default();
        format!(
            "<script type=\"application/json\" id=\"report-data\">{head}</script>\n<script type=\"application/octet-stream\" id=\"block-dressed\">{}</script>\n<script type=\"module\">\n{}\n</script>\n",
            self.bytes(has_clearance).base64(),
            SCRIPTS.join("\n")
        )
    }

    fn clothing_vertex_count(&self) -> usize {
        self.shown.first().map_or(0, |shape| shape.clothing.len())
    }

    fn bytes(&self, has_clearance: bool) -> Bytes {
        let mut bytes = Bytes::default();
        bytes.faces(&self.body.faces, self.body.vertex_count);
        let (weights, bones) = body_skin(&self.body.skin);
        bytes.raw(weights);
        bytes.raw(bones);
        bytes.faces(&self.clothing_faces, self.clothing_vertex_count());
        bytes.floats(self.rest_vertices.iter().flat_map(|place| place.to_array()));
        bytes.bones(&self.bones);
        for variant in [&self.shown, &self.before] {
            variant.iter().for_each(|shape| bytes.quantized(&shape.clothing));
            if has_clearance && !variant.is_empty() {
                bytes.clearances(variant.iter().flat_map(|shape| &shape.clearance_mm));
            }
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;

    fn clip() -> DressedClip {
        let triangle = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let shape = |height: f64| FrameShape {
            clothing: triangle.iter().map(|place| *place + DVec3::Z * height).collect(),
            clearance_mm: vec![1.0, -2.0, 300.0],
        };
        DressedClip {
            body: SkinnedSurface { vertex_count: 3, faces: vec![[0, 1, 2]], skin: vec![vec![(0, 1.0)]; 3] },
            rest_vertices: triangle.clone(),
            clothing_faces: vec![[0, 1, 2]],
            frames_per_second: 30.0,
            bones: vec![vec![(DMat3::IDENTITY, DVec3::ZERO)]; 2],
            shown: vec![shape(0.1), shape(0.2)],
            before: vec![shape(0.0), shape(0.1)],
        }
    }

    #[test]
    fn a_page_is_one_file_that_loads_nothing_and_names_stay_text() {
        let report = DressedReport {
            title: "<b>run</b>".into(),
            subtitle: "a & b".into(),
            clip: Some(clip()),
            ..DressedReport::default()
        };
        let html = report.html();
        assert!(html.contains("block-dressed") && html.contains("a &amp; b"));
        assert!(!html.contains("<b>run") && !html.contains("http://") && !html.contains("src="));
        let bare = DressedReport { clip: None, ..report }.html();
        assert!(!bare.contains("<script"));
    }

    #[test]
    fn the_block_has_the_length_that_the_script_reads() {
        let clip = clip();
        // Faces 6 → 8 twice, skin 12 + 12, rest 36, bones 2 × 48; a shape 24 + 18 → 20, clearance 6 → 8.
        assert_eq!(clip.bytes(true).finish().len(), 8 + 24 + 8 + 36 + 96 + 2 * (2 * 44 + 8));
    }

    #[test]
    fn long_sequences_are_thinned_evenly() {
        assert_eq!(frame_step(60, 5_000, 2), 1);
        let step = frame_step(1_000, 10_000, 2);
        assert!(step > 1 && 1_000 / step * 2 * 70_000 <= SIZE_LIMIT);
        assert_eq!(frame_step(10, 10_000_000, 2), 5, "two frames at least");
    }
}
