//! All scores of a prediction, and the numbers of entries behind them.

use serde::Serialize;

use super::contact::ContactScores;
use super::trace::EpisodesDefined;

/// All scores, under the names of `egotac eval --json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Metrics {
    /// Mean absolute force error, N.
    pub mae: Option<f64>,
    /// Mean absolute force error where the true force is above 0.05 N, N.
    pub active_mae: Option<f64>,
    /// Pearson correlation of the total force over time, mean over episodes.
    pub temporal_pearson: Option<f64>,
    /// Contact scores of each frame that has positives, averaged: the paper's averaging.
    pub frame_mean: ContactScores,
    /// Share of the frames without a contact in truth, which are left out of `frame_mean`.
    pub share_without_positives: Option<f64>,
    /// Share of the vertices that are predicted in contact in the frames without a contact in truth.
    pub false_positive_rate: Option<f64>,
    /// Contact scores over all vertices of all frames.
    pub pooled: ContactScores,
    /// Cosine of the normalised total force, mean over episodes.
    pub force_cosine: Option<f64>,
    /// F1 of the frames where the total force rises, mean over episodes.
    pub rise_f1: Option<f64>,
    /// F1 of the frames where the total force falls, mean over episodes.
    pub fall_f1: Option<f64>,
    /// Pearson correlation of the log-magnitude spectra, mean over episodes.
    pub dft_pearson: Option<f64>,
    /// Relative distance of the magnitude spectra, mean over episodes.
    pub spectral_convergence: Option<f64>,
    /// Distance of the dominant frequencies, Hz, mean over episodes.
    pub dominant_frequency_error_hz: Option<f64>,
    /// Numbers of episodes on which the temporal scores are defined, and over which they are averaged.
    pub episodes_defined: EpisodesDefined,
    /// Numbers of frames and entries that the scores were computed from.
    pub counts: EntryCounts,
}

/// Numbers of frames and entries that scores were computed from.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct EntryCounts {
    /// Frames.
    pub frames: usize,
    /// Episodes.
    pub episodes: usize,
    /// Frames in which the force of a vertex counts; the others are gaps in the traces.
    pub trace_frames: usize,
    /// Frames in which the contact of a vertex counts.
    pub contact_frames: usize,
    /// Those of them without a contact in truth: left out of `frame_mean`.
    pub frames_without_positives: usize,
    /// (frame, vertex) pairs whose force counts.
    pub force_entries: u64,
    /// (frame, vertex) pairs whose force counts and is above 0.05 N in truth.
    pub active_entries: u64,
    /// (frame, vertex) pairs whose contact counts.
    pub contact_entries: u64,
    /// Counted entries that the prediction leaves unknown; above 0 the scores they enter are undefined.
    pub unknown_predictions: u64,
}
