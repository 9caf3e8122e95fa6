//! The command as a person uses it: files in, files, messages and exit codes out.

mod bench;
mod hostile_files;
mod odd_scenes;
mod resume;
mod sequence;
mod shapes;
mod texts;
