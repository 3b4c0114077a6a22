//! Certainty of a network about one frame.

use serde::{Deserialize, Serialize};

use crate::hand::Side;

/// Reason why touch of a hand is not known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Doubt {
    /// The image is unlike those of the training.
    Unfamiliar,
    /// The hand is not in the image.
    Absent,
}

impl Doubt {
    /// Describes the reason.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Unfamiliar => "the image is unlike those of the training",
            Self::Absent => "no such hand in the image",
        }
    }
}

/// Certainty of a network about one frame: what it estimates about the image, and the hands whose touch it does not know.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Certainty {
    /// Likeness of the image to those of the training, 0 to 1; None = not estimated.
    pub familiarity: Option<f32>,
    /// Presence of the left and the right hand in the image, 0 to 1; None = not estimated.
    pub presence: [Option<f32>; 2],
    /// Reason why touch of the left and of the right hand is not known; None = it is known.
    pub doubt: [Option<Doubt>; 2],
    /// True if forces and contacts of hands in doubt are masked; false if they are the network's guess.
    pub masked: bool,
}

impl Certainty {
    /// Number of values of [`Certainty::to_values`].
    pub(crate) const VALUES: usize = 4;

    /// True if force and contact of a hand count: its touch is known, or the network's guess is wanted.
    pub fn counts(&self, side: Side) -> bool {
        !self.masked || self.doubt[side as usize].is_none()
    }

    /// Returns the mask of a frame, (1556): 1 where [`Certainty::counts`].
    pub fn mask(&self) -> Vec<u8> {
        Side::BOTH
            .iter()
            .flat_map(|side| std::iter::repeat_n(u8::from(self.counts(*side)), side.range().len()))
            .collect()
    }

    /// True if the frame is unfamiliar.
    pub fn is_unfamiliar(&self) -> bool {
        self.doubt.contains(&Some(Doubt::Unfamiliar))
    }

    /// Returns the reason for people, with the numbers behind it; empty if touch of both hands is known.
    pub fn reason(&self) -> String {
        if self.is_unfamiliar() {
            return format!("{} (familiarity {})", Doubt::Unfamiliar.reason(), shown(self.familiarity));
        }
        let of = |side: Side| {
            let doubt = self.doubt[side as usize]?;
            Some(format!("{}: {} (presence {})", side.name(), doubt.reason(), shown(self.presence[side as usize])))
        };
        Side::BOTH.into_iter().filter_map(of).collect::<Vec<_>>().join("; ")
    }

    /// Returns familiarity, presence of both hands (NaN = not estimated), and a code of the rest.
    pub(crate) fn to_values(self) -> [f32; Self::VALUES] {
        let code = |doubt: Option<Doubt>| match doubt {
            None => 0,
            Some(Doubt::Unfamiliar) => 1,
            Some(Doubt::Absent) => 2,
        };
        let [left, right] = self.doubt.map(code);
        let number = |value: Option<f32>| value.unwrap_or(f32::NAN);
        let [left_presence, right_presence] = self.presence.map(number);
        let rest = left + 3 * right + 9 * i32::from(self.masked);
        [number(self.familiarity), left_presence, right_presence, rest as f32]
    }

    /// Reads the values of [`Certainty::to_values`]; None if they are not such values.
    pub(crate) fn from_values(values: &[f32]) -> Option<Self> {
        let [familiarity, left, right, rest] = *values else { return None };
        if !(0.0..18.0).contains(&rest) {
            return None;
        }
        let rest = rest as u8;
        let doubt = |code: u8| match code % 3 {
            1 => Some(Doubt::Unfamiliar),
            2 => Some(Doubt::Absent),
            _ => None,
        };
        let number = |value: f32| (!value.is_nan()).then_some(value);
        Some(Self {
            familiarity: number(familiarity),
            presence: [number(left), number(right)],
            doubt: [doubt(rest), doubt(rest / 3)],
            masked: rest >= 9,
        })
    }
}

/// Formats an estimate; small ones keep their size.
fn shown(value: Option<f32>) -> String {
    match value {
        Some(value) if value < 0.01 => format!("{value:.1e}"),
        Some(value) => format!("{value:.2}"),
        None => "unknown".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::N_VERTICES;

    #[test]
    fn values_of_every_certainty_read_back() {
        let doubts = [None, Some(Doubt::Unfamiliar), Some(Doubt::Absent)];
        for left in doubts {
            for right in doubts {
                for masked in [false, true] {
                    for familiarity in [None, Some(0.25)] {
                        let presence = [familiarity, Some(1.0)];
                        let certainty = Certainty { familiarity, presence, doubt: [left, right], masked };
                        assert_eq!(Certainty::from_values(&certainty.to_values()), Some(certainty));
                    }
                }
            }
        }
        for bad in [&[0.5, 0.5, 0.5][..], &[0.5, 0.5, 0.5, 18.0], &[0.5, 0.5, 0.5, -1.0], &[0.5, 0.5, 0.5, f32::NAN]] {
            assert_eq!(Certainty::from_values(bad), None, "{bad:?}");
        }
    }

    #[test]
    fn the_mask_is_0_on_the_hand_in_doubt_unless_a_guess_is_wanted() {
        let doubt = [None, Some(Doubt::Absent)];
        let certainty = Certainty { presence: [Some(0.9), Some(0.02)], doubt, masked: true, ..Certainty::default() };
        let mask = certainty.mask();
        assert!(mask[..N_VERTICES].iter().all(|m| *m == 1) && mask[N_VERTICES..].iter().all(|m| *m == 0));
        assert_eq!(certainty.reason(), "right: no such hand in the image (presence 0.02)");
        assert!(Certainty { masked: false, ..certainty }.mask().iter().all(|m| *m == 1));
        assert_eq!(Certainty::default().reason(), "");
    }
}
