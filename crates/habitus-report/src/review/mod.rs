//! The page on which a person accepts and rejects registrations (P1 §3.3), worst first.
//!
//! The page is static; it asks its server for [`ReviewList`] and, scan by scan, for [`registration_block`].

mod block;
mod list;

pub use block::{ScanView, registration_block};
pub use list::{Criterion, ReviewList, ReviewRow};

use crate::report::markup::escaped;

/// The parts of the one script, in the order in which they need each other.
const SCRIPTS: [&str; 6] = [
    include_str!("../../assets/linear_algebra.js"),
    include_str!("../../assets/blocks.js"),
    include_str!("../../assets/shaders.js"),
    include_str!("../../assets/viewer.js"),
    include_str!("../../assets/controls.js"),
    include_str!("../../assets/review.js"),
];

/// The page; it loads `style.css` and `review.js` from beside itself.
pub fn page(title: &str) -> String {
    include_str!("../../assets/review.html").replace("{{title}}", &escaped(title))
}

/// Its style sheet.
pub fn style() -> String {
    [include_str!("../../assets/style.css"), include_str!("../../assets/review.css")].concat()
}

/// Its script.
pub fn script() -> String {
    SCRIPTS.join("\n")
}
