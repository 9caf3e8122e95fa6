//! Captures that are needed more than once, kept in memory as long as they are few triangles together.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

use super::captured_frame::{CapturedFrame, FitFromInput};

/// Keeps captures, the first ones first. Memory is bounded by `frame.kept_primitives`, whatever the sequence.
pub(super) struct KeptCaptures {
    largest: usize,
    kept: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    captures: BTreeMap<usize, KeptCapture>,
    primitives: usize,
    preferred: BTreeSet<usize>,
}

struct KeptCapture {
    capture: Arc<CapturedFrame>,
    /// In whose coordinates it is.
    fit_from_input: FitFromInput,
}

impl KeptCaptures {
    /// Keeps `largest` triangles or points at most.
    pub fn new(largest: usize) -> Self {
        Self { largest, kept: Mutex::default() }
    }

    /// From now on these frames are kept rather than others.
    pub fn prefer(&self, frames: &[usize]) {
        self.lock().preferred = frames.iter().copied().collect();
    }

    /// The capture of a frame in these coordinates: kept from an earlier call or from `read`, which makes no difference to
    /// what is in it.
    pub fn get_or_read<Failure>(
        &self,
        frame: usize,
        fit_from_input: &FitFromInput,
        read: impl FnOnce() -> Result<CapturedFrame, Failure>,
    ) -> Result<Arc<CapturedFrame>, Failure> {
        if let Some(kept) = self.lock().captures.get(&frame)
            && kept.fit_from_input == *fit_from_input
        {
            return Ok(Arc::clone(&kept.capture));
        }
        let capture = Arc::new(read()?);
        let kept = KeptCapture { capture: Arc::clone(&capture), fit_from_input: *fit_from_input };
        self.lock().insert(frame, kept, self.largest);
        Ok(capture)
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    fn insert(&mut self, frame: usize, capture: KeptCapture, largest: usize) {
        self.remove(frame);
        let primitives = capture.primitive_count();
        while self.preferred.contains(&frame) && self.primitives + primitives > largest {
            let last_other = self.captures.keys().rev().find(|other| !self.preferred.contains(other));
            let Some(other) = last_other.copied() else { break };
            self.remove(other);
        }
        if self.primitives + primitives <= largest {
            self.primitives += primitives;
            self.captures.insert(frame, capture);
        }
    }

    fn remove(&mut self, frame: usize) {
        if let Some(capture) = self.captures.remove(&frame) {
            self.primitives -= capture.primitive_count();
        }
    }
}

impl KeptCapture {
    fn primitive_count(&self) -> usize {
        self.capture.index.primitive_count()
    }
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};
    use habitus_geometry::{Surface, TriangleMesh};

    use super::super::captured_frame::size_of;
    use super::super::config::FrameConfig;
    use super::*;
    use crate::body::BodyModel;

    /// Reads body-shaped captures through a keeper and tells which calls had to read.
    struct Reader {
        captures: KeptCaptures,
        surface: Surface,
        usual: FitFromInput,
    }

    impl Reader {
        fn keeping(count: usize) -> Self {
            let model = BodyModel::default_space().expect("the embedded model");
            let surface = Surface::Mesh(
                TriangleMesh::new(model.mean_vertices().to_vec(), model.faces().to_vec()).expect("a mesh"),
            );
            let usual = FitFromInput {
                scale: 1.0,
                rotation: DMat3::IDENTITY,
                translation: DVec3::ZERO,
                usual_size: size_of(&surface),
            };
            let captures = KeptCaptures::new(count * model.faces().len());
            Self { captures, surface, usual }
        }

        fn reads(&self, frame: usize, fit_from_input: &FitFromInput) -> bool {
            let mut is_read = false;
            let read = || {
                is_read = true;
                let config = FrameConfig::default();
                CapturedFrame::prepare(self.surface.clone(), fit_from_input, &config, (1, "body"))
            };
            self.captures.get_or_read(frame, fit_from_input, read).expect("a frame");
            is_read
        }
    }

    #[test]
    fn the_first_captures_stay_and_preferred_ones_take_their_place() {
        let reader = Reader::keeping(2);
        let reads = |frames: &[usize]| -> Vec<bool> {
            frames.iter().map(|frame| reader.reads(*frame, &reader.usual)).collect()
        };
        assert_eq!(reads(&[0, 1, 2, 0, 1, 2]), [true, true, true, false, false, true]);
        reader.captures.prefer(&[5, 0]);
        assert_eq!(reads(&[0, 5, 1, 0, 5, 1]), [false, true, true, false, false, true]);
    }

    #[test]
    fn a_capture_in_other_coordinates_is_another_one() {
        let reader = Reader::keeping(2);
        let moved = FitFromInput { translation: DVec3::Y, ..reader.usual };
        assert!(reader.reads(0, &reader.usual) && reader.reads(0, &moved));
        assert!(!reader.reads(0, &moved) && reader.reads(0, &reader.usual));
    }
}
