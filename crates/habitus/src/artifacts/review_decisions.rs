//! What a person decided about registrations (P1 §3.3): a plain file that an editor can change as well as the page.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::write_atomically;

/// Why decisions cannot be read or kept.
#[derive(Debug, Error)]
pub enum DecisionsError {
    /// The file cannot be read.
    #[error("{}: the decisions cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file is not what it should be.
    #[error("{}: these are no decisions ({reason}); each is a table [[decision]] with scan, verdict (accept or reject) and, if you like, note", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong, with its line.
        reason: String,
    },
    /// Two decisions about one scan.
    #[error("{}: two decisions are about the scan '{scan}'; keep one", path.display())]
    Twice {
        /// The file.
        path: PathBuf,
        /// The scan.
        scan: String,
    },
    /// The file cannot be written.
    #[error("{}: the decisions cannot be written ({source})", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
}

/// Whether a registration may be learnt from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It may.
    Accept,
    /// It must not.
    Reject,
}

/// What was decided about one scan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Decision {
    /// Name of the scan.
    pub scan: String,
    /// The verdict; none yet where there is only a note.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
    /// What the person wants to remember.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
    /// Fingerprint of the registration that the verdict is about. With it, the verdict ends when the scan is
    /// registered anew; without it, as a person would write it, the verdict is about the scan in every round.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub registration: Option<String>,
}

impl Decision {
    /// The verdict on a registration with this fingerprint.
    pub fn verdict_on(&self, registration: &str) -> Option<Verdict> {
        self.verdict.filter(|_| self.registration.as_deref().is_none_or(|about| about == registration))
    }
}

/// All decisions, in the order in which they were made first.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReviewDecisions {
    decisions: Vec<Decision>,
    place_of_scan: HashMap<String, usize>,
}

/// The file as TOML.
#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default, rename = "decision")]
    decisions: Vec<Decision>,
}

/// Stands at the top of the file.
const PREFACE: &str = "\
# Which registrations may be learnt from; written by habitus review, read by habitus bootstrap, yours to edit.
# A verdict is \"accept\" or \"reject\". Without the line `registration` it holds in every round; with it, until the
# scan is registered anew.
";

impl ReviewDecisions {
    /// Name of the file in a run folder.
    pub const FILE: &'static str = "decisions.toml";

    /// Reads the file; no file means no decisions yet.
    pub fn read(path: &Path) -> Result<Self, DecisionsError> {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(source) if source.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(source) => return Err(DecisionsError::Unreadable { path: path.to_path_buf(), source }),
        };
        let file: File = toml::from_str(&text).map_err(|error| {
            let start = error.span().map_or(0, |span| span.start.min(text.len()));
            let line = text.as_bytes()[..start].iter().filter(|byte| **byte == b'\n').count() + 1;
            let reason = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
            DecisionsError::Malformed { path: path.to_path_buf(), reason: format!("line {line}: {reason}") }
        })?;
        let mut all = Self::default();
        for decision in file.decisions {
            if all.of(&decision.scan).is_some() {
                return Err(DecisionsError::Twice { path: path.to_path_buf(), scan: decision.scan });
            }
            all.set(decision);
        }
        Ok(all)
    }

    /// Writes the file; a kill at any moment leaves the old one or the new one.
    pub fn write(&self, path: &Path) -> Result<(), DecisionsError> {
        let unwritable = |source| DecisionsError::Unwritable { path: path.to_path_buf(), source };
        let file = File { decisions: self.decisions.clone() };
        let tables = toml::to_string(&file).map_err(|error| unwritable(std::io::Error::other(error)))?;
        write_atomically(path, format!("{PREFACE}\n{tables}").as_bytes()).map_err(unwritable)
    }

    /// Changes one decision in the file as it is now, so that what an editor wrote in between stays.
    pub fn update(path: &Path, decision: Decision) -> Result<Self, DecisionsError> {
        let mut all = Self::read(path)?;
        all.set(decision);
        all.write(path)?;
        Ok(all)
    }

    /// The decisions in order.
    pub fn iter(&self) -> impl Iterator<Item = &Decision> {
        self.decisions.iter()
    }

    /// What was decided about a scan.
    pub fn of(&self, scan: &str) -> Option<&Decision> {
        self.place_of_scan.get(scan).map(|place| &self.decisions[*place])
    }

    /// Puts a decision in the place of an earlier one about the same scan; one that says nothing removes it.
    pub fn set(&mut self, decision: Decision) {
        let is_empty = decision.verdict.is_none() && decision.note.is_empty();
        match self.place_of_scan.get(&decision.scan) {
            Some(place) if is_empty => {
                self.decisions.remove(*place);
                let places = self.decisions.iter().enumerate();
                self.place_of_scan = places.map(|(place, kept)| (kept.scan.clone(), place)).collect();
            }
            Some(place) => self.decisions[*place] = decision,
            None if is_empty => {}
            None => {
                self.place_of_scan.insert(decision.scan.clone(), self.decisions.len());
                self.decisions.push(decision);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Decision, DecisionsError, ReviewDecisions, Verdict};

    fn decision(scan: &str, verdict: Option<Verdict>, note: &str) -> Decision {
        Decision { scan: scan.into(), verdict, note: note.into(), registration: None }
    }

    #[test]
    fn decisions_are_read_back_as_written_and_the_file_is_plain() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(ReviewDecisions::FILE);
        assert_eq!(ReviewDecisions::read(&path).unwrap(), ReviewDecisions::default());
        let odd = "left \"hand\"\nis [[decision]] # missing ünïcode";
        let mut all = ReviewDecisions::default();
        all.set(decision("scan_1", Some(Verdict::Reject), odd));
        all.set(decision("scan_2", None, "look again"));
        let about = Some("fnv1a64:12".to_string());
        all.set(Decision { registration: about, ..decision("a b/é", Some(Verdict::Accept), "") });
        all.write(&path).unwrap();
        assert_eq!(ReviewDecisions::read(&path).unwrap(), all);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("[[decision]]\nscan = \"scan_1\"\nverdict = \"reject\""), "{text}");
        assert!(
            text.starts_with('#') && text.contains("[[decision]]\nscan = \"scan_2\"\nnote = \"look again\"")
        );
    }

    #[test]
    fn what_a_person_writes_by_hand_is_enough_and_survives_the_next_click() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(ReviewDecisions::FILE);
        std::fs::write(&path, "[[decision]]\nscan = \"x\"\nverdict = \"accept\"\n").unwrap();
        let all = ReviewDecisions::update(&path, decision("y", Some(Verdict::Reject), "")).unwrap();
        assert_eq!(all, ReviewDecisions::read(&path).unwrap());
        let verdicts: Vec<_> = all.iter().map(|one| (one.scan.as_str(), one.verdict)).collect();
        assert_eq!(verdicts, [("x", Some(Verdict::Accept)), ("y", Some(Verdict::Reject))]);
        // Taking back the last word about a scan removes it, and the others keep their places.
        let all = ReviewDecisions::update(&path, decision("x", None, "")).unwrap();
        assert!(all.of("x").is_none());
        assert_eq!(all.of("y").unwrap().verdict, Some(Verdict::Reject));
    }

    #[test]
    fn a_verdict_on_a_registration_ends_with_it_and_one_on_the_scan_does_not() {
        let on_scan = decision("x", Some(Verdict::Reject), "");
        let on_one = Decision { registration: Some("first".into()), ..on_scan.clone() };
        assert_eq!(on_scan.verdict_on("second"), Some(Verdict::Reject));
        assert_eq!((on_one.verdict_on("first"), on_one.verdict_on("second")), (Some(Verdict::Reject), None));
    }

    #[test]
    fn faults_name_file_and_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(ReviewDecisions::FILE);
        for (text, needle) in [
            ("[[decision]]\nscan = \"x\"\nverdict = \"maybe\"\n", "line 3"),
            ("[[decision]]\nverdict = \"accept\"\n", "scan"),
            ("[[decision]]\nscan = \"x\"\nveredict = \"accept\"\n", "line 3"),
            ("[[decisions]]\nscan = \"x\"\n", "decisions"),
            ("nonsense", "line 1"),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = ReviewDecisions::read(&path).unwrap_err().to_string();
            assert!(message.contains(needle) && message.contains(ReviewDecisions::FILE), "{message}");
        }
        let twice = "[[decision]]\nscan = \"x\"\nnote = \"a\"\n[[decision]]\nscan = \"x\"\nnote = \"b\"\n";
        std::fs::write(&path, twice).unwrap();
        assert!(matches!(ReviewDecisions::read(&path), Err(DecisionsError::Twice { .. })));
    }
}
