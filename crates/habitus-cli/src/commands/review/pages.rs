//! What the review's server answers.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use habitus::artifacts::review_decisions::{Decision, DecisionsError, ReviewDecisions, Verdict};
use habitus::evaluation::registration_ranking::{RankedRegistration, RankingConfig};
use habitus::pipeline::RegisteredRun;
use habitus_report::review::{self, ReviewList, ScanView, registration_block};
use serde::Deserialize;

use crate::local_server::{Answer, Method, Request};

/// The pages and data of one review.
pub struct ReviewPages<'a> {
    title: String,
    decisions_file: PathBuf,
    /// One click after the other, each on the file as it then is.
    writing: Mutex<()>,
    registered: &'a RegisteredRun,
    ranking: &'a [RankedRegistration],
    place_of_scan: HashMap<&'a str, usize>,
    config: &'a RankingConfig,
}

/// What the page sends when something is decided.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Click {
    scan: String,
    verdict: Option<Verdict>,
    #[serde(default)]
    note: String,
}

impl<'a> ReviewPages<'a> {
    /// Pages for a ranking; decisions that cannot be read are said now, before a person starts.
    pub fn new(
        run: &Path,
        registered: &'a RegisteredRun,
        ranking: &'a [RankedRegistration],
        config: &'a RankingConfig,
    ) -> anyhow::Result<Self> {
        let decisions_file = run.join(ReviewDecisions::FILE);
        ReviewDecisions::read(&decisions_file)?;
        let title = std::path::absolute(run).unwrap_or_else(|_| run.to_path_buf());
        let title = title.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let places = ranking.iter().enumerate();
        let place_of_scan = places.map(|(place, ranked)| (ranked.name.as_str(), place)).collect();
        Ok(Self {
            title,
            decisions_file,
            writing: Mutex::new(()),
            registered,
            ranking,
            place_of_scan,
            config,
        })
    }

    /// The answer to a request.
    pub fn answer(&self, request: &Request) -> Answer {
        match (request.method, request.parts().as_slice()) {
            (Method::Get, []) => Answer::page(review::page(&self.title)),
            (Method::Get, ["style.css"]) => Answer::style(review::style()),
            (Method::Get, ["review.js"]) => Answer::script(review::script()),
            (Method::Get, ["api", "scans"]) => match ReviewDecisions::read(&self.decisions_file) {
                Ok(decisions) => Answer::json(&ReviewList::new(self.ranking, self.config, &decisions)),
                Err(error) => Answer::refusal(500, error.to_string()),
            },
            (Method::Get, ["api", "registration", name]) => self.registration(name),
            (Method::Post, ["api", "decision"]) => self.decide(&request.body),
            (Method::Post, ["api", "finish"]) => Answer::json(&"finished").and_end(),
            _ => Answer::not_found(),
        }
    }

    fn ranked(&self, name: &str) -> Option<&RankedRegistration> {
        self.place_of_scan.get(name).map(|place| &self.ranking[*place])
    }

    fn registration(&self, name: &str) -> Answer {
        let Some(ranked) = self.ranked(name) else { return Answer::not_found() };
        match self.registered.pair(name) {
            Ok(pair) => Answer::binary(registration_block(
                &ScanView {
                    name,
                    registration: &pair.registration,
                    scan: &pair.scan,
                    worst_vertex: ranked.parts.worst_vertex,
                    upright: self.registered.upright(),
                },
                self.config,
            )),
            Err(error) => Answer::refusal(500, error.to_string()),
        }
    }

    fn decide(&self, body: &str) -> Answer {
        let click: Click = match serde_json::from_str(body) {
            Ok(click) => click,
            Err(error) => return Answer::refusal(400, format!("this is no decision ({error})")),
        };
        let Some(ranked) = self.ranked(&click.scan) else { return Answer::not_found() };
        let Ok(_turn) = self.writing.lock() else {
            return Answer::refusal(500, "an earlier decision failed; start the review again");
        };
        match self.keep(click, &ranked.registration) {
            Ok(()) => Answer::json(&"kept"),
            Err(error) => Answer::refusal(500, error.to_string()),
        }
    }

    fn keep(&self, click: Click, registration: &str) -> Result<(), DecisionsError> {
        let Click { scan, verdict, note } = click;
        let earlier = ReviewDecisions::read(&self.decisions_file)?;
        // A note alone is about the scan, and so stays what a person wrote about it in every round; any other verdict is
        // about the registration that was looked at.
        let is_general = earlier
            .of(&scan)
            .is_some_and(|decision| decision.verdict == verdict && decision.registration.is_none());
        let registration = verdict.filter(|_| !is_general).map(|_| registration.to_string());
        let decision = Decision { scan, verdict, note: note.trim().to_string(), registration };
        ReviewDecisions::update(&self.decisions_file, decision).map(drop)
    }
}
