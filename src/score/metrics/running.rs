//! Summary of frame scores in constant memory, for streams without end.

use super::contact::{Confusion, ContactScores};
use super::force::ForceErrors;
use super::frame_score::FrameScore;
use super::statistics::finite;
use super::summary::{EntryCounts, Metrics};

/// Sums over frames and episodes, from which the scores of [`summarize`](super::summarize) follow.
#[derive(Debug, Clone, Default)]
pub struct RunningSummary {
    force: ForceErrors,
    confusion: Confusion,
    frames: usize,
    frames_with_positives: usize,
    /// Per contact score: number of frames where it is defined, and their sum.
    frame_scores: [(u64, f64); 5],
    episode: RunningPearson,
    /// Number of closed episodes with a correlation, and its sum.
    pearsons: (u64, f64),
    episodes: usize,
}

impl RunningSummary {
    /// Adds the next frame.
    pub fn push(&mut self, frame: &FrameScore) {
        self.force = self.force + frame.force;
        self.confusion = self.confusion + frame.contact;
        self.frames += 1;
        if frame.contact.positives() > 0 {
            self.frames_with_positives += 1;
            let ContactScores { precision, recall, f1, iou, .. } = frame.contact.scores();
            for ((count, sum), score) in self.frame_scores.iter_mut().zip([precision, recall, f1, iou, frame.auroc]) {
                *count += u64::from(score.is_some());
                *sum += score.unwrap_or_default();
            }
        }
        self.episode.push(frame.pred_total, frame.target_total);
    }

    /// Ends an episode.
    pub fn end_episode(&mut self) {
        let episode = std::mem::take(&mut self.episode);
        self.episodes += usize::from(episode.count > 0);
        if let Some(pearson) = episode.value() {
            self.pearsons.0 += 1;
            self.pearsons.1 += pearson;
        }
    }

    /// Number of frames.
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
        Metrics {
            mae: self.force.mae(),
            active_mae: self.force.active_mae(),
            temporal_pearson: mean(ended.pearsons),
            frame_mean: ContactScores {
                precision: of_frames(0),
                recall: of_frames(1),
                f1: of_frames(2),
                iou: of_frames(3),
                auroc: of_frames(4),
            },
            pooled: confusion.scores(),
            force_cosine: None,
            rise_f1: None,
            fall_f1: None,
            dft_pearson: None,
            spectral_convergence: None,
            dominant_frequency_error_hz: None,
            counts: EntryCounts {
                frames: self.frames,
                episodes: ended.episodes,
                frames_without_positives: self.frames - self.frames_with_positives,
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
    has_unknown: bool,
}

impl RunningPearson {
    fn push(&mut self, a: Option<f64>, b: f64) {
        let Some(a) = a else {
            self.has_unknown = true;
            self.count += 1;
            return;
        };
        let values = [a, b];
        if self.count == 0 {
            self.first = values;
        }
        self.count += 1;
        let before = [a - self.mean[0], b - self.mean[1]];
        for k in 0..2 {
            self.varies[k] |= values[k] != self.first[k];
            self.mean[k] += before[k] / self.count as f64;
            self.squares[k] += before[k] * (values[k] - self.mean[k]);
        }
        self.product += before[0] * (b - self.mean[1]);
    }

    /// Returns the correlation; None for fewer than two frames, a constant side or an unknown value.
    fn value(&self) -> Option<f64> {
        let is_defined = self.count >= 2 && self.varies == [true; 2] && !self.has_unknown;
        let value = self.product / (self.squares[0].sqrt() * self.squares[1].sqrt());
        is_defined.then(|| finite(value)).flatten().map(|r| r.clamp(-1.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FrameScore, summarize};
    use super::*;
    use crate::tactile::N_FIELD;

    fn frame(index: usize, level: f32) -> FrameScore {
        let force: Vec<f32> = (0..N_FIELD).map(|v| if v % 7 == index % 7 { level } else { 0.0 }).collect();
        let predicted: Vec<f32> = force.iter().enumerate().map(|(v, f)| 0.9 * f + 0.01 * (v % 3) as f32).collect();
        let contact: Vec<f32> = (0..N_FIELD).map(|v| ((v * 13 + index) % 100) as f32 / 100.0).collect();
        let touched: Vec<f32> = force.iter().map(|f| f32::from(*f > 0.05)).collect();
        FrameScore::new(&predicted, &contact, &force, &touched, &[], &[])
    }

    #[test]
    fn a_running_summary_agrees_with_that_of_all_frames() {
        let frames: Vec<FrameScore> =
            (0..200).map(|t| frame(t, if t % 9 == 0 { 0.0 } else { 1.0 + (t as f32 * 0.3).sin() })).collect();
        let mut running = RunningSummary::default();
        frames.iter().for_each(|frame| running.push(frame));
        let (got, want) = (running.metrics(), summarize(&frames));
        let pearson = |metrics: &Metrics| metrics.temporal_pearson.unwrap();
        assert!((pearson(&got) - pearson(&want)).abs() < 1e-9);
        assert_eq!(Metrics { temporal_pearson: want.temporal_pearson, ..got }, want);
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
        let mean = frames.chunks(20).map(|episode| summarize(episode).temporal_pearson.unwrap()).sum::<f64>() / 3.0;
        assert!((running.metrics().temporal_pearson.unwrap() - mean).abs() < 1e-9);
        assert_eq!(running.metrics().counts.episodes, 3);
        assert_eq!(RunningSummary::default().metrics().temporal_pearson, None);
    }
}
