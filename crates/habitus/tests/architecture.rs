//! The rules of ARCHITECTURE.md that a program can check: which module may use which, and that pages tell the truth.
//! Crate edges and licences are checked by `ci/architecture`.
#![allow(clippy::unwrap_used, reason = "an unreadable source tree is a failed test")]

#[path = "architecture/documents.rs"]
mod documents;
#[path = "architecture/layers.rs"]
mod layers;
#[path = "architecture/source_rules.rs"]
mod source_rules;
#[path = "architecture/source_tree.rs"]
mod source_tree;
