//! A number of a scene that may vary: a value, or a range to draw from.

use rand::Rng;
use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

/// A fixed number, or one drawn uniformly from `low..=high`; in YAML `0.3` or `[0.2, 0.4]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    low: f64,
    high: f64,
}

impl Span {
    /// A number that does not vary.
    pub const fn fixed(value: f64) -> Self {
        Self { low: value, high: value }
    }

    /// A range, both ends included.
    pub const fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    /// Smallest value.
    pub fn low(&self) -> f64 {
        self.low
    }

    /// Largest value.
    pub fn high(&self) -> f64 {
        self.high
    }

    /// Draws a value; takes one random number in any case, so that fixing one span leaves the others as they were.
    pub fn sample(&self, rng: &mut impl Rng) -> f64 {
        self.low + (self.high - self.low) * rng.random::<f64>()
    }
}

impl<'de> Deserialize<'de> for Span {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(SpanVisitor)
    }
}

struct SpanVisitor;

impl SpanVisitor {
    fn checked<E: de::Error>(low: f64, high: f64) -> Result<Span, E> {
        if low.is_finite() && high.is_finite() && low <= high {
            return Ok(Span { low, high });
        }
        Err(E::custom(format!("expected finite numbers [low, high] with low <= high, got [{low}, {high}]")))
    }
}

impl<'de> Visitor<'de> for SpanVisitor {
    type Value = Span;

    fn expecting(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        formatter.write_str("a number or a range [low, high]")
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Span, E> {
        Self::checked(value, value)
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Span, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Span, E> {
        self.visit_f64(value as f64)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Span, A::Error> {
        let short = |got| de::Error::invalid_length(got, &"a range [low, high]");
        let low = seq.next_element()?.ok_or_else(|| short(0))?;
        let high = seq.next_element()?.ok_or_else(|| short(1))?;
        if seq.next_element::<f64>()?.is_some() {
            return Err(short(3));
        }
        Self::checked(low, high)
    }
}
