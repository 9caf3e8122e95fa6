//! Which unit and which up-axis a file was made with, guessed from the body in it and reported, never assumed.

use std::fmt;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Statures of standing people in metres; anything else means another unit or a mistake.
const PLAUSIBLE_STATURE: std::ops::RangeInclusive<f64> = 1.2..=2.2;
/// A middling stature in metres, to which an implausible one is compared.
const TYPICAL_STATURE: f64 = 1.7;

/// A unit of length in which scans come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LengthUnit {
    /// Metres.
    Metre,
    /// Centimetres.
    Centimetre,
    /// Millimetres.
    Millimetre,
    /// Inches of 25.4 mm.
    Inch,
}

impl LengthUnit {
    const ALL: [Self; 4] = [Self::Metre, Self::Centimetre, Self::Millimetre, Self::Inch];

    /// How many metres one unit is.
    pub fn metres(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Centimetre => 0.01,
            Self::Millimetre => 0.001,
            Self::Inch => 0.0254,
        }
    }
}

impl fmt::Display for LengthUnit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Metre => "metres",
            Self::Centimetre => "centimetres",
            Self::Millimetre => "millimetres",
            Self::Inch => "inches",
        })
    }
}

/// A guessed unit with the ground for it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UnitGuess {
    /// The unit.
    pub unit: LengthUnit,
    /// How many metres one unit of the file is.
    pub metres_per_unit: f64,
    /// False where no unit makes the stature plausible, or only a rare one does: ask for it then.
    pub certain: bool,
    /// The ground, for the report.
    pub reason: String,
}

/// The unit that makes a standing person's stature, in units of the file, plausible (1.2–2.2 m).
pub fn guess_unit(stature_in_file_units: f64) -> UnitGuess {
    let stature_in = |unit: LengthUnit| stature_in_file_units * unit.metres();
    if let Some(unit) =
        LengthUnit::ALL.into_iter().find(|unit| PLAUSIBLE_STATURE.contains(&stature_in(*unit)))
    {
        return UnitGuess {
            unit,
            metres_per_unit: unit.metres(),
            // Scanners do not measure in inches; a child in a file of unknown scale may look as if.
            certain: unit != LengthUnit::Inch,
            reason: format!(
                "a stature of {stature_in_file_units:.4} is {:.3} m if in {unit}",
                stature_in(unit)
            ),
        };
    }
    let is_usable = stature_in_file_units.is_finite() && stature_in_file_units > 0.0;
    let misfit = |unit: LengthUnit| (stature_in(unit) / TYPICAL_STATURE).ln().abs();
    let unit = match is_usable {
        true => LengthUnit::ALL[..3]
            .iter()
            .copied()
            .fold(LengthUnit::Metre, |best, unit| if misfit(unit) < misfit(best) { unit } else { best }),
        false => LengthUnit::Metre,
    };
    UnitGuess {
        unit,
        metres_per_unit: unit.metres(),
        certain: false,
        reason: format!(
            "a stature of {stature_in_file_units:.4} is implausible in every unit; {unit} come nearest; state the unit"
        ),
    }
}

/// One of the six directions along the axes of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum SignedAxis {
    /// Along x.
    #[serde(rename = "+x")]
    PlusX,
    /// Against x.
    #[serde(rename = "-x")]
    MinusX,
    /// Along y.
    #[serde(rename = "+y")]
    PlusY,
    /// Against y.
    #[serde(rename = "-y")]
    MinusY,
    /// Along z.
    #[serde(rename = "+z")]
    PlusZ,
    /// Against z.
    #[serde(rename = "-z")]
    MinusZ,
}

impl SignedAxis {
    /// All six, the usual ones first.
    pub const ALL: [Self; 6] =
        [Self::PlusY, Self::PlusZ, Self::MinusY, Self::MinusZ, Self::PlusX, Self::MinusX];

    /// The direction as a unit vector.
    pub fn vector(self) -> DVec3 {
        match self {
            Self::PlusX => DVec3::X,
            Self::MinusX => DVec3::NEG_X,
            Self::PlusY => DVec3::Y,
            Self::MinusY => DVec3::NEG_Y,
            Self::PlusZ => DVec3::Z,
            Self::MinusZ => DVec3::NEG_Z,
        }
    }
}

impl fmt::Display for SignedAxis {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::PlusX => "+x",
            Self::MinusX => "-x",
            Self::PlusY => "+y",
            Self::MinusY => "-y",
            Self::PlusZ => "+z",
            Self::MinusZ => "-z",
        })
    }
}

/// A direction that may be up, with the grounds for it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UpCandidate {
    /// The direction.
    pub up: SignedAxis,
    /// The share of belief, of 1 over all six; judge the leading ones by a fit where they are close.
    pub score: f64,
    /// The extent along the direction, relative to the largest of the three.
    pub relative_extent: f64,
    /// How much wider the body is near its lowest point than near its highest, as a logarithm: feet against a head.
    pub widening_downwards: f64,
    /// How much less its lowest point wanders over the frames than its highest, as a logarithm: a floor.
    pub floor_steadiness: f64,
}

/// All six directions by how much they look like up, best first, from one frame or several of one person.
///
/// Empty where there is no point. Weights were chosen on upright captures; lying or inverted people need the fit's verdict.
pub fn guess_up_axis(frames: &[&[DVec3]]) -> Vec<UpCandidate> {
    let frames: Vec<&[DVec3]> = frames.iter().copied().filter(|frame| !frame.is_empty()).collect();
    if frames.is_empty() {
        return Vec::new();
    }
    let extents: [f64; 3] = [0, 1, 2].map(|axis| {
        median(frames.iter().map(|frame| {
            let (low, high) = range_along(frame, unit_vector(axis));
            high - low
        }))
    });
    let largest = extents.iter().fold(f64::MIN_POSITIVE, |largest, extent| largest.max(*extent));
    let mut candidates: Vec<UpCandidate> = SignedAxis::ALL
        .into_iter()
        .map(|up| {
            let direction = up.vector();
            let relative_extent = direction.abs().dot(DVec3::from(extents)) / largest;
            let widening_downwards = median(frames.iter().map(|frame| widening_downwards(frame, direction)));
            let floor_steadiness = floor_steadiness(&frames, direction, largest);
            // A body is about four times as tall as deep; signs weigh less, as raised arms and jumps deny them.
            let belief =
                8.0 * relative_extent.max(1e-3).ln() + 3.0 * widening_downwards + 1.5 * floor_steadiness;
            UpCandidate { up, score: belief, relative_extent, widening_downwards, floor_steadiness }
        })
        .collect();
    let highest = candidates.iter().map(|candidate| candidate.score).fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = candidates.iter().map(|candidate| (candidate.score - highest).exp()).sum();
    for candidate in &mut candidates {
        candidate.score = (candidate.score - highest).exp() / total;
    }
    candidates.sort_by(|first, second| second.score.total_cmp(&first.score));
    candidates
}

fn unit_vector(axis: usize) -> DVec3 {
    DVec3::AXES[axis]
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn range_along(points: &[DVec3], direction: DVec3) -> (f64, f64) {
    points
        .iter()
        .map(|point| point.dot(direction))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), height| (low.min(height), high.max(height)))
}

/// The logarithm of the breadth of the lowest slice over that of the highest: two feet apart, or one foot's length,
/// against the crown of a head.
fn widening_downwards(points: &[DVec3], up: DVec3) -> f64 {
    /// The slice's height: to the ankle, and to the brow.
    const SLICE: f64 = 0.05;
    let (low, high) = range_along(points, up);
    let height = high - low;
    let breadth = |is_inside: &dyn Fn(f64) -> bool| {
        let slice: Vec<DVec3> = points.iter().copied().filter(|point| is_inside(point.dot(up))).collect();
        let mean = slice.iter().sum::<DVec3>() / slice.len().max(1) as f64;
        let spread = slice
            .iter()
            .map(|point| (*point - mean).reject_from_normalized(up).length_squared())
            .sum::<f64>();
        (spread / slice.len().max(1) as f64).sqrt()
    };
    let lowest = breadth(&|along| along <= low + SLICE * height);
    let highest = breadth(&|along| along >= high - SLICE * height);
    // A hundredth of the height keeps a slice of one point from deciding.
    let floor = 0.01 * height.max(f64::MIN_POSITIVE);
    ((lowest + floor) / (highest + floor)).ln()
}

/// The logarithm of how far the highest point wanders over how far the lowest does; 0 for a single frame.
fn floor_steadiness(frames: &[&[DVec3]], up: DVec3, largest_extent: f64) -> f64 {
    let ranges: Vec<(f64, f64)> = frames.iter().map(|frame| range_along(frame, up)).collect();
    let wander = |pick: fn(&(f64, f64)) -> f64| {
        let mean = ranges.iter().map(pick).sum::<f64>() / ranges.len() as f64;
        (ranges.iter().map(|range| (pick(range) - mean).powi(2)).sum::<f64>() / ranges.len() as f64).sqrt()
    };
    // Half a per cent: less is noise of the capture.
    let floor = 0.005 * largest_extent;
    ((wander(|range| range.1) + floor) / (wander(|range| range.0) + floor)).ln()
}

/// How a file's coordinates relate to ours: metres, y up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameOfReference {
    /// How many metres one unit of the file is.
    pub metres_per_unit: f64,
    /// Which direction of the file is up.
    pub up: SignedAxis,
}

impl FrameOfReference {
    /// Metres, y up: our own.
    pub const INTERNAL: Self = Self { metres_per_unit: 1.0, up: SignedAxis::PlusY };

    /// The rotation (never a reflection) that takes the file's up to y.
    pub fn internal_from_input_rotation(&self) -> DMat3 {
        match self.up {
            SignedAxis::PlusY => DMat3::IDENTITY,
            SignedAxis::MinusY => DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z),
            SignedAxis::PlusZ => DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y),
            SignedAxis::MinusZ => DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
            SignedAxis::PlusX => DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z),
            SignedAxis::MinusX => DMat3::from_cols(DVec3::NEG_Y, DVec3::X, DVec3::Z),
        }
    }

    /// A point of the file in metres, y up.
    pub fn to_internal(&self, point_in_input: DVec3) -> DVec3 {
        self.internal_from_input_rotation() * point_in_input * self.metres_per_unit
    }

    /// A point in metres, y up, as the file has it.
    pub fn to_input(&self, point: DVec3) -> DVec3 {
        self.internal_from_input_rotation().transpose() * point / self.metres_per_unit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plausible_statures_name_their_unit_with_certainty() {
        for (stature, unit) in
            [(1.75, LengthUnit::Metre), (162.0, LengthUnit::Centimetre), (1893.2, LengthUnit::Millimetre)]
        {
            let guess = guess_unit(stature);
            assert_eq!((guess.unit, guess.certain, guess.metres_per_unit), (unit, true, unit.metres()));
        }
        assert_eq!((guess_unit(69.0).unit, guess_unit(69.0).certain), (LengthUnit::Inch, false));
    }

    #[test]
    fn implausible_statures_are_never_certain() {
        for stature in [0.0, -1.0, f64::NAN, f64::INFINITY, 0.4, 17.0, 500.0, 1e7] {
            assert!(!guess_unit(stature).certain, "{stature}");
        }
        assert_eq!(guess_unit(2.6).unit, LengthUnit::Metre);
        assert_eq!(guess_unit(3000.0).unit, LengthUnit::Millimetre);
    }

    #[test]
    fn every_up_is_turned_to_y_and_back() {
        for up in SignedAxis::ALL {
            let frame = FrameOfReference { metres_per_unit: 0.001, up };
            let rotation = frame.internal_from_input_rotation();
            assert_eq!(rotation * up.vector(), DVec3::Y);
            assert_eq!(rotation.determinant(), 1.0);
            let point = DVec3::new(3.0, -70.0, 1100.0);
            assert!(frame.to_input(frame.to_internal(point)).distance(point) < 1e-12);
        }
    }

    #[test]
    fn no_points_give_no_candidates_and_one_point_gives_six() {
        assert!(guess_up_axis(&[]).is_empty());
        assert!(guess_up_axis(&[&[]]).is_empty());
        let candidates = guess_up_axis(&[&[DVec3::ONE]]);
        assert_eq!(candidates.len(), 6);
        assert!(candidates.iter().all(|candidate| (candidate.score - 1.0 / 6.0).abs() < 1e-9));
    }
}
