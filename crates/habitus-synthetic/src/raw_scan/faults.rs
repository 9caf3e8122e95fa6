//! What is wrong with a real scan: holes where hair, hems and shadows are, and crumbs in the air.

use glam::DVec3;
use habitus::body::BodyModel;
use habitus::statistics::RandomStream;

use super::RawScanSettings;
use crate::isosurface::Triangles;

/// Named vertices of the usual holes.
const USUAL_HOLES: [&str; 6] =
    ["crown", "crotch", "left_axilla", "right_axilla", "left_heel_sole", "right_heel_sole"];
/// Radius of holes anywhere, millimetres.
const DROPOUT_RADIUS_MM: [f64; 2] = [8.0, 22.0];
/// Points of a crumb.
const CRUMB_POINTS: usize = 6;
/// Size of a crumb, metres.
const CRUMB_SIZE: f64 = 0.004;

/// Cuts holes and adds stray pieces.
pub(super) fn add_faults(
    scanned: Triangles,
    model: &BodyModel,
    vertices: &[DVec3],
    settings: &RawScanSettings,
    random: &mut RandomStream,
) -> Triangles {
    let mut holes = Vec::new();
    for name in USUAL_HOLES {
        let is_there = random.unit() < settings.hole_probability;
        let radius = random.between(settings.hole_radius_mm[0], settings.hole_radius_mm[1]) / 1000.0;
        if let (true, Some(vertex)) = (is_there, model.measurement_vertex(name)) {
            holes.push((vertices[vertex], radius));
        }
    }
    let [fewest, most] = settings.dropout_count.map(|count| count as f64);
    for _ in 0..random.between(fewest, most + 1.0) as usize {
        let centre = vertices[(random.unit() * vertices.len() as f64) as usize % vertices.len()];
        holes.push((centre, random.between(DROPOUT_RADIUS_MM[0], DROPOUT_RADIUS_MM[1]) / 1000.0));
    }
    let (positions, mut faces) = scanned;
    let is_lost: Vec<bool> = positions
        .iter()
        .map(|point| holes.iter().any(|(centre, radius)| point.distance_squared(*centre) < radius * radius))
        .collect();
    faces.retain(|face| face.iter().all(|vertex| !is_lost[*vertex as usize]));
    let (mut positions, mut faces) = crate::capture::compact(positions, faces);
    let (low, high) = crate::capture::bounds(vertices.iter().copied());
    let crumbs = (settings.stray_share * positions.len() as f64) as usize / CRUMB_POINTS;
    for _ in 0..crumbs {
        add_crumb(&mut positions, &mut faces, [low, high], random);
    }
    (positions, faces)
}

/// A small fan of triangles anywhere in the scanner.
fn add_crumb(
    positions: &mut Vec<DVec3>,
    faces: &mut Vec<[u32; 3]>,
    [low, high]: [DVec3; 2],
    random: &mut RandomStream,
) {
    let share = DVec3::new(random.unit(), random.unit(), random.unit());
    let centre = low + (high - low) * share;
    let first = positions.len() as u32;
    for _ in 0..CRUMB_POINTS {
        let offset = DVec3::new(random.normal(), random.normal(), random.normal()) * CRUMB_SIZE;
        positions.push(centre + offset);
    }
    for corner in 1..CRUMB_POINTS as u32 - 1 {
        faces.push([first, first + corner, first + corner + 1]);
    }
}
