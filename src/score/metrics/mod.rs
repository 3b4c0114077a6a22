//! Scores of predicted touch against truth, as the paper's appendix defines them.
//!
//! | score | file | undefined when |
//! |---|---|---|
//! | MAE, active MAE, temporal Pearson | [`force`] | nothing valid (active); fewer than two frames or a constant trace |
//! | precision, recall, F1, IoU, AUROC | [`contact`] | no positives (AUROC: nor negatives) |
//! | force cosine, rise F1, fall F1 | [`dynamics`] | a trace that is zero everywhere; no event on either side |
//! | DFT Pearson, spectral convergence, dominant frequency | [`spectrum`] | fewer than three frames or a constant trace |
//!
//! An undefined score is `None` here, `null` in JSON, `undefined` in a table; it is never NaN and never a made-up
//! number. A score is undefined, too, where the prediction itself is unknown (NaN) at a valid vertex.

pub mod bootstrap;
pub mod compare;
pub mod contact;
pub mod dynamics;
pub mod force;
pub mod part;
mod report;
pub mod spectrum;
pub mod trace;

use std::borrow::Cow;

use serde::Serialize;

use crate::error::Result;
use crate::tactile::{N_FIELD, TactileSequence, check_rows};

pub use compare::{Comparison, compare};
pub use contact::{Counts, Scores};
pub use dynamics::Calibration;
pub use force::Errors;
pub use part::Part;
pub use report::{comparison_table, parts_table, table};
use trace::{TraceScores, Traces};

/// Settings of an evaluation; masks, episodes and frame rate come from the target.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EvalOptions {
    /// Range of the total force; None = each side's own.
    pub calibration: Option<Calibration>,
    /// Frames per second, in place of the rate of the target's time stamps; without both, the dominant frequency is
    /// undefined.
    pub fps: Option<f64>,
}

impl EvalOptions {
    fn fps(&self, target: &TactileSequence) -> Option<f64> {
        self.fps.or_else(|| target.fps())
    }
}

/// All scores, under the names of `egotac eval --json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Mean absolute force error, N.
    pub mae: Option<f64>,
    /// The same where the true force is above 0.05 N.
    pub active_mae: Option<f64>,
    /// Pearson correlation of the total force over time, mean over episodes.
    pub temporal_pearson: Option<f64>,
    /// Contact scores of each frame that has positives, averaged.
    pub frame_mean: Scores,
    /// Contact scores over all vertices of all frames.
    pub pooled: Scores,
    /// Cosine of the normalised total force, mean over episodes.
    pub force_cosine: Option<f64>,
    /// F1 of the frames where the total force rises, mean over episodes.
    pub rise_f1: Option<f64>,
    /// F1 of the frames where it falls, mean over episodes.
    pub fall_f1: Option<f64>,
    /// Pearson correlation of the log-magnitude spectra, mean over episodes.
    pub dft_pearson: Option<f64>,
    /// Relative distance of the magnitude spectra, mean over episodes.
    pub spectral_convergence: Option<f64>,
    /// Distance of the dominant frequencies, Hz, mean over episodes.
    pub dominant_frequency_error_hz: Option<f64>,
    /// What the scores were computed from.
    pub counts: ReportCounts,
}

/// What the scores were computed from.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ReportCounts {
    /// Frames.
    pub frames: usize,
    /// Episodes.
    pub episodes: usize,
    /// Frames without a contact in truth: left out of `frame_mean`.
    pub frames_without_positives: usize,
    /// (frame, vertex) pairs whose force counts.
    pub force_entries: u64,
    /// Those with a true force above 0.05 N.
    pub active_entries: u64,
    /// (frame, vertex) pairs whose contact counts.
    pub contact_entries: u64,
    /// Counted entries that the prediction leaves unknown; above 0 the scores they enter are undefined.
    pub unknown_predictions: u64,
}

/// Scores `pred` against `target`. Entries that the target masks out or leaves unknown (NaN) do not count.
///
/// # Errors
/// If lengths or topologies differ, or the target's episodes do not end where its data does.
pub fn evaluate(pred: &TactileSequence, target: &TactileSequence, options: &EvalOptions) -> Result<Report> {
    target.check()?;
    for (name, values) in [("pred force", &pred.force), ("pred contact", &pred.contact)] {
        check_rows(name, values.len(), target.n_frames())?;
    }
    if let (Some(pred), Some(target)) = (pred.topology, target.topology) {
        pred.must_match(target)?;
    }
    let episodes = target.episodes();
    let mask = Mask::of(target);
    let frames = FrameScore::all(pred, target, &mask);
    let summary = summarize(&frames);
    let per_episode = Traces::of(&frames).scores(&episodes, options.calibration.as_ref(), options.fps(target));
    let trace = TraceScores::mean(per_episode.iter());
    Ok(Report {
        temporal_pearson: trace.temporal_pearson,
        pooled: Scores { auroc: pooled_auroc(pred, target, &mask), ..summary.pooled },
        force_cosine: trace.force_cosine,
        rise_f1: trace.rise_f1,
        fall_f1: trace.fall_f1,
        dft_pearson: trace.dft_pearson,
        spectral_convergence: trace.spectral_convergence,
        dominant_frequency_error_hz: trace.dominant_frequency_error_hz,
        counts: ReportCounts { episodes: episodes.len(), ..summary.counts },
        ..summary
    })
}

/// What one frame adds to the scores; scores of many frames come from [`summarize`].
#[derive(Debug, Clone, PartialEq)]
pub struct FrameScore {
    /// Force errors of the frame.
    pub force: Errors,
    /// Contact decisions of the frame.
    pub contact: Counts,
    /// AUROC within the frame.
    pub auroc: Option<f64>,
    /// Predicted total force, N; None if unknown.
    pub pred_total: Option<f64>,
    /// True total force, N.
    pub target_total: f64,
}

impl FrameScore {
    /// Scores one frame of 1556 vertices; an empty mask counts every vertex.
    pub fn new(
        pred_force: &[f32],
        pred_contact: &[f32],
        target_force: &[f32],
        target_contact: &[f32],
        mask_force: &[u8],
        mask_contact: &[u8],
    ) -> Self {
        let forces = force::pairs(pred_force, target_force, mask_force);
        let contacts = contact::pairs(pred_contact, target_contact, mask_contact);
        let (pred_total, target_total) = force::totals(&forces);
        Self {
            force: Errors::of(&forces),
            contact: Counts::of(&contacts),
            auroc: contact::auroc(contacts),
            pred_total,
            target_total,
        }
    }

    /// Scores every frame.
    fn all(pred: &TactileSequence, target: &TactileSequence, mask: &Mask) -> Vec<Self> {
        let score = |frame: usize| {
            let rows = frame * N_FIELD..(frame + 1) * N_FIELD;
            Self::new(
                pred.force_at(frame),
                pred.contact_at(frame),
                target.force_at(frame),
                target.contact_at(frame),
                mask.force.get(rows.clone()).unwrap_or_default(),
                mask.contact.get(rows).unwrap_or_default(),
            )
        };
        (0..target.n_frames()).map(score).collect()
    }
}

/// Entries of a target that count, (T, 1556) each; empty = all of them.
struct Mask<'a> {
    force: Cow<'a, [u8]>,
    contact: Cow<'a, [u8]>,
}

impl<'a> Mask<'a> {
    fn of(target: &'a TactileSequence) -> Self {
        Self { force: target.counted_force(), contact: target.counted_contact() }
    }
}

/// Scores of frames that follow each other: everything of [`Report`] that needs no more than [`FrameScore`]s (the
/// pooled AUROC, dynamics and spectra are left undefined). Cheap enough to be called on every new frame of a window.
pub fn summarize<'a>(frames: impl IntoIterator<Item = &'a FrameScore>) -> Report {
    let frames: Vec<&FrameScore> = frames.into_iter().collect();
    let force = frames.iter().fold(Errors::default(), |sum, frame| sum + frame.force);
    let counts = frames.iter().fold(Counts::default(), |sum, frame| sum + frame.contact);
    let with_positives: Vec<&&FrameScore> = frames.iter().filter(|f| f.contact.positives() > 0).collect();
    let scores: Vec<Scores> = with_positives.iter().map(|f| Scores { auroc: f.auroc, ..f.contact.scores() }).collect();
    let pick = |score: fn(&Scores) -> Option<f64>| {
        // Unknown predictions spoil the mean as they spoil the pooled score.
        (counts.unknown == 0).then(|| mean(scores.iter().map(score))).flatten()
    };
    let traces = Traces::of(frames.iter().copied());
    Report {
        mae: force.mae(),
        active_mae: force.active_mae(),
        temporal_pearson: pearson(&traces.pred, &traces.target),
        frame_mean: Scores {
            precision: pick(|s| s.precision),
            recall: pick(|s| s.recall),
            f1: pick(|s| s.f1),
            iou: pick(|s| s.iou),
            auroc: pick(|s| s.auroc),
        },
        pooled: counts.scores(),
        force_cosine: None,
        rise_f1: None,
        fall_f1: None,
        dft_pearson: None,
        spectral_convergence: None,
        dominant_frequency_error_hz: None,
        counts: ReportCounts {
            frames: frames.len(),
            episodes: usize::from(!frames.is_empty()),
            frames_without_positives: frames.len() - with_positives.len(),
            force_entries: force.count,
            active_entries: force.active_count,
            contact_entries: counts.total(),
            unknown_predictions: force.unknown + counts.unknown,
        },
    }
}

/// Pearson correlation; undefined for fewer than two points or a constant side.
pub fn pearson(a: &[f64], b: &[f64]) -> Option<f64> {
    if a.len() != b.len() || a.len() < 2 || is_constant(a) || is_constant(b) {
        return None;
    }
    let n = a.len() as f64;
    let (mean_a, mean_b) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        ab += a * b;
        aa += a * a;
        bb += b * b;
    }
    finite(ab / (aa.sqrt() * bb.sqrt())).map(|r| r.clamp(-1.0, 1.0))
}

fn pooled_auroc(pred: &TactileSequence, target: &TactileSequence, mask: &Mask) -> Option<f64> {
    contact::auroc(contact::pairs(&pred.contact, &target.contact, &mask.contact))
}

/// Mean of the defined values.
fn mean(values: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    let (sum, count) = values.into_iter().flatten().fold((0.0, 0usize), |(sum, count), x| (sum + x, count + 1));
    (count > 0).then(|| sum / count as f64)
}

fn is_constant(values: &[f64]) -> bool {
    values.windows(2).all(|pair| pair[0] == pair[1])
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}
