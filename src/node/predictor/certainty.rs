//! Certainty about the newest images, for the log and `/diagnostics`.

use std::sync::{Arc, Mutex};

use crate::model::predictor::Prediction;
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::tactile::{Certainty, Doubt};

/// Number of consecutive images with another doubt before the log says so: a single one is common at the border.
const STEADY: u32 = 5;

/// Counts of doubts, and the doubt of the newest images; clones share them.
#[derive(Clone, Default)]
pub(super) struct Certainties(Arc<Mutex<DoubtCounts>>);

#[derive(Default)]
struct DoubtCounts {
    newest: Certainty,
    /// Doubts of both hands that the log told last.
    told: [Option<Doubt>; 2],
    /// Consecutive images whose doubts differ from those.
    others: u32,
    /// Images unlike those of the training.
    unfamiliar: u64,
    /// Familiar images without the left and without the right hand.
    absent: [u64; 2],
    /// Images that took the tokens of an earlier one.
    reused: u64,
}

impl Certainties {
    /// Counts an image. Logs one line when the hands whose touch is unknown have changed for some images.
    pub(super) fn push(&self, prediction: &Prediction, log: &Log) {
        lock(&self.0).reused += u64::from(prediction.is_reused());
        let certainty = &prediction.certainty;
        if let Some(line) = lock(&self.0).push(certainty) {
            match certainty.is_unfamiliar() {
                true => log.warn(line),
                false => log.info(line),
            }
        }
    }

    /// Returns the reason why touch in the newest image is unknown because of the whole image; None if it is familiar.
    pub(super) fn doubt(&self) -> Option<String> {
        let newest = lock(&self.0).newest;
        newest.is_unfamiliar().then(|| newest.reason())
    }

    /// Returns names and values for the diagnostics.
    pub(super) fn values(&self) -> Vec<(String, String)> {
        let counts = lock(&self.0);
        let shown = |value: Option<f32>| value.map_or("not estimated".to_owned(), |value| format!("{value:.3}"));
        let Certainty { familiarity, presence: [left, right], .. } = counts.newest;
        [
            ("familiarity", shown(familiarity)),
            ("presence left", shown(left)),
            ("presence right", shown(right)),
            ("unfamiliar", counts.unfamiliar.to_string()),
            ("absent left", counts.absent[0].to_string()),
            ("absent right", counts.absent[1].to_string()),
            ("reused", counts.reused.to_string()),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
    }
}

impl DoubtCounts {
    fn push(&mut self, certainty: &Certainty) -> Option<String> {
        self.newest = *certainty;
        self.unfamiliar += u64::from(certainty.is_unfamiliar());
        for (absent, doubt) in self.absent.iter_mut().zip(certainty.doubt) {
            *absent += u64::from(doubt == Some(Doubt::Absent));
        }
        self.others = if certainty.doubt == self.told { 0 } else { self.others + 1 };
        if self.others < STEADY {
            return None;
        }
        (self.told, self.others) = (certainty.doubt, 0);
        Some(match certainty.reason() {
            reason if reason.is_empty() => "touch of both hands is known".to_owned(),
            reason => format!("touch is unknown: {reason}"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_change_of_doubt_is_told_once() {
        let mut counts = DoubtCounts::default();
        let known = Certainty::default();
        let unfamiliar =
            Certainty { familiarity: Some(1e-4), doubt: [Some(Doubt::Unfamiliar); 2], ..Certainty::default() };
        let mut told = Vec::new();
        for (certainty, times) in [(known, 10), (unfamiliar, 4), (known, 3), (unfamiliar, 9), (known, 20)] {
            told.extend((0..times).filter_map(|_| counts.push(&certainty)));
        }
        let expected = "touch is unknown: the image is unlike those of the training (familiarity 1.0e-4)";
        assert_eq!(told, [expected, "touch of both hands is known"]);
        assert_eq!((counts.unfamiliar, counts.absent), (13, [0, 0]));
    }
}
