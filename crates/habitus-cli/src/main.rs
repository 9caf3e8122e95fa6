//! The habitus command.
fn main() {}
