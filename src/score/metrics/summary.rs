//! Summary of frame scores.

use serde::Serialize;

use super::contact::{Confusion, ContactScores};
use super::force::ForceErrors;
use super::frame_score::FrameScore;
use super::statistics::{finite, mean};
use super::trace::{EpisodesDefined, TraceScores, Traces};

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

/// Scores the consecutive frames of one episode: all of [`Metrics`] that [`FrameScore`]s alone determine. The pooled AUROC,
/// dynamics and spectra are left undefined. A call per new frame of a sliding window is cheap.
pub fn summarize<'a>(frames: impl IntoIterator<Item = &'a FrameScore>) -> Metrics {
    let frames: Vec<&FrameScore> = frames.into_iter().collect();
    let force = frames.iter().fold(ForceErrors::default(), |sum, frame| sum + frame.force);
    let confusion = frames.iter().fold(Confusion::default(), |sum, frame| sum + frame.contact);
    let with_contact: Vec<&FrameScore> = frames.iter().copied().filter(|frame| frame.contact.counts()).collect();
    let (positive, negative): (Vec<&FrameScore>, Vec<&FrameScore>) =
        with_contact.iter().copied().partition(|frame| frame.contact.positives() > 0);
    let scores: Vec<ContactScores> =
        positive.iter().map(|f| ContactScores { auroc: f.auroc, ..f.contact.scores() }).collect();
    let frame_mean = |score: fn(&ContactScores) -> Option<f64>| {
        // One unknown prediction makes the mean undefined, as it makes the pooled score.
        (confusion.unknown == 0).then(|| mean(scores.iter().map(score))).flatten()
    };
    let quiet = negative.iter().fold(Confusion::default(), |sum, frame| sum + frame.contact);
    let consecutive: Vec<FrameScore> = frames.iter().map(|frame| (*frame).clone()).collect();
    let traces = Traces::of(&consecutive, std::slice::from_ref(&(0..frames.len()))).scores(None, None);
    let defined = EpisodesDefined::of(&traces);
    Metrics {
        mae: force.mae(),
        active_mae: force.active_mae(),
        temporal_pearson: TraceScores::mean(traces.iter()).temporal_pearson,
        frame_mean: ContactScores {
            precision: frame_mean(|s| s.precision),
            recall: frame_mean(|s| s.recall),
            f1: frame_mean(|s| s.f1),
            iou: frame_mean(|s| s.iou),
            auroc: frame_mean(|s| s.auroc),
        },
        share_without_positives: finite(negative.len() as f64 / with_contact.len() as f64),
        false_positive_rate: quiet.false_positive_rate(),
        pooled: confusion.scores(),
        force_cosine: None,
        rise_f1: None,
        fall_f1: None,
        dft_pearson: None,
        spectral_convergence: None,
        dominant_frequency_error_hz: None,
        episodes_defined: EpisodesDefined { temporal_pearson: defined.temporal_pearson, ..EpisodesDefined::default() },
        counts: EntryCounts {
            frames: frames.len(),
            episodes: usize::from(!frames.is_empty()),
            trace_frames: frames.iter().filter(|frame| frame.target_total.is_some()).count(),
            contact_frames: with_contact.len(),
            frames_without_positives: negative.len(),
            force_entries: force.count,
            active_entries: force.active_count,
            contact_entries: confusion.total(),
            unknown_predictions: force.unknown + confusion.unknown,
        },
    }
}
