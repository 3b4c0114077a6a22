//! Scores of the total force over time.
//!
//! A frame in which no force counts (masked whole, or refused by a guard) is a gap. It takes part in no trace. Differences and
//! spectra are computed within the runs of frames between gaps; correlation and cosine take all frames that count.

use std::ops::Range;

use serde::Serialize;

use super::dynamics::{self, Calibration};
use super::frame_score::FrameScore;
use super::run::Run;
use super::spectrum;
use super::statistics::{is_constant, mean, pearson};

/// Predicted and true total force of episodes, as runs between gaps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Traces {
    /// Runs of each episode.
    episodes: Vec<Vec<Run>>,
    /// True if the predicted total is unknown in a frame that counts: every score is undefined.
    is_unknown: bool,
}

/// Scores of one episode's traces, or their means over episodes; None where undefined.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TraceScores {
    /// Pearson correlation; 0 for a constant prediction.
    pub temporal_pearson: Option<f64>,
    /// Cosine of the normalised traces.
    pub force_cosine: Option<f64>,
    /// F1 of the frames where the force rises.
    pub rise_f1: Option<f64>,
    /// F1 of the frames where the force falls.
    pub fall_f1: Option<f64>,
    /// Pearson correlation of the log-magnitude spectra; 0 for a constant prediction.
    pub dft_pearson: Option<f64>,
    /// Relative distance of the magnitude spectra; 1 for a constant prediction.
    pub spectral_convergence: Option<f64>,
    /// Distance of the dominant frequencies, Hz.
    pub dominant_frequency_error_hz: Option<f64>,
}

/// Numbers of episodes on which the temporal scores are defined.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct EpisodesDefined {
    /// Of the Pearson correlation of the total force.
    pub temporal_pearson: usize,
    /// Of the force cosine.
    pub force_cosine: usize,
    /// Of the F1 of rises.
    pub rise_f1: usize,
    /// Of the F1 of falls.
    pub fall_f1: usize,
    /// Of the Pearson correlation of the spectra.
    pub dft_pearson: usize,
    /// Of the spectral convergence.
    pub spectral_convergence: usize,
    /// Of the dominant frequency error.
    pub dominant_frequency_error_hz: usize,
}

impl Traces {
    /// Collects the totals of the frames of each episode.
    pub fn of(frames: &[FrameScore], episodes: &[Range<usize>]) -> Self {
        let mut traces = Self::default();
        for episode in episodes {
            let (mut runs, mut is_gap): (Vec<Run>, bool) = (Vec::new(), true);
            for frame in &frames[episode.clone()] {
                let Some(target) = frame.target_total else {
                    is_gap = true;
                    continue;
                };
                if std::mem::take(&mut is_gap) {
                    runs.push(Run::default());
                }
                if let Some(run) = runs.last_mut() {
                    traces.is_unknown |= frame.pred_total.is_none();
                    run.pred.push(frame.pred_total.unwrap_or(f64::NAN));
                    run.target.push(target);
                }
            }
            traces.episodes.push(runs);
        }
        traces
    }

    /// Returns the range of either side over all episodes; None if a predicted total is unknown or no frame counts.
    pub fn calibration(&self) -> Option<Calibration> {
        let runs = || self.episodes.iter().flatten();
        let pred = dynamics::range(runs().flat_map(|run| run.pred.iter().copied()))?;
        let target = dynamics::range(runs().flat_map(|run| run.target.iter().copied()))?;
        (!self.is_unknown).then_some(Calibration::Each { pred, target })
    }

    /// Scores each episode. Without a calibration, each side is normalised by its own range over all episodes, and spectra
    /// are those of forces in newtons; with one, spectra are those of normalised traces too.
    pub fn scores(&self, calibration: Option<&Calibration>, fps: Option<f64>) -> Vec<TraceScores> {
        let own = self.calibration();
        let Some(ranges) = calibration.or(own.as_ref()).filter(|_| own.is_some()) else {
            return vec![TraceScores::default(); self.episodes.len()];
        };
        self.episodes.iter().map(|runs| scores(runs, ranges, calibration.is_some(), fps)).collect()
    }
}

/// Scores one episode; every score is undefined if the true total does not change.
fn scores(runs: &[Run], ranges: &Calibration, is_calibrated: bool, fps: Option<f64>) -> TraceScores {
    let (pred, target) = joined(runs);
    if is_constant(&target) {
        return TraceScores::default();
    }
    let normalised: Vec<Run> = runs
        .iter()
        .map(|run| Run {
            pred: dynamics::normalise(&run.pred, ranges.pred()),
            target: dynamics::normalise(&run.target, ranges.target()),
        })
        .collect();
    let (normalised_pred, normalised_target) = joined(&normalised);
    let spectral = if is_calibrated { &normalised[..] } else { runs };
    TraceScores {
        temporal_pearson: if is_constant(&pred) { Some(0.0) } else { pearson(&pred, &target) },
        force_cosine: dynamics::cosine(&normalised_pred, &normalised_target),
        rise_f1: dynamics::rise_f1(&normalised),
        fall_f1: dynamics::fall_f1(&normalised),
        dft_pearson: over_runs(spectral, spectrum::dft_pearson),
        spectral_convergence: over_runs(spectral, spectrum::spectral_convergence),
        dominant_frequency_error_hz: fps
            .and_then(|fps| over_runs(spectral, |p, t| spectrum::dominant_frequency_error(p, t, fps))),
    }
}

/// Returns both traces without the gaps.
fn joined(runs: &[Run]) -> (Vec<f64>, Vec<f64>) {
    let side = |of: fn(&Run) -> &Vec<f64>| runs.iter().flat_map(|run| of(run).iter().copied()).collect();
    (side(|run| &run.pred), side(|run| &run.target))
}

/// Returns the mean of a score over the runs where it is defined, weighted by their frames.
fn over_runs(runs: &[Run], score: impl Fn(&[f64], &[f64]) -> Option<f64>) -> Option<f64> {
    let (sum, frames) = runs
        .iter()
        .filter_map(|run| Some((score(&run.pred, &run.target)?, run.target.len() as f64)))
        .fold((0.0, 0.0), |(sum, frames), (score, n)| (sum + score * n, frames + n));
    (frames > 0.0).then(|| sum / frames)
}

impl TraceScores {
    /// Returns the mean of each score over the episodes where it is defined.
    pub fn mean<'a>(episodes: impl Iterator<Item = &'a Self> + Clone) -> Self {
        let of = |score: fn(&Self) -> Option<f64>| mean(episodes.clone().map(score));
        Self {
            temporal_pearson: of(|s| s.temporal_pearson),
            force_cosine: of(|s| s.force_cosine),
            rise_f1: of(|s| s.rise_f1),
            fall_f1: of(|s| s.fall_f1),
            dft_pearson: of(|s| s.dft_pearson),
            spectral_convergence: of(|s| s.spectral_convergence),
            dominant_frequency_error_hz: of(|s| s.dominant_frequency_error_hz),
        }
    }
}

impl EpisodesDefined {
    /// Counts the episodes on which each score is defined.
    pub fn of(episodes: &[TraceScores]) -> Self {
        let count = |score: fn(&TraceScores) -> Option<f64>| episodes.iter().filter(|s| score(s).is_some()).count();
        Self {
            temporal_pearson: count(|s| s.temporal_pearson),
            force_cosine: count(|s| s.force_cosine),
            rise_f1: count(|s| s.rise_f1),
            fall_f1: count(|s| s.fall_f1),
            dft_pearson: count(|s| s.dft_pearson),
            spectral_convergence: count(|s| s.spectral_convergence),
            dominant_frequency_error_hz: count(|s| s.dominant_frequency_error_hz),
        }
    }
}
