//! Captures that are needed more than once, kept in memory as long as they are few triangles together.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use super::captured_frame::{CapturedFrame, FitFromInput, LimbSearch};
use super::{FitSequenceError, Stage};

/// Loads captures and keeps the first of them. Memory is bounded by `frame.kept_primitives`, whatever the sequence.
pub(super) struct KeptCaptures<'a> {
    stage: &'a Stage<'a>,
    fit_from_input: FitFromInput,
    limbs: LimbSearch,
    kept: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    captures: BTreeMap<usize, Arc<CapturedFrame>>,
    primitives: usize,
}

impl<'a> KeptCaptures<'a> {
    pub fn new(stage: &'a Stage<'a>, fit_from_input: FitFromInput, limbs: LimbSearch) -> Self {
        Self { stage, fit_from_input, limbs, kept: Mutex::default() }
    }

    /// The capture of a frame: kept from an earlier call or read afresh, which makes no difference to what is in it.
    pub fn load(&self, frame: usize) -> Result<Arc<CapturedFrame>, FitSequenceError> {
        let lock = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(capture) = lock().captures.get(&frame) {
            return Ok(Arc::clone(capture));
        }
        let capture = Arc::new(self.stage.load_with(frame, &self.fit_from_input, self.limbs)?);
        let primitives = capture.index.primitive_count();
        let mut kept = lock();
        if kept.primitives + primitives <= self.stage.config.frame.kept_primitives {
            kept.primitives += primitives;
            kept.captures.insert(frame, Arc::clone(&capture));
        }
        Ok(capture)
    }
}
