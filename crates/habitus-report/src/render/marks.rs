//! Curves as tubes and dots as balls: marks become meshes, so the rasteriser knows only triangles.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::{Curve, Dot, Layer, Paint};

/// Sides of a tube; enough to look round at a few pixels.
const TUBE_SIDES: u32 = 8;
/// Rings of a ball between its poles.
const BALL_RINGS: u32 = 9;
/// Sides of a ball's ring.
const BALL_SIDES: u32 = 16;

/// The tube around a curve; nothing when the curve has fewer than two corners.
pub(crate) fn tube(curve: &Curve) -> Option<Layer> {
    let points: Vec<DVec3> = curve.points.iter().copied().filter(|point| point.is_finite()).collect();
    let count = points.len();
    if count < 2 {
        return None;
    }
    let is_closed = curve.is_closed && count > 2;
    let neighbour = |i: usize, step: isize| {
        let j = i as isize + step;
        let j = if is_closed { j.rem_euclid(count as isize) } else { j.clamp(0, count as isize - 1) };
        points[j as usize]
    };
    let mut positions = Vec::with_capacity(count * TUBE_SIDES as usize);
    let mut side = DVec3::ZERO;
    for (i, &point) in points.iter().enumerate() {
        let tangent = (neighbour(i, 1) - neighbour(i, -1)).normalize_or(DVec3::X);
        // Carrying the side direction from corner to corner keeps the tube from twisting.
        side = side.reject_from_normalized(tangent).normalize_or(tangent.any_orthonormal_vector());
        let other = tangent.cross(side);
        positions.extend((0..TUBE_SIDES).map(|k| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(TUBE_SIDES)).sin_cos();
            point + curve.radius * (side * cos + other * sin)
        }));
    }
    let segments = if is_closed { count } else { count - 1 };
    let mut faces = Vec::with_capacity(segments * TUBE_SIDES as usize * 2);
    for segment in 0..segments {
        let [near, far] = [segment, (segment + 1) % count].map(|ring| ring as u32 * TUBE_SIDES);
        for k in 0..TUBE_SIDES {
            let next = (k + 1) % TUBE_SIDES;
            faces.push([near + k, near + next, far + next]);
            faces.push([near + k, far + next, far + k]);
        }
    }
    Some(Layer::opaque(positions, faces, Paint::Uniform(curve.color)))
}

/// The balls of all dots as one mesh; nothing when there is no dot.
pub(crate) fn balls(dots: &[Dot]) -> Option<Layer> {
    if dots.is_empty() {
        return None;
    }
    let (directions, ball_faces) = unit_ball();
    let mut positions = Vec::with_capacity(dots.len() * directions.len());
    let mut faces = Vec::with_capacity(dots.len() * ball_faces.len());
    let mut colors = Vec::with_capacity(positions.capacity());
    for dot in dots {
        let first = positions.len() as u32;
        positions.extend(directions.iter().map(|direction| dot.position + dot.radius * *direction));
        faces.extend(ball_faces.iter().map(|face| face.map(|vertex| first + vertex)));
        colors.resize(positions.len(), dot.color);
    }
    Some(Layer::opaque(positions, faces, Paint::PerVertex(colors)))
}

/// A ball of radius 1 about the origin: poles and rings.
fn unit_ball() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut positions = vec![DVec3::Y];
    for ring in 1..=BALL_RINGS {
        let (sin, cos) = (PI * f64::from(ring) / f64::from(BALL_RINGS + 1)).sin_cos();
        positions.extend((0..BALL_SIDES).map(|k| {
            let turn = TAU * f64::from(k) / f64::from(BALL_SIDES);
            DVec3::new(sin * turn.sin(), cos, sin * turn.cos())
        }));
    }
    positions.push(-DVec3::Y);
    let last = positions.len() as u32 - 1;
    let mut faces = Vec::new();
    for k in 0..BALL_SIDES {
        let next = (k + 1) % BALL_SIDES;
        faces.push([0, 1 + k, 1 + next]);
        for ring in 1..BALL_RINGS {
            let [upper, lower] = [1 + (ring - 1) * BALL_SIDES, 1 + ring * BALL_SIDES];
            faces.push([upper + k, lower + k, lower + next]);
            faces.push([upper + k, lower + next, upper + next]);
        }
        let bottom = 1 + (BALL_RINGS - 1) * BALL_SIDES;
        faces.push([last, bottom + next, bottom + k]);
    }
    (positions, faces)
}
