//! The label of one image, and counts of labels.

use serde::{Deserialize, Serialize};

use super::provenance::CONTACT_THRESHOLD;
use crate::tactile::{N_FIELD, TactileField};

/// Number of bins of the confidence histogram: 0.5 to 0.6, ..., 0.9 to 1.
const BINS: usize = 5;

/// The label of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelFrame {
    /// Stamp of the image, s.
    pub stamp_secs: f64,
    /// True if the network's window was not full yet.
    pub warming_up: bool,
    /// Force and contact, or the reason why there are none.
    pub touch: std::result::Result<TactileField, String>,
    /// Further numbers of a labelled image, such as distances; the same number of them in all images of a journal.
    pub further: Vec<f32>,
}

impl LabelFrame {
    /// Creates the label of an image that can't be labelled for `reason`.
    pub fn without(stamp_secs: f64, reason: String) -> Self {
        Self { stamp_secs, warming_up: false, touch: Err(reason), further: Vec::new() }
    }

    /// Returns force and contact, (1556) each; NaN without a label.
    pub fn into_values(self) -> (Vec<f32>, Vec<f32>) {
        match self.touch {
            Ok(field) => (field.force, field.contact),
            Err(_) => (vec![f32::NAN; N_FIELD], vec![f32::NAN; N_FIELD]),
        }
    }
}

/// Coverage and confidence of labels.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LabelCounts {
    /// Number of images.
    pub frames: u64,
    /// Number of images with a label.
    pub labelled: u64,
    /// Number of images whose window was not full yet.
    pub warming_up: u64,
    /// Number of vertices of labelled images whose contact is known by confidence, the larger of the probabilities of touch and no touch: 0.5 to
    /// 0.6, 0.6 to 0.7, and so on.
    pub confidence: [u64; BINS],
    /// Number of touched vertices of labelled images.
    pub touched: u64,
}

impl LabelCounts {
    /// Counts the label of one image.
    pub fn count(&mut self, label: &LabelFrame) {
        self.frames += 1;
        self.warming_up += u64::from(label.warming_up);
        let Ok(field) = &label.touch else { return };
        self.labelled += 1;
        for contact in field.contact.iter().filter(|contact| !contact.is_nan()) {
            let confidence = contact.max(1.0 - contact);
            let bin = ((confidence - 0.5) * 2.0 * BINS as f32) as usize;
            self.confidence[bin.min(BINS - 1)] += 1;
            self.touched += u64::from(f64::from(*contact) > CONTACT_THRESHOLD);
        }
    }

    /// Adds the counts of further images.
    pub fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.labelled += other.labelled;
        self.warming_up += other.warming_up;
        self.touched += other.touched;
        self.confidence.iter_mut().zip(other.confidence).for_each(|(sum, more)| *sum += more);
    }
}
