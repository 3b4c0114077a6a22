//! Summary of frame scores in constant memory, for streams without end.

use super::contact::{Confusion, ContactScores};
use super::force::ForceErrors;
use super::frame_score::FrameScore;
use super::statistics::finite;
use super::summary::{EntryCounts, Metrics};
use super::trace::EpisodesDefined;

/// Scores the consecutive frames of one episode: all of [`Metrics`] that [`FrameScore`]s alone determine. The pooled AUROC,
/// dynamics and spectra are left undefined. A call per new frame of a sliding window is cheap.
pub fn summarize<'a>(frames: impl IntoIterator<Item = &'a FrameScore>) -> Metrics {
    let mut running = RunningSummary::default();
    frames.into_iter().for_each(|frame| running.push(frame));
    running.metrics()
}

/// Sums over frames and episodes, from which the scores of [`summarize`] follow.
#[derive(Debug, Clone, Default)]
pub struct RunningSummary {
    force: ForceErrors,
    confusion: Confusion,
    /// Contact decisions of the frames without a contact in truth.
    quiet: Confusion,
    frames: usize,
    trace_frames: usize,
    contact_frames: usize,
    frames_with_positives: usize,
    /// Per contact score: number of frames where it is defined, and their sum.
    frame_scores: [(u64, f64); 5],
    /// Frames of the open episode.
    episode_frames: usize,
    episode: RunningPearson,
    /// Number of closed episodes with a correlation, and its sum.
    pearsons: (u64, f64),
    episodes: usize,
    /// True if the predicted total of a frame that counts is unknown: every correlation is undefined.
    is_unknown: bool,
}

impl RunningSummary {
    /// Adds the next frame; a frame in which nothing counts is a gap.
    pub fn push(&mut self, frame: &FrameScore) {
        self.force = self.force + frame.force;
        self.confusion = self.confusion + frame.contact;
        self.frames += 1;
        self.episode_frames += 1;
        self.contact_frames += usize::from(frame.contact.counts());
        if frame.contact.positives() > 0 {
            self.frames_with_positives += 1;
            let ContactScores { precision, recall, f1, iou, .. } = frame.contact.scores();
            for ((count, sum), score) in self.frame_scores.iter_mut().zip([precision, recall, f1, iou, frame.auroc]) {
                *count += u64::from(score.is_some());
                *sum += score.unwrap_or_default();
            }
        } else {
            self.quiet = self.quiet + frame.contact;
        }
        if let Some(target) = frame.target_total {
            self.trace_frames += 1;
            match frame.pred_total {
                Some(pred) => self.episode.push(pred, target),
                None => self.is_unknown = true,
            }
        }
    }

    /// Ends an episode.
    pub fn end_episode(&mut self) {
        self.episodes += usize::from(std::mem::take(&mut self.episode_frames) > 0);
        if let Some(pearson) = std::mem::take(&mut self.episode).value() {
            self.pearsons.0 += 1;
            self.pearsons.1 += pearson;
        }
    }

    /// Number of frames, gaps included.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Returns the scores; the open episode counts as if it ended here. The correlation is the mean over episodes.
    pub fn metrics(&self) -> Metrics {
        let mut ended = self.clone();
        ended.end_episode();
        let mean = |(count, sum): (u64, f64)| (count > 0).then(|| sum / count as f64);
        let confusion = self.confusion;
        // One unknown prediction makes the mean undefined, as it makes the pooled score.
        let of_frames = |index: usize| (confusion.unknown == 0).then(|| mean(self.frame_scores[index])).flatten();
        let pearsons = if self.is_unknown { (0, 0.0) } else { ended.pearsons };
        let frames_without_positives = self.contact_frames - self.frames_with_positives;
        Metrics {
            mae: self.force.mae(),
            active_mae: self.force.active_mae(),
            temporal_pearson: mean(pearsons),
            frame_mean: ContactScores {
                precision: of_frames(0),
                recall: of_frames(1),
                f1: of_frames(2),
                iou: of_frames(3),
                auroc: of_frames(4),
            },
            share_without_positives: finite(frames_without_positives as f64 / self.contact_frames as f64),
            false_positive_rate: self.quiet.false_positive_rate(),
            pooled: confusion.scores(),
            force_cosine: None,
            rise_f1: None,
            fall_f1: None,
            dft_pearson: None,
            spectral_convergence: None,
            dominant_frequency_error_hz: None,
            episodes_defined: EpisodesDefined { temporal_pearson: pearsons.0 as usize, ..EpisodesDefined::default() },
            counts: EntryCounts {
                frames: self.frames,
                episodes: ended.episodes,
                trace_frames: self.trace_frames,
                contact_frames: self.contact_frames,
                frames_without_positives,
                force_entries: self.force.count,
                active_entries: self.force.active_count,
                contact_entries: confusion.total(),
                unknown_predictions: self.force.unknown + confusion.unknown,
            },
        }
    }
}

/// Correlation of two numbers over frames, by Welford's recurrence.
#[derive(Debug, Clone, Copy, Default)]
struct RunningPearson {
    count: u64,
    mean: [f64; 2],
    /// Sums of the squared distances from the means, and of their products.
    squares: [f64; 2],
    product: f64,
    first: [f64; 2],
    varies: [bool; 2],
}

impl RunningPearson {
    /// Adds the predicted and the true total force of a frame, N.
    fn push(&mut self, pred: f64, target: f64) {
        let values = [pred, target];
        if self.count == 0 {
            self.first = values;
        }
        self.count += 1;
        let before = [pred - self.mean[0], target - self.mean[1]];
        for k in 0..2 {
            self.varies[k] |= values[k] != self.first[k];
            self.mean[k] += before[k] / self.count as f64;
            self.squares[k] += before[k] * (values[k] - self.mean[k]);
        }
        self.product += before[0] * (target - self.mean[1]);
    }

    /// Returns the correlation: 0 for a constant prediction, None for a constant truth.
    fn value(&self) -> Option<f64> {
        match self.varies {
            [_, false] => None,
            [false, true] => Some(0.0),
            [true, true] => {
                finite(self.product / (self.squares[0].sqrt() * self.squares[1].sqrt())).map(|r| r.clamp(-1.0, 1.0))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tactile::N_FIELD;

    fn frame(index: usize, level: f32) -> FrameScore {
        let force: Vec<f32> = (0..N_FIELD).map(|v| if v % 7 == index % 7 { level } else { 0.0 }).collect();
        let predicted: Vec<f32> = force.iter().enumerate().map(|(v, f)| 0.9 * f + 0.01 * (v % 3) as f32).collect();
        let contact: Vec<f32> = (0..N_FIELD).map(|v| ((v * 13 + index) % 100) as f32 / 100.0).collect();
        let touched: Vec<f32> = force.iter().map(|f| f32::from(*f > 0.05)).collect();
        FrameScore::new(&predicted, &contact, &force, &touched, &[], &[])
    }

    /// Correlation of the totals that count, by the textbook's formula.
    fn pearson(frames: &[FrameScore]) -> f64 {
        let totals: Vec<[f64; 2]> = frames.iter().filter_map(|f| Some([f.pred_total?, f.target_total?])).collect();
        let mean = [0, 1].map(|side| totals.iter().map(|t| t[side]).sum::<f64>() / totals.len() as f64);
        let moment = |a: usize, b: usize| totals.iter().map(|t| (t[a] - mean[a]) * (t[b] - mean[b])).sum::<f64>();
        moment(0, 1) / (moment(0, 0) * moment(1, 1)).sqrt()
    }

    #[test]
    fn the_correlation_of_sums_is_that_of_all_frames_and_leaves_gaps_out() {
        let mut frames: Vec<FrameScore> =
            (0..200).map(|t| frame(t, if t % 9 == 0 { 0.0 } else { 1.0 + (t as f32 * 0.3).sin() })).collect();
        (0..200).step_by(17).for_each(|gap| frames[gap] = FrameScore::default());
        let metrics = summarize(&frames);
        assert!((metrics.temporal_pearson.unwrap() - pearson(&frames)).abs() < 1e-9);
        assert_eq!((metrics.counts.frames, metrics.counts.trace_frames), (200, 188));
    }

    #[test]
    fn the_correlation_is_the_mean_over_episodes() {
        let frames: Vec<FrameScore> = (0..60).map(|t| frame(t, 1.0 + (t as f32 * 0.7).sin())).collect();
        let mut running = RunningSummary::default();
        for episode in frames.chunks(20) {
            episode.iter().for_each(|frame| running.push(frame));
            running.end_episode();
        }
        running.end_episode(); // an empty one
        let mean = frames.chunks(20).map(pearson).sum::<f64>() / 3.0;
        assert!((running.metrics().temporal_pearson.unwrap() - mean).abs() < 1e-9);
        assert_eq!(running.metrics().counts.episodes, 3);
        assert_eq!(RunningSummary::default().metrics().temporal_pearson, None);
    }

    #[test]
    fn a_constant_prediction_scores_zero_and_an_unknown_one_nothing() {
        let truth: Vec<FrameScore> = (0..30).map(|t| frame(t, 1.0 + (t as f32 * 0.7).sin())).collect();
        let predicting = |total: Option<f64>| -> Vec<FrameScore> {
            truth.iter().map(|frame| FrameScore { pred_total: total, ..frame.clone() }).collect()
        };
        for (frames, expected) in [(predicting(Some(2.0)), Some(0.0)), (predicting(None), None)] {
            assert_eq!(summarize(&frames).temporal_pearson, expected);
        }
    }
}
