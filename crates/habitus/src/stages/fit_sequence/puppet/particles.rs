//! Particles of a part, what the capture says to them, and the exact best combination of them (max-product).

use glam::{DMat3, DVec3};

use super::super::config::PuppetConfig;
use super::closest_grid::{ClosestGrid, Nearby};
use super::model::Puppet;
use super::parts::{COEFFICIENTS, Part, PartState};
use super::stitching::{Seam, seam_to_child, seam_to_parent};

/// A guess for one part.
#[derive(Clone, Debug)]
pub(super) struct Particle {
    pub state: PartState,
    /// Slot by slot, in metres.
    pub points: Vec<DVec3>,
    /// Negative logarithm of the capture's and the population's say.
    pub cost: f64,
}

/// What of a capture the puppet needs.
pub(super) struct Evidence<'a> {
    pub grid: ClosestGrid,
    pub config: &'a PuppetConfig,
}

impl Evidence<'_> {
    pub fn particle(&self, part: &Part, mut state: PartState) -> Particle {
        for value in &mut state.coefficients {
            *value = value.clamp(-self.config.coefficient_limit, self.config.coefficient_limit);
        }
        let points = part.points(&state);
        let cost = self.data_cost(part, &points, &state.rotation) + prior(&state.coefficients);
        Particle { state, points, cost }
    }

    /// Weight of a point's pull and its cost. Inside cloth the capture says little, outside and at bare skin much.
    pub fn judge(&self, nearby: &Nearby, normal: DVec3, is_bare: bool) -> (f64, f64) {
        let config = self.config;
        let (weight, scale) = if is_bare {
            (config.bare_weight, config.bare_scale)
        } else if nearby.signed_distance > 0.0 {
            (config.outside_weight, config.outside_scale)
        } else {
            (config.inside_weight, config.inside_scale)
        };
        let squared = scale * scale;
        let share = squared / (squared + nearby.distance_squared);
        let unit = 0.5 / (config.data_deviation * config.data_deviation);
        let turned = 0.5 * (1.0 - normal.dot(nearby.normal)) * config.normal_weight;
        (weight * share * share, weight * share * nearby.distance_squared * unit + turned)
    }

    fn data_cost(&self, part: &Part, points: &[DVec3], rotation: &DMat3) -> f64 {
        let count = part.layout.data_count;
        let sum: f64 = (0..count)
            .map(|slot| {
                let nearby = self.grid.at(points[slot]);
                self.judge(&nearby, *rotation * part.normals[slot], part.is_bare[slot]).1
            })
            .sum();
        self.config.independent_points * sum / count.max(1) as f64
    }
}

fn prior(coefficients: &[f64; COEFFICIENTS]) -> f64 {
    0.5 * coefficients.iter().map(|value| value * value).sum::<f64>()
}

/// Messages over candidates of all parts; costs, so that products are sums and the largest is the smallest.
pub(super) struct MaxProduct {
    /// For each part but the first: own candidate × parent's candidate.
    pub pairs: Vec<Vec<f64>>,
    /// For each part but the first: what it tells its parent, by parent's candidate.
    pub up: Vec<Vec<f64>>,
    /// For each part but the first: what its parent tells it, by own candidate.
    pub down: Vec<Vec<f64>>,
    /// Cost of the best body that contains a candidate.
    pub beliefs: Vec<Vec<f64>>,
    parents: Vec<Option<usize>>,
}

impl MaxProduct {
    pub fn run(puppet: &Puppet, candidates: &[Vec<Particle>], looseness: f64) -> Self {
        let parents: Vec<Option<usize>> = puppet.parts.iter().map(|part| part.layout.parent).collect();
        let count = parents.len();
        let mut pairs = vec![Vec::new(); count];
        for part in 1..count {
            let (Some(stitch), Some(parent)) = (&puppet.stitches[part], parents[part]) else { continue };
            let child = &puppet.parts[part];
            let own = seams(&candidates[part], |points, rotation| seam_to_parent(child, points, rotation));
            let other = seams(&candidates[parent], |points, rotation| seam_to_child(child, points, rotation));
            pairs[part] = own
                .iter()
                .flat_map(|own| other.iter().map(|other| stitch.cost(own, other, looseness)))
                .collect();
        }
        let mut beliefs: Vec<Vec<f64>> = candidates
            .iter()
            .map(|particles| particles.iter().map(|particle| particle.cost).collect())
            .collect();
        let mut up = vec![Vec::new(); count];
        for part in (1..count).rev() {
            let Some(parent) = parents[part] else { continue };
            let width = candidates[parent].len();
            let mut message = vec![f64::INFINITY; width];
            for (row, belief) in pairs[part].chunks_exact(width).zip(&beliefs[part]) {
                for (best, pair) in message.iter_mut().zip(row) {
                    *best = best.min(belief + pair);
                }
            }
            beliefs[parent].iter_mut().zip(&message).for_each(|(belief, heard)| *belief += heard);
            up[part] = message;
        }
        let mut down = vec![Vec::new(); count];
        for part in 1..count {
            let Some(parent) = parents[part] else { continue };
            let without: Vec<f64> =
                beliefs[parent].iter().zip(&up[part]).map(|(belief, own)| belief - own).collect();
            let message: Vec<f64> = pairs[part]
                .chunks_exact(without.len())
                .map(|row| row.iter().zip(&without).map(|(a, b)| a + b).fold(f64::INFINITY, f64::min))
                .collect();
            beliefs[part].iter_mut().zip(&message).for_each(|(belief, heard)| *belief += heard);
            down[part] = message;
        }
        Self { pairs, up, down, beliefs, parents }
    }

    /// The best body that contains a candidate of the first part: a candidate for each part.
    pub fn best_with(&self, root: usize) -> Vec<usize> {
        let mut picked = vec![root; self.parents.len()];
        for part in 1..picked.len() {
            let Some(parent) = self.parents[part] else { continue };
            let width = self.up[part].len();
            // What the subtree says without the parent, plus the pair with the parent that is picked.
            let score = |own: usize| {
                self.beliefs[part][own] - self.down[part][own]
                    + self.pairs[part][own * width + picked[parent]]
            };
            picked[part] = smallest((0..self.beliefs[part].len()).map(score));
        }
        picked
    }

    /// Candidates of the first part, best first.
    pub fn ranked_roots(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.beliefs[0].len()).collect();
        order.sort_by(|a, b| self.beliefs[0][*a].total_cmp(&self.beliefs[0][*b]));
        order
    }

    /// Which candidates of a part to keep: the one of the best body first, then whichever preserves most of the messages
    /// that are left (Pacheco et al. 2014, greedily).
    pub fn diverse(&self, part: usize, best: usize, count: usize) -> Vec<usize> {
        let rows = self.message_rows(part);
        let width = rows.first().map_or(0, Vec::len);
        let mut covered = rows[best].clone();
        let mut kept = vec![best];
        let gain = |row: &[f64], covered: &[f64]| -> f64 {
            row.iter().zip(covered).map(|(value, had)| (value - had).max(0.0)).sum()
        };
        // A gain only shrinks as more is covered, so that an old gain is a bound.
        let mut bounds: Vec<(f64, usize)> =
            (0..rows.len()).filter(|row| *row != best).map(|row| (gain(&rows[row], &covered), row)).collect();
        while kept.len() < count && !bounds.is_empty() {
            bounds.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            let mut fresh: Option<(f64, usize)> = None;
            for (place, (bound, row)) in bounds.iter_mut().enumerate() {
                if fresh.is_some_and(|(best, _)| best >= *bound) {
                    break;
                }
                *bound = gain(&rows[*row], &covered);
                if fresh.is_none_or(|(best, _)| *bound > best) {
                    fresh = Some((*bound, place));
                }
            }
            let Some((_, place)) = fresh else { break };
            let (_, row) = bounds.remove(place);
            for k in 0..width {
                covered[k] = covered[k].max(rows[row][k]);
            }
            kept.push(row);
        }
        kept
    }

    /// For each candidate what it contributes to the messages to all neighbours, relative to the best contribution.
    fn message_rows(&self, part: usize) -> Vec<Vec<f64>> {
        /// Differences of cost that still count.
        const TEMPERATURE: f64 = 4.0;
        let own = self.beliefs[part].len();
        let mut rows: Vec<Vec<f64>> = vec![Vec::new(); own];
        let mut add = |cost: &dyn Fn(usize, usize) -> f64, columns: usize| {
            for column in 0..columns {
                let costs: Vec<f64> = (0..own).map(|row| cost(row, column)).collect();
                let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
                for (row, cost) in rows.iter_mut().zip(costs) {
                    row.push(((least - cost) / TEMPERATURE).exp());
                }
            }
        };
        let beliefs = &self.beliefs[part];
        if self.parents[part].is_some() {
            let width = self.up[part].len();
            let cost = |row: usize, column: usize| {
                beliefs[row] - self.down[part][row] + self.pairs[part][row * width + column]
            };
            add(&cost, width);
        }
        for child in (1..self.parents.len()).filter(|child| self.parents[*child] == Some(part)) {
            let cost = |row: usize, column: usize| {
                beliefs[row] - self.up[child][row] + self.pairs[child][column * own + row]
            };
            add(&cost, self.beliefs[child].len());
        }
        rows
    }
}

fn seams(particles: &[Particle], seam: impl Fn(&[DVec3], &DMat3) -> Seam) -> Vec<Seam> {
    particles.iter().map(|particle| seam(&particle.points, &particle.state.rotation)).collect()
}

/// Place of the smallest value, the first of equals.
pub(super) fn smallest(values: impl Iterator<Item = f64>) -> usize {
    values.enumerate().fold((0, f64::INFINITY), |best, (k, v)| if v < best.1 { (k, v) } else { best }).0
}
