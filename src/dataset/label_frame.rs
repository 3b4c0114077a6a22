//! The label of one image, and counts of labels.

use serde::{Deserialize, Serialize};

use super::provenance::CONTACT_THRESHOLD;
use crate::hand::{N_KEYPOINTS, Side};
use crate::tactile::{Certainty, Doubt, N_FIELD, TactileField};

/// Number of bins of the confidence histogram: 0.5 to 0.6, ..., 0.9 to 1.
const BINS: usize = 5;

/// Number of values of the keypoints of both hands.
pub(crate) const KEYPOINT_VALUES: usize = 2 * N_KEYPOINTS * 3;

/// The label of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelFrame {
    /// Stamp of the image, s.
    pub stamp_secs: f64,
    /// True if the network's window was not full yet.
    pub warming_up: bool,
    /// Force and contact, or the reason why there are none.
    pub touch: std::result::Result<TactileField, String>,
    /// Certainty of the network about the image.
    pub certainty: Certainty,
    /// Further numbers of a labelled image, such as distances or keypoints; the same number of them in all images of a journal.
    pub further: Vec<f32>,
}

impl LabelFrame {
    /// Creates the label of an image that can't be labelled for `reason`.
    pub fn without(stamp_secs: f64, reason: String) -> Self {
        let certainty = Certainty::default();
        Self { stamp_secs, warming_up: false, touch: Err(reason), certainty, further: Vec::new() }
    }

    /// Returns familiarity, and presence of the left and the right hand; NaN = not estimated.
    pub fn estimates(&self) -> [f32; 3] {
        let Certainty { familiarity, presence: [left, right], .. } = self.certainty;
        [familiarity, left, right].map(|estimate| estimate.unwrap_or(f32::NAN))
    }

    /// Returns the keypoints of both hands, (2, 21, 3): x and y in pixels of the image, confidence; NaN = unknown.
    pub fn keypoints(&self) -> Vec<f32> {
        match self.further.len() {
            KEYPOINT_VALUES => self.further.clone(),
            _ => vec![f32::NAN; KEYPOINT_VALUES],
        }
    }

    /// Returns the masks of force and contact, (1556) each: 0 where they are unknown.
    pub fn masks(&self) -> [Vec<u8>; 2] {
        match &self.touch {
            Ok(field) => [&field.force, &field.contact].map(|values| {
                let mask = self.certainty.mask();
                mask.iter().zip(values).map(|(mask, value)| mask * u8::from(!value.is_nan())).collect()
            }),
            Err(_) => [vec![0; N_FIELD], vec![0; N_FIELD]],
        }
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
    /// Number of touched vertices of labelled images by the probability of touch: 0.5 to 0.6, 0.6 to 0.7, and so on.
    pub confidence: [u64; BINS],
    /// Number of touched vertices of labelled images.
    pub touched: u64,
    /// Number of vertices of labelled images whose contact is known.
    #[serde(default)]
    pub known: u64,
    /// Number of labelled images whose familiarity is known.
    #[serde(default)]
    pub judged: u64,
    /// Number of labelled images that are unlike those of the training.
    #[serde(default)]
    pub unfamiliar: u64,
    /// Number of familiar images without the left and without the right hand.
    #[serde(default)]
    pub absent: [u64; 2],
}

impl LabelCounts {
    /// Counts the label of one image.
    pub fn count(&mut self, label: &LabelFrame) {
        self.frames += 1;
        self.warming_up += u64::from(label.warming_up);
        let Ok(field) = &label.touch else { return };
        self.labelled += 1;
        let certainty = &label.certainty;
        self.judged += u64::from(certainty.familiarity.is_some());
        self.unfamiliar += u64::from(certainty.is_unfamiliar());
        for side in Side::BOTH {
            self.absent[side as usize] += u64::from(certainty.doubt[side as usize] == Some(Doubt::Absent));
            if !certainty.counts(side) {
                continue;
            }
            for contact in field.contact[side.range()].iter().filter(|contact| !contact.is_nan()) {
                self.known += 1;
                if f64::from(*contact) > CONTACT_THRESHOLD {
                    self.touched += 1;
                    let bin = ((contact - 0.5) * 2.0 * BINS as f32) as usize;
                    self.confidence[bin.min(BINS - 1)] += 1;
                }
            }
        }
    }

    /// Adds the counts of further images.
    pub fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.labelled += other.labelled;
        self.warming_up += other.warming_up;
        self.touched += other.touched;
        self.known += other.known;
        self.judged += other.judged;
        self.unfamiliar += other.unfamiliar;
        self.absent.iter_mut().zip(other.absent).for_each(|(sum, more)| *sum += more);
        self.confidence.iter_mut().zip(other.confidence).for_each(|(sum, more)| *sum += more);
    }
}
