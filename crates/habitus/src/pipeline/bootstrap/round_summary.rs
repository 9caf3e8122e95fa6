//! What is kept of each round: pass counts and curves as in P1 §4.5 and Fig. 2.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::acceptance::Acceptance;
use crate::artifacts::write_atomically;
use crate::evaluation::registration_ranking::{RankedRegistration, RankingConfig};

/// A point of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Distance, millimetres.
    pub within_mm: f64,
    /// Mean over all compared scans of the share of registered vertices that are nearer to the scan.
    pub share: f64,
}

/// The contents of `rounds/<k>/summary.json`. The names of its keys are a contract.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoundSummary {
    /// The round, counted from 0 as in P1 §4.5.
    pub round: usize,
    /// Scans that were given.
    pub scans: usize,
    /// Scans that could not be registered at all.
    pub failed: Vec<String>,
    /// Registrations that passed, and that the round's space is learnt from.
    pub passed: usize,
    /// How many of them a person accepted.
    pub accepted_by_person: usize,
    /// Registrations that did not pass, worst first.
    pub rejected: Vec<RejectedScan>,
    /// Mean over registrations of the mean distance from scan points to the registration, millimetres.
    pub point_to_surface_mm: f64,
    /// Mean over registrations of the largest mean residual of a patch, millimetres.
    pub worst_patch_mm: f64,
    /// Median score.
    pub median_score: f64,
    /// Share of vertices within distances, over all registrations (P1 Fig. 2a).
    pub curve: Vec<CurvePoint>,
    /// Components of the space that was learnt.
    pub components: usize,
    /// Wall-clock seconds of the round's own work, without what an earlier run had finished.
    pub seconds: f64,
}

/// A registration that did not pass.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RejectedScan {
    /// Name of the scan.
    pub scan: String,
    /// Its score.
    pub score: f64,
    /// Why.
    pub reason: String,
}

impl RoundSummary {
    /// Sums up a round. Time is the caller's to measure.
    pub(super) fn new(
        round: usize,
        ranking: &[RankedRegistration],
        failed: Vec<String>,
        acceptance: &Acceptance,
        review: &RankingConfig,
    ) -> Self {
        let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let scores: Vec<f64> = ranking.iter().map(|ranked| ranked.parts.score(review)).collect();
        let rejected = ranking.iter().zip(&scores).filter_map(|(ranked, score)| {
            let reason = acceptance.rejected.get(&ranked.name)?.clone();
            Some(RejectedScan { scan: ranked.name.clone(), score: *score, reason })
        });
        let curve = review.curve_mm.iter().enumerate().map(|(place, within_mm)| CurvePoint {
            within_mm: *within_mm,
            share: mean(ranking.iter().filter_map(|ranked| ranked.within.get(place).copied()).collect()),
        });
        Self {
            round,
            scans: ranking.len() + failed.len(),
            failed,
            passed: acceptance.accepted.len(),
            accepted_by_person: acceptance.accepted_by_person,
            rejected: rejected.collect(),
            point_to_surface_mm: mean(ranking.iter().map(|ranked| ranked.mean_mm).collect()),
            worst_patch_mm: mean(ranking.iter().filter_map(|ranked| ranked.parts.worst_patch_mm).collect()),
            // The ranking is sorted by score.
            median_score: scores.get(scores.len() / 2).copied().unwrap_or(0.0),
            curve: curve.collect(),
            components: 0,
            seconds: 0.0,
        }
    }

    /// Writes it.
    pub fn write(&self, path: &Path) -> std::io::Result<()> {
        let text = serde_json::to_string_pretty(self)?;
        write_atomically(path, (text + "\n").as_bytes())
    }

    /// Reads it.
    pub fn read(path: &Path) -> std::io::Result<Self> {
        Ok(serde_json::from_str(&std::fs::read_to_string(path)?)?)
    }
}
