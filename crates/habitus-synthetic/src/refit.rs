//! The same garment on another person and in another size: one topology for a whole wardrobe (P3 §5.3).
//!
//! A cut garment is carried over by the displacement of the body beneath it, then widened about the middle lines of
//! trunk and limbs and lengthened along them. Vertices keep their number, so that sequences of different people in
//! different sizes have one clothing surface.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::cloth::Anchor;
use crate::error::SyntheticError;
use crate::garment::Garment;
use crate::rest_body::{Bone, BoneLine, RestBody};

/// Size of an upper or lower garment against the one that was cut.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GarmentSize {
    /// Girths, as a multiple of those that were cut.
    pub width: f64,
    /// Length below the armpits (upper garments) or along the legs (lower garments), as a multiple.
    pub length: f64,
    /// Length of the sleeves, as a multiple.
    pub sleeves: f64,
}

impl Default for GarmentSize {
    fn default() -> Self {
        Self { width: 1.0, length: 1.0, sleeves: 1.0 }
    }
}

/// Distance below which a vertex counts as touching a body vertex, metres: keeps the mean of displacements finite.
const TOUCH: f64 = 0.015;
/// Distance over which a garment changes from one limb's middle line to the next one's, metres.
const LIMB_BLEND: f64 = 0.04;
/// Share of the way from shoulder to elbow over which sleeves take their full width and length.
const SLEEVE_START: f64 = 0.35;

/// A garment of one body, carried over to another and given another size.
pub fn refit(
    garment: &Garment,
    from: &RestBody,
    to: &RestBody,
    size: &GarmentSize,
) -> Result<Garment, SyntheticError> {
    for (setting, value) in
        [("size.width", size.width), ("size.length", size.length), ("size.sleeves", size.sleeves)]
    {
        if !(value.is_finite() && (0.5..=2.5).contains(&value)) {
            return Err(SyntheticError::Setting {
                setting,
                value: value.to_string(),
                expected: "from 0.5 to 2.5".into(),
            });
        }
    }
    let frame = SizeFrame::of(to, garment.name);
    let positions: Vec<DVec3> = garment
        .positions
        .par_iter()
        .map(|&position| frame.resize(carried(position, from, to), size))
        .collect();
    let anchors = garment.anchors.iter().map(|anchor| {
        let nearest = to.index().closest(positions[anchor.vertex as usize]);
        Anchor {
            face: nearest.face,
            barycentric: nearest.barycentric,
            height: nearest.distance_squared.sqrt(),
            ..anchor.clone()
        }
    });
    Ok(Garment { anchors: anchors.collect(), positions, faces: garment.faces.clone(), ..*garment })
}

/// Moves a point by the mean displacement of body vertices, weighted by nearness.
fn carried(position: DVec3, from: &RestBody, to: &RestBody) -> DVec3 {
    let (mut sum, mut total) = (DVec3::ZERO, 0.0);
    for (here, there) in from.positions().iter().zip(to.positions()) {
        let near = here.distance_squared(position) + TOUCH * TOUCH;
        let weight = 1.0 / (near * near * near);
        sum += (*there - *here) * weight;
        total += weight;
    }
    position + sum / total
}

/// Middle lines and heights that a size refers to.
struct SizeFrame {
    is_upper: bool,
    lines: Vec<BoneLine>,
    /// Where widening begins and where it is complete.
    fade: [f64; 2],
    /// Below this height lengths grow.
    length_start: f64,
}

impl SizeFrame {
    fn of(body: &RestBody, name: &str) -> Self {
        let is_upper = !matches!(name, "shorts" | "trousers");
        let hips = body.middle(Bone::LeftThigh, Bone::RightThigh);
        let mut lines = body.bone_lines();
        lines.retain(|line| {
            if is_upper { !line.bone.is_leg() } else { line.bone.is_leg() || line.bone == Bone::Pelvis }
        });
        if is_upper {
            // A hem or skirt hangs about the trunk's line, also below the hips.
            let end = hips - DVec3::Y * hips.y;
            lines.push(BoneLine { bone: Bone::Pelvis, start: hips, end });
        }
        let shoulder = body.joint(Bone::LeftUpperArm).y;
        let waist = body.joint(Bone::Thorax).y;
        Self {
            is_upper,
            lines,
            fade: if is_upper { [shoulder - 0.02, shoulder - 0.16] } else { [waist - 0.04, hips.y] },
            length_start: if is_upper { shoulder - 0.16 } else { hips.y - 0.05 },
        }
    }

    fn resize(&self, position: DVec3, size: &GarmentSize) -> DVec3 {
        let distances: Vec<f64> = self.lines.iter().map(|line| line.distance(position)).collect();
        let nearest = distances.iter().copied().fold(f64::INFINITY, f64::min);
        let weights: Vec<f64> =
            distances.iter().map(|distance| (-(distance - nearest) / LIMB_BLEND).exp()).collect();
        let total: f64 = weights.iter().sum();
        let (mut middle, mut widening, mut shift) = (DVec3::ZERO, 0.0, DVec3::ZERO);
        for (line, weight) in self.lines.iter().zip(weights) {
            let share = weight / total;
            middle += line.nearest(position) * share;
            let (start, grown) = self.along(line, position, size);
            widening += start * share;
            shift += grown * share;
        }
        middle + (position - middle) * (1.0 + (size.width - 1.0) * widening) + shift
    }

    /// How much of the widening a place on a line takes, and how far it moves along.
    fn along(&self, line: &BoneLine, position: DVec3, size: &GarmentSize) -> (f64, DVec3) {
        if line.bone.is_arm() {
            let direction = line.direction();
            let way = (position - line.start).dot(direction);
            let length = line.start.distance(line.end);
            let is_upper_arm = matches!(line.bone, Bone::LeftUpperArm | Bone::RightUpperArm);
            let start = if is_upper_arm { smooth_step(way / (SLEEVE_START * length)) } else { 1.0 };
            return (start, direction * (way.max(0.0) * start * (size.sleeves - 1.0)));
        }
        let [begin, full] = self.fade;
        let fade = smooth_step((begin - position.y) / (begin - full));
        let below = (self.length_start - position.y).max(0.0) * (size.length - 1.0);
        let direction = if self.is_upper { DVec3::NEG_Y } else { line.direction() };
        (fade, direction * below)
    }
}

fn smooth_step(share: f64) -> f64 {
    let share = share.clamp(0.0, 1.0);
    share * share * (3.0 - 2.0 * share)
}

#[cfg(test)]
mod tests {
    use habitus::body::BodyModel;

    use super::*;
    use crate::garment::{GarmentSettings, Outfit, tailor};

    fn extent(garment: &Garment, direction: DVec3) -> f64 {
        let places = garment.positions.iter().map(|place| place.dot(direction));
        let (low, high) =
            places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        high - low
    }

    #[test]
    fn a_refit_without_change_is_the_garment_and_a_larger_size_is_larger() {
        let model = BodyModel::default_space().unwrap();
        let body = RestBody::new(&model, model.rest_vertices(&[])).unwrap();
        let settings = GarmentSettings { cloth_edge_mm: 35.0, ..GarmentSettings::default() };
        let garments = tailor(Outfit::ShortsAndTShirt, &body, &settings).unwrap();
        for garment in &garments {
            let same = refit(garment, &body, &body, &GarmentSize::default()).unwrap();
            for (a, b) in garment.positions.iter().zip(&same.positions) {
                assert!(a.distance(*b) < 1e-9);
            }
            let mut last = [0.0; 2];
            for step in 0..4 {
                let factor = 0.9 + 0.2 * f64::from(step);
                let wide = GarmentSize { width: factor, ..GarmentSize::default() };
                let long = GarmentSize { length: factor, ..GarmentSize::default() };
                let [wide, long] = [wide, long].map(|size| refit(garment, &body, &body, &size).unwrap());
                // Front to back: sideways the sleeves decide.
                let now = [extent(&wide, DVec3::Z), extent(&long, DVec3::Y)];
                assert!(now[0] > last[0] + 0.01 && now[1] > last[1] + 0.01, "{}: {now:?}", garment.name);
                last = now;
            }
            let impossible = GarmentSize { width: f64::NAN, ..GarmentSize::default() };
            assert!(refit(garment, &body, &body, &impossible).is_err());
        }
    }

    #[test]
    fn a_garment_fits_another_person_as_it_fitted_the_first() {
        let model = BodyModel::default_space().unwrap();
        let bodies = [vec![0.0], vec![1.5, -1.0, 0.8]]
            .map(|identity| RestBody::new(&model, model.rest_vertices(&identity)).unwrap());
        let settings = GarmentSettings { cloth_edge_mm: 35.0, ..GarmentSettings::default() };
        for garment in tailor(Outfit::ShortsAndTShirt, &bodies[0], &settings).unwrap() {
            let refitted = refit(&garment, &bodies[0], &bodies[1], &GarmentSize::default()).unwrap();
            for (a, b) in garment.positions.iter().zip(&refitted.positions) {
                let [before, after] = [(&bodies[0], a), (&bodies[1], b)]
                    .map(|(body, place)| body.index().closest(*place).distance_squared.sqrt());
                // The room between cloth and skin changes by far less than the people differ (decimetres).
                assert!((before - after).abs() < 0.03, "{before} {after}");
            }
        }
    }
}
