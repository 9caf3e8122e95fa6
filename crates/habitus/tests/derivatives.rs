//! Every term over every deformer it may meet: its derivatives follow from its values, to 1e-6.
//!
//! A formula stands once, in the residual; what a deformer may get wrong is how a vertex moves with a parameter. The table
//! below therefore pairs each term with each deformer, once through the batched kernels and once through the plain form.
#![allow(clippy::expect_used, clippy::panic, reason = "a test may fail loudly")]

use glam::DVec3;
use habitus::body::{BodyModel, BodySurface};
use habitus::fitting::correspondence::Correspondence;
use habitus::fitting::deformers::{BodyParameters, FreeParameters, VertexAffines};
use habitus::fitting::terms::{
    AffineMetric, ClosestPoints, DistanceForm, InsideClothing, LandmarkPull, LandmarkTargets, SmoothAffines,
    StayNear,
};
use habitus::fitting::{DeformedSurface, Deformer, DerivativeColumns, Fit, Term};
use habitus::optimize::{
    Gradient, NormalEquations, ValueSum, assert_derivatives_match, assert_same_contributions,
    derivative_mismatch,
};

mod random;
use random::Random;

/// Vertices of the small body for each bone, from near its joint to far from it.
const VERTICES_PER_BONE: usize = 4;
const COMPONENT_COUNT: usize = 5;
/// Vertices of the freely bent surface: each has twelve parameters, and the checks are dense.
const AFFINE_VERTEX_COUNT: usize = 9;

fn small_body() -> BodySurface {
    let model = BodyModel::default_space().expect("the embedded model is valid");
    let dominant = model.dominant_bones();
    let vertices: Vec<u32> = (0..model.skeleton().bones().len())
        .flat_map(|bone| {
            let own: Vec<u32> =
                (0..dominant.len()).filter(|v| dominant[*v] == bone).map(|v| v as u32).collect();
            (0..VERTICES_PER_BONE).map(move |k| own[k * own.len() / VERTICES_PER_BONE])
        })
        .collect();
    model.surface().truncated(COMPONENT_COUNT).subset(&vertices)
}

/// The same deformer without its batched kernels, its derivatives multiplied by a factor.
struct Plain<'a> {
    deformer: &'a dyn Deformer,
    derivative_factor: f64,
}

impl Deformer for Plain<'_> {
    fn parameter_count(&self) -> usize {
        self.deformer.parameter_count()
    }

    fn deform<'a>(&'a self, parameters: &'a [f64]) -> Box<dyn DeformedSurface + 'a> {
        let surface = self.deformer.deform(parameters);
        Box::new(PlainSurface { surface, derivative_factor: self.derivative_factor })
    }
}

struct PlainSurface<'a> {
    surface: Box<dyn DeformedSurface + 'a>,
    derivative_factor: f64,
}

impl DeformedSurface for PlainSurface<'_> {
    fn vertices(&self) -> &[DVec3] {
        self.surface.vertices()
    }

    fn vertex_derivatives(&self, vertex: usize, columns: &mut DerivativeColumns) {
        self.surface.vertex_derivatives(vertex, columns);
        for (_, derivative) in columns {
            *derivative *= self.derivative_factor;
        }
    }
}

/// Targets a few centimetres off the vertices, in every direction, some outside and some inside.
fn correspondences(vertices: &[DVec3], random: &mut Random) -> Vec<Correspondence> {
    vertices
        .iter()
        .enumerate()
        .map(|(vertex, position)| {
            let target = *position + 0.05 * random.direction();
            let normal = random.direction().normalize();
            let signed_distance = (*position - target).dot(normal);
            Correspondence {
                vertex: vertex as u32,
                target,
                normal,
                is_outside: signed_distance > 0.0,
                signed_distance,
                weight: 0.2 + random.unit(),
            }
        })
        .collect()
}

/// All terms, with targets near the surface that `deformer` gives at `parameters`.
fn terms(deformer: &dyn Deformer, parameters: &[f64], random: &mut Random) -> Vec<Box<dyn Term>> {
    let pairs = correspondences(deformer.deform(parameters).vertices(), random);
    let pulls: Vec<LandmarkPull> = pairs
        .iter()
        .step_by(4)
        .map(|pair| LandmarkPull { vertex: pair.vertex, target: pair.target, confidence: pair.weight })
        .collect();
    let near: Vec<f64> = parameters.iter().map(|value| value + 0.3 * random.signed()).collect();
    let stiffness: Vec<f64> = parameters.iter().map(|_| random.unit()).collect();
    vec![
        Box::new(ClosestPoints::new(&pairs, DistanceForm::Point)),
        Box::new(ClosestPoints::new(&pairs, DistanceForm::Plane)),
        Box::new(InsideClothing::new(&pairs, DistanceForm::Point)),
        Box::new(InsideClothing::new(&pairs, DistanceForm::Plane)),
        Box::new(LandmarkTargets::new(&pulls)),
        Box::new(StayNear::new(0, &near, &stiffness)),
    ]
}

/// Poses where formulas change form or lose digits: rest, almost rest, bent, and root turns near and beyond half a turn.
fn poses(surface: &BodySurface, random: &mut Random) -> Vec<Vec<f64>> {
    let length = surface.skeleton().pose_length();
    let mut bent = |size: f64| -> Vec<f64> { (0..length).map(|_| size * random.signed()).collect() };
    let mut turned = |angle: f64| {
        let mut pose = bent(0.7);
        let axis = DVec3::new(0.4, -0.8, 0.45).normalize() * angle;
        pose[3..6].copy_from_slice(&axis.to_array());
        pose
    };
    let turns = [3.1, 3.5].map(&mut turned);
    turns.into_iter().chain([bent(0.0), bent(1e-6), bent(0.3), bent(1.2)]).collect()
}

/// P1 §3.1: each vertex moves by its own affine map.
fn small_affines(surface: &BodySurface) -> VertexAffines {
    VertexAffines::new(surface.mean_vertices()[..AFFINE_VERTEX_COUNT].to_vec(), 1.7)
}

/// Calls `check` with each deformer and parameters of it: the body's three kinds at six poses, and vertex affines.
fn for_each_deformer(mut check: impl FnMut(&str, &dyn Deformer, &[f64])) {
    let surface = small_body();
    let mut random = Random::new(7);
    for (index, pose) in poses(&surface, &mut random).into_iter().enumerate() {
        let identity: Vec<f64> = (0..COMPONENT_COUNT).map(|_| 2.0 * random.signed()).collect();
        let of_pose = BodyParameters::of_pose(&surface, &identity);
        check(&format!("pose {index}"), &of_pose, &pose);
        let of_identity = BodyParameters::new(&surface, FreeParameters::Identity { pose: pose.clone() });
        check(&format!("identity in pose {index}"), &of_identity, &identity);
        let of_both = BodyParameters::new(&surface, FreeParameters::IdentityAndPose);
        check(&format!("identity and pose {index}"), &of_both, &[identity, pose].concat());
    }
    let affines = small_affines(&surface);
    for size in [0.0, 0.2] {
        let parameters: Vec<f64> = (0..affines.parameter_count()).map(|_| size * random.signed()).collect();
        check("vertex affines", &affines, &parameters);
    }
}

/// Calls `check` with each allowed pair of deformer and term.
fn for_each_pair(mut check: impl FnMut(&str, &dyn Deformer, &dyn Term, &[f64])) {
    let mut random = Random::new(11);
    for_each_deformer(|name, deformer, parameters| {
        for term in terms(deformer, parameters, &mut random) {
            check(&format!("{} over {name}", term.name()), deformer, term.as_ref(), parameters);
        }
    });
}

fn assert_agrees(pair: &str, deformer: &dyn Deformer, term: &dyn Term, parameters: &[f64]) {
    let fit = Fit::new(deformer).with(1.0, term);
    if let Some(mismatch) = derivative_mismatch(&fit, parameters) {
        panic!("{pair}: {mismatch}");
    }
}

#[test]
fn derivatives_of_every_term_over_every_deformer_follow_from_its_values() {
    for_each_pair(|pair, deformer, term, parameters| {
        assert_agrees(pair, deformer, term, parameters);
        assert_agrees(
            &format!("{pair}, plain"),
            &Plain { deformer, derivative_factor: 1.0 },
            term,
            parameters,
        );
    });
}

#[test]
fn batched_kernels_add_what_the_plain_form_adds() {
    for_each_pair(|_, deformer, term, parameters| {
        let plain = Plain { deformer, derivative_factor: 1.0 };
        let (batched, plain) = (Fit::new(deformer).with(0.7, term), Fit::new(&plain).with(0.7, term));
        assert_same_contributions(&batched, &plain, parameters);
    });
}

#[test]
fn derivatives_of_smooth_affines_follow_from_their_values() {
    let affines = small_affines(&small_body());
    let edges: Vec<[u32; 2]> =
        (0..AFFINE_VERTEX_COUNT as u32 - 1).map(|v| [v, v + 1]).chain([[0, 5]]).collect();
    let mut random = Random::new(5);
    for metric in
        [AffineMetric::AtEdge, AffineMetric::Printed { unit: 0.001 }, AffineMetric::Printed { unit: 1.0 }]
    {
        let term = SmoothAffines::new(&affines, &edges, metric);
        let parameters: Vec<f64> = (0..affines.parameter_count()).map(|_| 0.2 * random.signed()).collect();
        assert_agrees("smooth affines", &affines, &term, &parameters);
        // Beside the data, as P1 Eq. 7 adds them up.
        let terms = terms(&affines, &parameters, &mut random);
        let together = terms
            .iter()
            .fold(Fit::new(&affines).with(3.0, &term), |fit, other| fit.with(1.0, other.as_ref()));
        assert_derivatives_match(&together, &parameters);
    }
}

#[test]
fn terms_of_one_fit_add_up() {
    for_each_deformer(|_, deformer, parameters| {
        let terms = terms(deformer, parameters, &mut Random::new(3));
        let together = terms.iter().fold(Fit::new(deformer), |fit, term| fit.with(1.5, term.as_ref()));
        assert_derivatives_match(&together, parameters);
        let apart: f64 = terms
            .iter()
            .map(|term| ValueSum::of(&Fit::new(deformer).with(1.5, term.as_ref()), parameters).value)
            .sum();
        let sum = ValueSum::of(&together, parameters).value;
        // The same numbers, summed in another order.
        assert!((sum - apart).abs() <= 1e-12 * sum, "{sum} {apart}");
    });
}

#[test]
fn a_doubled_weight_doubles_energy_gradient_and_normal_matrix() {
    for_each_pair(|pair, deformer, term, parameters| {
        let of = |weight: f64| NormalEquations::of(&Fit::new(deformer).with(weight, term), parameters);
        let (once, twice) = (of(0.7), of(1.4));
        assert!((twice.value - 2.0 * once.value).abs() <= 1e-12 * twice.value, "{pair}");
        let gradient = &once.half_gradient * 2.0 - &twice.half_gradient;
        assert!(gradient.amax() <= 1e-12 * twice.half_gradient.amax(), "{pair}");
        let matrix = &once.matrix * 2.0 - &twice.matrix;
        assert!(matrix.amax() <= 1e-12 * twice.matrix.amax(), "{pair}");
    });
}

#[test]
fn a_term_of_weight_zero_is_left_out() {
    for_each_pair(|pair, deformer, term, parameters| {
        let slope = Gradient::of(&Fit::new(deformer).with(0.0, term), parameters);
        assert_eq!(slope.value, 0.0, "{pair}");
        assert!(slope.gradient.iter().all(|entry| *entry == 0.0), "{pair}");
    });
}

/// The slip of half a derivative, of a wrong sign, and a small one of a tenth of a percent: all must be caught, or the first
/// test of this file proves nothing.
#[test]
fn wrong_derivatives_are_rejected() {
    for_each_pair(|pair, deformer, term, parameters| {
        // The pull on the parameters themselves never asks the surface.
        if term.name() == "stay_near" {
            return;
        }
        for derivative_factor in [0.5, -1.0, 1.001] {
            let wrong = Plain { deformer, derivative_factor };
            let fit = Fit::new(&wrong).with(1.0, term);
            assert!(derivative_mismatch(&fit, parameters).is_some(), "{pair}: factor {derivative_factor}");
        }
    });
}
