//! Runs the command and keeps one generated and fitted sequence for all tests to look at.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use tempfile::TempDir;

/// Frames of the shared sequence.
pub const FRAMES: usize = 5;

/// Settings that make and fit a sequence in seconds; what they change is accuracy only.
pub const QUICK: [&str; 8] = [
    "generate.outfit=tight",
    "generate.settle_seconds=0.2",
    "generate.garment.cloth_edge_mm=40.0",
    "generate.capture.camera_count=12",
    "generate.capture.image_height=288",
    "generate.capture.voxel_mm=24.0",
    "fit_sequence.components=12",
    "fit_sequence.refine.passes=1",
];

/// The built command.
pub fn habitus() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_habitus"));
    command.env("COLUMNS", "100").env_remove("RUST_BACKTRACE");
    command
}

/// What a finished command said.
#[derive(Debug)]
pub struct Answer {
    /// Exit code; none after a signal.
    pub code: Option<i32>,
    /// Standard output.
    pub result: String,
    /// Standard error.
    pub messages: String,
}

impl Answer {
    fn of(output: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self { code: output.status.code(), result: text(&output.stdout), messages: text(&output.stderr) }
    }

    /// Checks the exit code, and that nothing panicked.
    #[track_caller]
    pub fn expect(self, code: i32) -> Self {
        assert!(!self.messages.contains("panicked"), "{self:#?}");
        assert_eq!(self.code, Some(code), "{self:#?}");
        self
    }
}

/// Runs the command with these words.
pub fn run<Word: AsRef<std::ffi::OsStr>>(words: &[Word]) -> Answer {
    Answer::of(&habitus().args(words).output().expect("the command starts"))
}

/// Words from texts and paths.
#[macro_export]
macro_rules! words {
    ($($word:expr),* $(,)?) => {
        &[$(std::ffi::OsString::from(&$word)),*] as &[std::ffi::OsString]
    };
}

/// `--set` for each of the quick settings.
pub fn quick_settings() -> Vec<String> {
    QUICK.iter().flat_map(|setting| ["--set".to_string(), setting.to_string()]).collect()
}

/// A sequence that was made and fitted once.
pub struct Fitted {
    _folder: TempDir,
    /// Captures and truth.
    pub captures: PathBuf,
    /// The run folder.
    pub run: PathBuf,
    /// What the fit said.
    pub answer: Answer,
}

/// Fits the shared captures into another run folder.
pub fn fit_into(captures: &Path, run: &Path, more: &[&str]) -> Answer {
    let mut command = habitus();
    command.arg("fit-sequence").arg(captures).arg("-o").arg(run).args(quick_settings()).args(more);
    Answer::of(&command.output().expect("the command starts"))
}

/// The shared sequence; the first test that asks makes it.
pub fn fitted() -> &'static Fitted {
    static FITTED: OnceLock<Fitted> = OnceLock::new();
    FITTED.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let (captures, run) = (folder.path().join("captures"), folder.path().join("run"));
        let mut command = habitus();
        command.args(["generate", "--frames", &FRAMES.to_string(), "-o"]).arg(&captures);
        let made = Answer::of(&command.args(quick_settings()).output().expect("the command starts"));
        made.expect(0);
        let answer = fit_into(&captures, &run, &["--frame-rate", "25"]).expect(0);
        Fitted { _folder: folder, captures, run, answer }
    })
}
