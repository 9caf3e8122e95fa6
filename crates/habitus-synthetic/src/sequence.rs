//! A dressed person in motion, captured frame by frame, with the truth that a fit has to find.

use std::path::{Path, PathBuf};

use glam::DVec3;
use habitus::artifacts::fabric::find_fabric;
use habitus::artifacts::frames::{FrameError, FrameSource};
use habitus::artifacts::motion_clip::MotionClip;
use habitus::artifacts::motion_files::read_joint_motion;
use habitus::body::{BodyModel, Pose};
use habitus::fitting::retarget::{RetargetBody, RetargetSettings, retarget};
use habitus::geometry::{Surface, TriangleMesh};
use habitus::statistics::RandomStream;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::animate::Animation;
use crate::capture::{CaptureSettings, Subject, Substance, capture};
use crate::cloth::{ArmContact, BodyInterval, Cloth, ClothSettings, Weave};
use crate::error::SyntheticError;
use crate::garment::{Drive, Garment, GarmentSettings, Outfit, tailor, warp_directions};
use crate::motion::Motion;
use crate::rest_body::{Bone, RestBody};
use crate::second_skin::follow_skin;
use crate::source_bodies::source_body;

/// All that a dressed sequence depends on; the default is the demo.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DressedSequenceSettings {
    /// Start of all random numbers.
    pub seed: u64,
    /// Which of the source bodies, see [`crate::source_bodies`].
    pub source_body: usize,
    /// What the person wears.
    pub outfit: Outfit,
    /// What the person does, unless a motion file says it.
    pub motion: Motion,
    /// Motion capture file that the person follows: BVH, AMC with its ASF, or an AMASS-style archive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion_file: Option<PathBuf>,
    /// Where in the motion file the first frame is, seconds.
    pub motion_start_seconds: f64,
    /// Number of captured frames.
    pub frame_count: usize,
    /// Frames per second; P2 §6.1: 30.
    pub frames_per_second: f64,
    /// Time in which the person goes from the rest pose into the motion and the cloth settles, seconds.
    pub settle_seconds: f64,
    /// Fabric of all garments: a name, or a `.json` file of the 39-number form; none: the numbers of `cloth` alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fabric: Option<String>,
    /// How a motion file is brought to the person.
    pub retarget: RetargetSettings,
    /// How the garments are cut.
    pub garment: GarmentSettings,
    /// How the cloth behaves.
    pub cloth: ClothSettings,
    /// How each frame is captured.
    pub capture: CaptureSettings,
}

impl Default for DressedSequenceSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            source_body: 0,
            outfit: Outfit::Dress,
            motion: Motion::WalkAndTurn,
            motion_file: None,
            motion_start_seconds: 0.0,
            retarget: RetargetSettings::default(),
            frame_count: 60,
            frames_per_second: 30.0,
            settle_seconds: 1.0,
            fabric: None,
            garment: GarmentSettings::default(),
            cloth: ClothSettings::default(),
            capture: CaptureSettings::default(),
        }
    }
}

impl DressedSequenceSettings {
    /// A few coarse frames in a second or two, for tests.
    pub fn tiny() -> Self {
        let defaults = Self::default();
        Self {
            frame_count: 4,
            settle_seconds: 0.5,
            garment: GarmentSettings { cloth_edge_mm: 30.0, ..defaults.garment },
            cloth: ClothSettings {
                substeps_per_second: 600.0,
                contact_updates_per_second: 60.0,
                ..defaults.cloth
            },
            capture: CaptureSettings {
                camera_count: 16,
                image_height: 320,
                voxel_mm: 22.0,
                ..defaults.capture
            },
            ..defaults
        }
    }

    fn check(&self) -> Result<(), SyntheticError> {
        let positive = [
            ("frames_per_second", self.frames_per_second),
            ("settle_seconds", self.settle_seconds),
            ("garment.cloth_edge_mm", self.garment.cloth_edge_mm),
            ("cloth.substeps_per_second", self.cloth.substeps_per_second),
            ("cloth.density", self.cloth.density),
            ("capture.voxel_mm", self.capture.voxel_mm),
            ("capture.camera_distance", self.capture.camera_distance),
            ("capture.camera_count", self.capture.camera_count as f64),
            ("frame_count", self.frame_count as f64),
        ];
        for (setting, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(SyntheticError::Setting {
                    setting,
                    value: value.to_string(),
                    expected: "positive and finite".into(),
                });
            }
        }
        if !(64..=4096).contains(&self.capture.image_height) {
            return Err(SyntheticError::Setting {
                setting: "capture.image_height",
                value: self.capture.image_height.to_string(),
                expected: "from 64 to 4096 pixels".into(),
            });
        }
        Ok(())
    }
}

/// The true state of one frame, posed space.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The pose.
    pub pose: Pose,
    /// Joints, metres.
    pub joints: Vec<DVec3>,
    /// The naked body, metres.
    pub body_vertices: Vec<DVec3>,
    /// The model's landmark vertices on that body, metres.
    pub landmarks: Vec<DVec3>,
    /// Vertices of each garment, metres.
    pub garment_positions: Vec<Vec<DVec3>>,
}

/// One captured frame with its truth.
#[derive(Debug, Clone)]
pub struct DressedFrame {
    /// Place in the sequence.
    pub index: usize,
    /// The truth.
    pub scene: Scene,
    /// What the cameras saw: a mesh of its own, without correspondence to any other frame.
    pub capture: TriangleMesh,
}

/// A person, what they wear and how they move; gives one scene after the other.
pub struct Performance<'a> {
    model: &'a BodyModel,
    settings: &'a DressedSequenceSettings,
    /// With what the fabric says.
    cloth_settings: ClothSettings,
    body: RestBody,
    garments: Vec<Garment>,
    cloths: Vec<Cloth>,
    animation: Animation<'a>,
    /// Frame interval that ends next, counted from the end of settling.
    next_step: i64,
    body_vertices: Vec<DVec3>,
    /// Faces of the body that push the cloth.
    felt_faces: Vec<u32>,
}

/// A garment over one frame interval, as the one that is worn over it meets it.
struct Layer<'a> {
    faces: &'a [[u32; 3]],
    felt: Vec<u32>,
    start: Vec<DVec3>,
    end: Vec<DVec3>,
}

impl Layer<'_> {
    fn interval(&self, duration: f64, settings: &ClothSettings) -> Result<BodyInterval<'_>, SyntheticError> {
        BodyInterval::new(self.faces, &self.felt, &self.start, &self.end, duration, settings)
    }
}

impl<'a> Performance<'a> {
    /// Dresses a body (rest vertices in the model's topology, which need not lie in the model's space).
    pub fn new(
        model: &'a BodyModel,
        rest_vertices: Vec<DVec3>,
        settings: &'a DressedSequenceSettings,
    ) -> Result<Self, SyntheticError> {
        settings.check()?;
        let body = RestBody::new(model, rest_vertices)?;
        let garments = tailor(settings.outfit, &body, &settings.garment)?;
        Self::dressed(model, body, garments, settings)
    }

    /// Dresses a body in garments that were cut already.
    pub fn dressed(
        model: &'a BodyModel,
        body: RestBody,
        garments: Vec<Garment>,
        settings: &'a DressedSequenceSettings,
    ) -> Result<Self, SyntheticError> {
        let fabric = settings.fabric.as_deref().map(find_fabric).transpose()?;
        let cloth_settings = settings.cloth.made_of(fabric.as_ref());
        let cloth_settings = &cloth_settings;
        let mut animation = choreograph(model, &body, settings)?;
        let settle_steps = (settings.settle_seconds * settings.frames_per_second).ceil() as i64;
        let start_time = -(settle_steps as f64) / settings.frames_per_second;
        let pose = animation.next_pose(start_time, 0.0);
        let shift = pose.translation();
        let cloths = garments
            .iter()
            .map(|garment| {
                let positions = garment.positions.clone();
                let warp = match &fabric {
                    Some(_) => warp_directions(&body, &positions),
                    None => Vec::new(),
                };
                let woven = fabric.as_ref().map(|fabric| Weave { fabric, warp: &warp });
                let mut cloth =
                    Cloth::woven(positions, &garment.faces, garment.anchors.clone(), cloth_settings, woven)
                        .over(garment.layer, cloth_settings);
                cloth.shift(shift);
                cloth
            })
            .collect();
        let body_vertices =
            model.pose_vertices(body.positions(), &model.skeleton().pose(body.joints(), pose.parameters()));
        Ok(Self {
            felt_faces: felt_faces(&body, cloth_settings.arms),
            model,
            settings,
            cloth_settings: cloth_settings.clone(),
            body,
            garments,
            cloths,
            animation,
            next_step: -settle_steps + 1,
            body_vertices,
        })
    }

    /// What the sequence depends on.
    pub fn settings(&self) -> &DressedSequenceSettings {
        self.settings
    }

    /// The person at rest.
    pub fn body(&self) -> &RestBody {
        &self.body
    }

    /// The garments as they were cut.
    pub fn garments(&self) -> &[Garment] {
        &self.garments
    }

    /// The simulated state of the garments.
    pub fn cloths(&self) -> &[Cloth] {
        &self.cloths
    }

    /// Moves on by one frame; the first call also settles the cloth.
    pub fn next_scene(&mut self) -> Result<Scene, SyntheticError> {
        while self.next_step < 0 {
            self.step()?;
        }
        self.step()
    }

    /// Garments from the innermost outwards; where layers feel one another, each over the one before it.
    fn advance_cloths(&mut self, vertices: &[DVec3]) -> Result<(), SyntheticError> {
        let simulated = self.cloths.iter_mut().zip(&self.garments);
        let mut simulated: Vec<(&mut Cloth, &Garment)> =
            simulated.filter(|(_, garment)| garment.drive == Drive::Simulated).collect();
        if simulated.is_empty() {
            return Ok(());
        }
        let settings = &self.cloth_settings;
        let duration = 1.0 / self.settings.frames_per_second;
        let (faces, felt) = (self.body.faces(), &self.felt_faces);
        let body = BodyInterval::new(faces, felt, &self.body_vertices, vertices, duration, settings)?;
        if settings.layer_contact_mm <= 0.0 {
            simulated.par_iter_mut().for_each(|(cloth, _)| cloth.advance(&body, None, settings));
            return Ok(());
        }
        let mut beneath: Option<Layer<'_>> = None;
        for (cloth, garment) in simulated {
            let start = cloth.positions().to_vec();
            let layer = beneath.as_ref().map(|layer| layer.interval(duration, settings)).transpose()?;
            cloth.advance(&body, layer.as_ref(), settings);
            let felt = (0..garment.faces.len() as u32).collect();
            beneath = Some(Layer { faces: &garment.faces, felt, start, end: cloth.positions().to_vec() });
        }
        Ok(())
    }

    fn step(&mut self) -> Result<Scene, SyntheticError> {
        let rate = self.settings.frames_per_second;
        let time = self.next_step as f64 / rate;
        // Into the motion during the first two thirds of settling, smoothly; the rest lets the cloth calm down.
        let share = ((time / self.settings.settle_seconds + 1.0) * 1.5).clamp(0.0, 1.0);
        let pose = self.animation.next_pose(time, share * share * (3.0 - 2.0 * share));
        let posed = self.model.skeleton().pose(self.body.joints(), pose.parameters());
        let vertices = self.model.pose_vertices(self.body.positions(), &posed);
        self.advance_cloths(&vertices)?;
        let faces = self.body.faces();
        let garment_positions = self
            .cloths
            .iter()
            .zip(&self.garments)
            .map(|(cloth, garment)| match garment.drive {
                Drive::Simulated => cloth.positions().to_vec(),
                Drive::FollowsSkin => follow_skin(&garment.anchors, &vertices, faces),
            })
            .collect();
        self.next_step += 1;
        self.body_vertices.clone_from(&vertices);
        let landmarks =
            self.model.landmark_vertices().iter().map(|&vertex| vertices[vertex as usize]).collect();
        Ok(Scene { pose, joints: posed.joints, body_vertices: vertices, landmarks, garment_positions })
    }
}

/// Numbers of the faces of the body that push the cloth.
fn felt_faces(body: &RestBody, arms: ArmContact) -> Vec<u32> {
    let is_passed = |vertex: &u32| {
        let bone = body.bones()[*vertex as usize];
        bone.is_arm() && !matches!(bone, Bone::LeftUpperArm | Bone::RightUpperArm)
    };
    let faces = body.faces().iter().enumerate();
    let felt = faces.filter(|(_, face)| arms == ArmContact::Felt || !face.iter().all(is_passed));
    felt.map(|(number, _)| number as u32).collect()
}

/// The motion of the settings on this body.
fn choreograph<'a>(
    model: &'a BodyModel,
    body: &RestBody,
    settings: &DressedSequenceSettings,
) -> Result<Animation<'a>, SyntheticError> {
    let Some(path) = &settings.motion_file else {
        let phase = RandomStream::named(settings.seed, "phase of the motion").unit();
        return Ok(Animation::new(model, body, settings.motion, phase));
    };
    let clip = clip_for(model, body.positions(), path, &settings.retarget)?;
    let needed =
        settings.motion_start_seconds + (settings.frame_count - 1) as f64 / settings.frames_per_second;
    // A clip of 3 s at 30 frames/s is 2.97 s long from its first to its last pose.
    if needed > clip.duration() + 1.5 / settings.frames_per_second {
        return Err(SyntheticError::Setting {
            setting: "frame_count",
            value: settings.frame_count.to_string(),
            expected: format!(
                "at most {} with this motion file from {} s on",
                ((clip.duration() - settings.motion_start_seconds).max(0.0) * settings.frames_per_second)
                    as usize
                    + 1,
                settings.motion_start_seconds
            ),
        });
    }
    Animation::captured(model, body, clip, settings.motion_start_seconds)
        .ok_or_else(|| SyntheticError::File { path: path.clone(), reason: "holds no frame of motion".into() })
}

/// A motion file as poses of a body.
pub fn clip_for(
    model: &BodyModel,
    rest_vertices: &[DVec3],
    path: &Path,
    settings: &RetargetSettings,
) -> Result<MotionClip, SyntheticError> {
    let motion = read_joint_motion(path)?;
    Ok(retarget(&motion, &RetargetBody::new(model, rest_vertices)?, settings)?)
}

/// What the cameras need to know about a performance: the faces of the body and of each garment.
#[derive(Debug, Clone)]
pub struct Stage {
    faces: Vec<Vec<[u32; 3]>>,
    settings: CaptureSettings,
    seed: u64,
}

impl Stage {
    /// The stage of a performance.
    pub fn of(performance: &Performance<'_>) -> Self {
        let garments = performance.garments.iter().map(|garment| garment.faces.clone());
        Self {
            faces: std::iter::once(performance.body.faces().to_vec()).chain(garments).collect(),
            settings: performance.settings.capture.clone(),
            seed: performance.settings.seed,
        }
    }

    /// All that is seen: the body, then the garments.
    pub fn subjects<'a>(&'a self, scene: &'a Scene) -> Vec<Subject<'a>> {
        let positions = std::iter::once(&scene.body_vertices).chain(&scene.garment_positions);
        let substances = std::iter::once(Substance::Solid).chain(std::iter::repeat(Substance::Sheet));
        positions
            .zip(&self.faces)
            .zip(substances)
            .map(|((positions, faces), substance)| Subject { positions, faces, substance })
            .collect()
    }

    /// What the cameras make of a scene.
    pub fn capture(&self, index: usize, scene: Scene) -> Result<DressedFrame, SyntheticError> {
        let name = format!("frame {index}");
        let (positions, faces) = capture(&self.subjects(&scene), &self.settings, self.seed, &name);
        if faces.is_empty() {
            return Err(SyntheticError::EmptyCapture { frame: index });
        }
        Ok(DressedFrame { index, scene, capture: TriangleMesh::new(positions, faces)? })
    }

    fn capture_all(&self, first: usize, scenes: Vec<Scene>) -> Vec<Result<DressedFrame, SyntheticError>> {
        scenes.into_par_iter().enumerate().map(|(place, scene)| self.capture(first + place, scene)).collect()
    }
}

/// A finished sequence, held in memory.
#[derive(Debug, Clone)]
pub struct DressedSequence {
    /// What it was made with.
    pub settings: DressedSequenceSettings,
    /// The person at rest, in the model's topology, metres.
    pub rest_vertices: Vec<DVec3>,
    /// The body's faces.
    pub faces: Vec<[u32; 3]>,
    /// The garments as they were cut.
    pub garments: Vec<Garment>,
    /// The frames.
    pub frames: Vec<DressedFrame>,
}

impl FrameSource for DressedSequence {
    fn len(&self) -> usize {
        self.frames.len()
    }

    fn name(&self, frame: usize) -> String {
        format!("frame_{frame:04}")
    }

    fn surface(&self, frame: usize) -> Result<Surface, FrameError> {
        Ok(Surface::Mesh(self.frames[frame].capture.clone()))
    }
}

/// Hears how many of how many frames are done.
pub type Progress<'a> = &'a mut (dyn FnMut(usize, usize) + Send);

/// Takes frames as they are made, in order.
pub type FrameSink<'a> = &'a mut (dyn FnMut(DressedFrame) -> Result<(), SyntheticError> + Send);

/// Frames that are simulated ahead while the ones before them are captured.
const FRAMES_AHEAD: usize = 4;

/// Makes a sequence of one of the source bodies.
pub fn generate(
    model: &BodyModel,
    settings: &DressedSequenceSettings,
    progress: Progress<'_>,
) -> Result<DressedSequence, SyntheticError> {
    generate_of(model, source_body(model, settings.source_body)?, settings, progress)
}

/// Makes a sequence of any body in the model's topology.
pub fn generate_of(
    model: &BodyModel,
    rest_vertices: Vec<DVec3>,
    settings: &DressedSequenceSettings,
    progress: Progress<'_>,
) -> Result<DressedSequence, SyntheticError> {
    let mut performance = Performance::new(model, rest_vertices, settings)?;
    let mut frames = Vec::with_capacity(settings.frame_count);
    stream(&mut performance, &mut |frame| {
        frames.push(frame);
        progress(frames.len(), settings.frame_count);
        Ok(())
    })?;
    Ok(DressedSequence {
        settings: settings.clone(),
        rest_vertices: performance.body.positions().to_vec(),
        faces: performance.body.faces().to_vec(),
        garments: performance.garments,
        frames,
    })
}

/// Gives the frames one after the other, so that a sequence need not fit in memory.
pub fn stream(performance: &mut Performance<'_>, sink: FrameSink<'_>) -> Result<(), SyntheticError> {
    let frame_count = performance.settings.frame_count;
    let stage = Stage::of(performance);
    let mut captured = 0;
    let mut waiting = simulate(performance, FRAMES_AHEAD.min(frame_count))?;
    while captured < frame_count {
        let ahead = FRAMES_AHEAD.min(frame_count - captured - waiting.len());
        let scenes = std::mem::take(&mut waiting);
        let (next, frames) =
            rayon::join(|| simulate(performance, ahead), || stage.capture_all(captured, scenes));
        waiting = next?;
        for frame in frames {
            sink(frame?)?;
            captured += 1;
        }
    }
    Ok(())
}

fn simulate(performance: &mut Performance<'_>, count: usize) -> Result<Vec<Scene>, SyntheticError> {
    (0..count).map(|_| performance.next_scene()).collect()
}
