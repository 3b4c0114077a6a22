//! Predicted touch per image, and the outputs that hold it.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::label_info::LabelInfo;
use super::provenance::CONTACT_THRESHOLD;
use crate::error::{Error, Result};
use crate::hand::Topology;
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
}

impl LabelFrame {
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
    /// Number of vertices of labelled images by confidence, the larger of the probabilities of touch and no touch: 0.5 to
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
        for contact in &field.contact {
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

/// Labels of all units of a source, complete and on disk; an output reads them unit by unit, as often as it needs.
pub trait SourceLabels: Send + Sync {
    /// Returns the vertex numbering of the fields.
    fn topology(&self) -> Topology;

    /// Returns the labels of unit `unit` in the order of its images.
    ///
    /// # Errors
    /// If they can't be read.
    fn labels(&self, unit: usize) -> Result<LabelFrames<'_>>;

    /// Returns the source's notes of unit `unit` in order, without reading the fields.
    ///
    /// # Errors
    /// If they can't be read.
    fn notes(&self, unit: usize) -> Result<Notes<'_>>;
}

/// Labels in order.
pub type LabelFrames<'a> = Box<dyn Iterator<Item = Result<LabelFrame>> + Send + 'a>;

/// Notes in order.
pub type Notes<'a> = Box<dyn Iterator<Item = Result<String>> + Send + 'a>;

/// Returns the next label; an error if the source has more images than labels.
///
/// # Errors
/// If there is no further label for unit `unit`, or it can't be read.
pub(super) fn next_label(labels: &mut dyn Iterator<Item = Result<LabelFrame>>, unit: &str) -> Result<LabelFrame> {
    let label = labels.next().transpose()?;
    label.ok_or_else(|| Error::value(unit, "the images that were labelled", "more images"))
}

/// A data set that holds labels.
pub trait LabelOutput: Send + Sync {
    /// Writes the data set to `at`, which the caller then renames to `out`. The method may reuse or replace files that an
    /// earlier, killed attempt left at `at`. It adds damage found in the input to the summary of `info`, and writes `info`
    /// into the output.
    ///
    /// # Errors
    /// If the input can't be read, the output can't be written, or the labels belong to another input.
    fn assemble(&self, labels: &dyn SourceLabels, info: &mut LabelInfo, at: &Path, out: &Path) -> Result<()>;

    /// Checks that the output can hold fields of `topology`. The check runs before inference, so that no work is lost.
    ///
    /// # Errors
    /// If the output would be invalid.
    fn check(&self, topology: Topology) -> Result<()> {
        let _ = topology;
        Ok(())
    }

    /// Reads the description of the labels in the data set at `out`; None without one.
    fn info(&self, out: &Path) -> Option<LabelInfo>;
}
