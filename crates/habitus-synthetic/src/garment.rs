//! Garments cut on a body at rest: level sets around the body, widened by flared tubes and opened by cuts.
//!
//! A garment starts as the surface of a solid (body grown by an ease per bone, joined with cones for skirt and
//! trouser legs), because such a surface has the right topology on every body. Neckline, cuffs and hems are then
//! cut away, and what remains is a sheet of even triangles in its own rest shape.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::capture::compact;
use crate::cloth::Anchor;
use crate::error::SyntheticError;
use crate::isosurface::{ScalarGrid, Triangles};
use crate::rest_body::{Bone, RestBody};
use crate::second_skin::second_skin;
use crate::sheet;

/// What the person wears.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outfit {
    /// Short sleeves and a wide skirt down to the middle of the calf (P2 §6.1 "wide").
    Dress,
    /// A loose long-sleeved shirt over wide trousers (P2 §6.1 "layered" and "wide").
    ShirtAndTrousers,
    /// A suit like a second skin (P2 §6.1 "very tight").
    Tight,
    /// Shorts and a T-shirt over them (P3 §5.3).
    ShortsAndTShirt,
    /// Wide trousers under a T-shirt (P2 §6.1 "wide", for men).
    TShirtAndTrousers,
}

/// Sizes of the garments.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GarmentSettings {
    /// Length of the cloth's triangle edges, millimetres.
    pub cloth_edge_mm: f64,
    /// Room between skin and the upper part of a dress, millimetres.
    pub bodice_ease_mm: f64,
    /// Radius of a skirt at its hem, millimetres.
    pub skirt_hem_radius_mm: f64,
    /// Where a skirt ends between knee (0) and ankle (1).
    pub skirt_length: f64,
    /// Room between skin and a shirt, millimetres.
    pub shirt_ease_mm: f64,
    /// Room between skin and trousers, millimetres.
    pub trouser_ease_mm: f64,
    /// Radius of a trouser leg at its hem, millimetres.
    pub trouser_hem_radius_mm: f64,
    /// Radius of the neck opening, millimetres.
    pub neckline_radius_mm: f64,
    /// Thickness of a tight suit, millimetres.
    pub tight_ease_mm: f64,
    /// Room between skin and a T-shirt, millimetres.
    pub t_shirt_ease_mm: f64,
    /// Where the sleeves of a T-shirt end between shoulder (0) and elbow (1).
    pub sleeve_length: f64,
    /// Room between skin and shorts, millimetres.
    pub shorts_ease_mm: f64,
    /// Where shorts end between hip (0) and knee (1).
    pub shorts_length: f64,
    /// Radius of a leg of shorts at its hem, millimetres.
    pub shorts_hem_radius_mm: f64,
}

impl Default for GarmentSettings {
    fn default() -> Self {
        Self {
            cloth_edge_mm: 19.0,
            bodice_ease_mm: 12.0,
            skirt_hem_radius_mm: 400.0,
            skirt_length: 0.5,
            shirt_ease_mm: 28.0,
            trouser_ease_mm: 18.0,
            trouser_hem_radius_mm: 130.0,
            neckline_radius_mm: 110.0,
            tight_ease_mm: 3.0,
            t_shirt_ease_mm: 18.0,
            sleeve_length: 0.7,
            shorts_ease_mm: 14.0,
            shorts_length: 0.85,
            shorts_hem_radius_mm: 105.0,
        }
    }
}

/// How a garment moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drive {
    /// By cloth simulation.
    Simulated,
    /// Every vertex is anchored to the skin.
    FollowsSkin,
}

/// One piece of cloth in the shape that it was cut to, around the body at rest.
#[derive(Debug, Clone)]
pub struct Garment {
    /// Name, for files and messages.
    pub name: &'static str,
    /// Vertices, rest space, metres.
    pub positions: Vec<DVec3>,
    /// Faces, outward counter-clockwise.
    pub faces: Vec<[u32; 3]>,
    /// Where it is tied to the body.
    pub anchors: Vec<Anchor>,
    /// How it moves.
    pub drive: Drive,
    /// Number of garments that are worn beneath it.
    pub layer: u32,
}

/// Inverse stiffness of the hidden stitches that keep a waistband or a shoulder in place, m/N.
const STITCH_COMPLIANCE: f64 = 0.01;
/// Stitches hold cloth within this distance of a neckline or waistband, metres.
const STITCH_BAND: f64 = 0.035;
/// Joins a flare smoothly to what it hangs from, metres.
const JOIN_RADIUS: f64 = 0.02;

/// Cuts the garments of an outfit to a body.
pub fn tailor(
    outfit: Outfit,
    body: &RestBody,
    settings: &GarmentSettings,
) -> Result<Vec<Garment>, SyntheticError> {
    match outfit {
        Outfit::Dress => Ok(vec![dress(body, settings).sew(body, settings)?]),
        Outfit::ShirtAndTrousers => Ok(vec![
            trousers(body, settings).sew(body, settings)?,
            shirt(body, settings).sew(body, settings)?,
        ]),
        Outfit::Tight => Ok(vec![second_skin(body, settings.tight_ease_mm / 1000.0)]),
        Outfit::ShortsAndTShirt => Ok(vec![
            shorts(body, settings).sew(body, settings)?,
            t_shirt(body, settings).sew(body, settings)?,
        ]),
        Outfit::TShirtAndTrousers => Ok(vec![
            trousers(body, settings).sew(body, settings)?,
            t_shirt(body, settings).sew(body, settings)?,
        ]),
    }
}

/// Direction of the warp at each vertex: along the limb or trunk beneath, as tailors cut it. Where limbs meet it turns
/// smoothly, because bones near a vertex share it by distance.
pub(crate) fn warp_directions(body: &RestBody, positions: &[DVec3]) -> Vec<DVec3> {
    const REACH: f64 = 0.05;
    let lines = body.bone_lines();
    positions
        .par_iter()
        .map(|&position| {
            let nearest = lines.iter().map(|line| line.distance(position)).fold(f64::INFINITY, f64::min);
            let sum: DVec3 = lines
                .iter()
                .map(|line| line.direction() * (-(line.distance(position) - nearest) / REACH).exp())
                .sum();
            sum.try_normalize().unwrap_or(DVec3::NEG_Y)
        })
        .collect()
}

/// A tube that widens from an ellipse at the top to one at the bottom.
#[derive(Debug, Clone, Copy)]
struct Flare {
    top: DVec3,
    bottom: DVec3,
    top_half_axes: (f64, f64),
    bottom_half_axes: (f64, f64),
}

impl Flare {
    /// Approximate distance to the tube's wall, negative inside; large above its top.
    fn distance(&self, position: DVec3) -> f64 {
        let along = (self.top.y - position.y) / (self.top.y - self.bottom.y);
        if along < 0.0 {
            return (position.y - self.top.y).max(0.0) + JOIN_RADIUS;
        }
        let centre = self.top.lerp(self.bottom, along);
        let half_x = self.top_half_axes.0 + (self.bottom_half_axes.0 - self.top_half_axes.0) * along;
        let half_z = self.top_half_axes.1 + (self.bottom_half_axes.1 - self.top_half_axes.1) * along;
        let scaled = ((position.x - centre.x) / half_x).hypot((position.z - centre.z) / half_z);
        (scaled - 1.0) * half_x.min(half_z)
    }
}

/// A round tube around a leg, from the hip to the ankle.
#[derive(Debug, Clone, Copy)]
struct Leg {
    hip: DVec3,
    ankle: DVec3,
    hip_radius: f64,
    hem_radius: f64,
}

impl Leg {
    fn distance(&self, position: DVec3) -> f64 {
        let axis = self.ankle - self.hip;
        let along = (position - self.hip).dot(axis) / axis.length_squared();
        let radius = self.hip_radius + (self.hem_radius - self.hip_radius) * along.max(0.0);
        let aside = position.distance(self.hip + axis * along);
        // Legs of trousers part at the middle: each keeps to its own side.
        let beyond_middle = 0.003 - position.x * self.hip.x.signum();
        (aside - radius).max(beyond_middle).max(-along * axis.length())
    }
}

/// No point inside a body lies deeper than this, metres; further points are outside without a lookup.
const DEEPEST_INSIDE: f64 = 0.25;

/// The order for one garment.
struct Pattern<'a> {
    name: &'static str,
    layer: u32,
    /// Room above the skin per bone, metres; zero where the garment does not cover.
    ease: [f64; Bone::COUNT],
    flare: Option<Flare>,
    legs: Vec<Leg>,
    /// Cloth is kept where this is positive, metres; the bone is the nearest one.
    keep: Box<dyn Fn(DVec3, Bone) -> f64 + Sync + 'a>,
    /// Cloth is stitched to the body where this is positive.
    stitch: Box<dyn Fn(DVec3, Bone) -> bool + Sync + 'a>,
}

fn dress<'a>(body: &'a RestBody, settings: &GarmentSettings) -> Pattern<'a> {
    let ease = settings.bodice_ease_mm / 1000.0;
    let waist_height = body.joint(Bone::Thorax).y;
    let hem_height = body
        .middle(Bone::LeftShank, Bone::RightShank)
        .lerp(body.middle(Bone::LeftFoot, Bone::RightFoot), settings.skirt_length)
        .y;
    let (waist, half_x, half_z) = body.torso_slice(waist_height);
    let hem_radius = settings.skirt_hem_radius_mm / 1000.0;
    let flare = Flare {
        top: waist,
        bottom: DVec3::new(waist.x, hem_height, waist.z),
        top_half_axes: (half_x + ease, half_z + ease),
        bottom_half_axes: (hem_radius, hem_radius * 0.92),
    };
    let neckline = Neckline::of(body, settings);
    Pattern {
        name: "dress",
        layer: 0,
        ease: Bone::table(|bone| match bone {
            Bone::Pelvis | Bone::Thorax | Bone::LeftUpperArm | Bone::RightUpperArm => ease,
            Bone::LeftThigh | Bone::RightThigh => ease,
            _ => 0.0,
        }),
        flare: Some(flare),
        legs: Vec::new(),
        keep: Box::new(move |position, bone| {
            neckline
                .distance(position, bone)
                .min(position.y - hem_height)
                .min(body.before_on_arm(position, bone, 0.45))
        }),
        stitch: Box::new(move |position, bone| neckline.is_on_shoulder(position, bone)),
    }
}

fn shirt<'a>(body: &'a RestBody, settings: &GarmentSettings) -> Pattern<'a> {
    upper_garment("shirt", body, settings, settings.shirt_ease_mm / 1000.0, 1.85)
}

fn t_shirt<'a>(body: &'a RestBody, settings: &GarmentSettings) -> Pattern<'a> {
    upper_garment("t_shirt", body, settings, settings.t_shirt_ease_mm / 1000.0, settings.sleeve_length)
}

/// A garment for the trunk; `sleeve_end` is 1 at the elbow and 2 at the wrist.
fn upper_garment<'a>(
    name: &'static str,
    body: &'a RestBody,
    settings: &GarmentSettings,
    ease: f64,
    sleeve_end: f64,
) -> Pattern<'a> {
    let hem_height = body.joint(Bone::LeftThigh).y - 0.02;
    let chest_height = body.joint(Bone::LeftUpperArm).y - 0.16;
    let (chest, chest_x, chest_z) = body.torso_slice(chest_height);
    let (hips, hips_x, hips_z) = body.widest_torso_slice(hem_height, chest_height);
    let flare = Flare {
        top: chest,
        bottom: DVec3::new(hips.x, hem_height, hips.z),
        top_half_axes: (chest_x, chest_z),
        bottom_half_axes: (hips_x + ease, hips_z + ease),
    };
    let neckline = Neckline::of(body, settings);
    Pattern {
        name,
        layer: 1,
        ease: Bone::table(|bone| match bone {
            Bone::Pelvis | Bone::Thorax | Bone::LeftUpperArm | Bone::RightUpperArm => ease * 0.6,
            Bone::LeftForearm | Bone::RightForearm | Bone::LeftHand | Bone::RightHand => ease,
            Bone::LeftThigh | Bone::RightThigh => ease * 0.6,
            _ => 0.0,
        }),
        flare: Some(flare),
        legs: Vec::new(),
        keep: Box::new(move |position, bone| {
            neckline
                .distance(position, bone)
                .min(position.y - hem_height)
                .min(body.before_on_arm(position, bone, sleeve_end))
        }),
        stitch: Box::new(move |position, bone| neckline.is_on_shoulder(position, bone)),
    }
}

fn trousers<'a>(body: &'a RestBody, settings: &GarmentSettings) -> Pattern<'a> {
    let ends = [body.joint(Bone::LeftFoot), body.joint(Bone::RightFoot)];
    let hem_radius = settings.trouser_hem_radius_mm / 1000.0;
    lower_garment("trousers", body, settings.trouser_ease_mm / 1000.0, ends, hem_radius)
}

fn shorts<'a>(body: &'a RestBody, settings: &GarmentSettings) -> Pattern<'a> {
    let along = |hip: Bone, knee: Bone| body.joint(hip).lerp(body.joint(knee), settings.shorts_length);
    let ends = [along(Bone::LeftThigh, Bone::LeftShank), along(Bone::RightThigh, Bone::RightShank)];
    let hem_radius = settings.shorts_hem_radius_mm / 1000.0;
    lower_garment("shorts", body, settings.shorts_ease_mm / 1000.0, ends, hem_radius)
}

/// A garment with two legs that end at these places.
fn lower_garment<'a>(
    name: &'static str,
    body: &'a RestBody,
    ease: f64,
    ends: [DVec3; 2],
    hem_radius: f64,
) -> Pattern<'a> {
    let waist_height = body.joint(Bone::Thorax).y;
    let hem_height = (ends[0].y + ends[1].y) * 0.5;
    let leg = |hip: Bone, ankle: DVec3| Leg { hip: body.joint(hip), ankle, hip_radius: 0.09, hem_radius };
    Pattern {
        name,
        layer: 0,
        ease: Bone::table(|bone| match bone {
            Bone::Pelvis | Bone::Thorax => ease * 0.5,
            Bone::LeftThigh | Bone::RightThigh | Bone::LeftShank | Bone::RightShank => ease,
            _ => 0.0,
        }),
        flare: None,
        legs: vec![leg(Bone::LeftThigh, ends[0]), leg(Bone::RightThigh, ends[1])],
        keep: Box::new(move |position, bone| {
            let height = (position.y - hem_height).min(waist_height - position.y);
            if bone.is_arm() || bone == Bone::Head { -1.0 } else { height }
        }),
        stitch: Box::new(move |position, _| position.y > waist_height - STITCH_BAND),
    }
}

/// The neck opening: a ball about the base of the neck.
#[derive(Clone, Copy)]
struct Neckline {
    centre: DVec3,
    radius: f64,
    shoulder_height: f64,
}

impl Neckline {
    fn of(body: &RestBody, settings: &GarmentSettings) -> Self {
        let shoulder_height = body.joint(Bone::LeftUpperArm).y;
        Self { centre: body.joint(Bone::Head), radius: settings.neckline_radius_mm / 1000.0, shoulder_height }
    }

    fn distance(&self, position: DVec3, bone: Bone) -> f64 {
        if bone == Bone::Head { -1.0 } else { position.distance(self.centre) - self.radius }
    }

    fn is_on_shoulder(&self, position: DVec3, bone: Bone) -> bool {
        bone == Bone::Thorax
            && position.y > self.shoulder_height
            && position.distance(self.centre) < self.radius + STITCH_BAND
    }
}

impl Pattern<'_> {
    /// Distance to the garment's surface, negative inside.
    fn distance(&self, body: &RestBody, position: DVec3) -> f64 {
        let others = self.flare.map_or(f64::INFINITY, |flare| flare.distance(position));
        let others = self.legs.iter().fold(others, |distance, leg| distance.min(leg.distance(position)));
        let Some(nearest) = body.index().closest_within(position, DEEPEST_INSIDE) else {
            return others.min(DEEPEST_INSIDE);
        };
        let from_skin = nearest.distance_squared.sqrt();
        let is_inside = (position - nearest.position).dot(nearest.normal) < 0.0;
        let from_skin = if is_inside { -from_skin } else { from_skin };
        let eased = from_skin - body.interpolate(nearest.face, nearest.barycentric, &self.ease);
        let mut distance = eased;
        if !self.legs.is_empty() && body.bone_at(nearest.face, nearest.barycentric).is_leg() {
            distance = from_skin.min(eased.max(0.003 - position.x.abs()));
        }
        smooth_minimum(distance, others, JOIN_RADIUS)
    }

    fn sew(&self, body: &RestBody, settings: &GarmentSettings) -> Result<Garment, SyntheticError> {
        let spacing = settings.cloth_edge_mm / 1000.0;
        let (positions, faces) = self.solid(body, spacing);
        let is_kept: Vec<bool> = positions
            .par_iter()
            .map(|&position| (self.keep)(position, body.nearest_bone(position)) > 0.0)
            .collect();
        let faces =
            faces.into_iter().filter(|face| face.iter().all(|&vertex| is_kept[vertex as usize])).collect();
        let (positions, faces) = compact(positions, faces);
        let (mut positions, faces) = sheet::largest_part(positions, faces);
        if faces.is_empty() {
            return Err(SyntheticError::EmptyGarment { garment: self.name });
        }
        sheet::smooth_borders(&mut positions, &faces, 8);
        let anchors = self.stitches(body, &positions);
        Ok(Garment { name: self.name, positions, faces, anchors, drive: Drive::Simulated, layer: self.layer })
    }

    fn solid(&self, body: &RestBody, spacing: f64) -> Triangles {
        let reach = self.ease.iter().copied().fold(0.0, f64::max)
            + self.flare.map_or(0.0, |flare| flare.bottom_half_axes.0)
            + self.legs.first().map_or(0.0, |leg| leg.hem_radius);
        let (low, high) = body.bounds();
        let margin = DVec3::new(reach, 0.05, reach) + spacing * 2.0;
        let mut grid = ScalarGrid::covering(low - margin, high + margin, spacing);
        let [nx, ny, _] = grid.dimensions;
        let origin = grid.origin;
        grid.samples.par_iter_mut().enumerate().for_each(|(sample, value)| {
            let place = [sample % nx, sample / nx % ny, sample / (nx * ny)].map(|count| count as f64);
            *value = self.distance(body, origin + DVec3::from_array(place) * spacing) as f32;
        });
        let (mut positions, faces) = grid.surface();
        sheet::even_out(&mut positions, &faces, 4, |position| self.distance(body, position));
        (positions, faces)
    }

    fn stitches(&self, body: &RestBody, positions: &[DVec3]) -> Vec<Anchor> {
        let is_stitched = |position: DVec3| (self.stitch)(position, body.nearest_bone(position));
        positions
            .iter()
            .enumerate()
            .filter(|(_, position)| is_stitched(**position))
            .map(|(vertex, &position)| {
                let nearest = body.index().closest(position);
                Anchor {
                    vertex: vertex as u32,
                    face: nearest.face,
                    barycentric: nearest.barycentric,
                    height: nearest.distance_squared.sqrt(),
                    compliance: STITCH_COMPLIANCE,
                }
            })
            .collect()
    }
}

/// A polynomial minimum that is rounded where its arguments are within `radius` of each other.
fn smooth_minimum(first: f64, second: f64, radius: f64) -> f64 {
    let overlap = (radius - (first - second).abs()).max(0.0) / radius;
    first.min(second) - overlap * overlap * radius * 0.25
}
