//! The list of the review page: scans, criteria to sort by, verdicts and notes.

use std::collections::BTreeMap;

use habitus::artifacts::review_decisions::{ReviewDecisions, Verdict};
use habitus::evaluation::registration_ranking::{RankedRegistration, RankingConfig, RankingPart};
use serde::Serialize;

use crate::render::ColorScale;

/// Steps of the heat map's colour table.
const HEAT_STEPS: usize = 256;

/// Something that scans are sorted by, worst first.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Criterion {
    /// Its name in the data.
    pub key: &'static str,
    /// Its name beside a value.
    pub label: &'static str,
    /// Its name as a choice.
    pub choice: &'static str,
    /// What it is, in a sentence.
    pub title: &'static str,
    /// Unit of its values.
    pub unit: &'static str,
    /// Digits after the point.
    pub decimals: usize,
}

const fn criterion(
    key: &'static str,
    label: &'static str,
    choice: &'static str,
    title: &'static str,
    unit: &'static str,
    decimals: usize,
) -> Criterion {
    Criterion { key, label, choice, title, unit, decimals }
}

/// The criteria; the first is the joint score, and the last, the name, has no value.
const CRITERIA: [Criterion; 9] = [
    criterion("score", "Score", "Score", "All parts joined: 1 is where it stops being acceptable", "", 2),
    criterion(
        "worst_patch",
        "Worst patch",
        "Worst patch",
        "Largest mean distance over a patch of the surface",
        "mm",
        1,
    ),
    criterion("flipped_faces", "Flipped", "Flipped faces", "Faces that lie inside out", "", 0),
    criterion(
        "edges",
        "Edges",
        "Edge distortion",
        "Stretch or squeeze of edges at the outer percentiles",
        "×",
        2,
    ),
    criterion(
        "mahalanobis",
        "Unusual",
        "Unusual shape",
        "Root mean square of the identity in standard deviations",
        "σ",
        2,
    ),
    criterion("landmarks", "Landmarks", "Landmarks", "Mean distance of landmarks", "mm", 1),
    criterion("code", "Codes", "Codes", "A code says that it must not be used unseen", "", 0),
    criterion("mean", "Mean", "Mean distance", "Mean distance of the scan's points", "mm", 2),
    criterion("name", "Name", "Name", "By name", "", 0),
];

/// One scan in the list.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct ReviewRow {
    /// Name of the scan.
    pub name: String,
    /// Verdict on this registration.
    pub verdict: Option<Verdict>,
    /// Verdict on another registration of the same scan.
    pub earlier_verdict: Option<Verdict>,
    /// The person's note.
    pub note: String,
    /// Value of each criterion.
    pub values: BTreeMap<&'static str, Option<f64>>,
    /// Each part over what is acceptable.
    pub shares: BTreeMap<&'static str, f64>,
}

/// What the page shows.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct ReviewList {
    /// What can be sorted by.
    pub criteria: Vec<Criterion>,
    /// The scans.
    pub scans: Vec<ReviewRow>,
    /// Colours of the error map from inside to outside, as screen values.
    pub heat_colors: Vec<[u8; 3]>,
}

impl ReviewList {
    /// The list for a ranking, with what has been decided so far.
    pub fn new(ranking: &[RankedRegistration], config: &RankingConfig, decisions: &ReviewDecisions) -> Self {
        Self {
            criteria: CRITERIA.to_vec(),
            scans: ranking.iter().map(|ranked| row(ranked, config, decisions)).collect(),
            // Inside the scan is warm and outside is cool, as for clearance seen from the other side.
            heat_colors: ColorScale { low_mm: -1.0, high_mm: 1.0 }.table(HEAT_STEPS),
        }
    }
}

fn row(ranked: &RankedRegistration, config: &RankingConfig, decisions: &ReviewDecisions) -> ReviewRow {
    let decision = decisions.of(&ranked.name);
    let verdict = decision.and_then(|decision| decision.verdict_on(&ranked.registration));
    let parts = &ranked.parts;
    let score = parts.score(config);
    let finite = |value: f64| value.is_finite().then_some(value);
    let values = [
        ("score", finite(score)),
        ("worst_patch", parts.worst_patch_mm.and_then(finite)),
        ("flipped_faces", Some(parts.flipped_faces as f64)),
        ("edges", finite(parts.edge_factor)),
        ("mahalanobis", parts.mahalanobis.and_then(finite)),
        ("landmarks", parts.landmark_mm.and_then(finite)),
        ("code", parts.has_failure_code.then_some(1.0)),
        ("mean", finite(ranked.mean_mm)),
    ];
    let shares = parts.shares(config).map(|(part, share)| (key_of(part), share));
    ReviewRow {
        name: ranked.name.clone(),
        verdict,
        earlier_verdict: decision.and_then(|decision| decision.verdict).filter(|_| verdict.is_none()),
        note: decision.map_or(String::new(), |decision| decision.note.clone()),
        values: values.into(),
        shares: shares.into_iter().chain([("score", score)]).collect(),
    }
}

fn key_of(part: RankingPart) -> &'static str {
    match part {
        RankingPart::WorstPatch => "worst_patch",
        RankingPart::FlippedFaces => "flipped_faces",
        RankingPart::Edges => "edges",
        RankingPart::Mahalanobis => "mahalanobis",
        RankingPart::Landmarks => "landmarks",
        RankingPart::Code => "code",
    }
}

#[cfg(test)]
mod tests {
    use habitus::artifacts::review_decisions::{Decision, ReviewDecisions, Verdict};
    use habitus::evaluation::registration_ranking::{RankedRegistration, RankingConfig, RankingParts};

    use super::ReviewList;

    #[test]
    fn every_criterion_has_a_value_and_verdicts_belong_to_their_registration() {
        let ranked = |name: &str| RankedRegistration {
            name: name.into(),
            registration: "now".into(),
            mean_mm: 0.8,
            parts: RankingParts { worst_patch_mm: Some(12.0), edge_factor: 1.1, ..RankingParts::default() },
            within: Vec::new(),
        };
        let mut decisions = ReviewDecisions::default();
        for (scan, about) in [("a", "now"), ("b", "before")] {
            decisions.set(Decision {
                scan: scan.into(),
                verdict: Some(Verdict::Reject),
                note: "arm".into(),
                registration: Some(about.into()),
            });
        }
        let list = ReviewList::new(&["a", "b", "c"].map(ranked), &RankingConfig::default(), &decisions);
        let verdicts: Vec<_> = list.scans.iter().map(|scan| (scan.verdict, scan.earlier_verdict)).collect();
        let rejected = Some(Verdict::Reject);
        assert_eq!(verdicts, [(rejected, None), (None, rejected), (None, None)]);
        assert_eq!(list.scans[1].note, "arm");
        for criterion in list.criteria.iter().filter(|criterion| criterion.key != "name") {
            assert!(list.scans[0].values.contains_key(criterion.key), "{}", criterion.key);
        }
        assert_eq!(list.scans[0].values["mahalanobis"], None);
        let json = serde_json::to_string(&list).expect("JSON");
        assert!(json.contains(r#""earlierVerdict":"reject""#) && json.contains(r#""heatColors":[["#));
    }
}
