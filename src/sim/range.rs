//! A number of a scene that may vary: a fixed value, or a range to draw from.

use rand::Rng;
use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Fixed number, or number drawn uniformly from `low..=high`; in YAML `0.3` or `[0.2, 0.4]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UniformRange {
    low: f64,
    high: f64,
}

impl UniformRange {
    /// Creates a range of one value.
    pub const fn fixed(value: f64) -> Self {
        Self { low: value, high: value }
    }

    /// Creates a range; both ends are included.
    pub const fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    /// Returns the smallest value.
    pub fn low(&self) -> f64 {
        self.low
    }

    /// Returns the largest value.
    pub fn high(&self) -> f64 {
        self.high
    }

    /// Draws a value. Takes one random number even from a fixed range, so that fixing one range leaves the draws of the
    /// others unchanged.
    pub fn sample(&self, rng: &mut impl Rng) -> f64 {
        self.low + (self.high - self.low) * rng.random::<f64>()
    }
}

impl Serialize for UniformRange {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.low == self.high { self.low.serialize(serializer) } else { [self.low, self.high].serialize(serializer) }
    }
}

impl<'de> Deserialize<'de> for UniformRange {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(UniformRangeVisitor)
    }
}

struct UniformRangeVisitor;

impl UniformRangeVisitor {
    fn checked<E: de::Error>(low: f64, high: f64) -> Result<UniformRange, E> {
        if low.is_finite() && high.is_finite() && low <= high {
            return Ok(UniformRange { low, high });
        }
        Err(E::custom(format!("expected finite numbers [low, high] with low <= high, got [{low}, {high}]")))
    }
}

impl<'de> Visitor<'de> for UniformRangeVisitor {
    type Value = UniformRange;

    fn expecting(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        formatter.write_str("a number or a range [low, high]")
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<UniformRange, E> {
        Self::checked(value, value)
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<UniformRange, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<UniformRange, E> {
        self.visit_f64(value as f64)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<UniformRange, A::Error> {
        let wrong_length = |got| de::Error::invalid_length(got, &"a range [low, high]");
        let low = seq.next_element()?.ok_or_else(|| wrong_length(0))?;
        let high = seq.next_element()?.ok_or_else(|| wrong_length(1))?;
        if seq.next_element::<f64>()?.is_some() {
            return Err(wrong_length(3));
        }
        Self::checked(low, high)
    }
}
