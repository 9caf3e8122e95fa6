//! The command as a person uses it: files in, files, messages and exit codes out.
#![allow(clippy::expect_used, clippy::panic, reason = "test helpers stand outside test functions")]

mod bench;
mod hostile_files;
mod odd_scenes;
mod resume;
mod sequence;
mod shapes;
mod texts;
