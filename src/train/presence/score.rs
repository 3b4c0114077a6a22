//! Scores of presence and keypoints on held-out images.

use std::fmt;

use super::samples::Samples;
use crate::hand::N_KEYPOINTS;
use crate::model::Presence;
use crate::score::metrics::contact::auroc;
use crate::statistics::median;
use crate::train::keypoints;

/// Scores of presence and keypoints. Hands with one or two keypoints in view are left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Hands of frames as they are: area under the ROC curve of presence; None if all are present, or none.
    pub auroc: Option<f64>,
    /// Likewise, of all images: changed frames and pictures too.
    pub auroc_changed: Option<f64>,
    /// Hands in view of frames as they are.
    pub present: usize,
    /// Of these, hands with a presence below 0.5.
    pub missed: usize,
    /// Hands not in view, of all images.
    pub absent: usize,
    /// Of these, hands with a presence of at least 0.5.
    pub invented: usize,
    /// Median distance of keypoints in view from the truth, as a share of the image's side, in frames as they are.
    pub keypoint_error: f64,
}

impl Score {
    /// Scores the estimates of samples; `size`: numbers of the tokens of a frame.
    pub(super) fn of(presence: &Presence, samples: &Samples, size: usize) -> Self {
        let (mut plain, mut all, mut errors) = (Vec::new(), Vec::new(), Vec::new());
        let frames = samples.tokens.chunks_exact(size).zip(&samples.truths).zip(&samples.unchanged);
        for ((tokens, truth), unchanged) in frames {
            let tokens: Vec<f32> = tokens.iter().map(|value| value.to_f32()).collect();
            let hands = presence.of(&tokens);
            for (hand, (estimate, known)) in hands.iter().zip(truth.presence()).enumerate() {
                let Some(known) = known else { continue };
                all.push((estimate.presence, known));
                plain.extend(unchanged.then_some((estimate.presence, known)));
                if *unchanged && known {
                    let places = &truth.places[hand * N_KEYPOINTS..(hand + 1) * N_KEYPOINTS];
                    let pairs = estimate.keypoints.iter().zip(places);
                    let seen = pairs.filter(|(_, place)| keypoints::patch(**place, 1).is_some());
                    errors.extend(
                        seen.map(|(keypoint, [x, y])| f64::from((keypoint.place[0] - x).hypot(keypoint.place[1] - y))),
                    );
                }
            }
        }
        let count = |of: &[(f32, bool)], known: bool| of.iter().filter(|(_, truth)| *truth == known).count();
        let wrong = |of: &[(f32, bool)], known: bool| {
            of.iter().filter(|(presence, truth)| *truth == known && (*presence >= 0.5) != known).count()
        };
        Self {
            present: count(&plain, true),
            missed: wrong(&plain, true),
            absent: count(&all, false),
            invented: wrong(&all, false),
            auroc: auroc(plain),
            auroc_changed: auroc(all),
            keypoint_error: median(errors),
        }
    }
}

impl fmt::Display for Score {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let area = |area: Option<f64>| area.map_or("undefined".to_owned(), |area| format!("{area:.4}"));
        write!(
            f,
            "AUROC of presence {} on held-out frames, {} with changed frames and pictures; {} of {} hands in view missed, {} \
             of {} hands not in view reported; median keypoint error {:.2} % of the image's side",
            area(self.auroc),
            area(self.auroc_changed),
            self.missed,
            self.present,
            self.invented,
            self.absent,
            100.0 * self.keypoint_error
        )
    }
}
