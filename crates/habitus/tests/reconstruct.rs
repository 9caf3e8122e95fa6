//! P1 §6: front and back depth images of one tightly dressed person, who moves between them, give the body.

use glam::{DQuat, DVec3};
use habitus::artifacts::depth_image::{DepthImage, Intrinsics};
use habitus::body::{BodyModel, PartLabel};
use habitus::geometry::vertex_normals;
use habitus::optimize::Silent;
use habitus::stages::reconstruct::{PartialView, ReconstructConfig, ReconstructedBody, Side, reconstruct};
use habitus::statistics::{RandomStream, align_to};
use habitus_synthetic::depth_map::{Camera, DepthMap};
use habitus_synthetic::source_bodies::source_body;

const WIDTH: usize = 288;
const HEIGHT: usize = 320;
const FOCAL: f64 = 252.0;

/// The depth image of a person in a suit of 3 mm, at 2.3 m, with noise.
fn depth_image(model: &BodyModel, rest: &[DVec3], side: Side, stream: &mut RandomStream) -> DepthImage {
    let mut pose = model.skeleton().rest_pose();
    for (angle, axis) in pose.parameters_mut()[6..].iter_mut().zip(model.skeleton().axes()) {
        *angle = (0.1 * stream.normal()).clamp(axis.limits[0], axis.limits[1]);
    }
    let turn = if side == Side::Front { 0.0 } else { std::f64::consts::PI } + 0.08 * stream.normal();
    let joints = model.joints(rest);
    pose.set_root(DQuat::from_rotation_y(turn), DVec3::new(0.02, 0.9, -2.3) - joints[0]);
    let posed = model.pose_vertices(rest, &model.skeleton().pose(&joints, pose.parameters()));
    let middle = 0.5
        * (posed.iter().map(|v| v.y).fold(f64::MAX, f64::min)
            + posed.iter().map(|v| v.y).fold(f64::MIN, f64::max));
    let normals = vertex_normals(&posed, model.faces());
    let suited: Vec<DVec3> = posed
        .iter()
        .zip(normals)
        .zip(model.part_labels())
        .map(|((vertex, normal), label)| {
            let thickness = if *label == PartLabel::Covered { 0.003 } else { 0.0 };
            *vertex + normal * thickness - DVec3::Y * middle
        })
        .collect();
    let camera = Camera::looking_at(DVec3::ZERO, DVec3::NEG_Z, FOCAL, WIDTH, HEIGHT);
    let map = DepthMap::render(camera, &[(&suited, model.faces())]);
    let depths = map.inverse_depth.iter().map(|inverse| {
        if *inverse <= 0.0 {
            return 0;
        }
        let depth = 1.0 / f64::from(*inverse);
        (1000.0 * depth + 0.8 * depth * depth * stream.normal()).round() as u16
    });
    let (cx, cy) = (WIDTH as f64 / 2.0, HEIGHT as f64 / 2.0);
    DepthImage {
        depths: depths.collect(),
        intrinsics: Intrinsics {
            width: WIDTH,
            height: HEIGHT,
            fx: FOCAL,
            fy: FOCAL,
            cx,
            cy,
            depth_scale: 0.001,
        },
    }
}

fn rest_error_mm(found: &ReconstructedBody, truth: &[DVec3]) -> f64 {
    let mut rest: Vec<f64> = found.rest_vertices.iter().flat_map(|v| v.to_array()).collect();
    align_to(&mut rest, truth);
    let distances = rest.chunks_exact(3).zip(truth).map(|(x, y)| DVec3::from_slice(x).distance(*y));
    1000.0 * distances.sum::<f64>() / truth.len() as f64
}

#[test]
fn two_depth_images_give_the_rest_body_within_twelve_millimetres() {
    let model = BodyModel::default_space().expect("is embedded");
    let config = ReconstructConfig::default();
    let mut errors = Vec::new();
    for subject in 0..4 {
        let rest = source_body(&model, subject).expect("is embedded");
        let mut stream = RandomStream::named(2, &format!("depth of {subject}"));
        let views: Vec<PartialView> = [Side::Front, Side::Back]
            .map(|side| {
                let image = depth_image(&model, &rest, side, &mut stream);
                PartialView::of_depth(side, &image, &config).expect("shows a person")
            })
            .into();
        let found = reconstruct(&views, &model, &config, &mut Silent).expect("fits");
        let front_alone = reconstruct(&views[..1], &model, &config, &mut Silent).expect("fits");
        assert_eq!(found.identity.len(), model.component_count(), "local shapes are no part of it");
        let (both, alone) = (rest_error_mm(&found, &rest), rest_error_mm(&front_alone, &rest));
        println!(
            "subject {subject}: both {both:.1} mm, front alone {alone:.1} mm, residual {:.1} mm",
            1000.0 * found.residuals[0]
        );
        errors.push(both);
    }
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    println!("mean {mean:.1} mm");
    assert!(mean <= 12.0, "mean vertex error of the rest bodies is {mean} mm");
}

#[test]
fn an_empty_image_is_refused_by_its_side() {
    let (cx, cy) = (1.0, 1.0);
    let intrinsics = Intrinsics { width: 2, height: 2, fx: 1.0, fy: 1.0, cx, cy, depth_scale: 0.001 };
    let image = DepthImage { intrinsics, depths: vec![0; 4] };
    let error = PartialView::of_depth(Side::Back, &image, &ReconstructConfig::default());
    let message = error.err().expect("is refused").to_string();
    assert!(message.contains("back") && message.contains("depth_range"), "{message}");
}
