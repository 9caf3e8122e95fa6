//! A progress bar with the time that is left; hidden where nobody watches.

use habitus::optimize::{Event, Flow, Observer};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::clock::StageClock;
use crate::console::Console;

/// A bar for one kind of work after the other.
pub struct StageBar {
    bar: ProgressBar,
    stage: &'static str,
}

impl StageBar {
    /// A bar that waits for its first stage.
    pub fn new(console: &Console) -> Self {
        let target =
            if console.is_quiet() { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        Self { bar: ProgressBar::with_draw_target(None, target), stage: "" }
    }

    /// Shows how far a stage is.
    pub fn show(&mut self, stage: &'static str, done: usize, total: usize) {
        if stage != self.stage {
            self.stage = stage;
            self.bar.reset();
            let template = "{msg:>8} {bar:30} {pos}/{len}  {elapsed} gone, about {eta} left";
            if let Ok(style) = ProgressStyle::with_template(template) {
                self.bar.set_style(style);
            }
            self.bar.set_message(stage);
        }
        self.bar.set_length(total as u64);
        self.bar.set_position(done as u64);
    }

    /// Removes the bar.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }
}

/// Hears the library: moves the bar and the clock.
pub struct RunObserver<'a> {
    /// The bar.
    pub bar: StageBar,
    /// The clock.
    pub clock: &'a mut StageClock,
}

impl Observer for RunObserver<'_> {
    fn on_event(&mut self, event: &Event) -> Flow {
        if let Event::Progress { stage, done, total } = event {
            self.clock.hear(stage, *done);
            self.bar.show(stage, *done, *total);
        }
        Flow::Continue
    }
}
