//! Scores of a single frame.

use super::contact::{self, Confusion};
use super::force::{self, ForceErrors};

/// Contribution of one frame to the scores; [`summarize`](super::summarize) makes scores of many frames.
///
/// The default is a frame in which nothing counts.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameScore {
    /// Force errors of the frame.
    pub force: ForceErrors,
    /// Contact decisions of the frame.
    pub contact: Confusion,
    /// AUROC within the frame.
    pub auroc: Option<f64>,
    /// Predicted total force, N; None if unknown.
    pub pred_total: Option<f64>,
    /// True total force, N; None if the force of no vertex counts, so that the frame is a gap in every trace.
    pub target_total: Option<f64>,
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
            force: ForceErrors::of(&forces),
            contact: Confusion::of(&contacts),
            auroc: contact::auroc(contacts),
            pred_total,
            target_total,
        }
    }
}
