//! Where the time of a run goes; the library keeps no clock.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use habitus::artifacts::frames::{FrameError, FrameSource};
use habitus::geometry::Surface;
use habitus::pipeline::Seconds;

/// Adds up the seconds of a run by part.
pub struct StageClock {
    begin: Instant,
    last: Instant,
    seconds: Seconds,
    frames: Vec<f64>,
}

impl StageClock {
    /// Starts now.
    pub fn start() -> Self {
        let now = Instant::now();
        Self { begin: now, last: now, seconds: Seconds::default(), frames: Vec::new() }
    }

    /// Begins a part: what passed since the last event belongs to none of them.
    pub fn skip(&mut self) {
        self.last = Instant::now();
    }

    /// The library says that a part of `stage` is done.
    pub fn hear(&mut self, stage: &str, done: usize) {
        let passed = self.last.elapsed().as_secs_f64();
        self.skip();
        match stage {
            "start" => self.seconds.start += passed,
            "track" => {
                self.seconds.track += passed;
                // Several frames may be reported at once; they share the time.
                let news = done.saturating_sub(self.frames.len()).max(1);
                self.frames.resize(done.max(self.frames.len()), passed / news as f64);
            }
            "second look" => self.seconds.track += passed,
            _ => self.seconds.refine += passed,
        }
    }

    /// Frames that an earlier run has tracked cost this one nothing.
    pub fn skip_frames(&mut self, count: usize) {
        self.frames.resize(count, 0.0);
    }

    /// Adds time spent on files.
    pub fn add_io(&mut self, duration: Duration) {
        self.seconds.io += duration.as_secs_f64();
    }

    /// Seconds spent on tracking each frame.
    pub fn frame_seconds(&self) -> &[f64] {
        &self.frames
    }

    /// All seconds up to now.
    pub fn seconds(&self) -> Seconds {
        Seconds { total: self.begin.elapsed().as_secs_f64(), ..self.seconds }
    }
}

/// Times the reading of frames and keeps what was wrong with them.
pub struct TimedFrames<'a> {
    source: &'a dyn FrameSource,
    nanoseconds: AtomicU64,
    errors: Mutex<BTreeMap<usize, String>>,
}

impl<'a> TimedFrames<'a> {
    /// Wraps a source.
    pub fn new(source: &'a dyn FrameSource) -> Self {
        Self { source, nanoseconds: AtomicU64::new(0), errors: Mutex::new(BTreeMap::new()) }
    }

    /// Time spent on reading, over all threads.
    pub fn reading_time(&self) -> Duration {
        Duration::from_nanos(self.nanoseconds.load(Ordering::Relaxed))
    }

    /// What was wrong with a frame that could not be read.
    pub fn error(&self, frame: usize) -> Option<String> {
        self.errors.lock().ok()?.get(&frame).cloned()
    }
}

impl FrameSource for TimedFrames<'_> {
    fn len(&self) -> usize {
        self.source.len()
    }

    fn name(&self, frame: usize) -> String {
        self.source.name(frame)
    }

    fn surface(&self, frame: usize) -> Result<Surface, FrameError> {
        let begin = Instant::now();
        let surface = self.source.surface(frame);
        let passed = u64::try_from(begin.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.nanoseconds.fetch_add(passed, Ordering::Relaxed);
        if let (Err(error), Ok(mut errors)) = (&surface, self.errors.lock()) {
            errors.insert(frame, error.to_string());
        }
        surface
    }
}
