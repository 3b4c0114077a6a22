//! Layout of a glove's taxels: pads outlined on the hand, as written in YAML.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::hand::{JOINT_NAMES, N_KEYPOINTS};

/// Names of the keypoints that pads refer to.
pub const KEYPOINT_NAMES: [&str; N_KEYPOINTS] = [
    "wrist",
    "thumb_base",
    "thumb_2",
    "thumb_3",
    "thumb_tip",
    "index_base",
    "index_2",
    "index_3",
    "index_tip",
    "middle_base",
    "middle_2",
    "middle_3",
    "middle_tip",
    "ring_base",
    "ring_2",
    "ring_3",
    "ring_tip",
    "little_base",
    "little_2",
    "little_3",
    "little_tip",
];
/// Largest number of channels of a sensor.
pub const MAX_CHANNELS: usize = 1 << 14;

/// Origin of the taxels' places.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Placement {
    /// Places are those that the sensor's makers publish.
    #[serde(rename = "exact")]
    Exact,
    /// Pads are outlined by hand after a description or picture.
    #[serde(rename = "drawn by us")]
    Drawn,
}

impl Placement {
    /// Returns the name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Drawn => "drawn by us",
        }
    }
}

/// A glove: its channels and its pads, outlined on the right hand; the left hand is the mirror image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layout {
    /// Name of the glove, for files and messages.
    pub name: String,
    /// One line for people.
    pub title: String,
    /// Origin of the taxels' places: published by the sensor's makers, or outlined by hand after a description or picture.
    pub placement: Placement,
    /// Source of numbers and places of the taxels.
    pub source: String,
    /// Unit of a reading: `N`, or another word where no calibration is published.
    pub unit: String,
    /// Number of channels of one hand; channels that no pad has carry no taxel.
    pub channels: usize,
    /// Pads: grids of taxels, each on one part of the hand.
    pub pads: Vec<Pad>,
}

/// A grid of taxels on one part of the hand.
///
/// Corners are given in the plane that the pad faces, on the right hand at rest: `u` runs from the keypoint `from` (0) to
/// the keypoint `to` (1), `v` to the thumb's side, in units of the distance between the bases of index and little finger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pad {
    /// Name, for errors and pictures.
    pub name: String,
    /// Keypoint at u = 0.
    pub from: String,
    /// Keypoint at u = 1.
    pub to: String,
    /// Direction that the pad faces, in the frame of the right hand at rest; by default that of the palm, `[0, -1, 0]`.
    #[serde(default = "palmar", skip_serializing_if = "is_palmar")]
    pub facing: [f32; 3],
    /// Outer corners (u, v) of the grid: first row and column, first row and last column, last row and column, last row and
    /// first column.
    pub corners: [[f32; 2]; 4],
    /// Numbers of rows and columns.
    pub grid: [usize; 2],
    /// Channel of the first taxel; the others follow row by row. Not together with `channels`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first: Option<usize>,
    /// Channel of each taxel, row by row; null = no taxel there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channels: Option<Vec<Option<usize>>>,
    /// Channel of each taxel of the left hand, if they differ from those of the right hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_channels: Option<Vec<Option<usize>>>,
    /// True if the grid is larger than the hand: taxels beside the hand then do not exist. By default they lie on its edge.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub clip: bool,
    /// Links of the hand that the pad covers, by the names of their joints.
    pub links: Vec<String>,
}

fn palmar() -> [f32; 3] {
    [0.0, -1.0, 0.0]
}

fn is_palmar(facing: &[f32; 3]) -> bool {
    *facing == palmar()
}

impl Layout {
    /// Checks that names exist, outlines are not degenerate, and no channel has two taxels.
    ///
    /// # Errors
    /// If a value does not fit; the error names the pad, the expected and the actual value.
    pub fn check(&self) -> Result<()> {
        if !(1..=MAX_CHANNELS).contains(&self.channels) {
            return Err(Error::value("channels", format!("1 to {MAX_CHANNELS}"), self.channels));
        }
        if self.pads.is_empty() {
            return Err(Error::value("pads", "at least one", "none"));
        }
        for left in [false, true] {
            let mut taken = vec![None; self.channels];
            for (index, pad) in self.pads.iter().enumerate() {
                let name = format!("pads[{index}] ({})", pad.name);
                for channel in pad.taxels(left).map_err(|error| named(&name, error))?.into_iter().flatten() {
                    let Some(place) = taken.get_mut(channel) else {
                        let expected = format!("channels below {}", self.channels);
                        return Err(Error::value(format!("{name}.channels"), expected, channel));
                    };
                    if let Some(other) = place.replace(&pad.name) {
                        let got = format!("channel {channel} also in {other}");
                        return Err(Error::value(format!("{name}.channels"), "each channel once", got));
                    }
                }
            }
        }
        self.pads.iter().enumerate().try_for_each(|(index, pad)| {
            pad.check().map_err(|error| named(&format!("pads[{index}] ({})", pad.name), error))
        })
    }
}

impl Pad {
    /// Returns the channel of each taxel, row by row; `None` = no taxel there.
    ///
    /// # Errors
    /// If the number of channels is not that of the grid, or the grid is empty or too large.
    pub fn taxels(&self, left: bool) -> Result<Vec<Option<usize>>> {
        let [rows, columns] = self.grid;
        let count = rows.checked_mul(columns).filter(|count| (1..=MAX_CHANNELS).contains(count));
        let Some(count) = count else {
            return Err(Error::value("grid", format!("1 to {MAX_CHANNELS} taxels"), format!("{rows} x {columns}")));
        };
        let channels = self.left_channels.as_ref().filter(|_| left).or(self.channels.as_ref());
        match (channels, self.first) {
            (Some(channels), None) if channels.len() == count => Ok(channels.clone()),
            (Some(channels), None) => Err(Error::shape("channels", format!("[{count}]"), [channels.len()])),
            (None, Some(first)) => Ok((0..count).map(|k| first.checked_add(k)).collect()),
            _ => Err(Error::value("first and channels", "one of them", "both or none")),
        }
    }

    fn check(&self) -> Result<()> {
        for name in [&self.from, &self.to] {
            keypoint(name)?;
        }
        if self.links.is_empty() {
            return Err(Error::value("links", "at least one", "none"));
        }
        self.links.iter().try_for_each(|name| link(name).map(drop))?;
        let numbers = self.corners.iter().flatten().chain(&self.facing);
        if let Some(bad) = numbers.copied().find(|number| !(-100.0..=100.0).contains(number)) {
            return Err(Error::value("corners and facing", "numbers from -100 to 100", bad));
        }
        if self.facing.iter().map(|x| x * x).sum::<f32>() < 1e-6 {
            return Err(Error::value("facing", "a direction", "(0, 0, 0)"));
        }
        let cross = |k: usize| {
            let [a, b, c] = [k, (k + 1) % 4, (k + 2) % 4].map(|corner| self.corners[corner]);
            (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        };
        let signs = [0, 1, 2, 3].map(cross);
        match signs.iter().all(|s| *s > 1e-8) || signs.iter().all(|s| *s < -1e-8) {
            true => Ok(()),
            false => Err(Error::value("corners", "a convex outline, corner after corner", "another one")),
        }
    }
}

/// Returns the index of a keypoint.
pub(super) fn keypoint(name: &str) -> Result<usize> {
    let found = KEYPOINT_NAMES.iter().position(|known| *known == name);
    found.ok_or_else(|| Error::unknown("keypoint", name, KEYPOINT_NAMES))
}

/// Returns the index of a link.
pub(super) fn link(name: &str) -> Result<usize> {
    let found = JOINT_NAMES.iter().position(|known| *known == name);
    found.ok_or_else(|| Error::unknown("link", name, JOINT_NAMES))
}

fn named(pad: &str, error: Error) -> Error {
    match error {
        Error::Value { name, expected, got } => Error::Value { name: format!("{pad}.{name}"), expected, got },
        Error::Shape { name, expected, got } => Error::Shape { name: format!("{pad}.{name}"), expected, got },
        other => other,
    }
}
