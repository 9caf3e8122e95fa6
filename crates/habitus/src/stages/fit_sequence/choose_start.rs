//! Chooses the start of a sequence: the search, the puppet, or landmarks that a person gives; asks the puppet for a second
//! opinion, if the settings say so, when the search has a rival that is almost as good.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::captured_frame::CapturedFrame;
use super::config::StartMethod;
use super::orientation::{Orientation, candidates};
use super::puppet::{Beginning, FEWEST_LANDMARKS, Puppet, StitchedBody, start_at_landmarks};
use super::start_search::{Start, StartSearch};
use super::{FitSequenceError, Stage, Track};
use crate::artifacts::fitted_sequence::{Landmark, SecondOpinion, StartReport};

/// A started sequence.
pub(super) struct Started {
    pub orientation: Orientation,
    pub identity: Vec<f64>,
    pub first_frame: usize,
    pub pose: Vec<f64>,
    pub rival_ratio: f64,
    pub report: StartReport,
}

/// Starts whose joints all lie closer than this are not rivals: tracking brings them together.
const RIVAL_DISTANCE: f64 = 0.2;

/// The first frame that can be used, in every orientation that is possible.
struct FirstFrame {
    frame: usize,
    orientations: Vec<Orientation>,
    captures: Vec<CapturedFrame>,
}

/// A start that has been tracked through the trial frames.
struct Tried {
    energy: f64,
    start: Start,
    by: StartMethod,
}

impl Stage<'_> {
    /// The best start over orientations and rivals, and the identity of the first frames.
    pub(super) fn start(&self) -> Result<Started, FitSequenceError> {
        let config = &self.config.start;
        let search = StartSearch::new(self.model, config);
        let first = self.first_frame()?;
        let starts = match config.method {
            StartMethod::Search => search.search(&first.captures, None, &[]),
            StartMethod::Puppet => self.puppet_starts(&search, &first.captures),
            StartMethod::Landmarks => self.landmark_starts(&search, &first)?,
        };
        let mut tried = Vec::new();
        self.try_rivals(&search, &first, starts, config.method, &mut tried)?;
        let mut rival_ratio = self.rival_ratio(&tried);
        let mut second_opinion = None;
        if config.method == StartMethod::Search && rival_ratio < config.second_opinion_ratio {
            let before = tried.first().map_or(f64::INFINITY, |best| best.energy);
            let opinions = self.puppet_starts(&search, &first.captures);
            let agrees = opinions
                .first()
                .zip(tried.first())
                .is_some_and(|(opinion, best)| search.joint_distance(opinion, &best.start) <= RIVAL_DISTANCE);
            self.try_rivals(&search, &first, opinions, StartMethod::Puppet, &mut tried)?;
            let after = tried.first().map_or(f64::INFINITY, |best| best.energy);
            rival_ratio = self.rival_ratio(&tried);
            second_opinion =
                Some(SecondOpinion { agrees, energy_ratio: after / before.max(f64::MIN_POSITIVE) });
        }
        let Some(best) = tried.into_iter().next() else {
            return Err(FitSequenceError::NoUsableFrame);
        };
        let mut report = StartReport { method: best.by, second_opinion, rival_ratio, landmarks: Vec::new() };
        let orientation = first.orientations[best.start.capture].clone();
        report.landmarks = self.start_landmarks(&search, &best.start, &orientation);
        let mut identity = best.start.identity;
        identity.resize(self.component_count, 0.0);
        let mut track = Track {
            orientation,
            covariance: DMatrix::identity(self.component_count, self.component_count),
            body: None,
            identity,
            frames: Vec::new(),
            rival_ratio,
            start: report,
        };
        self.initial_identity(&mut track, first.frame, &best.start.pose)?;
        let pose = track.frames[0].pose.clone();
        Ok(Started {
            orientation: track.orientation,
            identity: track.identity,
            first_frame: first.frame,
            pose,
            rival_ratio,
            report: track.start,
        })
    }

    fn first_frame(&self) -> Result<FirstFrame, FitSequenceError> {
        let orientations = candidates(self.source, self.config)?;
        let mut first_error = None;
        for frame in 0..self.source.len() {
            let captures: Result<Vec<CapturedFrame>, FitSequenceError> = orientations
                .iter()
                .map(|orientation| self.read(frame, &orientation.fit_from_input))
                .collect();
            match captures {
                Ok(captures) => return Ok(FirstFrame { frame, orientations, captures }),
                Err(error) => {
                    first_error.get_or_insert(error);
                }
            }
        }
        Err(first_error.unwrap_or(FitSequenceError::NoUsableFrame))
    }

    /// Tracks those of the starts that come close to the best and differ from what has been tried; sorts by energy.
    fn try_rivals(
        &self,
        search: &StartSearch<'_>,
        first: &FirstFrame,
        starts: Vec<Start>,
        by: StartMethod,
        tried: &mut Vec<Tried>,
    ) -> Result<(), FitSequenceError> {
        let smallest = starts.iter().map(|start| start.energy).fold(f64::INFINITY, f64::min);
        for start in starts {
            let is_close = start.energy <= self.config.start.rival_ratio * smallest;
            if is_close
                && tried.iter().all(|other| search.joint_distance(&other.start, &start) > RIVAL_DISTANCE)
            {
                let energy = self.try_start(&first.orientations[start.capture], &start, first.frame)?;
                tried.push(Tried { energy, start, by });
            }
        }
        tried.sort_by(|a, b| a.energy.total_cmp(&b.energy));
        Ok(())
    }

    fn rival_ratio(&self, tried: &[Tried]) -> f64 {
        match tried {
            [best, second, ..] => second.energy / best.energy.max(f64::MIN_POSITIVE),
            _ => self.config.start.rival_ratio,
        }
    }

    /// Starts from the landmarks of the puppet's best bodies, best first.
    fn puppet_starts(&self, search: &StartSearch<'_>, captures: &[CapturedFrame]) -> Vec<Start> {
        let config = &self.config.puppet;
        let puppet = self.puppet(search);
        let beginning = Beginning::Anew { poses: search.clusters() };
        let bodies: Vec<(usize, StitchedBody)> = captures
            .iter()
            .enumerate()
            .flat_map(|(place, capture)| {
                let fit = puppet.fit(capture, &beginning, config.first_particles, config, self.config.seed);
                fit.bodies.into_iter().map(move |body| (place, body))
            })
            .collect();
        let mut starts: Vec<Start> = bodies
            .par_iter()
            .filter_map(|(place, body)| {
                let landmarks = self.weighted(&body.landmarks);
                start_at_landmarks(search, (*place, &captures[*place]), &landmarks)
            })
            .collect();
        starts.sort_by(|a, b| a.energy.total_cmp(&b.energy));
        starts
    }

    pub(super) fn puppet(&self, search: &StartSearch<'_>) -> Puppet {
        Puppet::learn(self.model, search.clusters(), &self.config.puppet, self.config.seed)
    }

    /// Landmarks with their vertices, weighted by confidence.
    fn weighted(&self, landmarks: &[Landmark]) -> Vec<(u32, glam::DVec3, f64)> {
        let vertices = self.model.landmark_vertices();
        vertices.iter().zip(landmarks).map(|(vertex, of)| (*vertex, of.position, of.confidence)).collect()
    }

    /// A start from the landmarks that a person gives for the first frame.
    fn landmark_starts(
        &self,
        search: &StartSearch<'_>,
        first: &FirstFrame,
    ) -> Result<Vec<Start>, FitSequenceError> {
        let given = first.captures.first().map_or(0, |capture| capture.landmarks.len());
        let starts: Vec<Start> = first
            .captures
            .iter()
            .enumerate()
            .filter_map(|(place, capture)| {
                let landmarks: Vec<_> =
                    capture.landmarks.iter().map(|given| (given.vertex, given.position, 1.0)).collect();
                start_at_landmarks(search, (place, capture), &landmarks)
            })
            .collect();
        if starts.is_empty() {
            return Err(FitSequenceError::TooFewLandmarks {
                frame: self.source.name(first.frame),
                found: given,
                needed: FEWEST_LANDMARKS,
            });
        }
        Ok(starts)
    }

    /// Where the start has the landmarks, in metres, y up.
    fn start_landmarks(
        &self,
        search: &StartSearch<'_>,
        start: &Start,
        orientation: &Orientation,
    ) -> Vec<Landmark> {
        let vertices = search.vertices(start);
        let level = search.level();
        self.model
            .landmark_vertices()
            .iter()
            .filter_map(|vertex| {
                let slot = level.vertices.binary_search(vertex).ok()?;
                let position = orientation.internal_from_fit().apply(vertices[slot]);
                Some(Landmark { position, confidence: 1.0 })
            })
            .collect()
    }
}
