//! Limits of a scene's numbers, and the defaults that several keys share.

use crate::error::{Error, Result};
use crate::sim::range::UniformRange;

/// Largest angle that a scene may give, rad: any rotation lies within.
pub(super) const MAX_ANGLE: f64 = 10.0;

/// Checks that `range` lies within 1e-6 to 1e6; `name` is the key for the error.
pub(super) fn positive(name: &str, range: UniformRange) -> Result<()> {
    within(name, range, 1e-6, 1e6)
}

/// Checks that `range` lies within `low..=high`; `name` is the key for the error.
pub(super) fn within(name: &str, range: UniformRange, low: f64, high: f64) -> Result<()> {
    if low <= range.low() && range.high() <= high {
        return Ok(());
    }
    Err(Error::value(name, format!("{low} to {high}"), format!("[{}, {}]", range.low(), range.high())))
}

/// Default of keys that are 0 unless given.
pub(super) fn zero() -> UniformRange {
    UniformRange::fixed(0.0)
}
