//! The dressing room of a clothing model: what sliders say becomes coefficients, bones and a rest body.

use std::collections::BTreeSet;

use glam::DVec3;
use habitus::artifacts::clothing_model::{ClothingModel, pose_clothing};
use habitus::body::{BodyModel, PosedSkeleton};
use habitus::geometry::{SurfaceIndex, TriangleMesh};
use rayon::prelude::*;

use super::{
    DressedMotion, DressingChoice, DressingScene, FabricChoice, LARGEST_DEVIATION, SizeChoice, SkinnedSurface,
};
use crate::dressed_report::signed_mm;

/// A motion that can be chosen.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomMotion {
    /// Its name.
    pub name: String,
    /// Poses in metres and radians at the model's frame rate.
    pub poses: Vec<Vec<f64>>,
}

/// A fabric that can be chosen besides those that the model was learnt from.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomFabric {
    /// Its name.
    pub name: String,
    /// Numbers of its table, as the model was learnt with.
    pub table: Vec<f64>,
}

/// Sliders for the build at most: the first components carry most of it.
const IDENTITY_SLIDERS: usize = 8;
/// Frames that share the faces where closest points are looked for first. Fixed, so that an answer does not depend on the
/// number of threads.
const FRAMES_PER_RUN: usize = 8;

/// A clothing model with the motions and the body model that it is shown with.
#[derive(Debug)]
pub struct DressingRoom {
    model: ClothingModel,
    body: BodyModel,
    motions: Vec<RoomMotion>,
    /// Rest vertices of the model's own person without the body model's part: what no component expresses.
    own_detail: Vec<DVec3>,
    scene: DressingScene,
}

impl DressingRoom {
    /// The room of a model; `title` is shown above it. None if there is no motion, or if the body model is another than
    /// the clothes' own.
    pub fn new(
        model: ClothingModel,
        body: BodyModel,
        motions: Vec<RoomMotion>,
        fabrics: &[RoomFabric],
        title: &str,
    ) -> Option<Self> {
        let dressed = &model.dressed;
        let pose_length = dressed.rig.skeleton.pose_length();
        let is_own_body = body.metadata().name == dressed.rig.model_name
            && body.vertex_count() == dressed.rest_vertices.len()
            && body.skeleton().pose_length() == pose_length;
        let are_playable = motions.iter().all(|motion| {
            !motion.poses.is_empty() && motion.poses.iter().all(|pose| pose.len() == pose_length)
        });
        if !is_own_body || motions.is_empty() || !are_playable {
            return None;
        }
        let expressed = body.rest_vertices(&dressed.identity);
        let own_detail = dressed.rest_vertices.iter().zip(&expressed).map(|(own, shown)| *own - *shown);
        let own_detail = own_detail.collect();
        let scene = scene_of(&model, &body, &motions, fabrics, title);
        Some(Self { own_detail, scene, model, body, motions })
    }

    /// What the page needs once.
    pub fn scene(&self) -> &DressingScene {
        &self.scene
    }

    /// The dressed person of a choice that [`DressingScene::choice`] has checked.
    pub fn dress(&self, choice: &DressingChoice) -> DressedMotion {
        let dressed = &self.model.dressed;
        let rest_vertices = self.rest_vertices(&choice.identity);
        let joints = self.body.joints(&rest_vertices);
        let motion = &self.motions[choice.motion];
        let poses: Vec<&[f64]> = motion.poses.iter().map(Vec::as_slice).collect();
        let rate = self.model.frame_rate();
        let times: Vec<f64> = (0..poses.len()).map(|frame| rate.time_of(frame)).collect();
        let controls: Vec<f64> = choice.fabric.iter().chain(&choice.sizes).copied().collect();
        let amounts = self.model.coefficients(&poses, &times, &controls);
        let coefficients: Vec<Vec<f64>> =
            amounts.row_iter().map(|row| row.iter().copied().collect()).collect();
        let skeletons: Vec<PosedSkeleton> =
            poses.iter().map(|pose| dressed.rig.skeleton.pose(&joints, pose)).collect();
        let anchors = dressed.association.anchors(&rest_vertices);
        let mean = self.model.offsets(&vec![0.0; self.scene.components.len()]);
        let clearance_mm = if choice.shows_clearance {
            self.clearances(&rest_vertices, &anchors, &skeletons, &coefficients)
        } else {
            Vec::new()
        };
        DressedMotion {
            clothing_base: anchors
                .iter()
                .zip(points(&mean))
                .map(|(anchor, offset)| *anchor + offset)
                .collect(),
            bones: skeletons
                .iter()
                .map(|posed| {
                    posed.rotations.iter().copied().zip(posed.translations.iter().copied()).collect()
                })
                .collect(),
            coefficients,
            clearance_mm,
            rest_vertices,
        }
    }

    /// The own person with some components changed, in metres.
    fn rest_vertices(&self, changes: &[f64]) -> Vec<DVec3> {
        let mut identity = self.model.dressed.identity.clone();
        identity.resize(identity.len().max(changes.len()), 0.0);
        identity.iter_mut().zip(changes).for_each(|(own, change)| *own += change);
        let expressed = self.body.rest_vertices(&identity);
        expressed.iter().zip(&self.own_detail).map(|(shown, detail)| *shown + *detail).collect()
    }

    /// Signed distance of each clothing vertex from the skin for each frame, millimetres; nothing where a posed body is
    /// no mesh.
    fn clearances(
        &self,
        rest: &[DVec3],
        anchors: &[DVec3],
        skeletons: &[PosedSkeleton],
        coefficients: &[Vec<f64>],
    ) -> Vec<Vec<f64>> {
        let dressed = &self.model.dressed;
        let skin = self.model.skin();
        let of_run = |start: usize| -> Option<Vec<Vec<f64>>> {
            let end = skeletons.len().min(start + FRAMES_PER_RUN);
            let mut hints = vec![0; anchors.len()];
            let mut closest = Vec::new();
            let frame_of = |frame: usize| {
                let posed = &skeletons[frame];
                let carriers = skin.carriers(anchors, posed, dressed.association.smallest_stretch);
                let clothing = pose_clothing(&self.model, &carriers, &coefficients[frame]);
                let body = TriangleMesh::new(self.body.pose_vertices(rest, posed), dressed.rig.faces.clone());
                SurfaceIndex::of_mesh(&body.ok()?).closest_many(&clothing, Some(&hints), &mut closest);
                hints.iter_mut().zip(&closest).for_each(|(hint, point)| *hint = point.face);
                Some(clothing.iter().zip(&closest).map(|(place, point)| signed_mm(*place, point)).collect())
            };
            (start..end).map(frame_of).collect()
        };
        let starts: Vec<usize> = (0..skeletons.len()).step_by(FRAMES_PER_RUN).collect();
        let runs: Option<Vec<Vec<Vec<f64>>>> = starts.into_par_iter().map(of_run).collect();
        runs.unwrap_or_default().concat()
    }
}

fn points(values: &[f32]) -> impl Iterator<Item = DVec3> + '_ {
    values.as_chunks::<3>().0.iter().map(|place| DVec3::from_array(place.map(f64::from)))
}

fn scene_of(
    model: &ClothingModel,
    body: &BodyModel,
    motions: &[RoomMotion],
    fabrics: &[RoomFabric],
    title: &str,
) -> DressingScene {
    let dressed = &model.dressed;
    let vertex_count = dressed.rest_vertices.len();
    let skin = model.skin();
    let clothing_count = dressed.clothing_vertex_count();
    let component_count = model.space.component_count();
    let mean = model.offsets(&vec![0.0; component_count]);
    let component = |component: usize| {
        let mut unit = vec![0.0; component_count];
        unit[component] = 1.0;
        let moved = model.offsets(&unit);
        points(&moved).zip(points(&mean)).map(|(moved, mean)| moved - mean).collect()
    };
    let fabric_count = model.controls.fabric_component_count();
    DressingScene {
        title: title.into(),
        subtitle: format!(
            "{clothing_count} clothing vertices, {component_count} components, recipe {}",
            model.record.recipe
        ),
        body: SkinnedSurface {
            vertex_count,
            faces: dressed.rig.faces.clone(),
            skin: (0..vertex_count).map(|vertex| dressed.rig.skin.of(vertex).collect()).collect(),
        },
        bone_count: dressed.rig.skeleton.bones().len(),
        clothing: SkinnedSurface {
            vertex_count: clothing_count,
            faces: dressed.clothing_faces.clone(),
            skin: (0..clothing_count).map(|vertex| skin.of(vertex).collect()).collect(),
        },
        components: (0..component_count).map(component).collect(),
        identity_count: IDENTITY_SLIDERS.min(body.component_count()),
        motions: motions.iter().map(|motion| motion.name.clone()).collect(),
        fabrics: fabric_choices(model, fabrics),
        fabric_component_count: fabric_count,
        sizes: model.controls.controls[fabric_count..]
            .iter()
            .map(|control| SizeChoice {
                name: control.name.clone(),
                label: control.name.replace('_', " "),
                low: control.minimum,
                high: control.maximum,
                value: control.default,
            })
            .collect(),
        frames_per_second: model.frame_rate().frames_per_second(),
    }
}

/// The mean fabric, those that were learnt from, and others that the model's components can express.
fn fabric_choices(model: &ClothingModel, others: &[RoomFabric]) -> Vec<FabricChoice> {
    let count = model.controls.fabric_component_count();
    if count == 0 {
        return Vec::new();
    }
    let choice = |name: &str, values: &[f64]| FabricChoice {
        name: name.into(),
        components: values[..count]
            .iter()
            .map(|value| value.clamp(-LARGEST_DEVIATION, LARGEST_DEVIATION))
            .collect(),
    };
    let mut choices = vec![choice("mean of all", &model.controls.defaults())];
    choices.extend(model.controls.known.iter().map(|(name, values)| choice(name, values)));
    let known: BTreeSet<&str> = model.controls.known.iter().map(|(name, _)| name.as_str()).collect();
    for fabric in others.iter().filter(|fabric| !known.contains(fabric.name.as_str())) {
        let mut values = model.controls.defaults();
        if model.controls.set_fabric(&mut values, &fabric.table).is_ok() {
            choices.push(choice(&fabric.name, &values));
        }
    }
    choices
}
