//! Evaluation of a predicted sequence against a true one.

use std::borrow::Cow;

use super::contact::{self, ContactScores};
use super::dynamics::{Calibration, Range};
use super::frame_score::FrameScore;
use super::running::summarize;
use super::summary::{EntryCounts, Metrics};
use super::trace::{EpisodesDefined, TraceScores, Traces};
use crate::error::{Error, Result};
use crate::tactile::{N_FIELD, TactileSequence, check_rows};

/// Settings of an evaluation; masks, episodes and frame rate come from the target.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EvalOptions {
    /// Range of the total force, from [`calibrate`] or a file; differences and spectra are then those of normalised traces. None
    /// = each side's own over all episodes, and spectra in newtons.
    pub calibration: Option<Calibration>,
    /// Frames per second, in place of the rate of the target's time stamps. The dominant frequency is undefined without
    /// either.
    pub fps: Option<f64>,
}

/// Scores `pred` against `target`. Entries that the target masks out or leaves unknown (NaN) do not count.
///
/// ```
/// use egotac::metrics::{EvalOptions, evaluate};
/// use egotac::{TactileSequence, Topology};
///
/// # fn main() -> egotac::Result<()> {
/// let mut force = vec![0.0; 1556]; // one frame of two hands, N
/// force[800] = 2.0; // on the right hand
/// let truth = TactileSequence::from_force(Some(Topology::EgotacHand1), force.clone());
/// force[800] = 1.5;
/// let predicted = TactileSequence::from_force(Some(Topology::EgotacHand1), force);
/// let scores = evaluate(&predicted, &truth, &EvalOptions::default())?;
/// assert_eq!((scores.active_mae, scores.pooled.f1), (Some(0.5), Some(1.0)));
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// If lengths or topologies differ, or the target's episodes do not end where its data does.
pub fn evaluate(pred: &TactileSequence, target: &TactileSequence, options: &EvalOptions) -> Result<Metrics> {
    check(pred, target)?;
    let mask = Mask::of(target);
    let frames = score_frames(pred, target, &mask);
    let per_episode = score_traces(&frames, target, options);
    let trace = TraceScores::mean(per_episode.iter());
    let auroc = contact::auroc(contact::pairs(&pred.contact, &target.contact, &mask.contact));
    let summary = summarize(&frames);
    Ok(Metrics {
        temporal_pearson: trace.temporal_pearson,
        pooled: ContactScores { auroc, ..summary.pooled },
        force_cosine: trace.force_cosine,
        rise_f1: trace.rise_f1,
        fall_f1: trace.fall_f1,
        dft_pearson: trace.dft_pearson,
        spectral_convergence: trace.spectral_convergence,
        dominant_frequency_error_hz: trace.dominant_frequency_error_hz,
        episodes_defined: EpisodesDefined::of(&per_episode),
        counts: EntryCounts { episodes: per_episode.len(), ..summary.counts },
        ..summary
    })
}

/// Returns the range of the predicted and of the true total force over a calibration split, for
/// [`EvalOptions::calibration`].
///
/// # Errors
/// As [`evaluate`]; and if a total is unknown in a frame that counts, or one side does not change.
pub fn calibrate(pred: &TactileSequence, target: &TactileSequence) -> Result<Calibration> {
    check(pred, target)?;
    let frames = score_frames(pred, target, &Mask::of(target));
    let calibration = Traces::of(&frames, &target.episodes()).calibration().ok_or_else(|| {
        Error::value("calibration split", "known total forces, predicted and true", "an unknown one, or no frame")
    })?;
    for (side, Range { min, max }) in [("predicted", calibration.pred()), ("true", calibration.target())] {
        if min >= max {
            let got = format!("{min} N in every frame");
            return Err(Error::value(format!("calibration split, {side} total force"), "a range", got));
        }
    }
    Ok(calibration)
}

/// Checks that both sequences have the same frames, topology and meaning of forces.
pub(super) fn check(pred: &TactileSequence, target: &TactileSequence) -> Result<()> {
    target.check()?;
    for (name, values) in [("pred force", &pred.force), ("pred contact", &pred.contact)] {
        check_rows(name, values.len(), target.n_frames())?;
    }
    pred.same_force_kind(target)?;
    match (pred.topology, target.topology) {
        (Some(pred), Some(target)) => pred.must_match(target),
        _ => Ok(()),
    }
}

/// Entries of a target that count, (T, 1556) each; empty = all of them.
pub(super) struct Mask<'a> {
    pub force: Cow<'a, [u8]>,
    pub contact: Cow<'a, [u8]>,
}

impl<'a> Mask<'a> {
    pub fn of(target: &'a TactileSequence) -> Self {
        Self { force: target.counted_force(), contact: target.counted_contact() }
    }
}

/// Scores each frame by itself.
pub(super) fn score_frames(pred: &TactileSequence, target: &TactileSequence, mask: &Mask) -> Vec<FrameScore> {
    let score = |frame: usize| {
        let rows = frame * N_FIELD..(frame + 1) * N_FIELD;
        FrameScore::new(
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

/// Scores the total force over time, episode by episode.
pub(super) fn score_traces(frames: &[FrameScore], target: &TactileSequence, options: &EvalOptions) -> Vec<TraceScores> {
    let fps = options.fps.or_else(|| target.fps());
    Traces::of(frames, &target.episodes()).scores(options.calibration.as_ref(), fps)
}
