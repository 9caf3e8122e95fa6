//! Pages that talk back to the program: served over real sockets, clicked and typed on in a headless Chromium.
#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers stand outside test functions"
)]

mod browser;
mod dressed_people;
mod dressing_room;
mod registered_people;
mod review;
mod server;
