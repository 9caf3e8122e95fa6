//! The dressing room: a page on which a dressed person plays while sliders change build, motion, fabric and size.
//!
//! This module knows the page and the order of the numbers that it reads; `room` answers choices from a clothing model.
//! All arrays are little-endian, one after the other, each padded to four bytes.

mod bytes;
mod room;

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};
use serde::Serialize;
use thiserror::Error;

pub(crate) use bytes::{Bytes, body_skin};
pub use room::{DressingRoom, RoomFabric, RoomMotion};

use crate::render::ColorScale;
use crate::report::escaped;

const PAGE: &str = include_str!("../../assets/dressing_room.html");
/// Canvas and buttons of a dressed person, for the room and for reports.
pub(crate) const VIEWER: &str = include_str!("../../assets/dressed_viewer.html");
const STYLES: [&str; 2] =
    [include_str!("../../assets/style.css"), include_str!("../../assets/dressing_room.css")];
const SCRIPTS: [&str; 7] = [
    include_str!("../../assets/linear_algebra.js"),
    include_str!("../../assets/blocks.js"),
    include_str!("../../assets/shaders.js"),
    include_str!("../../assets/viewer.js"),
    include_str!("../../assets/controls.js"),
    include_str!("../../assets/dressed_stage.js"),
    include_str!("../../assets/dressing_room.js"),
];
/// Steps of the heat map's colour table.
const HEAT_STEPS: usize = 256;

/// A fabric of the list, in standardised components.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FabricChoice {
    /// Name.
    pub name: String,
    /// Components (P3 §5.2: 4).
    pub components: Vec<f64>,
}

/// A size that a slider changes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SizeChoice {
    /// Name in questions.
    pub name: String,
    /// Words for a person.
    pub label: String,
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
    /// Value at the start.
    pub value: f64,
}

/// A surface that bones move.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkinnedSurface {
    /// Number of vertices.
    pub vertex_count: usize,
    /// Triangles.
    pub faces: Vec<[u32; 3]>,
    /// Bones and weights of each vertex.
    pub skin: Vec<Vec<(usize, f64)>>,
}

impl SkinnedSurface {
    /// A vertex that the root moves most: what the camera follows.
    pub(crate) fn root_vertex(&self) -> usize {
        let share = |vertex: &Vec<(usize, f64)>| {
            vertex.iter().filter(|(bone, _)| *bone == 0).map(|(_, weight)| *weight).sum::<f64>()
        };
        let shares = self.skin.iter().enumerate().map(|(index, vertex)| (index, share(vertex)));
        shares.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index)
    }
}

/// All that the page needs once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DressingScene {
    /// Heading.
    pub title: String,
    /// A line below it.
    pub subtitle: String,
    /// The body.
    pub body: SkinnedSurface,
    /// Number of bones.
    pub bone_count: usize,
    /// The clothing: its skin is that of the associated body vertices, blended by their weights (P3 Eq. 3).
    pub clothing: SkinnedSurface,
    /// Components of the clothing layer, each of `vertex_count` displacements of the unposed clothing, metres.
    pub components: Vec<Vec<DVec3>>,
    /// Sliders for the build.
    pub identity_count: usize,
    /// Names of the motions.
    pub motions: Vec<String>,
    /// Fabrics; the first is that of the start.
    pub fabrics: Vec<FabricChoice>,
    /// Sliders for the fabric.
    pub fabric_component_count: usize,
    /// Sliders for the size.
    pub sizes: Vec<SizeChoice>,
    /// Poses a second.
    pub frames_per_second: f64,
}

/// What the sliders say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DressingChoice {
    /// Number of the motion.
    pub motion: usize,
    /// Build in standard deviations.
    pub identity: Vec<f64>,
    /// Fabric in standardised components.
    pub fabric: Vec<f64>,
    /// Sizes in the order of the scene.
    pub sizes: Vec<f64>,
    /// Whether the distance of the cloth from the skin is shown.
    pub shows_clearance: bool,
}

/// The answer to a choice.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DressedMotion {
    /// The body at rest, metres.
    pub rest_vertices: Vec<DVec3>,
    /// The unposed clothing without any component, metres.
    pub clothing_base: Vec<DVec3>,
    /// Rotation and translation of each bone, posed from rest, for each frame.
    pub bones: Vec<Vec<(DMat3, DVec3)>>,
    /// Coefficients of the components for each frame.
    pub coefficients: Vec<Vec<f64>>,
    /// Signed distance of each clothing vertex from the skin for each frame, millimetres, negative inside; empty: unknown.
    pub clearance_mm: Vec<Vec<f64>>,
}

/// Why a choice has no answer.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum DressingError {
    /// A number is missing, broken or out of its range.
    #[error("{name} is '{value}', but must be {expected}")]
    Choice {
        /// What the sliders call it.
        name: &'static str,
        /// What was sent.
        value: String,
        /// What is allowed.
        expected: String,
    },
}

/// Largest deviation of a build or a fabric that a slider can ask for.
const LARGEST_DEVIATION: f64 = 3.0;

impl DressingScene {
    /// The page's markup.
    pub fn page(&self) -> String {
        PAGE.replace("{{viewer}}", VIEWER)
            .replace("{{title}}", &escaped(&self.title))
            .replace("{{subtitle}}", &escaped(&self.subtitle))
    }

    /// The page's style sheet.
    pub fn style() -> String {
        STYLES.concat()
    }

    /// The page's script.
    pub fn script() -> String {
        SCRIPTS.join("\n")
    }

    /// What the script reads first, as a value for JSON.
    pub fn head(&self) -> serde_json::Value {
        let scale = ColorScale::CLEARANCE;
        serde_json::json!({
            "body": {
                "vertexCount": self.body.vertex_count,
                "faceCount": self.body.faces.len(),
                "boneCount": self.bone_count,
                "rootVertex": self.body.root_vertex(),
            },
            "clothing": {
                "vertexCount": self.clothing.vertex_count,
                "faceCount": self.clothing.faces.len(),
                "componentCount": self.components.len(),
                "influenceCount": self.influence_count(),
            },
            "identityCount": self.identity_count,
            "motions": self.motions,
            "fabrics": self.fabrics,
            "fabricComponentCount": self.fabric_component_count,
            "sizes": self.sizes,
            "framesPerSecond": self.frames_per_second,
            "heatRange": [scale.low_mm, scale.high_mm],
            "heatColors": scale.table(HEAT_STEPS),
        })
    }

    /// Body faces, weights and bones; clothing faces, weights, bones and components.
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = Bytes::default();
        bytes.faces(&self.body.faces, self.body.vertex_count);
        let (weights, bones) = body_skin(&self.body.skin);
        bytes.raw(weights);
        bytes.raw(bones);
        bytes.faces(&self.clothing.faces, self.clothing.vertex_count);
        let count = self.influence_count();
        let padded = |vertex: &Vec<(usize, f64)>| {
            let mut influences = vertex.clone();
            influences.resize(count, (0, 0.0));
            influences
        };
        let skin: Vec<(usize, f64)> = self.clothing.skin.iter().flat_map(padded).collect();
        bytes.floats(skin.iter().map(|(_, weight)| *weight));
        bytes.raw(skin.iter().map(|(bone, _)| *bone as u8).collect());
        bytes.floats(self.components.iter().flatten().flat_map(|place| place.to_array()));
        bytes.finish()
    }

    fn influence_count(&self) -> usize {
        self.clothing.skin.iter().map(Vec::len).max().unwrap_or(0).max(1)
    }

    /// Reads what the sliders say, as the script writes it into the path: `motion=0;identity=0,1.5;fabric=;sizes=1`.
    /// Everything is checked against the scene.
    pub fn choice(&self, question: &str) -> Result<DressingChoice, DressingError> {
        let values: BTreeMap<&str, &str> =
            question.split(';').filter_map(|pair| pair.split_once('=')).collect();
        let text = |name: &str| values.get(name).copied().unwrap_or_default();
        let refuse = |name, value: &str, expected: String| {
            Err(DressingError::Choice { name, value: value.into(), expected })
        };
        let motion = text("motion").parse().ok().filter(|motion: &usize| *motion < self.motions.len());
        let Some(motion) = motion else {
            return refuse("motion", text("motion"), format!("below {}", self.motions.len()));
        };
        let numbers = |name: &'static str, limits: Vec<[f64; 2]>| {
            let words: Vec<&str> = text(name).split(',').filter(|word| !word.is_empty()).collect();
            let numbers: Vec<f64> = words.iter().filter_map(|word| word.parse().ok()).collect();
            let fits = words.len() == limits.len()
                && numbers.len() == limits.len()
                && numbers.iter().zip(&limits).all(|(number, [low, high])| (*low..=*high).contains(number));
            if fits {
                return Ok(numbers);
            }
            let expected = format!("{} numbers within the sliders' ends", limits.len());
            Err(DressingError::Choice { name, value: text(name).into(), expected })
        };
        let deviation = [-LARGEST_DEVIATION, LARGEST_DEVIATION];
        Ok(DressingChoice {
            motion,
            identity: numbers("identity", vec![deviation; self.identity_count])?,
            fabric: numbers("fabric", vec![deviation; self.fabric_component_count])?,
            sizes: numbers("sizes", self.sizes.iter().map(|size| [size.low, size.high]).collect())?,
            shows_clearance: text("clearance") == "1",
        })
    }
}

impl DressedMotion {
    /// Counts, rest body, clothing base, bones, coefficients, clearance.
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = Bytes::default();
        let has_clearance = !self.clearance_mm.is_empty();
        bytes.words(&[self.bones.len() as u32, u32::from(has_clearance)]);
        bytes.floats(self.rest_vertices.iter().flat_map(|place| place.to_array()));
        bytes.floats(self.clothing_base.iter().flat_map(|place| place.to_array()));
        bytes.bones(&self.bones);
        bytes.floats(self.coefficients.iter().flatten().copied());
        bytes.clearances(self.clearance_mm.iter().flatten());
        bytes.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> DressingScene {
        DressingScene {
            motions: vec!["walk".into(), "turn".into()],
            identity_count: 2,
            sizes: vec![SizeChoice {
                name: "width".into(),
                label: "Width".into(),
                low: 0.8,
                high: 1.4,
                value: 1.0,
            }],
            ..DressingScene::default()
        }
    }

    #[test]
    fn sliders_are_read_and_checked_against_their_ends() {
        let choice = scene().choice("motion=1;identity=0.5,-3;fabric=;sizes=1.25;clearance=1").unwrap();
        let expected = DressingChoice {
            motion: 1,
            identity: vec![0.5, -3.0],
            fabric: Vec::new(),
            sizes: vec![1.25],
            shows_clearance: true,
        };
        assert_eq!(choice, expected);
        for broken in [
            "motion=2;identity=0,0;sizes=1",
            "motion=-1;identity=0,0;sizes=1",
            "motion=0;identity=0;sizes=1",
            "motion=0;identity=0,4;sizes=1",
            "motion=0;identity=0,NaN;sizes=1",
            "motion=0;identity=0,0;sizes=1e9",
            "motion=0;identity=0,0,0,0,0;sizes=1",
            "",
        ] {
            assert!(scene().choice(broken).is_err(), "{broken}");
        }
    }

    #[test]
    fn markup_in_a_title_stays_text() {
        let scene = DressingScene { title: "<script>".into(), ..DressingScene::default() };
        assert!(!scene.page().contains("<h1><script>"));
    }

    #[test]
    fn arrays_are_padded_to_words() {
        let motion = DressedMotion {
            rest_vertices: vec![DVec3::ONE],
            clothing_base: vec![DVec3::ZERO; 2],
            bones: vec![vec![(DMat3::IDENTITY, DVec3::new(1.0, 2.0, 3.0))]],
            coefficients: vec![vec![0.5]],
            clearance_mm: vec![vec![-300.0, 4.4]],
        };
        let bytes = motion.bytes();
        assert_eq!(bytes.len(), 8 + 12 + 24 + 48 + 4 + 4);
        assert_eq!(bytes[bytes.len() - 4..], [-127_i8 as u8, 4, 0, 0]);
        let number = |index: usize| f32::from_le_bytes(bytes[index..index + 4].try_into().unwrap());
        // The last column of the second row.
        assert_eq!(number(8 + 12 + 24 + 16 + 12), 2.0);
    }
}
