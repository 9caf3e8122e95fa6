//! The puppet through a sequence: many particles on the first frame, fewer afterwards, each frame from the one before (P2
//! §4.2 and §5).

use glam::DVec3;
use habitus_optimize::Observer;

use super::super::captured_frame::CapturedFrame;
use super::super::orientation::candidates;
use super::super::start_search::StartSearch;
use super::super::{FitSequenceConfig, FitSequenceError, Stage, progress};
use super::parts::PartState;
use super::{Beginning, Puppet, StitchedBody};
use crate::artifacts::fitted_sequence::Landmark;
use crate::artifacts::frames::FrameSource;
use crate::body::BodyModel;

/// A puppet that goes from frame to frame.
pub(in super::super) struct PuppetFollower<'a> {
    puppet: Puppet,
    config: &'a FitSequenceConfig,
    poses: Vec<Vec<f64>>,
    last: Option<(Vec<Vec<PartState>>, DVec3)>,
}

impl<'a> PuppetFollower<'a> {
    pub fn new(stage: &Stage<'a>, search: &StartSearch<'_>) -> Self {
        let puppet = stage.puppet(search);
        Self { puppet, config: stage.config, poses: search.clusters().to_vec(), last: None }
    }

    /// The best body of the next frame.
    pub fn next(&mut self, capture: &CapturedFrame) -> StitchedBody {
        let config = &self.config.puppet;
        let (beginning, count) = match &self.last {
            Some((particles, middle)) => {
                (Beginning::From { particles, moved: capture.middle - *middle }, config.later_particles)
            }
            None => (Beginning::Anew { poses: &self.poses }, config.first_particles),
        };
        let mut fit = self.puppet.fit(capture, &beginning, count, config, self.config.seed);
        self.last = Some((fit.particles, capture.middle));
        fit.bodies.swap_remove(0)
    }
}

/// What the puppet alone makes of a frame.
#[derive(Clone, Debug)]
pub struct PuppetFrame {
    /// Name of the frame.
    pub name: String,
    /// The model's landmarks, in metres, y up.
    pub landmarks: Vec<Landmark>,
    /// Negative logarithm of the posterior.
    pub energy: f64,
    /// Root mean square of the parts' shape coefficients, in standard deviations.
    pub shape_deviation: f64,
    /// Vertices of the parts that are compared with the capture, in metres, y up.
    pub points: Vec<DVec3>,
}

/// Follows a sequence with the puppet and nothing else: what P2 §4.2 does before any fit. Frames that cannot be read are
/// left out.
pub fn follow_with_puppet(
    source: &dyn FrameSource,
    model: &BodyModel,
    config: &FitSequenceConfig,
    observer: &mut dyn Observer,
) -> Result<Vec<PuppetFrame>, FitSequenceError> {
    let stage = Stage::new(source, model, config, &[]);
    let search = StartSearch::new(model, &config.start);
    let mut frames = Vec::new();
    let mut best: Option<(f64, Vec<PuppetFrame>)> = None;
    for orientation in candidates(source, config)? {
        let mut follower = PuppetFollower::new(&stage, &search);
        let mut first_energy = None;
        for frame in 0..source.len() {
            progress(observer, "puppet", frame, source.len())?;
            let Ok(capture) = stage.load(frame, &orientation.fit_from_input) else { continue };
            let body = follower.next(&capture);
            let energy = *first_energy.get_or_insert(body.energy);
            // An orientation whose first frame is worse than that of another is not worth following.
            if best.as_ref().is_some_and(|(least, _)| energy >= *least) {
                break;
            }
            let internal = orientation.internal_from_fit();
            frames.push(PuppetFrame {
                name: source.name(frame),
                landmarks: body
                    .landmarks
                    .iter()
                    .map(|of| Landmark { position: internal.apply(of.position), ..*of })
                    .collect(),
                energy: body.energy,
                shape_deviation: body.shape_deviation(),
                points: follower.puppet.skin(&body).into_iter().map(|point| internal.apply(point)).collect(),
            });
        }
        if let Some(energy) = first_energy.filter(|_| !frames.is_empty()) {
            best = Some((energy, std::mem::take(&mut frames)));
        }
    }
    best.map(|(_, frames)| frames).ok_or(FitSequenceError::NoUsableFrame)
}

impl Puppet {
    /// The vertices of a body that are compared with the capture.
    fn skin(&self, body: &StitchedBody) -> Vec<DVec3> {
        self.parts
            .iter()
            .zip(&body.states)
            .flat_map(|(part, state)| {
                let mut points = part.points(state);
                points.truncate(part.layout.data_count);
                points
            })
            .collect()
    }
}
