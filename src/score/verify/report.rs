//! Report over all episodes: scores with confidence intervals, as JSON and as a table.

use std::collections::BTreeMap;

use serde::Serialize;

use super::candidate::Candidate;
use super::episode::Episode;
use crate::error::{Error, Result};
use crate::geometry::Sampling;
use crate::score::agreement::scores::SCORES;
use crate::score::agreement::{Sums, VertexGroups};
use crate::score::metrics::bootstrap;
use crate::tactile::CONTACT_FORCE_N;

/// The scores of each candidate over all episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VerifyReport {
    /// Version of egotac.
    pub version: &'static str,
    /// Seed of the bootstrap resamples.
    pub seed: u64,
    /// Force above which a vertex is touched, N.
    pub contact_force: f64,
    /// Points where forces act, for `false_contact_mass`: `contacts` of the engine, `touched_vertices` instead of them, or
    /// `both` if episodes differ.
    pub force_places: &'static str,
    /// Numbers of frames and touches.
    pub counts: VerifyCounts,
    /// In the order of the table.
    pub candidates: Vec<CandidateReport>,
    /// In the order in which they were given.
    pub episodes: Vec<EpisodeReport>,
    /// Messages of a recording that found no partner.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unmatched: Option<Unmatched>,
}

/// Numbers of frames and touches that were scored.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct VerifyCounts {
    /// Episodes.
    pub episodes: usize,
    /// Frames scored.
    pub frames: u64,
    /// Scored frames with a touched vertex.
    pub touching_frames: u64,
    /// Frames that guards refused, by reason; they are not scored.
    pub refused: BTreeMap<&'static str, u64>,
    /// Touches of links, or of hands where links are not known.
    pub touches: u64,
    /// Force on touched vertices, N, summed over frames.
    pub force: f64,
}

/// Scores of one candidate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CandidateReport {
    /// Name of the candidate.
    pub name: String,
    /// Value and interval by score.
    pub scores: BTreeMap<&'static str, ScoreValue>,
    /// Numbers of onsets and offsets that could be compared.
    pub compared: [u64; 2],
    /// Force error by link, for links with force; empty for a candidate without forces.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub links: BTreeMap<String, LinkForce>,
}

/// A score over all episodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ScoreValue {
    /// None = undefined.
    pub value: Option<f64>,
    /// 95 % interval over episodes; None for fewer than two episodes.
    pub interval: Option<[f64; 2]>,
}

/// Force error on one link.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LinkForce {
    /// Mean true force over frames, N.
    pub mean_force: f64,
    /// Sum of |labelled - true| over frames, over the sum of the true force; None for a link without force.
    pub error: Option<f64>,
}

/// Brief scores of one episode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeReport {
    /// Name of the scene, or path of the source.
    pub name: String,
    /// Seed of the rollout, if there is one.
    pub seed: Option<u64>,
    /// Frames scored.
    pub frames: u64,
    /// Frames refused.
    pub refused: u64,
    /// `frame_mean.f1`, `pooled.f1` and `missed_force` by candidate.
    pub scores: BTreeMap<String, BTreeMap<&'static str, Option<f64>>>,
    /// Sampling density of each object for label (a).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub samplings: Vec<Sampling>,
}

/// Numbers of messages without a partner of the same stamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Unmatched {
    /// Predictions without truth.
    pub predictions: u64,
    /// Truths without prediction.
    pub truths: u64,
}

impl VerifyReport {
    /// Sums up the episodes; `seed` is the seed of the bootstrap.
    ///
    /// # Errors
    /// If no episode has a frame to score.
    pub fn new(candidates: &[Candidate], groups: &VertexGroups, episodes: &[Episode], seed: u64) -> Result<Self> {
        let counts = counts(episodes);
        if counts.frames == 0 {
            let refused: u64 = counts.refused.values().sum();
            return Err(Error::value("frames to score", "at least one", format!("none, {refused} refused by guards")));
        }
        let reports = candidates.iter().enumerate().map(|(index, candidate)| {
            let sums: Vec<&Sums> = episodes.iter().map(|episode| &episode.sums[index]).collect();
            candidate_report(candidate.name(), groups, &sums, seed)
        });
        Ok(Self {
            version: env!("CARGO_PKG_VERSION"),
            seed,
            // Through text: the f32 converted to f64 would be written as 0.05000000074505806.
            contact_force: CONTACT_FORCE_N.to_string().parse().unwrap_or(CONTACT_FORCE_N.into()),
            force_places: match episodes.iter().filter(|episode| episode.has_contacts).count() {
                0 => "touched_vertices",
                all if all == episodes.len() => "contacts",
                _ => "both",
            },
            counts,
            candidates: reports.collect(),
            episodes: episodes.iter().map(|episode| episode_report(candidates, episode)).collect(),
            unmatched: None,
        })
    }

    /// Returns the candidate of the given name; without a name, the prediction or the only candidate.
    ///
    /// # Errors
    /// If there is no such candidate, or several and no name; the error lists the names.
    pub fn candidate(&self, name: Option<&str>) -> Result<&CandidateReport> {
        let names = || self.candidates.iter().map(|candidate| candidate.name.as_str());
        match (name, self.candidates.as_slice()) {
            (None, [only]) => Ok(only),
            (None, [first, ..]) if is_prediction(first) => Ok(first),
            (None, _) => {
                let all = names().collect::<Vec<_>>().join(", ");
                Err(Error::value("require", "CANDIDATE:NAME=NUMBER where there are several candidates", all))
            }
            (Some(name), all) => all
                .iter()
                .find(|candidate| candidate.name == name)
                .ok_or_else(|| Error::unknown("candidate", name, names())),
        }
    }
}

/// Returns all scores by name; an undefined score is None.
pub fn scores_of(sums: &Sums) -> BTreeMap<&'static str, Option<f64>> {
    SCORES.iter().map(|score| (score.name, (score.value)(sums))).collect()
}

fn counts(episodes: &[Episode]) -> VerifyCounts {
    let mut counts = VerifyCounts { episodes: episodes.len(), ..VerifyCounts::default() };
    for episode in episodes {
        for (reason, count) in &episode.refused {
            *counts.refused.entry(reason).or_default() += count;
        }
        // Frames and truth are the same for each candidate.
        if let Some(sums) = episode.sums.first() {
            counts.frames += sums.frames;
            counts.touching_frames += sums.frame_scores.0;
            counts.touches += sums.timing.touches;
            counts.force += sums.force;
        }
    }
    counts
}

fn candidate_report(name: String, groups: &VertexGroups, episodes: &[&Sums], seed: u64) -> CandidateReport {
    let sum = |drawn: &mut dyn Iterator<Item = &&Sums>| {
        drawn.fold(Sums::default(), |mut sum, sums| {
            sum += *sums;
            sum
        })
    };
    let total = sum(&mut episodes.iter());
    let statistics = |sums: &Sums| SCORES.iter().map(|score| (score.value)(sums)).collect::<Vec<_>>();
    let intervals = bootstrap::intervals(episodes, seed, sum, statistics);
    let values = statistics(&total).into_iter().zip(intervals).map(|(value, interval)| ScoreValue { value, interval });
    let forces = groups.names().iter().zip(&total.group_force);
    let links = forces.filter(|(_, [error, force])| *error > 0.0 || *force > 0.0).map(|(name, [error, force])| {
        let mean_force = force / total.frames.max(1) as f64;
        (name.clone(), LinkForce { mean_force, error: (*force > 0.0).then(|| error / force) })
    });
    CandidateReport {
        name,
        scores: SCORES.iter().map(|score| score.name).zip(values).collect(),
        compared: [total.timing.onset.count, total.timing.offset.count],
        links: links.collect(),
    }
}

fn episode_report(candidates: &[Candidate], episode: &Episode) -> EpisodeReport {
    let brief = |sums: &Sums| {
        let all = scores_of(sums);
        ["frame_mean.f1", "pooled.f1", "missed_force"]
            .map(|name| (name, all.get(name).copied().flatten()))
            .into_iter()
            .collect()
    };
    EpisodeReport {
        name: episode.name.clone(),
        seed: episode.seed,
        frames: episode.sums.first().map_or(0, |sums| sums.frames),
        refused: episode.refused.values().sum(),
        scores: candidates.iter().zip(&episode.sums).map(|(c, sums)| (c.name(), brief(sums))).collect(),
        samplings: episode.samplings.clone(),
    }
}

/// Returns the report for a terminal: one candidate in full, or several side by side.
pub fn table(report: &VerifyReport) -> String {
    let mut text = match report.candidates.as_slice() {
        [first, baselines @ ..] if baselines.is_empty() || is_prediction(first) => in_full(first, baselines),
        all => side_by_side(all),
    };
    let counts = &report.counts;
    let refused: u64 = counts.refused.values().sum();
    text += &format!(
        "\n{} episodes, {} frames ({} with touch), {} touches; {refused} frames refused by guards",
        counts.episodes, counts.frames, counts.touching_frames, counts.touches
    );
    for (reason, count) in &counts.refused {
        text += &format!("\n  {count}: {reason}");
    }
    if let Some(Unmatched { predictions, truths }) = report.unmatched {
        text += &format!("\nwithout partner of the same stamp: {predictions} predictions, {truths} truths");
    }
    text
}

/// Returns true for the report of a prediction, which stands before its baselines.
fn is_prediction(candidate: &CandidateReport) -> bool {
    candidate.name == Candidate::Prediction.name()
}

/// Returns all scores of one candidate with their intervals, beside those of baselines.
fn in_full(candidate: &CandidateReport, baselines: &[CandidateReport]) -> String {
    let value = |of: &CandidateReport, name: &str| {
        let value = of.scores.get(name).and_then(|scored| scored.value);
        value.map_or("undefined".into(), |value| format!("{value:.4}"))
    };
    let mut text = format!("{:24}{:>11}  {:22}", "", candidate.name, "95 % over episodes");
    baselines.iter().for_each(|baseline| text += &format!("{:>13}", baseline.name));
    for score in &SCORES {
        let Some(ScoreValue { interval, .. }) = candidate.scores.get(score.name) else { continue };
        let interval = interval.map_or(String::new(), |[low, high]| format!("{low:.4} .. {high:.4}"));
        let mut line = format!("\n{:24}{:>11}  {interval:22}", score.name, value(candidate, score.name));
        baselines.iter().for_each(|baseline| line += &format!("{:>13}", value(baseline, score.name)));
        text += format!("{line}  {}", score.meaning).trim_end();
    }
    text
}

/// Columns of the table of several candidates: heading and name of the score.
const COLUMNS: [(&str, &str); 10] = [
    ("precision", "frame_mean.precision"),
    ("recall", "frame_mean.recall"),
    ("IoU", "frame_mean.iou"),
    ("pooled F1", "pooled.f1"),
    ("false pos.", "false_positive_rate"),
    ("false mass", "false_contact_mass"),
    ("onset s", "onset_error_secs"),
    ("offset s", "offset_error_secs"),
    ("labelled", "labelled_ratio"),
    ("touched", "contact_ratio"),
];

fn side_by_side(candidates: &[CandidateReport]) -> String {
    let mut text = format!("{:12}{:>22}{:>22}", "label", "F1 (95 %)", "missed force (95 %)");
    COLUMNS.iter().for_each(|(heading, _)| text += &format!("{heading:>11}"));
    for candidate in candidates {
        let value =
            |name: &str| candidate.scores.get(name).copied().unwrap_or(ScoreValue { value: None, interval: None });
        text += &format!("\n{:12}", candidate.name);
        for name in ["frame_mean.f1", "missed_force"] {
            let ScoreValue { value, interval } = value(name);
            let interval = interval.map_or(String::new(), |[low, high]| format!(" ({low:.3}..{high:.3})"));
            text += &format!("{:>22}", value.map_or("undefined".into(), |value| format!("{value:.3}{interval}")));
        }
        for (_, name) in COLUMNS {
            text += &value(name).value.map_or(format!("{:>11}", "-"), |value| format!("{value:>11.3}"));
        }
    }
    text + "\nF1, precision, recall, IoU: mean over frames with touch; pooled F1: over all vertices of all frames; false pos.: share \
            of vertices labelled in frames without touch"
}
