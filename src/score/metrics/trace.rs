//! Scores of the total force over time.

use std::ops::Range;

use super::dynamics::{self, Calibration};
use super::frame_score::FrameScore;
use super::spectrum;
use super::statistics::{mean, pearson};

/// Predicted and true total force over time; the predicted one is empty if it is unknown in any frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Traces {
    /// Predicted, N.
    pub pred: Vec<f64>,
    /// True, N.
    pub target: Vec<f64>,
}

/// Scores of one episode's traces, or their means over episodes; None where undefined.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TraceScores {
    /// Pearson correlation.
    pub temporal_pearson: Option<f64>,
    /// Cosine of the normalised traces.
    pub force_cosine: Option<f64>,
    /// F1 of the frames where the force rises.
    pub rise_f1: Option<f64>,
    /// F1 of the frames where the force falls.
    pub fall_f1: Option<f64>,
    /// Pearson correlation of the log-magnitude spectra.
    pub dft_pearson: Option<f64>,
    /// Relative distance of the magnitude spectra.
    pub spectral_convergence: Option<f64>,
    /// Distance of the dominant frequencies, Hz.
    pub dominant_frequency_error_hz: Option<f64>,
}

impl Traces {
    /// Collects the totals of consecutive frames.
    pub fn of<'a>(frames: impl IntoIterator<Item = &'a FrameScore>) -> Self {
        let (pred, target): (Vec<Option<f64>>, Vec<f64>) =
            frames.into_iter().map(|frame| (frame.pred_total, frame.target_total)).unzip();
        Self { pred: pred.into_iter().collect::<Option<Vec<f64>>>().unwrap_or_default(), target }
    }

    /// Scores each episode. Without a calibration, each side is normalised by its own range over all episodes.
    pub fn scores(
        &self,
        episodes: &[Range<usize>],
        calibration: Option<&Calibration>,
        fps: Option<f64>,
    ) -> Vec<TraceScores> {
        let (pred_range, target_range) = match calibration {
            Some(calibration) => (calibration.pred(), calibration.target()),
            None => (dynamics::range(&self.pred), dynamics::range(&self.target)),
        };
        let of = |episode: &Range<usize>| -> Option<TraceScores> {
            let (p, t) = (self.pred.get(episode.clone())?, self.target.get(episode.clone())?);
            let (np, nt) = (dynamics::normalise(p, pred_range), dynamics::normalise(t, target_range));
            Some(TraceScores {
                temporal_pearson: pearson(p, t),
                force_cosine: dynamics::cosine(&np, &nt),
                rise_f1: dynamics::rise_f1(&np, &nt),
                fall_f1: dynamics::fall_f1(&np, &nt),
                dft_pearson: spectrum::dft_pearson(p, t),
                spectral_convergence: spectrum::spectral_convergence(p, t),
                dominant_frequency_error_hz: fps.and_then(|fps| spectrum::dominant_frequency_error(p, t, fps)),
            })
        };
        episodes.iter().map(|episode| of(episode).unwrap_or_default()).collect()
    }
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
