//! Recipes: each stage takes and gives artifacts, has its own config and error, and knows no other stage.

pub mod extract_clothing;
pub mod fit_sequence;
pub mod learn_clothing;
pub mod learn_shape;
pub mod measure;
pub mod reconstruct;
pub mod register;
pub mod synthesize;
