//! One measurement, made ready for a model: names looked up, its part of the body cut out.

use glam::DVec3;

use super::MeasureError;
use super::cross_section::{BodyPart, Plane, polyline_length, taut_tape};
use super::definitions::{BreadthDirection, Definition, Extreme, Method, PointReference, Tape};
use super::points::{Point, RestBody, bone_index};
use crate::artifacts::measurements::Quantity;
use crate::body::BodyModel;

/// Levels tried between the ends of a search before the best one is refined.
const SEARCH_LEVELS: usize = 24;
/// Golden-section steps: the level is then known to 10⁻⁶ of the search's range.
const REFINEMENT_STEPS: usize = 24;
/// Below this length in metres a line has no direction.
const SHORTEST_DIRECTION: f64 = 1e-6;

/// A definition bound to a model.
pub(super) struct BoundDefinition<'a> {
    /// The definition.
    pub(super) definition: &'a Definition,
    method: BoundMethod,
}

enum BoundMethod {
    Height([Point; 2]),
    Length(Vec<Point>),
    Breadth { at: Point, across: [Point; 2], direction: BreadthDirection, tape: BoundTape },
    Girth { at: Point, tape: BoundTape },
    ExtremeGirth { pick: Extreme, ends: [Point; 2], tape: BoundTape },
    Volume { faces: Vec<[u32; 3]> },
}

struct BoundTape {
    part: BodyPart,
    along: Option<[Point; 2]>,
    around: Option<Point>,
}

/// A value with the curve that it was taken along.
pub(super) struct Taken {
    /// Metres or cubic metres.
    pub(super) value: f64,
    /// Polyline on the body.
    pub(super) curve: Vec<DVec3>,
    /// Where a search ended, 0 to 1.
    pub(super) level: Option<f64>,
}

impl Taken {
    fn along(curve: Vec<DVec3>) -> Self {
        Self { value: polyline_length(&curve), curve, level: None }
    }
}

impl<'a> BoundDefinition<'a> {
    /// Looks up every name that the definition uses.
    pub(super) fn new(definition: &'a Definition, model: &BodyModel) -> Result<Self, MeasureError> {
        let point = |reference: &PointReference| {
            Point::resolve(reference, model).map_err(|name| MeasureError::UnknownPoint {
                measurement: definition.name.clone(),
                point: name,
            })
        };
        let pair = |references: &[PointReference; 2]| Ok([point(&references[0])?, point(&references[1])?]);
        let tape = |tape: &Tape| -> Result<BoundTape, MeasureError> {
            let bone = |name: &String| {
                bone_index(name, model).ok_or_else(|| MeasureError::UnknownPoint {
                    measurement: definition.name.clone(),
                    point: format!("bone:{name}"),
                })
            };
            let bones: Vec<usize> = tape.bones.iter().map(bone).collect::<Result<_, _>>()?;
            Ok(BoundTape {
                part: BodyPart::new(model, &bones),
                along: tape.along.as_deref().map(pair).transpose()?,
                around: tape.around.as_ref().map(point).transpose()?,
            })
        };
        let method = match &definition.method {
            Method::Height { from, to } => BoundMethod::Height([point(from)?, point(to)?]),
            Method::Length { through } => {
                BoundMethod::Length(through.iter().map(point).collect::<Result<_, _>>()?)
            }
            Method::Breadth { at, across, direction, tape: around } => BoundMethod::Breadth {
                at: point(at)?,
                across: pair(across)?,
                direction: *direction,
                tape: tape(around)?,
            },
            Method::Girth { at, tape: around } => BoundMethod::Girth { at: point(at)?, tape: tape(around)? },
            Method::ExtremeGirth { pick, from, to, tape: around } => BoundMethod::ExtremeGirth {
                pick: *pick,
                ends: [point(from)?, point(to)?],
                tape: tape(around)?,
            },
            Method::Volume {} => BoundMethod::Volume { faces: model.faces().to_vec() },
        };
        Ok(Self { definition, method })
    }

    /// Length or volume.
    pub(super) fn quantity(&self) -> Quantity {
        match self.method {
            BoundMethod::Volume { .. } => Quantity::Volume,
            _ => Quantity::Length,
        }
    }

    /// Takes the measurement; a search stays at `level` if one is given.
    pub(super) fn take(&self, body: &RestBody<'_>, level: Option<f64>) -> Result<Taken, MeasureError> {
        let taken = match &self.method {
            BoundMethod::Height(ends) => Some(height(ends[0].on(body), ends[1].on(body))),
            BoundMethod::Length(points) => {
                Some(Taken::along(points.iter().map(|point| point.on(body)).collect()))
            }
            BoundMethod::Breadth { at, across, direction, tape } => {
                let sideways = across[1].on(body) - across[0].on(body);
                breadth(body, at.on(body), sideways, *direction, tape)
            }
            BoundMethod::Girth { at, tape } => tape.girth(body, at.on(body)).map(Taken::along),
            BoundMethod::ExtremeGirth { pick, ends, tape } => {
                let ends = [ends[0].on(body), ends[1].on(body)];
                extreme_girth(body, *pick, ends, tape, level)
            }
            BoundMethod::Volume { faces } => Some(volume(body.vertices, faces)),
        };
        taken.ok_or_else(|| MeasureError::NothingThere { measurement: self.definition.name.clone() })
    }
}

impl BoundTape {
    fn normal(&self, body: &RestBody<'_>) -> Option<DVec3> {
        match &self.along {
            None => Some(DVec3::Y),
            Some([from, to]) => direction(to.on(body) - from.on(body)),
        }
    }

    /// The closed tape through a point.
    fn girth(&self, body: &RestBody<'_>, origin: DVec3) -> Option<Vec<DVec3>> {
        let plane = Plane { origin, normal: self.normal(body)? };
        taut_tape(&self.cut(body, plane), plane.normal)
    }

    fn cut(&self, body: &RestBody<'_>, plane: Plane) -> Vec<DVec3> {
        self.part.cut(body.vertices, plane, self.around.as_ref().map(|point| point.on(body)))
    }
}

fn direction(difference: DVec3) -> Option<DVec3> {
    (difference.length() > SHORTEST_DIRECTION).then(|| difference.normalize())
}

/// Vertical distance, drawn as a vertical line below or above the second point.
fn height(from: DVec3, to: DVec3) -> Taken {
    Taken::along(vec![DVec3::new(to.x, from.y, to.z), to])
}

fn breadth(
    body: &RestBody<'_>,
    origin: DVec3,
    sideways: DVec3,
    kind: BreadthDirection,
    tape: &BoundTape,
) -> Option<Taken> {
    let sideways = direction(DVec3::new(sideways.x, 0.0, sideways.z))?;
    let direction = match kind {
        BreadthDirection::Sideways => sideways,
        BreadthDirection::FrontToBack => sideways.cross(DVec3::Y),
    };
    let points = tape.cut(body, Plane { origin, normal: DVec3::Y });
    let by_extent = |a: &&DVec3, b: &&DVec3| a.dot(direction).total_cmp(&b.dot(direction));
    let (low, high) = (points.iter().min_by(by_extent)?, points.iter().max_by(by_extent)?);
    let value = (*high - *low).dot(direction);
    // Callipers: a straight line in the measured direction, midway between the two touched points.
    let middle = 0.5 * (*low + *high);
    let curve = vec![middle - 0.5 * value * direction, middle + 0.5 * value * direction];
    Some(Taken { value, curve, level: None })
}

/// The best of evenly spaced levels, refined by golden section between its neighbours.
fn extreme_girth(
    body: &RestBody<'_>,
    pick: Extreme,
    ends: [DVec3; 2],
    tape: &BoundTape,
    level: Option<f64>,
) -> Option<Taken> {
    let at = |level: f64| tape.girth(body, ends[0].lerp(ends[1], level));
    let cost = |level: f64| {
        at(level).map_or(f64::INFINITY, |curve| match pick {
            Extreme::Smallest => polyline_length(&curve),
            Extreme::Largest => -polyline_length(&curve),
        })
    };
    let level = level.unwrap_or_else(|| {
        let step = 1.0 / SEARCH_LEVELS as f64;
        let mut best = (f64::INFINITY, 0.0);
        for index in 0..=SEARCH_LEVELS {
            let level = index as f64 * step;
            let found = cost(level);
            if found < best.0 {
                best = (found, level);
            }
        }
        let refined = golden_section(&cost, (best.1 - step).max(0.0), (best.1 + step).min(1.0));
        // An end of the range beats the inside when the girth grows or shrinks all the way.
        if cost(refined) < best.0 { refined } else { best.1 }
    });
    at(level).map(|curve| Taken { level: Some(level), ..Taken::along(curve) })
}

fn golden_section(cost: &dyn Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut cost_a, mut cost_b) = (cost(a), cost(b));
    for _ in 0..REFINEMENT_STEPS {
        if cost_a <= cost_b {
            (high, b, cost_b) = (b, a, cost_a);
            a = high - ratio * (high - low);
            cost_a = cost(a);
        } else {
            (low, a, cost_a) = (a, b, cost_b);
            b = low + ratio * (high - low);
            cost_b = cost(b);
        }
    }
    0.5 * (low + high)
}

/// Sum of signed tetrahedra from the middle of the body, which keeps the terms small.
fn volume(vertices: &[DVec3], faces: &[[u32; 3]]) -> Taken {
    let middle = vertices.iter().sum::<DVec3>() / vertices.len().max(1) as f64;
    let value = faces
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|vertex| vertices[vertex as usize] - middle);
            a.dot(b.cross(c)) / 6.0
        })
        .sum();
    Taken { value, curve: Vec::new(), level: None }
}
