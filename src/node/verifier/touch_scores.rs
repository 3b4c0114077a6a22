//! Scores of touches, as `egotac verify` computes them, from fields alone: vertices are placed as in the rest pose.

use crate::score::agreement::{Scorer, Sums, TruthFrame};
use crate::score::verify::recording::RestHands;
use crate::tactile::TactileField;

/// Most frames of one episode, 11 minutes at 30 Hz, which bound its memory to about 0.5 MB; touches under way where a longer one is
/// cut have no known onset or offset.
const MAX_EPISODE_FRAMES: u64 = 20_000;

/// Sums of touch scores over the episodes of the truth.
#[derive(Default)]
pub(super) struct TouchScores {
    hands: Option<RestHands>,
    /// Scorer of the open episode.
    open: Option<Scorer>,
    /// Frames of the open episode.
    frames: u64,
    /// Sums of the closed episodes.
    closed: Sums,
}

impl TouchScores {
    /// Adds a valid pair with its stamp in seconds; returns the sums of this pair.
    ///
    /// # Errors
    /// If the truth has no rest pose or the fields do not fit it.
    pub(super) fn push(&mut self, secs: f64, predicted: &TactileField, target: &TactileField) -> crate::Result<Sums> {
        if self.hands.as_ref().is_none_or(|hands| hands.topology != target.topology) {
            self.end_episode();
            self.hands = Some(RestHands::of(target.topology, None)?);
        }
        self.frames += 1;
        if self.frames > MAX_EPISODE_FRAMES {
            self.end_episode();
            self.frames = 1;
        }
        let Some(hands) = &self.hands else { return Ok(Sums::default()) };
        let truth = TruthFrame::new(secs, target.force.clone(), Vec::new(), hands.positions.clone(), None)?;
        let scorer = self.open.get_or_insert_with(|| Scorer::new(hands.groups.clone()));
        scorer.push(&truth, &predicted.contact, &predicted.force)
    }

    /// Skips a pair whose truth is invalid.
    pub(super) fn skip(&mut self) {
        self.open.iter_mut().for_each(Scorer::refuse);
    }

    /// Closes the open episode.
    pub(super) fn end_episode(&mut self) {
        self.frames = 0;
        if let Some(scorer) = self.open.take() {
            self.closed += &scorer.finish();
        }
    }

    /// Returns the sums of all episodes; the open one counts as if it ended here.
    pub(super) fn total(&self) -> Sums {
        let mut total = self.closed.clone();
        if let Some(scorer) = &self.open {
            total += &scorer.clone().finish();
        }
        total
    }
}
