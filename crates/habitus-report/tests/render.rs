//! The rasteriser against laws: silhouette area, depth order, blending, thread independence.
#![expect(clippy::expect_used, reason = "test helpers stand outside test functions")]

mod capsule_person;

use std::f64::consts::{PI, TAU};

use capsule_person::{capsule_person, posed, walking_bones};
use glam::DVec3;
use habitus_report::render::{
    Camera, Color, ColorScale, Curve, Dot, Layer, Lighting, Paint, Projection, RenderError, Scene, View,
    contact_sheet, render, sequential_color,
};
use habitus_report::render::{Image, Panel};

const RED: Color = Color { red: 1.0, green: 0.0, blue: 0.0 };
const BLUE: Color = Color { red: 0.0, green: 0.0, blue: 1.0 };
const BLACK: Color = Color { red: 0.0, green: 0.0, blue: 0.0 };

fn unlit() -> Scene {
    Scene { lighting: Lighting::Unlit, background: BLACK, ..Scene::default() }
}

fn front_camera(visible_height: f64) -> Camera {
    let projection = Projection::Orthographic { visible_height };
    Camera { eye: DVec3::Z * 5.0, target: DVec3::ZERO, up: DVec3::Y, projection }
}

fn square(half: f64, depth: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let positions = corners.map(|[x, y]| DVec3::new(half * x, half * y, depth)).to_vec();
    (positions, vec![[0, 1, 2], [0, 2, 3]])
}

fn sphere(radius: f64, sides: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let rings = sides / 2;
    let positions = (0..=rings)
        .flat_map(|ring| (0..sides).map(move |k| (ring, k)))
        .map(|(ring, k)| {
            let (sin, cos) = (PI * f64::from(ring) / f64::from(rings)).sin_cos();
            let (side, depth) = (TAU * f64::from(k) / f64::from(sides)).sin_cos();
            radius * DVec3::new(sin * side, cos, sin * depth)
        })
        .collect();
    let faces = (0..rings)
        .flat_map(|ring| (0..sides).map(move |k| (ring * sides, k, (k + 1) % sides)))
        .flat_map(|(r, k, n)| [[r + k, r + sides + k, r + sides + n], [r + k, r + sides + n, r + n]])
        .collect();
    (positions, faces)
}

/// Sum of linear red over all pixels: the covered area of a full red shape, with partly covered pixels counted as parts.
fn covered_pixels(image: &Image) -> f64 {
    image.pixels().iter().map(|[r, g, b]| f64::from(Color::from_srgb(*r, *g, *b).red)).sum()
}

#[test]
fn silhouette_area_of_a_sphere_is_that_of_its_disc() {
    let (positions, faces) = sphere(0.4, 256);
    let scene = Scene { layers: vec![Layer::opaque(positions, faces, Paint::Uniform(RED))], ..unlit() };
    let image = render(&scene, &front_camera(1.0), 500, 400).expect("picture");
    let expected = PI * (0.4f64 * 400.0).powi(2);
    let relative = covered_pixels(&image) / expected - 1.0;
    // 2 × 2 samples over a 1,005-pixel outline leave an error far below 1/1000; a pixel of radius would be 12/1000.
    assert!(relative.abs() < 1e-3, "relative error {relative}");
}

#[test]
fn perspective_shrinks_the_silhouette_by_distance() {
    let half_angle = 0.2f64;
    let projection = Projection::Perspective { vertical_angle: 2.0 * half_angle };
    let side = |depth: f64| {
        let (positions, faces) = square(0.1, depth);
        let scene = Scene { layers: vec![Layer::opaque(positions, faces, Paint::Uniform(RED))], ..unlit() };
        let camera = Camera { eye: DVec3::Z * 4.0, target: DVec3::ZERO, up: DVec3::Y, projection };
        covered_pixels(&render(&scene, &camera, 400, 400).expect("picture")).sqrt()
    };
    for depth in [0.0, 2.0] {
        let expected = 0.2 / (2.0 * (4.0 - depth) * half_angle.tan()) * 400.0;
        // Half a sample at each border.
        assert!((side(depth) - expected).abs() < 0.5, "{} against {expected}", side(depth));
    }
}

#[test]
fn nearer_surfaces_hide_farther_ones_in_any_layer_order() {
    let near = square(0.3, 0.5);
    let far = square(0.3, -0.5);
    let layer = |(positions, faces), color| Layer::opaque(positions, faces, Paint::Uniform(color));
    for layers in
        [vec![layer(near.clone(), RED), layer(far.clone(), BLUE)], vec![layer(far, BLUE), layer(near, RED)]]
    {
        let image = render(&Scene { layers, ..unlit() }, &front_camera(1.0), 64, 64).expect("picture");
        assert_eq!(image.pixel(32, 32), Some([255, 0, 0]));
    }
}

#[test]
fn translucent_layers_blend_back_to_front_in_linear_light() {
    let layer = |depth, color, opacity| {
        let (positions, faces) = square(0.3, depth);
        Layer::translucent(positions, faces, Paint::Uniform(color), opacity)
    };
    let white = Color { red: 1.0, green: 1.0, blue: 1.0 };
    let (positions, faces) = square(0.3, -1.0);
    let back = Layer::opaque(positions, faces, Paint::Uniform(white));
    let (hidden, far, near) = (layer(-2.0, BLUE, 0.9), layer(0.0, BLUE, 0.5), layer(1.0, RED, 0.25));
    let expected = white.mix(BLUE, 0.5).mix(RED, 0.25).to_srgb();
    for layers in
        [vec![back.clone(), near.clone(), far.clone(), hidden.clone()], vec![hidden, far, near, back]]
    {
        let image = render(&Scene { layers, ..unlit() }, &front_camera(1.0), 64, 64).expect("picture");
        assert_eq!(image.pixel(32, 32), Some(expected));
    }
}

#[test]
fn only_the_nearest_sheet_of_a_translucent_layer_counts() {
    let (mut positions, mut faces) = square(0.3, 0.0);
    let (behind, _) = square(0.3, -0.2);
    positions.extend(behind);
    faces.extend([[4, 5, 6], [4, 6, 7]]);
    let layer = Layer::translucent(positions, faces, Paint::Uniform(RED), 0.5);
    let image =
        render(&Scene { layers: vec![layer], ..unlit() }, &front_camera(1.0), 64, 64).expect("picture");
    assert_eq!(image.pixel(32, 32), Some(BLACK.mix(RED, 0.5).to_srgb()));
}

fn person_scene() -> Scene {
    let body = capsule_person(0.0, 24);
    let capture = capsule_person(0.03, 20);
    let bones = walking_bones(0.9);
    let heat = body.positions.iter().map(|p| ColorScale::CLEARANCE.color(100.0 * p.x + 30.0)).collect();
    let ring = (0..40).map(|k| {
        let (sin, cos) = (TAU * f64::from(k) / 40.0).sin_cos();
        DVec3::new(0.19 * cos, 1.25, 0.09 + 0.19 * sin)
    });
    let cloth = Paint::Uniform(Color::from_srgb(120, 150, 190));
    Scene {
        layers: vec![
            Layer::opaque(posed(&body, &bones), body.faces.clone(), Paint::PerVertex(heat)),
            Layer::translucent(posed(&capture, &bones), capture.faces.clone(), cloth, 0.3),
        ],
        curves: vec![Curve { points: ring.collect(), is_closed: true, color: RED, radius: 0.004 }],
        dots: vec![Dot { position: DVec3::new(0.0, 1.62, 0.22), color: RED, radius: 0.015 }],
        ground_height: Some(0.0),
        ..Scene::default()
    }
}

fn person_picture(yaw: f64) -> Image {
    let scene = person_scene();
    let camera = scene.camera(View::from_degrees(yaw, 12.0), 0.6);
    render(&scene, &camera, 300, 500).expect("picture")
}

#[test]
fn pixels_are_the_same_on_one_thread_and_on_two() {
    let on_threads = |count| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("pool");
        pool.install(|| person_picture(25.0))
    };
    assert!(on_threads(1) == on_threads(2));
}

#[test]
fn framing_shows_the_whole_box_and_fills_the_picture() {
    let (positions, faces) = sphere(0.7, 64);
    let layer = Layer::opaque(positions, faces, Paint::Uniform(RED));
    for view in [View::from_degrees(30.0, 20.0), View::from_degrees(200.0, -10.0).orthographic()] {
        let scene = Scene { layers: vec![layer.clone()], ..unlit() };
        let camera = Camera::framing(scene.bounds(), view, 1.0);
        let image = render(&scene, &camera, 200, 200).expect("picture");
        let exact = render(&scene, &scene.camera(view, 1.0), 200, 200).expect("picture");
        // The disc touches the 4 % margin: 92 % of the side across.
        let expected = PI * (0.46f64 * 200.0).powi(2);
        assert!(
            (covered_pixels(&exact) / expected - 1.0).abs() < 0.02,
            "{}",
            covered_pixels(&exact) / expected
        );
        let border = (0..200).flat_map(|i| [(i, 0), (i, 199), (0, i), (199, i)]);
        assert!(border.into_iter().all(|(x, y)| image.pixel(x, y) == Some([0, 0, 0])));
        // The box of a sphere seen from a corner is √3 wide at most, so the disc fills at least a third of each side.
        assert!(covered_pixels(&image) > PI * (200.0f64 / 6.0).powi(2));
    }
}

#[test]
fn heat_map_lightness_rises_evenly() {
    // Rec. 709 luminance to CIE lightness: the steps of the sequential map stay near equal.
    let lightness = |color: Color| {
        let y = 0.2126 * color.red + 0.7152 * color.green + 0.0722 * color.blue;
        116.0 * f64::from(y).cbrt() - 16.0
    };
    let steps: Vec<f64> = (0..16)
        .map(|i| {
            lightness(sequential_color(f64::from(i + 1) / 16.0))
                - lightness(sequential_color(f64::from(i) / 16.0))
        })
        .collect();
    let mean = steps.iter().sum::<f64>() / 16.0;
    // OKLab and CIE lightness differ by up to a third in slope for strong colours.
    assert!(steps.iter().all(|step| (step / mean - 1.0).abs() < 0.4), "{steps:?}");
}

#[test]
fn unusable_input_is_refused_with_its_place() {
    let (positions, _) = square(0.3, 0.0);
    let face = Layer::opaque(positions.clone(), vec![[0, 1, 9]], Paint::Uniform(RED));
    let scene = Scene { layers: vec![face], ..unlit() };
    let error = render(&scene, &front_camera(1.0), 8, 8).expect_err("face 0 names vertex 9");
    assert!(matches!(error, RenderError::FaceOutOfRange { layer: 0, face: 0, vertex: 9, vertex_count: 4 }));
    let colors = Layer::opaque(positions, vec![[0, 1, 2]], Paint::PerVertex(vec![RED; 3]));
    let scene = Scene { layers: vec![colors], ..unlit() };
    assert!(matches!(
        render(&scene, &front_camera(1.0), 8, 8),
        Err(RenderError::ColorCount { layer: 0, color_count: 3, vertex_count: 4 })
    ));
    assert!(matches!(render(&unlit(), &front_camera(1.0), 0, 8), Err(RenderError::Size { .. })));
}

#[test]
fn vertices_that_are_not_finite_leave_only_their_faces_out() {
    let (mut positions, faces) = square(0.3, 0.0);
    positions[1] = DVec3::NAN;
    let layer = Layer::opaque(positions, faces, Paint::Uniform(RED));
    let image =
        render(&Scene { layers: vec![layer], ..unlit() }, &front_camera(1.0), 64, 64).expect("picture");
    assert_eq!(image.pixel(24, 24), Some([255, 0, 0]));
    assert_eq!(image.pixel(44, 44), Some([0, 0, 0]));
}

#[test]
fn a_sheet_of_pictures_survives_the_png_round_trip() {
    let panels =
        [0.0, 90.0, 180.0].map(|yaw| Panel { caption: format!("yaw {yaw} deg"), image: person_picture(yaw) });
    let sheet = contact_sheet(&panels, 3).expect("sheet");
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("sheet.png");
    sheet.save_png(&path).expect("written");
    let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(&path).expect("file")));
    let mut reader = decoder.read_info().expect("header");
    let mut bytes = vec![0; reader.output_buffer_size().expect("size")];
    reader.next_frame(&mut bytes).expect("pixels");
    assert!(bytes == sheet.pixels().as_flattened());
    if let Some(folder) = option_env!("HABITUS_TEST_PICTURES") {
        sheet.save_png(&std::path::Path::new(folder).join("sheet.png")).expect("written");
        let legend = ColorScale::CLEARANCE.legend(300, 36).expect("legend");
        legend.save_png(&std::path::Path::new(folder).join("legend.png")).expect("written");
    }
}
