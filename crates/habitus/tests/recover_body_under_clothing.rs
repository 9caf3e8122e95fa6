//! Known truth: a synthetic person, dressed and captured, is found again under the clothes, and what is no person is
//! never passed off as one.
#![allow(clippy::expect_used, clippy::print_stdout, reason = "a test may fail loudly")]

use std::sync::LazyLock;

use glam::DVec3;
use habitus::artifacts::codes::Code;
use habitus::artifacts::fitted_sequence::FittedSequence;
use habitus::artifacts::frames::FramesInMemory;
use habitus::body::BodyModel;
use habitus::evaluation::sequence_accuracy::SequenceAccuracy;
use habitus::geometry::{PointCloud, Surface, TriangleMesh};
use habitus::stages::fit_sequence::config::{Recipe, RefineConfig, SurfaceConfig};
use habitus::stages::fit_sequence::{FitSequenceConfig, FitSequenceError};
use habitus_synthetic::capture::CaptureSettings;
use habitus_synthetic::garment::Outfit;
use habitus_synthetic::sequence::{DressedSequence, DressedSequenceSettings};

mod dressed_person;
mod random;
use dressed_person::{accuracy, captures, dressed, fit, model};
use random::Random;

static MODEL: LazyLock<BodyModel> = LazyLock::new(model);
static DRESS: LazyLock<DressedSequence> = LazyLock::new(|| person(Outfit::Dress, 1.0));
static DRESS_FIT: LazyLock<FittedSequence> = LazyLock::new(|| fitted(&DRESS, &FitSequenceConfig::default()));

/// A quarter of a second of a source body that walks and turns. Voxels of 16 mm still show fingers and feet below a hem;
/// the coarser ones of the tiny settings do not for every person.
fn person(outfit: Outfit, noise_mm: f64) -> DressedSequence {
    let tiny = DressedSequenceSettings::tiny();
    let capture = CaptureSettings { noise_mm, voxel_mm: 16.0, ..tiny.capture };
    let settings = DressedSequenceSettings { outfit, capture, source_body: 1, frame_count: 8, ..tiny };
    dressed(&MODEL, &settings)
}

fn fitted(sequence: &DressedSequence, config: &FitSequenceConfig) -> FittedSequence {
    fit(&captures(sequence), &MODEL, config).expect("a person can be fitted")
}

fn errors(name: &str, fitted: &FittedSequence, sequence: &DressedSequence) -> SequenceAccuracy {
    let errors = accuracy(&MODEL, fitted, sequence);
    println!("{name}: {errors:?}");
    for frame in &fitted.frames {
        println!("  {}: outside {:.4}, codes {:?}", frame.name, frame.outside_share_5mm, frame.codes);
    }
    errors
}

/// What the fit must reach, in millimetres: about half as much again as was measured when the promise was made, so that
/// another order of sums or another weight passes and a wrong sign, a lost part of the energy or a swapped limb does not.
/// A quarter of a second of a skirt says little about the hips under it: girths are promised last and least.
struct Promise {
    posed: f64,
    rest: f64,
    joints: f64,
    stature: f64,
    girths: f64,
}

impl Promise {
    fn assert_kept(&self, errors: &SequenceAccuracy) {
        let pairs = [
            ("posed", errors.posed_mean_mm, self.posed),
            ("rest", errors.rest_mean_mm, self.rest),
            ("joints", errors.mpjpe_mm, self.joints),
            ("stature", errors.stature_error_mm, self.stature),
            ("girths", errors.girth_mean_error_mm, self.girths),
        ];
        for (what, found, promised) in pairs {
            assert!(found < promised, "{what}: {found:.1} mm, promised below {promised} mm");
        }
    }
}

fn assert_no_failure(fitted: &FittedSequence) {
    for frame in &fitted.frames {
        assert!(frame.is_ok(), "{}: {:?}", frame.name, frame.codes);
    }
    assert!(!fitted.codes.contains(&Code::NotAPerson));
}

/// Voxels of 16 mm swallow fingers and leave shreds of hem, so that a frame or two of a right fit may raise an alarm; a
/// sequence that is lost raises it everywhere.
fn assert_few_alarms(fitted: &FittedSequence) {
    let alarms = fitted.frames.iter().filter(|frame| !frame.is_ok()).count();
    assert!(alarms <= 2, "{alarms} of {} frames", fitted.frames.len());
    assert!(!fitted.codes.contains(&Code::NotAPerson));
}

#[test]
fn a_person_in_a_dress_is_recovered() {
    assert_few_alarms(&DRESS_FIT);
    let errors = errors("dress, noise 1 mm", &DRESS_FIT, &DRESS);
    Promise { posed: 20.0, rest: 30.0, joints: 24.0, stature: 20.0, girths: 60.0 }.assert_kept(&errors);
}

#[test]
fn noise_of_three_millimetres_is_survived() {
    let sequence = person(Outfit::Dress, 3.0);
    let fitted = fitted(&sequence, &FitSequenceConfig::default());
    assert_few_alarms(&fitted);
    let errors = errors("dress, noise 3 mm", &fitted, &sequence);
    // Noise on 16 mm voxels turns normals by up to a right angle, and pairs are lost to the angle rule.
    Promise { posed: 25.0, rest: 50.0, joints: 30.0, stature: 20.0, girths: 90.0 }.assert_kept(&errors);
}

#[test]
fn a_tightly_dressed_person_is_recovered_better_than_a_loosely_dressed_one() {
    let tight = person(Outfit::Tight, 1.0);
    let tight_fit = fitted(&tight, &FitSequenceConfig::default());
    assert_no_failure(&tight_fit);
    let (tight, loose) = (errors("tight", &tight_fit, &tight), errors("dress", &DRESS_FIT, &DRESS));
    Promise { posed: 8.0, rest: 12.0, joints: 7.0, stature: 10.0, girths: 21.0 }.assert_kept(&tight);
    assert!(tight.posed_mean_mm < loose.posed_mean_mm);
    assert!(tight.rest_mean_mm < loose.rest_mean_mm);
    assert!(tight.mpjpe_mm < loose.mpjpe_mm);
}

/// Volume of a closed mesh in cubic metres.
fn volume(vertices: &[DVec3], faces: &[[u32; 3]]) -> f64 {
    faces
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|vertex| vertices[vertex as usize]);
            a.dot(b.cross(c)) / 6.0
        })
        .sum()
}

/// The default recipe with inside and outside treated alike: what P2 §4.5 warns of.
fn symmetric() -> FitSequenceConfig {
    let surface = SurfaceConfig::default();
    let weight = surface.outside_weight;
    let scale = surface.outside_scale;
    FitSequenceConfig {
        surface: SurfaceConfig { inside_weight: weight, inside_scale: scale, ..surface },
        refine: RefineConfig {
            contact_weight: weight,
            contact_scale: [scale; 2],
            // Every frame attracts a vertex, however far the cloth is there.
            clearance_tolerance: 10.0,
            ..RefineConfig::default()
        },
        ..FitSequenceConfig::default()
    }
}

#[test]
fn the_body_is_inside_the_clothes_and_not_fatter_than_a_symmetric_fit() {
    let symmetric = fitted(&DRESS, &symmetric());
    let of = |vertices: &[DVec3]| volume(vertices, MODEL.faces());
    let truth = of(&DRESS.rest_vertices);
    let (one_sided, both_sided) = (of(&DRESS_FIT.rest_vertices), of(&symmetric.rest_vertices));
    println!("volume: truth {truth:.4}, one-sided {one_sided:.4}, symmetric {both_sided:.4} m³");
    errors("symmetric", &symmetric, &DRESS);
    assert!(one_sided < both_sided);
    for frame in &DRESS_FIT.frames {
        assert!(frame.outside_share_5mm < 0.05, "{}: {}", frame.name, frame.outside_share_5mm);
    }
}

#[test]
fn the_recipe_of_the_paper_gives_a_body_too() {
    let config = FitSequenceConfig { recipe: Recipe::Paper2016, ..FitSequenceConfig::default() };
    let fitted = fitted(&DRESS, &config);
    let errors = errors("paper2016", &fitted, &DRESS);
    // Not its accuracy, which docs compare, but its sanity: a swapped limb or a wrong unit costs far more.
    Promise { posed: 60.0, rest: 90.0, joints: 80.0, stature: 80.0, girths: 150.0 }.assert_kept(&errors);
}

fn mesh(positions: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Surface {
    Surface::Mesh(TriangleMesh::new(positions, faces).expect("a mesh"))
}

/// A closed surface from a grid over the sphere, its radius given for each direction.
fn blob(mut radius: impl FnMut(DVec3) -> f64) -> Surface {
    const RINGS: u32 = 40;
    const AROUND: u32 = 60;
    let mut positions = Vec::new();
    for ring in 0..RINGS {
        for step in 0..AROUND {
            let polar = std::f64::consts::PI * (f64::from(ring) + 0.5) / f64::from(RINGS);
            let angle = std::f64::consts::TAU * f64::from(step) / f64::from(AROUND);
            let direction = DVec3::new(polar.sin() * angle.sin(), polar.cos(), polar.sin() * angle.cos());
            positions.push(direction * radius(direction));
        }
    }
    let mut faces = Vec::new();
    for ring in 0..RINGS - 1 {
        for step in 0..AROUND {
            let (here, next) = (ring * AROUND + step, ring * AROUND + (step + 1) % AROUND);
            faces.push([here, here + AROUND, next]);
            faces.push([next, here + AROUND, next + AROUND]);
        }
    }
    mesh(positions, faces)
}

fn outcome(surfaces: Vec<Surface>) -> Result<FittedSequence, FitSequenceError> {
    let result = fit(&FramesInMemory { surfaces }, &MODEL, &FitSequenceConfig::default());
    match &result {
        Ok(fitted) => {
            println!("codes {:?}", fitted.codes);
            for frame in &fitted.frames {
                println!("  {}: ok {}, {:?}", frame.name, frame.is_ok(), frame.codes);
            }
        }
        Err(error) => println!("error: {error}"),
    }
    result
}

fn is_refused(outcome: &Result<FittedSequence, FitSequenceError>) -> bool {
    outcome.as_ref().map_or(true, |fitted| {
        fitted.codes.contains(&Code::NotAPerson) || fitted.frames.iter().all(|frame| !frame.is_ok())
    })
}

#[test]
fn a_cube_is_no_person() {
    let side = |direction: DVec3| 0.85 / direction.abs().max_element();
    assert!(is_refused(&outcome(vec![blob(side), blob(side)])));
}

#[test]
fn a_blob_of_noise_is_no_person() {
    let mut random = Random::new(5);
    assert!(is_refused(&outcome(vec![blob(|_| 0.6 + 0.3 * random.unit())])));
}

#[test]
fn scattered_points_are_no_person() {
    let mut random = Random::new(6);
    let positions: Vec<DVec3> = (0..5000).map(|_| 0.9 * random.direction()).collect();
    let normals: Vec<DVec3> = (0..5000).map(|_| random.direction().normalize()).collect();
    let cloud = PointCloud::new(positions, Some(normals)).expect("a cloud");
    assert!(is_refused(&outcome(vec![Surface::Cloud(cloud)])));
}

#[test]
fn one_point_and_one_triangle_are_errors() {
    let cloud = PointCloud::new(vec![DVec3::ONE], Some(vec![DVec3::Y])).expect("a cloud");
    let point = outcome(vec![Surface::Cloud(cloud)]);
    assert!(matches!(point, Err(FitSequenceError::TooLittleSurface { found: 1, .. })));
    let triangle = outcome(vec![mesh(DVec3::AXES.to_vec(), vec![[0, 1, 2]])]);
    assert!(matches!(triangle, Err(FitSequenceError::TooLittleSurface { found: 1, .. })));
    assert!(matches!(outcome(Vec::new()), Err(FitSequenceError::NoUsableFrame)));
}

#[test]
fn two_people_are_marked_in_every_frame() {
    let both = |frame: usize| {
        let capture = &DRESS.frames[frame].capture;
        let count = capture.positions().len() as u32;
        let beside = capture.positions().iter().map(|point| *point + DVec3::new(1.0, 0.0, 0.3));
        let positions = capture.positions().iter().copied().chain(beside).collect();
        let faces = capture.faces();
        let others = faces.iter().map(|face| face.map(|vertex| vertex + count));
        mesh(positions, faces.iter().copied().chain(others).collect())
    };
    let outcome = outcome((0..3).map(both).collect());
    assert!(
        outcome.is_err() || outcome.is_ok_and(|fitted| fitted.frames.iter().all(|f| !f.codes.is_empty()))
    );
}

#[test]
fn a_broken_frame_is_marked_and_the_others_survive() {
    let mut source = captures(&DRESS);
    source.surfaces.truncate(4);
    source.surfaces[2] = mesh(DVec3::AXES.to_vec(), vec![[0, 1, 2]]);
    let fitted = fit(&source, &MODEL, &FitSequenceConfig::default()).expect("the others can be fitted");
    assert_eq!(fitted.frames.len(), 4);
    assert_eq!(fitted.frames[2].codes, [Code::UnreadableFrame]);
    for frame in [0, 1, 3] {
        assert!(fitted.frames[frame].is_ok(), "{:?}", fitted.frames[frame].codes);
    }
}
