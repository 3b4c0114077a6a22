//! Description of a source for the page.

use serde::Serialize;

use super::trace::Course;

/// Kind of a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A recording whose moments can be asked for in any order.
    Recording,
    /// A camera or topic, of which there is only the newest moment.
    Live,
}

/// Description of a source.
#[derive(Debug, Clone, Serialize)]
pub struct About {
    /// Name for people.
    pub name: String,
    /// Kind of the source.
    pub kind: Kind,
    /// Number of images; None = not known, or a live source.
    pub frames: Option<usize>,
    /// Images per second; None = not known.
    pub fps: Option<f64>,
    /// Force at the dark end of the colours, N.
    pub scale: f32,
    /// Origin of the touch: labels of the source, or the name of the network.
    pub touch: String,
    /// True if the source has truth.
    pub truth: bool,
    /// Familiarity below which touch is unknown; None = not estimated.
    pub familiarity_threshold: Option<f32>,
    /// Presence below which touch of a hand is unknown; None = not estimated.
    pub presence_threshold: Option<f32>,
    /// Total force over time, if all of it is known before the images are shown.
    pub course: Option<Course>,
}
