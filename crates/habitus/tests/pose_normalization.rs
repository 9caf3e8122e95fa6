//! P1 §3.4 on pairs with known truth: the same people in two postures, bent by other skin weights than the model's.
#![allow(clippy::expect_used, reason = "a test may fail loudly")]

use glam::{DQuat, DVec3};
use habitus::body::{BodyModel, SkinWeights};
use habitus::geometry::Topology;
use habitus::optimize::Silent;
use habitus::stages::learn_shape::{LearnShapeConfig, PoseNormalization, Registration, prepare_samples};
use habitus::statistics::{RandomStream, align_to};

const PEOPLE: usize = 10;

/// Rest bodies with the angles of their two postures.
struct Pairs {
    model: BodyModel,
    skin: SkinWeights,
    rest: Vec<Vec<DVec3>>,
    angles: Vec<[Vec<f64>; 2]>,
}

/// The model's weights, blurred over the surface: bodies are not bent exactly as any model bends them.
fn blurred(model: &BodyModel, rounds: usize) -> SkinWeights {
    let topology = Topology::new(model.vertex_count(), model.faces());
    let bone_count = model.skeleton().bones().len();
    let mut dense: Vec<Vec<f64>> = (0..model.vertex_count())
        .map(|vertex| {
            let mut row = vec![0.0; bone_count];
            model.surface().skin().of(vertex).for_each(|(bone, weight)| row[bone] = weight);
            row
        })
        .collect();
    for _ in 0..rounds {
        dense = (0..dense.len())
            .map(|vertex| {
                let ring = topology.one_ring(vertex);
                let share = 1.0 / (ring.len() + 1) as f64;
                (0..bone_count)
                    .map(|bone| {
                        share
                            * (dense[vertex][bone]
                                + ring.iter().map(|v| dense[*v as usize][bone]).sum::<f64>())
                    })
                    .collect()
            })
            .collect();
    }
    let (mut bones, mut weights) = (Vec::new(), Vec::new());
    for row in dense {
        let mut order: Vec<usize> = (0..bone_count).collect();
        order.sort_by(|a, b| row[*b].total_cmp(&row[*a]));
        let sum: f64 = order[..4].iter().map(|bone| row[*bone]).sum();
        bones.push(std::array::from_fn(|slot| order[slot] as u8));
        weights.push(std::array::from_fn(|slot| row[order[slot]] / sum));
    }
    SkinWeights { bones, weights }
}

impl Pairs {
    fn new() -> Self {
        let model = BodyModel::default_space().expect("is embedded");
        let mut stream = RandomStream::named(9, "pairs");
        let rest = (0..PEOPLE)
            .map(|_| {
                let identity: Vec<f64> = (0..60).map(|_| stream.normal().clamp(-2.0, 2.0)).collect();
                model.rest_vertices(&identity)
            })
            .collect();
        let axes = model.skeleton().axes().to_vec();
        let mut posture = || -> Vec<f64> {
            let spread = |name: &str| if name.contains("shoulder") { 0.12 } else { 0.06 };
            axes.iter().map(|a| (spread(&a.name) * stream.normal()).clamp(a.limits[0], a.limits[1])).collect()
        };
        let angles = (0..PEOPLE).map(|_| [posture(), posture()]).collect();
        Self { skin: blurred(&model, 3), model, rest, angles }
    }

    fn posed(&self, person: usize, angles: &[f64]) -> Vec<DVec3> {
        let joints = self.model.joints(&self.rest[person]);
        let pose = [&[0.0; 6], angles].concat();
        let mut vertices = Vec::new();
        self.skin.apply_into(&self.rest[person], &self.model.skeleton().pose(&joints, &pose), &mut vertices);
        vertices
    }

    fn registrations(&self) -> Vec<Registration> {
        (0..2 * PEOPLE)
            .map(|index| {
                let vertices = self.posed(index / 2, &self.angles[index / 2][index % 2]);
                let turn = DQuat::from_rotation_y(index as f64);
                let vertices = vertices.iter().map(|vertex| turn * *vertex + DVec3::X).collect();
                Registration { name: format!("{}_{}", index / 2, index % 2), vertices }
            })
            .collect()
    }

    fn mean_angles(&self) -> Vec<f64> {
        let count = (2 * PEOPLE) as f64;
        let mut mean = vec![0.0; self.angles[0][0].len()];
        for angles in self.angles.iter().flatten() {
            mean.iter_mut().zip(angles).for_each(|(mean, angle)| *mean += angle / count);
        }
        mean
    }

    /// Posture leak (mean distance between the two normalized bodies of a person) and identity error (to the person's true
    /// body in the common pose), both in millimetres after rigid alignment.
    fn leak_and_error(&self, method: PoseNormalization) -> [f64; 2] {
        let config = LearnShapeConfig { pose_normalization: method, ..Default::default() };
        let found =
            prepare_samples(&self.registrations(), &self.model, &config, &mut Silent).expect("prepares");
        let common = self.mean_angles();
        let (mut leak, mut error) = (0.0, 0.0);
        for person in 0..PEOPLE {
            let truth =
                if found.is_in_rest_pose { self.rest[person].clone() } else { self.posed(person, &common) };
            let [first, second] = [0, 1].map(|side| found.samples.points(2 * person + side));
            leak += distance_after_alignment(&first, &second) / PEOPLE as f64;
            error += 0.5 * distance_after_alignment(&first, &truth) / PEOPLE as f64;
            error += 0.5 * distance_after_alignment(&second, &truth) / PEOPLE as f64;
        }
        [leak, error].map(|metres| 1000.0 * metres)
    }
}

fn distance_after_alignment(moving: &[DVec3], fixed: &[DVec3]) -> f64 {
    let mut stacked: Vec<f64> = moving.iter().flat_map(|vertex| vertex.to_array()).collect();
    align_to(&mut stacked, fixed);
    let distances = stacked.chunks_exact(3).zip(fixed).map(|(x, y)| DVec3::from_slice(x).distance(*y));
    distances.sum::<f64>() / fixed.len() as f64
}

#[test]
fn normalization_takes_the_posture_out_and_leaves_the_person() {
    let pairs = Pairs::new();
    let [plain_leak, plain_error] = pairs.leak_and_error(PoseNormalization::None);
    println!("method               leak mm   removed   identity error mm");
    println!("none                 {plain_leak:7.2}         –   {plain_error:7.2}");
    let mut best = 0.0_f64;
    for method in &PoseNormalization::ALL[1..] {
        let [leak, error] = pairs.leak_and_error(*method);
        let removed = 1.0 - leak / plain_leak;
        println!("{:20} {leak:7.2}   {:5.1} %   {error:7.2}", method.name(), 100.0 * removed);
        best = best.max(removed);
        assert!(removed > 0.0, "{}", method.name());
    }
    assert!(best >= 0.7, "the best removes {best}");
    let [_, error] = pairs.leak_and_error(PoseNormalization::Unpose);
    assert!(error < 0.5 * plain_error, "unposing keeps the person: {error} mm for {plain_error} mm");
}
