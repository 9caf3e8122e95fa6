//! Laws of the surface: linear in the identity, joints that follow the shape, consistent parts.

use glam::DVec3;

use crate::body::fixture;

const IDENTITY: [f64; 6] = [0.8, -1.2, 0.5, 2.0, -0.3, 1.1];

#[test]
fn skin_weights_sum_to_one() {
    let model = fixture::model();
    for vertex in 0..model.vertex_count() {
        let sum: f64 = model.surface().skin().of(vertex).map(|(_, weight)| weight).sum();
        assert!((sum - 1.0).abs() < 1e-14);
    }
}

#[test]
fn joints_follow_the_shape() {
    let model = fixture::model();
    let rest = model.rest_vertices(&IDENTITY);
    let by_regressor = model.joints(&rest);
    let by_map = model.surface().rest_joints(&IDENTITY);
    for (a, b) in by_regressor.iter().zip(&by_map) {
        // The instance is summed in f32 (eight lanes), the map in f64.
        assert!(a.distance(*b) < 1e-7);
    }
    let moved = by_map.iter().zip(&model.surface().joint_map().mean).any(|(a, b)| a.distance(*b) > 0.01);
    assert!(moved, "a taller body has other joints");
}

#[test]
fn the_joints_of_the_figure_are_where_its_tubes_begin() {
    let model = fixture::model();
    let joints = model.joints(model.mean_vertices());
    for tube in fixture::TUBES {
        let expected = if tube.bone == 0 { 0.5 * (tube.start + tube.end) } else { tube.start };
        assert!(joints[tube.bone].distance(expected) < 1e-6);
    }
}

#[test]
fn the_body_is_linear_in_the_identity() {
    let model = fixture::model();
    let mean = model.mean_vertices().to_vec();
    let whole = model.rest_vertices(&IDENTITY);
    let mut sum = mean.clone();
    for (component, coefficient) in IDENTITY.iter().enumerate() {
        let mut unit = vec![0.0; component + 1];
        unit[component] = 1.0;
        for ((total, one), mean) in sum.iter_mut().zip(model.rest_vertices(&unit)).zip(&mean) {
            *total += (one - *mean) * *coefficient;
        }
    }
    let worst = whole.iter().zip(&sum).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    assert!(worst < 1e-6, "f32 basis, metre-sized sums: {worst}");
}

#[test]
fn one_deviation_has_the_stated_size() {
    let model = fixture::model();
    for (component, deviation) in model.standard_deviations().iter().enumerate() {
        let mut unit = vec![0.0; component + 1];
        unit[component] = 1.0;
        let norm: f64 = model
            .rest_vertices(&unit)
            .iter()
            .zip(model.mean_vertices())
            .map(|(a, b)| a.distance_squared(*b))
            .sum::<f64>()
            .sqrt();
        assert!((norm / deviation - 1.0).abs() < 1e-3, "the basis is stored in f16: {norm} for {deviation}");
    }
}

#[test]
fn a_truncated_surface_is_the_whole_one_with_zeros() {
    let surface = fixture::model().surface().clone();
    for kept in [0, 1, 4, 6, 9] {
        let truncated = surface.truncated(kept);
        assert_eq!(truncated.component_count(), kept.min(6));
        let used = &IDENTITY[..kept.min(6)];
        assert_eq!(truncated.rest_joints(&IDENTITY), surface.rest_joints(used));
        let (a, b) = (truncated.rest_vertices(&IDENTITY), surface.rest_vertices(used));
        assert!(a.iter().zip(&b).all(|(a, b)| a.distance(*b) < 1e-6));
        assert_eq!(truncated.mean_vertices(), surface.mean_vertices());
    }
}

#[test]
fn a_subset_moves_as_in_the_whole() {
    let model = fixture::model();
    let surface = model.surface();
    let vertices: Vec<u32> = (0..model.vertex_count() as u32).step_by(7).collect();
    let subset = surface.subset(&vertices);
    assert_eq!(subset.vertex_count(), vertices.len());
    let pose: Vec<f64> = (0..30).map(|k| 0.3 * (k as f64).sin()).collect();
    let posed = surface.skeleton().pose(&surface.rest_joints(&IDENTITY), &pose);
    assert_eq!(subset.rest_joints(&IDENTITY), surface.rest_joints(&IDENTITY));
    let whole = surface.skin_vertices(&surface.rest_vertices(&IDENTITY), &posed);
    let part = subset.skin_vertices(&subset.rest_vertices(&IDENTITY), &posed);
    for (index, vertex) in vertices.iter().enumerate() {
        assert_eq!(part[index], whole[*vertex as usize]);
        let (a, b) =
            (subset.blended_rotation(index, &posed), surface.blended_rotation(*vertex as usize, &posed));
        assert_eq!(a, b);
    }
}

#[test]
fn the_mirror_map_is_an_involution_that_mirrors_the_mean() {
    let model = fixture::model();
    let mirror = model.mirror_vertices();
    for (vertex, image) in mirror.iter().enumerate() {
        assert_eq!(mirror[*image as usize] as usize, vertex);
        let position = model.mean_vertices()[vertex];
        let reflected = DVec3::new(-position.x, position.y, position.z);
        assert!(reflected.distance(model.mean_vertices()[*image as usize]) < 1e-6);
    }
}

#[test]
fn dominant_bones_are_the_heaviest() {
    let model = fixture::model();
    for (vertex, dominant) in model.dominant_bones().into_iter().enumerate() {
        let heaviest = model.surface().skin().of(vertex).map(|(_, weight)| weight).fold(0.0, f64::max);
        assert!(model.surface().skin().of(vertex).any(|pair| pair == (dominant, heaviest)));
    }
}
