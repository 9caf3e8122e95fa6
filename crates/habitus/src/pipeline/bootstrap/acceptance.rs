//! Which registrations of a round are learnt from: a person's word first, then the score.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::BootstrapConfig;
use crate::artifacts::review_decisions::{ReviewDecisions, Verdict};
use crate::artifacts::write_atomically;
use crate::evaluation::registration_ranking::{RankedRegistration, RankingConfig};
use crate::pipeline::InputKey;

/// Who passed in a round. Once the next round has begun it stays as it is: what a person then says is about newer
/// registrations of the same scans.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Acceptance {
    /// What it was decided from, but for the person's decisions.
    key: String,
    /// Names of the accepted scans in order.
    pub accepted: Vec<String>,
    /// How many of them a person accepted.
    pub accepted_by_person: usize,
    /// Rejected scans with the reason.
    pub rejected: BTreeMap<String, String>,
}

impl Acceptance {
    /// Decides about all registrations of a round.
    pub fn decide(
        ranking: &[RankedRegistration],
        decisions: &ReviewDecisions,
        config: &BootstrapConfig,
        review: &RankingConfig,
    ) -> Self {
        let mut all = Self { key: key(ranking, config, review), ..Self::default() };
        for ranked in ranking {
            let decision = decisions.of(&ranked.name);
            let score = ranked.parts.score(review);
            match decision.and_then(|decision| decision.verdict_on(&ranked.registration)) {
                Some(Verdict::Accept) => {
                    all.accepted.push(ranked.name.clone());
                    all.accepted_by_person += 1;
                }
                Some(Verdict::Reject) => {
                    let note = decision.map_or("", |decision| decision.note.as_str());
                    let reason = if note.is_empty() { "rejected by a person" } else { note };
                    all.rejected.insert(ranked.name.clone(), reason.into());
                }
                None if score < config.accept_below => all.accepted.push(ranked.name.clone()),
                None => {
                    let reason = format!("score {score:.2}: {}", ranked.parts.worst_part(review).words());
                    all.rejected.insert(ranked.name.clone(), reason);
                }
            }
        }
        all.accepted.sort_unstable();
        all
    }

    /// What was decided before from the same registrations and settings, if anything.
    pub fn read(
        path: &Path,
        ranking: &[RankedRegistration],
        config: &BootstrapConfig,
        review: &RankingConfig,
    ) -> Option<Self> {
        let text = std::fs::read_to_string(path).ok()?;
        let found: Self = serde_json::from_str(&text).ok()?;
        (found.key == key(ranking, config, review)).then_some(found)
    }

    /// Keeps it.
    pub fn write(&self, path: &Path) -> std::io::Result<()> {
        let text = serde_json::to_string_pretty(self)?;
        write_atomically(path, (text + "\n").as_bytes())
    }
}

fn key(ranking: &[RankedRegistration], config: &BootstrapConfig, review: &RankingConfig) -> String {
    let mut key = InputKey::new();
    key.add_bytes(&config.accept_below.to_le_bytes());
    for ranked in ranking {
        key.add_text(&ranked.name);
        key.add_text(&ranked.registration);
        key.add_bytes(&ranked.parts.score(review).to_le_bytes());
    }
    key.text()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifacts::review_decisions::Decision;
    use crate::evaluation::registration_ranking::RankingParts;

    fn ranked(name: &str, patch_mm: f64) -> RankedRegistration {
        RankedRegistration {
            name: name.into(),
            registration: "now".into(),
            mean_mm: 1.0,
            parts: RankingParts {
                worst_patch_mm: Some(patch_mm),
                edge_factor: 1.0,
                ..RankingParts::default()
            },
            within: Vec::new(),
        }
    }

    #[test]
    fn a_persons_word_comes_before_the_score_while_it_is_about_this_registration() {
        let (config, review) = (BootstrapConfig::default(), RankingConfig::default());
        let ranking = ["a", "b", "c", "d"].map(|name| ranked(name, if name < "c" { 100.0 } else { 0.1 }));
        let mut decisions = ReviewDecisions::default();
        for (scan, verdict, about) in
            [("a", Verdict::Accept, "now"), ("b", Verdict::Accept, "before"), ("d", Verdict::Reject, "now")]
        {
            let registration = Some(about.to_string());
            decisions.set(Decision {
                scan: scan.into(),
                verdict: Some(verdict),
                note: "hm".into(),
                registration,
            });
        }
        let found = Acceptance::decide(&ranking, &decisions, &config, &review);
        assert_eq!(found.accepted, ["a", "c"]);
        assert_eq!(found.accepted_by_person, 1);
        assert_eq!(found.rejected["d"], "hm");
        assert!(found.rejected["b"].contains("patch"), "{:?}", found.rejected);
    }

    #[test]
    fn it_is_kept_for_the_same_registrations_and_settings_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("accepted.json");
        let (config, review) = (BootstrapConfig::default(), RankingConfig::default());
        let ranking = [ranked("a", 1.0), ranked("b", 2.0)];
        let found = Acceptance::decide(&ranking, &ReviewDecisions::default(), &config, &review);
        found.write(&path).unwrap();
        assert_eq!(Acceptance::read(&path, &ranking, &config, &review), Some(found));
        let stricter = BootstrapConfig { accept_below: 0.1, ..config.clone() };
        assert_eq!(Acceptance::read(&path, &ranking, &stricter, &review), None);
        let other = [ranked("a", 1.0), RankedRegistration { registration: "new".into(), ..ranked("b", 2.0) }];
        assert_eq!(Acceptance::read(&path, &other, &config, &review), None);
    }
}
