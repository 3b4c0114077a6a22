//! Description of the labels in a data set: provenance and summary.

use serde::{Deserialize, Serialize};

use super::label_frame::LabelCounts;
use super::provenance::Provenance;
use super::source::LostBytes;
use crate::tactile::N_FIELD;
use crate::text::printable_name;

/// Largest number of unlabelled images that a summary lists; further ones are only counted.
const LISTED: usize = 1000;
/// Largest number of unlabelled images, and of lost stretches, that the text shows.
const SHOWN: usize = 20;

/// Share of unfamiliar images above which the summary warns.
const MANY_UNFAMILIAR: f64 = 0.1;

/// Description of labels; every output holds one under [`super::PROVENANCE_KEY`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LabelInfo {
    /// Origin and meaning of the labels.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Coverage of the labels.
    pub summary: LabelSummary,
}

/// Coverage of labels: counts, unlabelled images and lost bytes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LabelSummary {
    /// Coverage and confidence.
    #[serde(flatten)]
    pub counts: LabelCounts,
    /// Images without a label, the first thousand.
    pub faults: Vec<UnlabelledImage>,
    /// Bytes of the input that can't be read.
    pub lost: Vec<LostBytes>,
}

/// An image without a label.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnlabelledImage {
    /// Name of the unit.
    pub unit: String,
    /// Index of the image in the unit.
    pub frame: u64,
    /// Place and cause of the failure.
    pub reason: String,
}

impl LabelSummary {
    /// Adds counts and unlabelled images.
    pub fn add_images(&mut self, counts: &LabelCounts, faults: impl IntoIterator<Item = UnlabelledImage>) {
        self.counts.add(counts);
        let room = LISTED.saturating_sub(self.faults.len());
        self.faults.extend(faults.into_iter().take(room));
    }

    /// Adds another summary.
    pub fn add(&mut self, other: &Self) {
        self.add_images(&other.counts, other.faults.iter().cloned());
        self.lost.extend_from_slice(&other.lost);
    }

    /// True if every image has a label and every byte was read.
    pub fn is_whole(&self) -> bool {
        self.counts.labelled == self.counts.frames && self.lost.is_empty()
    }

    /// Returns a warning if more than a tenth of the images are unlike those of the training.
    pub fn warning(&self) -> Option<String> {
        let LabelCounts { judged, unfamiliar, .. } = self.counts;
        let share = unfamiliar as f64 / judged.max(1) as f64;
        (share > MANY_UNFAMILIAR).then(|| {
            format!(
                "{:.1} % of the images are unlike those that the network was trained on: it does not know touch in these{}",
                100.0 * share,
                if unfamiliar < judged { ", and its labels of the others deserve a look" } else { "" }
            )
        })
    }

    /// Returns the lines about unfamiliar images and absent hands; empty if the network judges no images.
    fn certainty_text(&self) -> String {
        let LabelCounts { judged, unfamiliar, absent, .. } = self.counts;
        if judged == 0 && absent == [0, 0] {
            return String::new();
        }
        let share = |part: u64, whole: u64| 100.0 * part as f64 / whole.max(1) as f64;
        let mut text = format!("\nunfamiliar: {:.1} % of the images", share(unfamiliar, judged));
        let familiar = self.counts.labelled - unfamiliar.min(self.counts.labelled);
        if absent != [0, 0] {
            let [left, right] = absent.map(|absent| share(absent, familiar));
            text += &format!("; of the others, no left hand in {left:.1} %, no right hand in {right:.1} %");
        }
        if let Some(warning) = self.warning() {
            text += &format!("\nwarning: {warning}");
        }
        text
    }

    /// Returns the summary as text, one fact per line.
    pub fn text(&self) -> String {
        let share = |part: u64, whole: u64| 100.0 * part as f64 / whole.max(1) as f64;
        let LabelCounts { frames, labelled, warming_up, confidence, touched, known, judged, absent, .. } = &self.counts;
        let mut text = format!(
            "{labelled} of {frames} images labelled ({:.1} %), {warming_up} of them before the window was full\n",
            share(*labelled, *frames)
        );
        let vertices = labelled * N_FIELD as u64;
        // Labels of version 0.1.0 know all vertices and do not count them.
        let counted = *known > 0 || *judged > 0 || *absent != [0, 0];
        text += &match if counted { *known } else { vertices } {
            0 if vertices > 0 => "touch is unknown in all of them".into(),
            known if known < vertices => format!(
                "{:.3} % of the vertices whose touch is known are touched; {:.1} % are known",
                share(*touched, known),
                share(known, vertices)
            ),
            known => format!("{:.3} % of the vertices touched", share(*touched, known)),
        };
        if *touched > 0 {
            text += "; probability of touch on these";
            for (bin, count) in confidence.iter().enumerate() {
                let (low, high) = (0.5 + 0.1 * bin as f64, 0.6 + 0.1 * bin as f64);
                text += &format!(" {low:.1}-{high:.1}: {:.2} %", share(*count, *touched));
            }
        }
        text += &self.certainty_text();
        for fault in self.faults.iter().take(SHOWN) {
            let line = format!("no label: {}, image {}: {}", fault.unit, fault.frame, fault.reason);
            text += &format!("\n{}", printable_name(&line));
        }
        let missing = frames - labelled;
        if missing > SHOWN as u64 {
            text += &format!("\nno label: {} more images", missing - SHOWN as u64);
        }
        for lost in self.lost.iter().take(SHOWN) {
            let line = format!("lost: {}, {} bytes from byte {}: {}", lost.file, lost.bytes, lost.offset, lost.reason);
            text += &format!("\n{}", printable_name(&line));
        }
        if self.lost.len() > SHOWN {
            text += &format!("\nlost: {} more places", self.lost.len() - SHOWN);
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_tells_unknown_touch_from_labels_that_do_not_count_known_vertices() {
        let text = |counts: LabelCounts| {
            LabelSummary { counts: LabelCounts { frames: 2, labelled: 2, ..counts }, ..LabelSummary::default() }.text()
        };
        let old = text(LabelCounts { touched: 778, ..LabelCounts::default() });
        assert!(old.contains("25.000 % of the vertices touched"), "{old}");
        let unfamiliar = text(LabelCounts { judged: 2, unfamiliar: 2, ..LabelCounts::default() });
        assert!(unfamiliar.contains("touch is unknown in all of them"), "{unfamiliar}");
        let half = text(LabelCounts { judged: 2, absent: [2, 0], known: 1556, touched: 389, ..LabelCounts::default() });
        assert!(half.contains("25.000 % of the vertices whose touch is known are touched; 50.0 % are known"), "{half}");
    }
}
