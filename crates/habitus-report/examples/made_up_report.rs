//! Writes the report of a made-up run, for work on the page: `cargo run --example made_up_report -- report.html [frames]`.

#[path = "../tests/capsule_person/mod.rs"]
mod capsule_person;
#[path = "../tests/made_up_run/mod.rs"]
mod made_up_run;

use habitus_report::report::{ReportError, ReportOptions, write_report};

fn main() -> Result<(), ReportError> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().unwrap_or_else(|| "report.html".to_owned());
    let frame_count = arguments.next().and_then(|text| text.parse().ok()).unwrap_or(36);
    write_report(path.as_ref(), &made_up_run::made_up_run(frame_count, 32), &ReportOptions::default())
}
