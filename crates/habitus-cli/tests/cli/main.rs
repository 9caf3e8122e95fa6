//! The command as a person uses it: files in, files, messages and exit codes out.
#![allow(clippy::expect_used, clippy::panic, reason = "test helpers stand outside test functions")]

mod bench;
mod benchmark;
mod hostile_files;
mod landmarks;
mod odd_scenes;
mod resume;
mod sequence;
mod shapes;
mod texts;
