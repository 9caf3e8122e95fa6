//! Specificity: how far random bodies of a space are from the nearest real one (P1 §5.1), exactly and without comparing
//! all vertices of all pairs.
//!
//! The mean vertex distance of two bodies is at least the mean distance of the centres of small groups of vertices
//! (triangle inequality). Most training bodies are ruled out by that bound; the others are compared in full.

use glam::DVec3;
use habitus_optimize::map_chunks;

use super::ShapeSpaceQualitySettings;
use crate::statistics::{LinearSpace, RandomStream, SampleMatrix};

/// Sums that run side by side, so that loops are vectorised.
const LANES: usize = 8;
/// Halvings of the vertices into groups: 128 groups.
const HALVINGS: usize = 7;
/// Random bodies that one thread draws at a time.
const CHUNK: usize = 32;
/// The bound is computed in f32: this much is taken off before it rules a body out.
const SLACK: f32 = 1e-4;

/// Mean over random bodies (coefficients from the standard normal distribution) of the mean vertex distance, in
/// millimetres, to the nearest training body, for each number of components (rising).
pub fn specificity(
    space: &LinearSpace,
    training: &SampleMatrix,
    components: &[usize],
    settings: &ShapeSpaceQualitySettings,
) -> Vec<f64> {
    let search = NearestBody::new(space, training);
    let chunks = map_chunks(settings.specificity_samples, CHUNK, |range| {
        let mut sums = vec![0.0; components.len()];
        for index in range {
            let mut stream = RandomStream::named(settings.seed, &format!("specificity {index}"));
            let coefficients: Vec<f64> = (0..space.component_count()).map(|_| stream.normal()).collect();
            for (sum, distance) in sums.iter_mut().zip(search.distances(&coefficients, components)) {
                *sum += distance;
            }
        }
        sums
    });
    let count = settings.specificity_samples.max(1) as f64;
    (0..components.len())
        .map(|place| 1000.0 * chunks.iter().map(|sums| sums[place]).sum::<f64>() / count)
        .collect()
}

/// A body as three lists of coordinates.
#[derive(Clone)]
struct Planes([Vec<f32>; 3]);

impl Planes {
    fn of(stacked: &[f64], order: &[u32]) -> Self {
        Self(std::array::from_fn(|axis| {
            order.iter().map(|vertex| stacked[3 * *vertex as usize + axis] as f32).collect()
        }))
    }

    /// Centres of consecutive groups of vertices.
    fn group_centres(&self, groups: &[std::ops::Range<usize>]) -> Self {
        Self(std::array::from_fn(|axis| {
            let centre = |group: &std::ops::Range<usize>| {
                let sum: f64 = self.0[axis][group.clone()].iter().map(|value| f64::from(*value)).sum();
                (sum / group.len() as f64) as f32
            };
            groups.iter().map(centre).collect()
        }))
    }

    fn add(&mut self, amount: f32, other: &Self) {
        for (values, others) in self.0.iter_mut().zip(&other.0) {
            values.iter_mut().zip(others).for_each(|(value, other)| *value += amount * other);
        }
    }
}

/// A space and training bodies, prepared for many searches.
struct NearestBody {
    deviations: Vec<f32>,
    mean: Planes,
    mean_groups: Planes,
    basis: Vec<Planes>,
    basis_groups: Vec<Planes>,
    training: Vec<Planes>,
    training_groups: Vec<Planes>,
    /// Share of the vertices that each group holds.
    shares: Vec<f32>,
}

impl NearestBody {
    fn new(space: &LinearSpace, training: &SampleMatrix) -> Self {
        let points: Vec<DVec3> = space.mean().chunks_exact(3).map(DVec3::from_slice).collect();
        let (order, groups) = spatial_groups(&points);
        let planes = |stacked: &[f64]| Planes::of(stacked, &order);
        let mean = planes(space.mean());
        let basis: Vec<Planes> =
            space.basis().column_iter().map(|column| planes(column.as_slice())).collect();
        let training: Vec<Planes> = training.samples().map(planes).collect();
        Self {
            deviations: space.standard_deviations().iter().map(|deviation| *deviation as f32).collect(),
            mean_groups: mean.group_centres(&groups),
            basis_groups: basis.iter().map(|body| body.group_centres(&groups)).collect(),
            training_groups: training.iter().map(|body| body.group_centres(&groups)).collect(),
            shares: groups.iter().map(|group| group.len() as f32 / points.len() as f32).collect(),
            mean,
            basis,
            training,
        }
    }

    /// Distance in metres to the nearest training body for each number of components.
    fn distances(&self, coefficients: &[f64], components: &[usize]) -> Vec<f64> {
        let (mut body, mut groups) = (self.mean.clone(), self.mean_groups.clone());
        let mut done = 0;
        components
            .iter()
            .map(|wanted| {
                let new = done..(*wanted).min(self.basis.len()).max(done);
                for (amount, component) in coefficients[new.clone()].iter().zip(new) {
                    let amount = *amount as f32 * self.deviations[component];
                    body.add(amount, &self.basis[component]);
                    groups.add(amount, &self.basis_groups[component]);
                }
                done = *wanted;
                self.nearest(&body, &groups)
            })
            .collect()
    }

    fn nearest(&self, body: &Planes, groups: &Planes) -> f64 {
        let mut bounds: Vec<(f32, usize)> = self
            .training_groups
            .iter()
            .enumerate()
            .map(|(index, other)| (weighted_distance(groups, other, &self.shares) - SLACK, index))
            .collect();
        bounds.sort_by(|left, right| left.0.total_cmp(&right.0));
        let mut best = f64::INFINITY;
        for (bound, index) in bounds {
            if f64::from(bound) >= best {
                break;
            }
            best = best.min(mean_distance(body, &self.training[index]));
        }
        best
    }
}

/// `Σ share · distance` of corresponding points.
fn weighted_distance(left: &Planes, right: &Planes, shares: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    let planes = |body: &Planes, axis: usize, start: usize| -> [f32; LANES] {
        std::array::from_fn(|lane| body.0[axis].get(start + lane).copied().unwrap_or(0.0))
    };
    for start in (0..shares.len()).step_by(LANES) {
        let share: [f32; LANES] =
            std::array::from_fn(|lane| shares.get(start + lane).copied().unwrap_or(0.0));
        let [lx, ly, lz] = [0, 1, 2].map(|axis| planes(left, axis, start));
        let [rx, ry, rz] = [0, 1, 2].map(|axis| planes(right, axis, start));
        for lane in 0..LANES {
            let (x, y, z) = (lx[lane] - rx[lane], ly[lane] - ry[lane], lz[lane] - rz[lane]);
            lanes[lane] += share[lane] * (x * x + y * y + z * z).sqrt();
        }
    }
    lanes.iter().sum()
}

/// Mean distance of corresponding vertices; f32 sums run over short blocks only.
fn mean_distance(left: &Planes, right: &Planes) -> f64 {
    const BLOCK: usize = 32 * LANES;
    let count = left.0[0].len();
    let mut sum = 0.0_f64;
    for start in (0..count).step_by(BLOCK) {
        let range = start..(start + BLOCK).min(count);
        let [lx, ly, lz] = [0, 1, 2].map(|axis| &left.0[axis][range.clone()]);
        let [rx, ry, rz] = [0, 1, 2].map(|axis| &right.0[axis][range.clone()]);
        let mut lanes = [0.0_f32; LANES];
        let whole = lx.len() / LANES * LANES;
        for at in (0..whole).step_by(LANES) {
            for (lane, total) in lanes.iter_mut().enumerate() {
                let k = at + lane;
                let (x, y, z) = (lx[k] - rx[k], ly[k] - ry[k], lz[k] - rz[k]);
                *total += (x * x + y * y + z * z).sqrt();
            }
        }
        for k in whole..lx.len() {
            let (x, y, z) = (lx[k] - rx[k], ly[k] - ry[k], lz[k] - rz[k]);
            lanes[0] += (x * x + y * y + z * z).sqrt();
        }
        sum += f64::from(lanes.iter().sum::<f32>());
    }
    sum / count.max(1) as f64
}

/// An order of the vertices in which groups of neighbours are consecutive: the longest side of each box is halved.
fn spatial_groups(points: &[DVec3]) -> (Vec<u32>, Vec<std::ops::Range<usize>>) {
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    let mut groups: Vec<_> = std::iter::once(0..points.len()).collect();
    for _ in 0..HALVINGS {
        let mut halves = Vec::with_capacity(2 * groups.len());
        for group in groups {
            if group.len() < 2 {
                halves.push(group);
                continue;
            }
            let members = &mut order[group.clone()];
            let (low, high) =
                members.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), v| {
                    (low.min(points[*v as usize]), high.max(points[*v as usize]))
                });
            let size = high - low;
            let axis = if size.x >= size.y && size.x >= size.z {
                0
            } else if size.y >= size.z {
                1
            } else {
                2
            };
            members.sort_by(|left, right| {
                let place = |vertex: &u32| points[*vertex as usize].to_array()[axis];
                place(left).total_cmp(&place(right)).then(left.cmp(right))
            });
            let middle = group.start + group.len() / 2;
            halves.push(group.start..middle);
            halves.push(middle..group.end);
        }
        groups = halves;
    }
    (order, groups)
}
