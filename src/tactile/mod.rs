//! Touch on both hands: [`TactileField`] at one instant, [`TactileSequence`] over time; [`Certainty`] of who predicts it.

mod carry;
mod certainty;
mod field;
mod force_kind;
mod sequence;

pub use crate::hand::N_FIELD;
pub use certainty::{Certainty, Doubt};
pub use field::{CONTACT_FORCE_N, TactileField, Validity};
pub use force_kind::ForceKind;
pub use sequence::{TactileSequence, episode_ranges, fps};
pub(crate) use sequence::{check_rows, median_step};
