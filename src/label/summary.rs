//! What a labelling did, in numbers.

use serde::{Deserialize, Serialize};

use super::journal::{Head, Label};
use super::provenance::{CONTACT_THRESHOLD, Provenance};
use crate::dataset::mcap::Lost;

/// Bins of the confidence histogram: 0.5 to 0.6 and so on.
const BINS: usize = 5;
/// Faults that are listed; more are counted.
const LISTED: usize = 1000;

/// What an output says about itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct About {
    /// Where the labels come from.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// What was labelled and what was not.
    pub summary: Summary,
}

/// What was labelled, and what was not.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The labels in numbers.
    #[serde(flatten)]
    pub counts: Counts,
    /// Images without a label, the first thousand of them.
    pub faults: Vec<Fault>,
    /// Bytes of the input that are in no output since they can't be read.
    pub lost: Vec<Lost>,
}

/// Coverage and confidence of labels.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Images.
    pub frames: u64,
    /// Images with a label.
    pub labelled: u64,
    /// Images whose window was not full yet.
    pub warming_up: u64,
    /// Vertices of labelled images by confidence, the larger of the probabilities of touch and no touch: 0.5 to 0.6,
    /// 0.6 to 0.7, and so on.
    pub confidence: [u64; BINS],
    /// Vertices of labelled images that are touched.
    pub touched: u64,
}

/// An image without a label.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// The unit's name.
    pub unit: String,
    /// Number of the image in it.
    pub frame: u64,
    /// Where and why.
    pub reason: String,
}

impl Counts {
    /// Counts the label of one image.
    pub fn count(&mut self, label: &Label) {
        self.frames += 1;
        self.warming_up += u64::from(label.warming_up);
        let Ok(field) = &label.touch else { return };
        self.labelled += 1;
        for contact in &field.contact {
            let confidence = contact.max(1.0 - contact);
            let bin = ((confidence - 0.5) * 2.0 * BINS as f32) as usize;
            self.confidence[bin.min(BINS - 1)] += 1;
            self.touched += u64::from(f64::from(*contact) > CONTACT_THRESHOLD);
        }
    }

    /// Adds another one's numbers.
    pub fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.labelled += other.labelled;
        self.warming_up += other.warming_up;
        self.touched += other.touched;
        self.confidence.iter_mut().zip(other.confidence).for_each(|(sum, more)| *sum += more);
    }
}

impl Summary {
    /// Adds what a block of the journal of `unit` says.
    pub fn add_block(&mut self, unit: &str, head: &Head) {
        self.counts.add(&head.counts);
        for (place, reason) in head.faults.iter().take(LISTED - self.faults.len().min(LISTED)) {
            let frame = (head.first + place) as u64;
            self.faults.push(Fault { unit: unit.to_string(), frame, reason: reason.clone() });
        }
    }

    /// Adds another one's numbers.
    pub fn add(&mut self, other: &Self) {
        self.counts.add(&other.counts);
        self.faults.extend(other.faults.iter().take(LISTED - self.faults.len().min(LISTED)).cloned());
        self.lost.extend_from_slice(&other.lost);
    }

    /// Whether every image was labelled and every byte read.
    pub fn is_whole(&self) -> bool {
        self.counts.labelled == self.counts.frames && self.lost.is_empty()
    }

    /// The numbers in words, one fact per line.
    pub fn text(&self) -> String {
        let share = |part: u64, whole: u64| 100.0 * part as f64 / whole.max(1) as f64;
        let Counts { frames, labelled, warming_up, confidence, touched } = &self.counts;
        let entries = confidence.iter().sum();
        let mut text = format!(
            "{labelled} of {frames} images labelled ({:.1} %), {warming_up} of them before the window was full\n{:.3} % of the vertices touched",
            share(*labelled, *frames),
            share(*touched, entries)
        );
        if entries > 0 {
            text += "; confidence";
            for (bin, count) in confidence.iter().enumerate() {
                text += &format!(
                    " {:.1}-{:.1}: {:.2} %",
                    0.5 + 0.1 * bin as f64,
                    0.6 + 0.1 * bin as f64,
                    share(*count, entries)
                );
            }
        }
        const SHOWN: usize = 20;
        for fault in self.faults.iter().take(SHOWN) {
            text += &format!("\nno label: {}, image {}: {}", fault.unit, fault.frame, fault.reason);
        }
        let missing = frames - labelled;
        if missing > SHOWN as u64 {
            text += &format!("\nno label: {} more images", missing - SHOWN as u64);
        }
        for lost in self.lost.iter().take(SHOWN) {
            text += &format!("\nlost: {}, {} bytes from byte {}: {}", lost.file, lost.bytes, lost.offset, lost.reason);
        }
        if self.lost.len() > SHOWN {
            text += &format!("\nlost: {} more places", self.lost.len() - SHOWN);
        }
        text
    }
}
