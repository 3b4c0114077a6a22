//! Touch on both hands: [`TactileField`] at one instant.

mod field;

pub use field::{CONTACT_FORCE_N, N_FIELD, TactileField, Validity};
