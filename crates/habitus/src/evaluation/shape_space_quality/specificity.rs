//! Specificity: how far random bodies of a space are from the nearest real one (P1 §5.1), exactly and without comparing
//! all vertices of all pairs.
//!
//! The mean vertex distance of two bodies is at least the mean distance of the centres of groups of vertices (triangle
//! inequality). Most training bodies are ruled out by the bound of a few large groups, most others by that of many small
//! ones; the rest are compared one large group after the other, until what is known of the distance rules them out.

use std::ops::Range;

use glam::DVec3;
use habitus_optimize::map_chunks;

use super::ShapeSpaceQualitySettings;
use crate::statistics::{LinearSpace, RandomStream, SampleMatrix};

/// Sums that run side by side, so that loops are vectorised.
const LANES: usize = 8;
/// Halvings of the vertices into large and into small groups: 16 and 128 of them, both multiples of the lanes.
const HALVINGS: [usize; 2] = [4, 7];
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

    /// Centres of consecutive groups of vertices, padded to whole lanes.
    fn group_centres(&self, groups: &[Range<usize>]) -> Self {
        Self(std::array::from_fn(|axis| {
            let centre = |group: &Range<usize>| {
                let sum: f64 = self.0[axis][group.clone()].iter().map(|value| f64::from(*value)).sum();
                (sum / group.len() as f64) as f32
            };
            let mut centres: Vec<f32> = groups.iter().map(centre).collect();
            centres.resize(padded(centres.len()), 0.0);
            centres
        }))
    }

    fn distance(&self, other: &Self, place: usize) -> f32 {
        let squares = self.0.iter().zip(&other.0).map(|(one, other)| (one[place] - other[place]).powi(2));
        squares.sum::<f32>().sqrt()
    }

    fn add(&mut self, amount: f32, other: &Self) {
        for (values, others) in self.0.iter_mut().zip(&other.0) {
            values.iter_mut().zip(others).for_each(|(value, other)| *value += amount * other);
        }
    }
}

/// The centres of groups of vertices of a space and of training bodies.
struct Groups {
    mean: Planes,
    basis: Vec<Planes>,
    training: Vec<Planes>,
    /// Share of the vertices that each group holds.
    shares: Vec<f32>,
}

impl Groups {
    fn new(ranges: &[Range<usize>], mean: &Planes, basis: &[Planes], training: &[Planes]) -> Self {
        let centres = |bodies: &[Planes]| bodies.iter().map(|body| body.group_centres(ranges)).collect();
        let count = mean.0[0].len().max(1) as f32;
        let mut shares: Vec<f32> = ranges.iter().map(|group| group.len() as f32 / count).collect();
        shares.resize(padded(shares.len()), 0.0);
        Self { mean: mean.group_centres(ranges), basis: centres(basis), training: centres(training), shares }
    }

    /// What the distance of a body to a training body is at least, metres.
    fn bound(&self, body: &Planes, training: usize) -> f64 {
        f64::from(weighted_distance(body, &self.training[training], &self.shares) - SLACK)
    }
}

/// A space and training bodies, prepared for many searches.
struct NearestBody {
    deviations: Vec<f32>,
    mean: Planes,
    basis: Vec<Planes>,
    training: Vec<Planes>,
    large_groups: Groups,
    small_groups: Groups,
    /// The vertices of each large group, and the small groups that it holds.
    regions: Vec<(Range<usize>, Range<usize>)>,
}

impl NearestBody {
    fn new(space: &LinearSpace, training: &SampleMatrix) -> Self {
        let points: Vec<DVec3> = space.mean().chunks_exact(3).map(DVec3::from_slice).collect();
        let (order, [large, small]) = spatial_groups(&points);
        let planes = |stacked: &[f64]| Planes::of(stacked, &order);
        let mean = planes(space.mean());
        let basis: Vec<Planes> =
            space.basis().column_iter().map(|column| planes(column.as_slice())).collect();
        let training: Vec<Planes> = training.samples().map(planes).collect();
        Self {
            deviations: space.standard_deviations().iter().map(|deviation| *deviation as f32).collect(),
            large_groups: Groups::new(&large, &mean, &basis, &training),
            small_groups: Groups::new(&small, &mean, &basis, &training),
            regions: regions(&large, &small),
            mean,
            basis,
            training,
        }
    }

    /// Distance in metres to the nearest training body for each number of components.
    fn distances(&self, coefficients: &[f64], components: &[usize]) -> Vec<f64> {
        let mut bodies = [self.mean.clone(), self.large_groups.mean.clone(), self.small_groups.mean.clone()];
        let mut done = 0;
        let mut nearest = 0;
        components
            .iter()
            .map(|wanted| {
                let new = done..(*wanted).min(self.basis.len()).max(done);
                for (amount, component) in coefficients[new.clone()].iter().zip(new) {
                    let amount = *amount as f32 * self.deviations[component];
                    let parts = [&self.basis, &self.large_groups.basis, &self.small_groups.basis];
                    bodies
                        .iter_mut()
                        .zip(parts)
                        .for_each(|(body, basis)| body.add(amount, &basis[component]));
                }
                done = *wanted;
                let found = self.nearest(&bodies, nearest);
                nearest = found.1;
                found.0
            })
            .collect()
    }

    /// Distance to the nearest training body, and which it is; the closer the guess, the fewer are compared.
    fn nearest(&self, [body, large_groups, small_groups]: &[Planes; 3], guess: usize) -> (f64, usize) {
        let guessed = self.training.get(guess).map_or(f64::INFINITY, |other| mean_distance(body, other));
        let mut best = (guessed, guess);
        let mut left: Vec<(f64, usize)> = (0..self.training.len())
            .map(|index| (self.large_groups.bound(large_groups, index), index))
            .filter(|(bound, _)| *bound < best.0)
            .collect();
        left.iter_mut().for_each(|(bound, index)| *bound = self.small_groups.bound(small_groups, *index));
        left.sort_unstable_by(|left, right| left.0.total_cmp(&right.0).then(left.1.cmp(&right.1)));
        for (bound, index) in left {
            if bound >= best.0 {
                break;
            }
            if let Some(distance) = self.distance_below(best.0, body, small_groups, index) {
                best = (distance, index);
            }
        }
        best
    }

    /// The distance to a training body if it is less than `limit`: the bounds of its regions give way to what they are,
    /// one by one.
    fn distance_below(&self, limit: f64, body: &Planes, groups: &Planes, training: usize) -> Option<f64> {
        let count = body.0[0].len().max(1) as f64;
        let (other, other_groups) = (&self.training[training], &self.small_groups.training[training]);
        let mut unknown = [0.0_f32; 1 << HALVINGS[0]];
        for (bound, (_, small)) in unknown.iter_mut().zip(&self.regions) {
            *bound = small
                .clone()
                .map(|group| self.small_groups.shares[group] * groups.distance(other_groups, group))
                .sum();
        }
        let mut left: f64 = unknown.iter().map(|bound| f64::from(*bound)).sum();
        let mut known = 0.0;
        for (bound, (vertices, _)) in unknown.iter().zip(&self.regions) {
            left -= f64::from(*bound);
            known += distance_sum(body, other, vertices.clone()) / count;
            if known + left - f64::from(SLACK) >= limit {
                return None;
            }
        }
        (known < limit).then_some(known)
    }
}

/// The next multiple of the lanes.
fn padded(length: usize) -> usize {
    length.next_multiple_of(LANES)
}

/// `Σ share · distance` of corresponding points; all lists are padded to whole lanes.
fn weighted_distance(left: &Planes, right: &Planes, shares: &[f32]) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    let [left, right] = [left, right].map(|body| body.0.each_ref().map(|plane| plane.chunks_exact(LANES)));
    let [[lx, ly, lz], [rx, ry, rz]] = [left, right];
    let pairs = lx.zip(ly).zip(lz).zip(rx.zip(ry).zip(rz));
    for (share, (((lx, ly), lz), ((rx, ry), rz))) in shares.chunks_exact(LANES).zip(pairs) {
        for lane in 0..LANES {
            let (x, y, z) = (lx[lane] - rx[lane], ly[lane] - ry[lane], lz[lane] - rz[lane]);
            lanes[lane] += share[lane] * (x * x + y * y + z * z).sqrt();
        }
    }
    lanes.iter().sum()
}

/// Mean distance of corresponding vertices.
fn mean_distance(left: &Planes, right: &Planes) -> f64 {
    let count = left.0[0].len();
    distance_sum(left, right, 0..count) / count.max(1) as f64
}

/// Sum of the distances of corresponding vertices; f32 sums run over short blocks only.
fn distance_sum(left: &Planes, right: &Planes, vertices: Range<usize>) -> f64 {
    const BLOCK: usize = 32 * LANES;
    let mut sum = 0.0_f64;
    for start in vertices.clone().step_by(BLOCK) {
        let range = start..(start + BLOCK).min(vertices.end);
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
    sum
}

/// The vertices of each large group with the small groups that it holds; groups of both kinds are consecutive.
fn regions(large: &[Range<usize>], small: &[Range<usize>]) -> Vec<(Range<usize>, Range<usize>)> {
    let mut first = 0;
    large
        .iter()
        .map(|vertices| {
            let held = small[first..].iter().take_while(|group| group.end <= vertices.end).count();
            first += held;
            (vertices.clone(), first - held..first)
        })
        .collect()
}

/// An order of the vertices in which large and small groups of neighbours are consecutive: the longest side of each box is
/// halved.
fn spatial_groups(points: &[DVec3]) -> (Vec<u32>, [Vec<Range<usize>>; 2]) {
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    let mut groups: Vec<_> = std::iter::once(0..points.len()).collect();
    let mut large = groups.clone();
    for halving in 0..HALVINGS[1] {
        if halving == HALVINGS[0] {
            large.clone_from(&groups);
        }
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
    (order, [large, groups])
}
