//! The part-based puppet (P2 §4.2, after Zuffi and Black 2015): finds a person in a capture without landmarks or pose.
//!
//! Parts with small spaces of their own ([`parts`]) hang together by stitches ([`stitching`]), both learnt from bodies of
//! the loaded model when it is needed. Particles ([`particles`]) guess each part; in every step new guesses are made
//! ([`proposals`]), exact max-product over the tree says how good the best body with each guess is, and a diverse set is
//! kept. Particles are selected in sets of a fixed size that know nothing of each other; at the end the best body is
//! sought in the union of all sets. More particles are more sets, so that they can only lower the puppet's energy.
//!
//! Deviation: 15 parts on the model's bones instead of 16, joint limits in the stitches, one-sided data, sets of
//! particles, diverse selection by greed instead of a linear program.

mod closest_grid;
mod follow;
mod landmark_start;
mod model;
mod particles;
mod parts;
mod proposals;
mod stitching;

use glam::DVec3;
use rayon::prelude::*;

use self::closest_grid::ClosestGrid;
pub(super) use self::follow::PuppetFollower;
pub use self::follow::{PuppetFrame, follow_with_puppet};
pub(super) use self::landmark_start::{FEWEST_LANDMARKS, start_at_landmarks};
pub(super) use self::model::Puppet;
use self::particles::{Evidence, MaxProduct, Particle};
use self::parts::{PartState, SHAPE_COMPONENTS};
use self::proposals::{Walk, expected_beside, facing_twin, pulled, walked};
use super::captured_frame::CapturedFrame;
use super::config::PuppetConfig;
use crate::artifacts::fitted_sequence::Landmark;
use crate::statistics::RandomStream;

/// A body put together from parts.
#[derive(Clone, Debug)]
pub(super) struct StitchedBody {
    /// State of each part.
    pub states: Vec<PartState>,
    /// Negative logarithm of the posterior; smaller is better.
    pub energy: f64,
    /// The model's landmarks.
    pub landmarks: Vec<Landmark>,
}

impl StitchedBody {
    /// Root mean square of the parts' shape coefficients, in standard deviations.
    pub fn shape_deviation(&self) -> f64 {
        let of_part = |state: &PartState| {
            state.coefficients[..SHAPE_COMPONENTS].iter().map(|value| value * value).sum::<f64>()
        };
        let sum: f64 = self.states.iter().map(of_part).sum();
        (sum / (SHAPE_COMPONENTS * self.states.len()) as f64).sqrt()
    }
}

/// What a search leaves behind.
pub(super) struct PuppetFit {
    /// Different bodies, best first; there is always one.
    pub bodies: Vec<StitchedBody>,
    /// Particles of each part, for the next frame.
    pub particles: Vec<Vec<PartState>>,
}

/// How a search begins.
pub(super) enum Beginning<'a> {
    /// With bodies of the model in these poses, in all headings.
    Anew { poses: &'a [Vec<f64>] },
    /// With the particles of another frame, moved along.
    From { particles: &'a [Vec<PartState>], moved: DVec3 },
}

impl Puppet {
    /// Fits the puppet with `count` particles for each part.
    pub fn fit(
        &self,
        frame: &CapturedFrame,
        beginning: &Beginning<'_>,
        count: usize,
        config: &PuppetConfig,
        seed: u64,
    ) -> PuppetFit {
        let evidence = Evidence { grid: ClosestGrid::new(&frame.index, frame.bounds), config };
        let set_size = config.set_size.clamp(2, count.max(2));
        let sets: Vec<Vec<Vec<Particle>>> = (0..count.div_ceil(set_size).max(1))
            .into_par_iter()
            .map(|set| {
                let size = set_size.min(count - (set * set_size).min(count)).max(2);
                let mut random = RandomStream::named(seed, &format!("puppet set {set}"));
                let first = self.first_particles(frame, beginning, &evidence, (set, size), &mut random);
                let steps = match beginning {
                    Beginning::Anew { .. } => config.first_steps,
                    Beginning::From { .. } => config.later_steps,
                };
                self.improve(first, beginning, &evidence, (size, steps), &mut random)
            })
            .collect();
        let mut all: Vec<Vec<Particle>> = vec![Vec::new(); self.parts.len()];
        for set in sets {
            for (own, particles) in all.iter_mut().zip(set) {
                own.extend(particles);
            }
        }
        let messages = MaxProduct::run(self, &all, config.looseness[1]);
        let bodies = self.different_bodies(&all, &messages, &evidence);
        let particles = all.iter().map(|of_part| of_part.iter().map(|p| p.state).collect()).collect();
        PuppetFit { bodies, particles }
    }

    fn first_particles(
        &self,
        frame: &CapturedFrame,
        beginning: &Beginning<'_>,
        evidence: &Evidence<'_>,
        (set, size): (usize, usize),
        random: &mut RandomStream,
    ) -> Vec<Vec<Particle>> {
        let mut first: Vec<Vec<Particle>> = vec![Vec::new(); self.parts.len()];
        match beginning {
            Beginning::Anew { poses } => {
                let bodies = size * evidence.config.first_factor.max(1);
                for body in 0..bodies {
                    let index = set * bodies + body;
                    let states = self.standing(frame, &poses[index % poses.len().max(1)], index, random);
                    for (part, state) in states.into_iter().enumerate() {
                        first[part].push(evidence.particle(&self.parts[part], state));
                    }
                }
            }
            Beginning::From { particles, moved } => {
                for (part, known) in particles.iter().enumerate() {
                    for place in 0..size {
                        let mut state = known[(set * size + place) % known.len().max(1)];
                        state.joint += *moved;
                        first[part].push(evidence.particle(&self.parts[part], state));
                    }
                }
            }
        }
        first
    }

    /// A random body in a pose, somewhere about the capture's middle, in the heading that belongs to `index`.
    fn standing(
        &self,
        frame: &CapturedFrame,
        pose: &[f64],
        index: usize,
        random: &mut RandomStream,
    ) -> Vec<PartState> {
        /// Of the place, in metres (Zuffi and Black 2015), of the angles in radians.
        const PLACE_NOISE: f64 = 0.08;
        const ANGLE_NOISE: f64 = 0.15;
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let identity: Vec<f64> = (0..6).map(|_| 0.7 * random.normal()).collect();
        let mut pose = pose.to_vec();
        for angle in &mut pose[crate::body::ROOT_LENGTH..] {
            *angle += ANGLE_NOISE * random.normal();
        }
        // Multiples of the golden ratio are spread evenly however many there are.
        let yaw = std::f64::consts::TAU * (index as f64 * GOLDEN).fract();
        pose[..6].copy_from_slice(&[0.0, 0.0, 0.0, 0.0, yaw, 0.0]);
        let mut states = self.states_of(&identity, &pose);
        let points: Vec<DVec3> =
            self.parts.iter().zip(&states).flat_map(|(part, state)| part.points(state)).collect();
        let [low, high] = super::captured_frame::bounds_of(&points);
        let middle = points.iter().copied().sum::<DVec3>() / points.len().max(1) as f64;
        let [frame_low, frame_high] = frame.bounds;
        let noise = DVec3::new(random.normal(), random.normal(), random.normal()) * PLACE_NOISE;
        let mut offset = frame.middle - middle;
        offset.y = 0.5 * (frame_low.y + frame_high.y - low.y - high.y);
        for state in &mut states {
            state.joint += offset + noise * DVec3::new(1.0, 0.3, 1.0);
        }
        states
    }

    /// Augments, passes messages, selects; over and over, ever tighter.
    fn improve(
        &self,
        mut kept: Vec<Vec<Particle>>,
        beginning: &Beginning<'_>,
        evidence: &Evidence<'_>,
        (size, steps): (usize, usize),
        random: &mut RandomStream,
    ) -> Vec<Vec<Particle>> {
        /// Steps between bodies that face the other way, and the share of the steps after which none is tried.
        const TWIN_EVERY: usize = 5;
        const TWINS_UNTIL: f64 = 0.7;
        let config = evidence.config;
        let is_anew = matches!(beginning, Beginning::Anew { .. });
        let first = Walk { turn: config.walk[0], shift: config.walk[1], coefficients: config.walk[2] };
        let mut best: Vec<usize> = vec![0; self.parts.len()];
        for step in 0..=steps {
            let share = step as f64 / steps.max(1) as f64;
            let looseness = config.looseness[0] * (config.looseness[1] / config.looseness[0]).powf(share);
            // The first selection is among the particles that the search begins with.
            if step > 0 {
                let walk = first.scaled(config.last_walk.powf(share));
                self.augment(&mut kept, &best, evidence, walk, share, random);
                if is_anew && step % TWIN_EVERY == 0 && share < TWINS_UNTIL {
                    self.add_facing_twin(&mut kept, &best, evidence);
                }
            }
            let messages = MaxProduct::run(self, &kept, looseness);
            best = messages.best_with(messages.ranked_roots()[0]);
            kept = kept
                .into_iter()
                .enumerate()
                .map(|(part, particles)| {
                    let picked = messages.diverse(part, best[part], size);
                    picked.into_iter().map(|place| particles[place].clone()).collect()
                })
                .collect();
            // Selection puts the best body's particle first.
            best.fill(0);
        }
        kept
    }

    /// Adds a new guess for each particle that was kept.
    fn augment(
        &self,
        kept: &mut [Vec<Particle>],
        best: &[usize],
        evidence: &Evidence<'_>,
        walk: Walk,
        share: f64,
        random: &mut RandomStream,
    ) {
        /// From this share of the steps on, every second guess starts at the best body (Zuffi and Black 2015).
        const GREEDY_FROM: f64 = 0.6;
        /// Turns between neighbours come from learning bodies until this share.
        const EXAMPLES_UNTIL: f64 = 0.7;
        let mut added: Vec<Vec<Particle>> = Vec::with_capacity(kept.len());
        for part in 0..kept.len() {
            let neighbours = self.neighbours(part);
            let mut new = Vec::with_capacity(kept[part].len());
            for place in 0..kept[part].len() {
                let is_greedy = share >= GREEDY_FROM && place % 2 == 0;
                let own = &kept[part][if is_greedy { best[part] } else { place }];
                // A model of a single part has no neighbours: it walks beside itself.
                let neighbour =
                    neighbours.get(random.below(neighbours.len().max(1))).copied().unwrap_or(part);
                let pick = if is_greedy { best[neighbour] } else { random.below(kept[neighbour].len()) };
                let beside = &kept[neighbour][pick];
                let guess = if neighbour == part || random.unit() < 0.5 {
                    let middle = own.points.iter().copied().sum::<DVec3>() / own.points.len().max(1) as f64;
                    Some(walked(&own.state, middle, walk, random))
                } else {
                    let keeps_turn = share > EXAMPLES_UNTIL || random.unit() < 0.4;
                    let own = keeps_turn.then_some(&own.state);
                    expected_beside(self, (part, neighbour), beside, own, walk, random)
                };
                let mut state = guess.unwrap_or(own.state);
                // Every second guess is drawn to the capture and to the neighbours that it may be seen beside.
                if random.unit() < 0.5 {
                    let anchors = self.anchors(kept, part, &neighbours, (neighbour, pick), best);
                    for _ in 0..evidence.config.pulls {
                        state = pulled(self, part, &state, evidence, &anchors, 0.5 + share);
                    }
                }
                new.push(evidence.particle(&self.parts[part], state));
            }
            added.push(new);
        }
        for (own, new) in kept.iter_mut().zip(added) {
            own.extend(new);
        }
    }

    /// Adds the best body as it would be if it faced the other way, which no part can try alone.
    fn add_facing_twin(&self, kept: &mut [Vec<Particle>], best: &[usize], evidence: &Evidence<'_>) {
        let states: Vec<PartState> =
            kept.iter().zip(best).map(|(particles, place)| particles[*place].state).collect();
        for (part, state) in facing_twin(self, &states).into_iter().enumerate() {
            let pulled = pulled(self, part, &state, evidence, &[], 0.0);
            kept[part].push(evidence.particle(&self.parts[part], state));
            kept[part].push(evidence.particle(&self.parts[part], pulled));
        }
    }

    fn neighbours(&self, part: usize) -> Vec<usize> {
        let children = (1..self.parts.len()).filter(|child| self.parts[*child].layout.parent == Some(part));
        self.parts[part].layout.parent.into_iter().chain(children).collect()
    }

    /// Interface points of the neighbours' particles: of the one that was asked, and of the best body for the others.
    fn anchors(
        &self,
        kept: &[Vec<Particle>],
        part: usize,
        neighbours: &[usize],
        (asked, pick): (usize, usize),
        best: &[usize],
    ) -> Vec<(usize, DVec3)> {
        let mut anchors = Vec::new();
        for neighbour in neighbours {
            let particle = &kept[*neighbour][if *neighbour == asked { pick } else { best[*neighbour] }];
            let is_child = self.parts[part].layout.parent == Some(*neighbour);
            let layout = &self.parts[if is_child { part } else { *neighbour }].layout;
            let (own, other) = if is_child {
                (&layout.parent_slots, &layout.child_slots)
            } else {
                (&layout.child_slots, &layout.parent_slots)
            };
            anchors.extend(own.iter().zip(other).map(|(own, other)| (*own, particle.points[*other])));
        }
        anchors
    }

    /// The best bodies that differ from one another.
    fn different_bodies(
        &self,
        all: &[Vec<Particle>],
        messages: &MaxProduct,
        evidence: &Evidence<'_>,
    ) -> Vec<StitchedBody> {
        let mut bodies: Vec<StitchedBody> = Vec::new();
        for root in messages.ranked_roots() {
            if bodies.len() == evidence.config.starts.max(1) {
                break;
            }
            let picked = messages.best_with(root);
            let states: Vec<PartState> =
                picked.iter().enumerate().map(|(part, place)| all[part][*place].state).collect();
            let is_new = bodies.iter().all(|body| differs(&body.states, &states, evidence.config.difference));
            if is_new {
                let landmarks = self.landmarks_of(all, messages, &picked, evidence);
                bodies.push(StitchedBody { states, energy: messages.beliefs[0][root], landmarks });
            }
        }
        bodies
    }

    /// P2 §4.2, l_i(F): fixed vertices of the parts. A landmark is trusted where the capture is near and the particles of
    /// its part agree, weighted by how good a body they belong to.
    fn landmarks_of(
        &self,
        all: &[Vec<Particle>],
        messages: &MaxProduct,
        picked: &[usize],
        evidence: &Evidence<'_>,
    ) -> Vec<Landmark> {
        /// Distance, or disagreement, at which a landmark is half trusted: the thickness of loose clothing.
        const HALF_TRUST: f64 = 0.04;
        self.landmarks
            .iter()
            .map(|(part, slot)| {
                let position = all[*part][picked[*part]].points[*slot];
                let beliefs = &messages.beliefs[*part];
                let (mut spread, mut total) = (0.0, 0.0);
                for (particle, belief) in all[*part].iter().zip(beliefs) {
                    let weight = (beliefs[picked[*part]] - belief).min(0.0).exp();
                    spread += weight * particle.points[*slot].distance_squared(position);
                    total += weight;
                }
                let squared = evidence.grid.at(position).distance_squared + spread / total.max(1e-12);
                let confidence = HALF_TRUST * HALF_TRUST / (HALF_TRUST * HALF_TRUST + squared);
                Landmark { position, confidence }
            })
            .collect()
    }
}

fn differs(a: &[PartState], b: &[PartState], distance: f64) -> bool {
    a.iter().zip(b).any(|(a, b)| {
        // A turn counts like the way of a point a quarter of a metre from the joint.
        let turned = 0.25 * (a.rotation.x_axis - b.rotation.x_axis).length();
        a.joint.distance(b.joint).max(turned) > distance
    })
}

#[cfg(test)]
mod tests;
