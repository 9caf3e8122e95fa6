//! Data with truth for clothing models: fabrics, sizes, motions (P3 §5.1–5.3).
//!
//! Each sequence is a run folder whose fit is the truth itself and whose captures are the garments in one topology, so
//! that `extract-clothing --aligned` takes it as it is. `parameters.csv` beside the runs holds the semantic parameters.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use habitus::artifacts::fabric::named_fabrics;
use habitus::artifacts::fitted_sequence::{FittedFrame, FittedSequence, InputFrame, Landmark};
use habitus::artifacts::rigged_sequence::{Rig, RiggedSequence};
use habitus::artifacts::sequence_files::write_fit;
use habitus::artifacts::synthesized_sequence::Penetration;
use habitus::artifacts::write_atomically;
use habitus::body::BodyModel;
use habitus::geometry::TriangleMesh;
use habitus::geometry::io::write_mesh;
use habitus::pipeline::{CaptureOrigin, InputKey, RunFolder, StageName, file_names};
use habitus::stages::synthesize::PushOut;
use habitus::stages::synthesize::config::PushOutConfig;
use habitus::statistics::RandomStream;
use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::cloth::ArmContact;
use crate::error::SyntheticError;
use crate::garment::{Garment, Outfit, tailor};
use crate::motion::Motion;

use crate::refit::{GarmentSize, refit};
use crate::rest_body::RestBody;
use crate::sequence::{DressedSequenceSettings, Performance, Scene};
use crate::truth::capture_file;

/// What varies over the sequences of a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClothingSet {
    /// One person, one garment, one motion, eight fabrics (P3 §5.2).
    Fabrics,
    /// Eight people walking in shorts and T-shirts of different sizes (P3 §5.3).
    Sizes,
    /// One person, one garment, several motions (P3 §5.1).
    Motions,
}

/// How large a data set is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SetSize {
    /// Coarse cloth and short sequences, minutes in all.
    Small,
    /// Fine cloth and sequences of several seconds.
    Full,
}

/// One sequence of a data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClothingSequence {
    /// Name of its run folder.
    pub name: String,
    /// The person, in standard deviations of the body model.
    pub identity: Vec<f64>,
    /// What the sequence is made with.
    pub settings: DressedSequenceSettings,
    /// Sizes of the garments, innermost first; none: cut to the person.
    pub sizes: Option<Vec<GarmentSize>>,
    /// Semantic parameters by name: 39 numbers of the fabric, or ratios of garment to body.
    pub parameters: BTreeMap<String, f64>,
}

/// What is known of a finished sequence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClothingSequenceSummary {
    /// Name of its run folder.
    pub name: String,
    /// Frames.
    pub frames: usize,
    /// Vertices of all garments.
    pub clothing_vertices: usize,
    /// Share of clothing vertices inside the body as they were simulated, over all frames.
    pub inside_share: f64,
    /// Largest depth of the clothing inside the body as it was simulated, over all frames, millimetres.
    pub deepest_simulated_mm: f64,
    /// The same as it was written, after the push-out.
    pub deepest_mm: f64,
    /// Semantic parameters by name, as measured on what was made.
    pub parameters: BTreeMap<String, f64>,
    /// Why the sequence could not be made, if so.
    pub error: Option<String>,
}

/// Subjects of the set of sizes (P3 §5.3: 8).
const SUBJECT_COUNT: usize = 8;
/// Components in which subjects differ, and their largest deviation.
const SUBJECT_COMPONENTS: usize = 12;
const SUBJECT_DEVIATION: f64 = 1.6;
/// Steps by which the sizes of the eight subjects differ: T-shirt width, shorts width, shorts length. Each takes every
/// step once, in orders that are nearly uncorrelated.
const SIZE_STEPS: [[f64; 3]; SUBJECT_COUNT] = [
    [0.0, 3.0, 5.0],
    [1.0, 6.0, 2.0],
    [2.0, 1.0, 7.0],
    [3.0, 4.0, 0.0],
    [4.0, 7.0, 6.0],
    [5.0, 0.0, 3.0],
    [6.0, 5.0, 1.0],
    [7.0, 2.0, 4.0],
];

/// The sequences of a data set. `motion_files` join the made motions of the set of motions; the first one replaces the
/// made motion of the other sets.
pub fn plan(
    model: &BodyModel,
    set: ClothingSet,
    size: SetSize,
    seed: u64,
    motion_files: &[PathBuf],
) -> Result<Vec<ClothingSequence>, SyntheticError> {
    let settings = base_settings(size, seed, motion_files.first());
    let person = |name: &str| -> Vec<f64> {
        let mut random = RandomStream::named(seed, name);
        let count = SUBJECT_COMPONENTS.min(model.component_count());
        (0..count).map(|_| random.between(-SUBJECT_DEVIATION, SUBJECT_DEVIATION)).collect()
    };
    let sequence = |name: String, identity: &[f64], settings: DressedSequenceSettings| ClothingSequence {
        name,
        identity: identity.to_vec(),
        settings,
        sizes: None,
        parameters: BTreeMap::new(),
    };
    Ok(match set {
        ClothingSet::Fabrics => named_fabrics()?
            .into_iter()
            .map(|fabric| {
                let settings =
                    DressedSequenceSettings { fabric: Some(fabric.name.clone()), ..settings.clone() };
                let names = (0..).map(|index| format!("fabric_{index:02}"));
                ClothingSequence {
                    parameters: names.zip(fabric.table()).collect(),
                    ..sequence(fabric.name, &person("model"), settings)
                }
            })
            .collect(),
        ClothingSet::Sizes => (0..SUBJECT_COUNT)
            .map(|index| {
                let name = format!("subject_{}", index + 1);
                let [shirt, width, length] = SIZE_STEPS[index].map(|step| step / 7.0);
                let shorts =
                    GarmentSize { width: 0.97 + 0.33 * width, length: 0.7 + 0.6 * length, sleeves: 1.0 };
                // A larger T-shirt is longer, too.
                let shirt = GarmentSize {
                    width: 0.97 + 0.30 * shirt,
                    length: 0.92 + 0.25 * shirt,
                    sleeves: 0.9 + 0.4 * shirt,
                };
                let settings = DressedSequenceSettings {
                    outfit: Outfit::ShortsAndTShirt,
                    motion: Motion::Walk,
                    fabric: Some("jersey".into()),
                    ..settings.clone()
                };
                ClothingSequence {
                    sizes: Some(vec![shorts, shirt]),
                    ..sequence(name.clone(), &person(&name), settings)
                }
            })
            .collect(),
        ClothingSet::Motions => {
            let made = [Motion::Walk, Motion::WalkAndTurn, Motion::TurnOnSpot, Motion::KneePulls];
            let identity = person("model");
            let made = made.into_iter().map(|motion| {
                let name = serde_json::to_string(&motion).unwrap_or_default().replace('"', "");
                let settings = DressedSequenceSettings { motion, motion_file: None, ..settings.clone() };
                sequence(name, &identity, settings)
            });
            let captured = motion_files.iter().map(|path| {
                let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
                let settings =
                    DressedSequenceSettings { motion_file: Some(path.clone()), ..settings.clone() };
                sequence(name, &identity, settings)
            });
            made.chain(captured).collect()
        }
    })
}

fn base_settings(size: SetSize, seed: u64, motion_file: Option<&PathBuf>) -> DressedSequenceSettings {
    let defaults = DressedSequenceSettings::default();
    let mut settings = DressedSequenceSettings {
        seed,
        outfit: Outfit::Dress,
        motion: Motion::WalkAndTurn,
        motion_file: motion_file.cloned(),
        fabric: Some("cotton-poplin".into()),
        frame_count: 150,
        ..defaults
    };
    // Layers must not show through one another, and hands that graze a thigh must not carry the cloth away.
    settings.cloth.layer_contact_mm = 30.0;
    settings.cloth.arms = ArmContact::PassThrough;
    // Cloth that is learnt from must win over its own edges where the body is.
    settings.cloth.largest_push_mm = 20.0;
    if size == SetSize::Small {
        settings.frame_count = 24;
        settings.settle_seconds = 0.7;
        settings.garment.cloth_edge_mm = 30.0;
        settings.cloth.substeps_per_second = 1200.0;
    }
    settings
}

/// Name of the table of parameters in a data set's folder.
pub const PARAMETERS_FILE: &str = "parameters.csv";
/// Name of the summary in a data set's folder.
pub const SUMMARY_FILE: &str = "summary.json";

/// Makes all sequences of a data set that are not there yet, several at a time; one that fails does not stop the rest.
/// `progress` hears how many are finished.
pub fn write_clothing_data(
    model: &BodyModel,
    sequences: &[ClothingSequence],
    folder: &Path,
    progress: &(dyn Fn() + Sync),
) -> Result<Vec<ClothingSequenceSummary>, SyntheticError> {
    let made: Vec<ClothingSequenceSummary> = sequences
        .par_iter()
        .map(|sequence| {
            let made = write_clothing_sequence(model, sequence, &folder.join(&sequence.name));
            progress();
            made.unwrap_or_else(|error| ClothingSequenceSummary {
                name: sequence.name.clone(),
                frames: 0,
                clothing_vertices: 0,
                inside_share: 0.0,
                deepest_simulated_mm: 0.0,
                deepest_mm: 0.0,
                parameters: BTreeMap::new(),
                error: Some(error.to_string()),
            })
        })
        .collect();
    write_text(&folder.join(SUMMARY_FILE), &json(&made))?;
    write_text(&folder.join(PARAMETERS_FILE), &parameter_table(&made))?;
    Ok(made)
}

/// One row a sequence: its name, then its parameters.
fn parameter_table(sequences: &[ClothingSequenceSummary]) -> String {
    let names: std::collections::BTreeSet<&String> =
        sequences.iter().flat_map(|sequence| sequence.parameters.keys()).collect();
    let mut text = String::from("sequence");
    for name in &names {
        text.push(',');
        text.push_str(name);
    }
    text.push('\n');
    for sequence in sequences.iter().filter(|sequence| sequence.error.is_none()) {
        text.push_str(&sequence.name);
        for name in &names {
            text.push(',');
            if let Some(value) = sequence.parameters.get(*name) {
                text.push_str(&value.to_string());
            }
        }
        text.push('\n');
    }
    text
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).unwrap_or_default() + "\n"
}

fn write_text(path: &Path, text: &str) -> Result<(), SyntheticError> {
    let failed =
        |error: std::io::Error| SyntheticError::File { path: path.to_path_buf(), reason: error.to_string() };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    write_atomically(path, text.as_bytes()).map_err(failed)
}

/// Makes one sequence as a run folder, unless it is there already.
pub fn write_clothing_sequence(
    model: &BodyModel,
    sequence: &ClothingSequence,
    folder: &Path,
) -> Result<ClothingSequenceSummary, SyntheticError> {
    let failed = |reason: String| SyntheticError::File { path: folder.to_path_buf(), reason };
    let run = RunFolder::open(folder).map_err(|error| failed(error.to_string()))?;
    let stage = |name: StageName| run.stage(name).map_err(|error| failed(error.to_string()));
    let (captures, fit) = (stage(StageName::Scans)?, stage(StageName::FitSequence)?);
    let mut key = InputKey::new();
    key.add_text(&json(sequence));
    let key = key.text();
    let summary_path = fit.file(SUMMARY_FILE);
    if fit.is_finished(&key)
        && let Some(summary) =
            std::fs::read_to_string(&summary_path).ok().and_then(|text| serde_json::from_str(&text).ok())
    {
        return Ok(summary);
    }
    fit.mark_unfinished().map_err(|error| failed(error.to_string()))?;
    let dressed = Wardrobe::of(model, sequence)?;
    let mut performance = dressed.performance(model, &sequence.settings)?;
    let faces = joined_faces(performance.garments());
    let mut scenes = Vec::with_capacity(sequence.settings.frame_count);
    let clothing_vertices = performance.garments().iter().map(|garment| garment.positions.len()).sum();
    // Contact cannot hold cloth where an armpit leaves no room for it; truth that cuts into the body must not be
    // learnt from.
    let push_out = PushOut::new(clothing_vertices, &faces, &PushOutConfig::default());
    let mut hints = Vec::new();
    let (mut simulated, mut written) = (Vec::new(), Vec::new());
    for frame in 0..sequence.settings.frame_count {
        let scene = performance.next_scene()?;
        let mut positions: Vec<DVec3> = scene.garment_positions.concat();
        let body = TriangleMesh::new(scene.body_vertices.clone(), performance.body().faces().to_vec())?;
        let (before, after) = push_out.apply(&mut positions, &body, &mut hints);
        simulated.push(before);
        written.push(after);
        let path = captures.file(&capture_file(frame));
        let mesh = TriangleMesh::new(positions, faces.clone())?;
        write_mesh(&path, &mesh).map_err(|error| SyntheticError::File { path, reason: error.to_string() })?;
        scenes.push(scene);
    }
    let rigged = truth_as_fit(model, &sequence.identity, performance.body(), &scenes);
    write_fit(&fit.file(file_names::FIT), &rigged).map_err(|error| failed(error.to_string()))?;
    CaptureOrigin {
        input: captures.path().to_path_buf(),
        first: 0,
        last: None,
        step: 1,
        frame_rate: sequence.settings.frames_per_second,
    }
    .write(run.path())
    .map_err(|error| failed(error.to_string()))?;
    let (simulated, written) = (Penetration::over(&simulated), Penetration::over(&written));
    let summary = ClothingSequenceSummary {
        name: sequence.name.clone(),
        frames: scenes.len(),
        clothing_vertices,
        inside_share: simulated.inside_share,
        deepest_simulated_mm: simulated.deepest_mm,
        deepest_mm: written.deepest_mm,
        parameters: sequence.parameters.clone().into_iter().chain(dressed.ratios).collect(),
        error: None,
    };
    write_text(&summary_path, &json(&summary))?;
    fit.mark_finished(&key).map_err(|error| failed(error.to_string()))?;
    Ok(summary)
}

/// A person and what they wear.
struct Wardrobe {
    body: RestBody,
    garments: Vec<Garment>,
    ratios: BTreeMap<String, f64>,
}

impl Wardrobe {
    fn of(model: &BodyModel, sequence: &ClothingSequence) -> Result<Self, SyntheticError> {
        let body = RestBody::new(model, model.rest_vertices(&sequence.identity))?;
        let settings = &sequence.settings;
        let Some(sizes) = &sequence.sizes else {
            let garments = tailor(settings.outfit, &body, &settings.garment)?;
            return Ok(Self { body, garments, ratios: BTreeMap::new() });
        };
        // All sizes of all people come from one cut, that of the mean body.
        let mean = RestBody::new(model, model.mean_vertices().to_vec())?;
        let cut = tailor(settings.outfit, &mean, &settings.garment)?;
        let garments: Vec<Garment> = cut
            .iter()
            .zip(sizes)
            .map(|(garment, size)| refit(garment, &mean, &body, size))
            .collect::<Result<_, _>>()?;
        let ratios = garments.iter().flat_map(|garment| garment_ratios(garment, &body)).collect();
        Ok(Self { body, garments, ratios })
    }

    fn performance<'a>(
        &self,
        model: &'a BodyModel,
        settings: &'a DressedSequenceSettings,
    ) -> Result<Performance<'a>, SyntheticError> {
        let body = RestBody::new(model, self.body.positions().to_vec())?;
        Performance::dressed(model, body, self.garments.clone(), settings)
    }
}

/// Girths and lengths of a garment over those of the body (P3 §5.3: "the sizes are expressed as ratio").
fn garment_ratios(garment: &Garment, body: &RestBody) -> Vec<(String, f64)> {
    use crate::rest_body::Bone;
    let hip = body.joint(Bone::LeftThigh);
    let knee = body.joint(Bone::LeftShank);
    let lowest = |places: &[DVec3]| places.iter().map(|place| place.y).fold(f64::INFINITY, f64::min);
    match garment.name {
        "t_shirt" => {
            let chest = body.joint(Bone::LeftUpperArm).y - 0.16;
            let shoulder = body.joint(Bone::LeftUpperArm).x;
            let trunk =
                |places: &[DVec3]| girth(places.iter().filter(|p| p.x.abs() < shoulder * 1.25), chest);
            vec![("t_shirt_width".into(), trunk(&garment.positions) / trunk(body.positions()))]
        }
        "shorts" => {
            let hem = lowest(&garment.positions);
            let height = (hem + 0.03).min(hip.y - 0.08);
            let leg = |places: &[DVec3]| girth(places.iter().filter(|place| place.x > 0.0), height);
            vec![
                ("shorts_width".into(), leg(&garment.positions) / leg(body.positions())),
                ("shorts_length".into(), (hip.y - hem) / (hip.y - knee.y)),
            ]
        }
        _ => Vec::new(),
    }
}

/// Perimeter of the convex hull of the points near a height, as a tape lies; metres.
fn girth<'a>(places: impl Iterator<Item = &'a DVec3>, height: f64) -> f64 {
    const HALF_BAND: f64 = 0.02;
    let mut points: Vec<[f64; 2]> =
        places.filter(|place| (place.y - height).abs() < HALF_BAND).map(|place| [place.x, place.z]).collect();
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let half = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..]
                && (b[0] - a[0]) * (point[1] - a[1]) <= (b[1] - a[1]) * (point[0] - a[0])
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.windows(2).map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1])).sum::<f64>()
    };
    half(&mut points.iter().copied()) + half(&mut points.iter().rev().copied())
}

fn joined_faces(garments: &[Garment]) -> Vec<[u32; 3]> {
    let mut faces = Vec::new();
    let mut first = 0;
    for garment in garments {
        faces.extend(garment.faces.iter().map(|face| face.map(|vertex| vertex + first)));
        first += garment.positions.len() as u32;
    }
    faces
}

/// The truth in the form of a fit: exact body and poses, nothing uncertain.
pub fn truth_as_fit(
    model: &BodyModel,
    identity: &[f64],
    body: &RestBody,
    scenes: &[Scene],
) -> RiggedSequence {
    let frames = scenes.iter().enumerate().map(|(frame, scene)| FittedFrame {
        name: capture_file(frame),
        pose: scene.pose.parameters().to_vec(),
        landmarks: scene
            .landmarks
            .iter()
            .map(|position| Landmark { position: *position, confidence: 1.0 })
            .collect(),
        codes: Vec::new(),
        inlier_share: 1.0,
        outside_share_5mm: 0.0,
        outside_mean: 0.0,
        clearance_percentiles: None,
        energy: 0.0,
        capture_scale: 1.0,
        seconds: 0.0,
    });
    let sequence = FittedSequence {
        input_frame: InputFrame {
            metres_per_unit: 1.0,
            internal_from_input: DMat3::IDENTITY,
            report: vec!["metres, y up: the truth of a synthetic sequence".into()],
        },
        identity: identity.to_vec(),
        identity_covariance: DMatrix::zeros(identity.len(), identity.len()),
        rest_vertices: body.positions().to_vec(),
        rest_joints: body.joints().to_vec(),
        start: None,
        smallest_clearance: vec![0.0; body.positions().len()],
        frames: frames.collect(),
        codes: Vec::new(),
    };
    RiggedSequence { sequence, rig: Rig::of(model) }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use habitus::artifacts::sequence_files::read_fit;

    use super::*;

    #[test]
    fn the_sets_have_the_sequences_of_the_paper() {
        let model = BodyModel::default_space().unwrap();
        let set = |set| plan(&model, set, SetSize::Full, 3, &[]).unwrap();
        let fabrics = set(ClothingSet::Fabrics);
        assert_eq!(fabrics.len(), 8);
        assert!(fabrics.iter().all(|sequence| sequence.identity == fabrics[0].identity));
        assert!(fabrics.iter().all(|sequence| sequence.parameters.len() == 39));
        let sizes = set(ClothingSet::Sizes);
        assert_eq!(sizes.len(), 8);
        let people: BTreeSet<String> =
            sizes.iter().map(|sequence| format!("{:?}", sequence.identity)).collect();
        assert_eq!(people.len(), 8);
        for column in 0..3 {
            let steps: BTreeSet<u64> = SIZE_STEPS.iter().map(|row| row[column] as u64).collect();
            assert_eq!(steps.len(), 8, "each step once");
        }
        assert_eq!(set(ClothingSet::Motions).len(), 4);
    }

    #[test]
    fn a_clothing_sequence_is_a_run_whose_fit_is_the_truth() {
        let model = BodyModel::default_space().unwrap();
        let mut sequence = plan(&model, ClothingSet::Sizes, SetSize::Small, 1, &[]).unwrap().remove(2);
        sequence.settings.frame_count = 2;
        sequence.settings.settle_seconds = 0.3;
        sequence.settings.garment.cloth_edge_mm = 45.0;
        sequence.settings.cloth.substeps_per_second = 600.0;
        let folder = tempfile::tempdir().unwrap();
        let made = write_clothing_sequence(&model, &sequence, folder.path()).unwrap();
        assert_eq!((made.frames, made.parameters.len()), (2, 3));
        assert!(made.parameters.values().all(|ratio| (0.5..2.5).contains(ratio)), "{:?}", made.parameters);
        let fit = read_fit(&folder.path().join("3_fit_sequence/fit.npz")).unwrap();
        let rest = model.rest_vertices(&sequence.identity);
        for (stored, rest) in fit.sequence.rest_vertices.iter().zip(&rest) {
            assert!(stored.distance(*rest) < 1e-6);
        }
        let origin = CaptureOrigin::read(folder.path()).unwrap();
        let frames = origin.frames().unwrap();
        let names: Vec<&String> = fit.sequence.frames.iter().map(|frame| &frame.name).collect();
        use habitus::artifacts::frames::FrameSource;
        assert_eq!(names, [&frames.name(0), &frames.name(1)]);
        // Made once: the second call finds it, and gives the same summary.
        std::fs::remove_file(folder.path().join("0_scans/frame_0000.ply")).unwrap();
        assert_eq!(write_clothing_sequence(&model, &sequence, folder.path()).unwrap(), made);
        assert!(!folder.path().join("0_scans/frame_0000.ply").exists());
    }

    #[test]
    fn a_girth_is_that_of_a_tape() {
        let circle: Vec<DVec3> = (0..720)
            .map(|degree| {
                let angle = f64::from(degree).to_radians();
                DVec3::new(angle.cos(), 1.0, angle.sin())
            })
            .chain([DVec3::Y, DVec3::new(0.3, 1.01, -0.2), DVec3::new(5.0, 2.0, 5.0)])
            .collect();
        assert!((girth(circle.iter(), 1.0) - std::f64::consts::TAU).abs() < 1e-4);
    }
}
