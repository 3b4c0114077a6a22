//! The rule for touch that a network does not know: an unfamiliar image, or a hand that is not in it.
//!
//! | condition | touch that is unknown |
//! |---|---|
//! | familiarity below its threshold | both hands' |
//! | presence of a hand below its threshold | that hand's |
//!
//! A checkpoint holds the thresholds; options of the predictor replace them. An estimate that a checkpoint does not give
//! makes nothing unknown.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::hand::Side;
use crate::tactile::{Certainty, Doubt, TactileField};

/// Form of touch that is unknown, in all outputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unknown {
    /// NaN, mask 0.
    #[default]
    Nan,
    /// Zero, mask 0; for consumers that can't take NaN.
    Zero,
    /// The network's output as it is, mask 1.
    Guess,
}

impl Unknown {
    /// All forms.
    pub const ALL: [Unknown; 3] = [Unknown::Nan, Unknown::Zero, Unknown::Guess];
    /// Names of the forms, for options.
    pub const NAMES: [&'static str; 3] = ["nan", "zero", "guess"];

    /// Name: `nan`, `zero` or `guess`.
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// Gives the hands in doubt this form.
    pub fn apply(self, field: &mut TactileField, certainty: &mut Certainty) {
        certainty.masked = self != Unknown::Guess;
        let value = match self {
            Unknown::Nan => f32::NAN,
            Unknown::Zero => 0.0,
            Unknown::Guess => return,
        };
        for side in Side::BOTH.into_iter().filter(|side| !certainty.counts(*side)) {
            field.force[side.range()].fill(value);
            field.contact[side.range()].fill(value);
        }
    }
}

impl fmt::Display for Unknown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Unknown {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|unknown| unknown.name() == name);
        found.ok_or_else(|| Error::unknown("form of unknown touch", name, Self::NAMES))
    }
}

/// Thresholds below which touch is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DoubtThresholds {
    /// Familiarity below which both hands' touch is unknown, 0 to 1.
    pub familiarity: f32,
    /// Presence below which a hand's touch is unknown, 0 to 1.
    pub presence: f32,
}

impl Default for DoubtThresholds {
    /// One in 50 held-out frames of the training's kind is less familiar; presence is even odds.
    fn default() -> Self {
        Self { familiarity: 0.02, presence: 0.5 }
    }
}

impl DoubtThresholds {
    /// Checks ranges.
    ///
    /// # Errors
    /// Names the threshold that is not within 0 to 1.
    pub fn check(&self) -> Result<()> {
        let share = |name: &str, value: f32| match (0.0..=1.0).contains(&value) {
            true => Ok(()),
            false => Err(Error::value(name, "a number from 0 to 1", value)),
        };
        share("familiarity_threshold", self.familiarity)?;
        share("presence_threshold", self.presence)
    }

    /// Returns the certainty that follows from the estimates of a frame.
    pub fn judge(&self, familiarity: Option<f32>, presence: [Option<f32>; 2]) -> Certainty {
        let unfamiliar = familiarity.is_some_and(|familiarity| familiarity < self.familiarity);
        let doubt = presence.map(|presence| match unfamiliar {
            true => Some(Doubt::Unfamiliar),
            false => presence.filter(|presence| *presence < self.presence).map(|_| Doubt::Absent),
        });
        Certainty { familiarity, presence, doubt, masked: true }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{N_VERTICES, Topology};
    use crate::tactile::N_FIELD;

    #[test]
    fn an_unfamiliar_frame_hides_both_hands_and_an_absent_hand_itself() {
        let thresholds = DoubtThresholds { familiarity: 0.1, presence: 0.5 };
        let doubt = |familiarity, presence| thresholds.judge(familiarity, presence).doubt;
        let (unfamiliar, absent) = (Some(Doubt::Unfamiliar), Some(Doubt::Absent));
        assert_eq!(doubt(Some(0.09), [Some(0.9), None]), [unfamiliar, unfamiliar]);
        assert_eq!(doubt(Some(0.1), [Some(0.5), Some(0.49)]), [None, absent]);
        assert_eq!(doubt(None, [Some(0.0), Some(1.0)]), [absent, None]);
        assert_eq!(doubt(None, [None, None]), [None, None], "what is not estimated hides nothing");
    }

    #[test]
    fn unknown_touch_is_nan_zero_or_the_guess_and_the_other_hand_stays() {
        let field =
            TactileField { topology: Topology::default(), force: vec![0.5; N_FIELD], contact: vec![0.75; N_FIELD] };
        for unknown in Unknown::ALL {
            let mut certainty = DoubtThresholds::default().judge(Some(0.9), [Some(0.1), Some(0.9)]);
            let mut formed = field.clone();
            unknown.apply(&mut formed, &mut certainty);
            let (left, right) = (formed.force[..N_VERTICES].to_vec(), &formed.force[N_VERTICES..]);
            let expected = match unknown {
                Unknown::Nan => f32::NAN,
                Unknown::Zero => 0.0,
                Unknown::Guess => 0.5,
            };
            assert!(left.iter().all(|f| f.to_bits() == expected.to_bits()), "{unknown}");
            assert!(right.iter().all(|f| *f == 0.5) && formed.contact[N_VERTICES..].iter().all(|c| *c == 0.75));
            assert_eq!(certainty.counts(Side::Left), unknown == Unknown::Guess, "{unknown}");
            assert!(certainty.counts(Side::Right));
            assert_eq!(unknown.name().parse::<Unknown>().unwrap(), unknown);
        }
        let error = "none".parse::<Unknown>().unwrap_err().to_string();
        assert!(error.contains("nan") && error.contains("zero") && error.contains("guess"), "{error}");
    }
}
