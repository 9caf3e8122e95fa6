//! A first identity and pose of a person who stands upright with the arms off the body, without landmarks.
//!
//! Cheaper than the search of a moving, dressed person: such a person is widest across the arms, so that only facing
//! one way or the other is open.

use glam::{DQuat, DVec3};
use habitus_geometry::{SurfaceIndex, TriangleMesh};
use habitus_optimize::SolveError;
use rayon::prelude::*;

use super::gaps::ScanPoints;
use super::model_fit::{ModelFitter, ModelState};

/// A start with what speaks for it.
#[derive(Clone, Debug)]
pub struct StandingStart {
    /// Identity and pose after the coarsest levels.
    pub state: ModelState,
    /// Mean robust squared distance between body and scan, square metres.
    pub energy: f64,
    /// The energy of the best start that faces elsewhere, over this one's.
    pub margin: f64,
}

/// Turns that are tried beside the widest direction's two normals, degrees: the arms may be held askew.
const TURNS_DEG: [f64; 4] = [0.0, 180.0, 90.0, 270.0];
/// Distances beyond this count the same, metres.
const ROBUST_DISTANCE: f64 = 0.05;
/// Points that are compared.
const COMPARED_POINTS: usize = 1500;

/// A person whose facing is known, heading in radians about y (0 faces +z): the coarsest level from there.
pub fn facing_start(
    fitter: &ModelFitter<'_>,
    scan: &ScanPoints<'_>,
    heading: f64,
) -> Result<StandingStart, SolveError> {
    let mut state = upright(fitter, scan, heading);
    fitter.fit_level(0, &mut state, scan, &[])?;
    let energy = misfit(fitter, &state, scan);
    Ok(StandingStart { state, energy, margin: 1.0 })
}

/// Tries the facings and keeps the best; the scan is in metres, y up. `levels` is how many levels decide.
pub fn standing_start(
    fitter: &ModelFitter<'_>,
    scan: &ScanPoints<'_>,
    levels: usize,
) -> Result<StandingStart, SolveError> {
    let heading = widest_heading(scan.positions);
    let mut starts: Vec<StandingStart> = TURNS_DEG
        .par_iter()
        .map(|turn| {
            let mut state = upright(fitter, scan, heading + turn.to_radians());
            fitter.fit_level(0, &mut state, scan, &[])?;
            let energy = misfit(fitter, &state, scan);
            Ok(StandingStart { state, energy, margin: 1.0 })
        })
        .collect::<Result<_, SolveError>>()?;
    starts.sort_by(|a, b| a.energy.total_cmp(&b.energy));
    starts.truncate(2);
    let mut starts: Vec<StandingStart> = starts
        .into_par_iter()
        .map(|mut start| {
            for level in 1..levels.min(fitter.level_count()) {
                fitter.fit_level(level, &mut start.state, scan, &[])?;
            }
            start.energy = misfit(fitter, &start.state, scan);
            Ok(start)
        })
        .collect::<Result<_, SolveError>>()?;
    starts.sort_by(|a, b| a.energy.total_cmp(&b.energy));
    let margin = starts.get(1).map_or(f64::INFINITY, |other| other.energy / starts[0].energy.max(1e-12));
    Ok(StandingStart { margin, ..starts.swap_remove(0) })
}

/// The heading (radians about y, 0 faces +z) across the scan's widest horizontal direction.
fn widest_heading(points: &[DVec3]) -> f64 {
    let count = points.len().max(1) as f64;
    let mean = points.iter().copied().sum::<DVec3>() / count;
    let (mut xx, mut xz, mut zz) = (0.0, 0.0, 0.0);
    for point in points {
        let offset = *point - mean;
        xx += offset.x * offset.x;
        xz += offset.x * offset.z;
        zz += offset.z * offset.z;
    }
    // The widest direction is (cos a, 0, sin a); the body's own is +x when it faces +z, and turns by −a about y.
    -0.5 * (2.0 * xz).atan2(xx - zz)
}

/// The rest pose under this heading, scaled to the scan's stature by the first component, standing where the scan stands.
fn upright(fitter: &ModelFitter<'_>, scan: &ScanPoints<'_>, heading: f64) -> ModelState {
    let model = fitter.model();
    let mut state =
        ModelState { identity: Vec::new(), pose: model.skeleton().rest_pose().parameters().to_vec() };
    let turn = DQuat::from_rotation_y(heading);
    state.pose[3..6].copy_from_slice(&crate::body::rotation_vector(turn).to_array());
    let body = fitter.vertices(&state);
    let (low, high) = quantile_box(scan.positions);
    let (body_low, body_high) = quantile_box(&body);
    let target = (low + high) * 0.5 - (body_low + body_high) * 0.5;
    // Arms of different height shift the middle little; heads and feet decide the height.
    state.pose[..3].copy_from_slice(&target.to_array());
    state
}

/// A box that leaves out the few outermost points of each side: crumbs in the air.
fn quantile_box(points: &[DVec3]) -> (DVec3, DVec3) {
    const SHARE: f64 = 0.003;
    let mut bounds = [[0.0; 3]; 2];
    for axis in 0..3 {
        let mut values: Vec<f64> = points.iter().map(|point| point[axis]).collect();
        values.sort_by(f64::total_cmp);
        let cut = (SHARE * values.len() as f64) as usize;
        bounds[0][axis] = values.get(cut).copied().unwrap_or(0.0);
        bounds[1][axis] = values.get(values.len().saturating_sub(1 + cut)).copied().unwrap_or(0.0);
    }
    (DVec3::from_array(bounds[0]), DVec3::from_array(bounds[1]))
}

/// Mean robust squared distance, both ways.
fn misfit(fitter: &ModelFitter<'_>, state: &ModelState, scan: &ScanPoints<'_>) -> f64 {
    let vertices = fitter.vertices(state);
    let robust = |squared: f64| {
        let scale = ROBUST_DISTANCE * ROBUST_DISTANCE;
        squared * scale / (squared + scale)
    };
    let mean = |points: &[DVec3], index: &SurfaceIndex| {
        let stride = (points.len() / COMPARED_POINTS).max(1);
        let count = points.len().div_ceil(stride).max(1) as f64;
        points.iter().step_by(stride).map(|point| robust(index.closest(*point).distance_squared)).sum::<f64>()
            / count
    };
    let body = TriangleMesh::new(vertices.clone(), fitter.model().faces().to_vec());
    let from_scan = body.map_or(f64::INFINITY, |mesh| mean(scan.positions, &SurfaceIndex::of_mesh(&mesh)));
    mean(&vertices, scan.index) + from_scan
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_heading_is_across_the_widest_direction() {
        for heading in [-1.2_f64, 0.0, 0.4, 1.3] {
            let turn = DQuat::from_rotation_y(heading);
            let points: Vec<DVec3> = (0..100)
                .map(|k| turn * DVec3::new((f64::from(k) * 0.7).sin(), 0.0, 0.3 * (f64::from(k) * 1.1).cos()))
                .collect();
            let found = widest_heading(&points);
            let difference = (found - heading).sin();
            assert!(difference.abs() < 0.02, "{heading}: {found}");
        }
    }
}
