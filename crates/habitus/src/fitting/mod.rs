//! fitting
