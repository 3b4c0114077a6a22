//! Parameter `min_confidence`: least confidence of a hand pose that a node uses.

use super::params::{Allowed, Parameter, Parameters};

/// Declares the parameter.
pub(crate) fn parameter() -> Parameter {
    Parameter::new(
        "min_confidence",
        0.0,
        Allowed::Doubles(0.0, 1.0),
        "Least confidence of a hand pose that is used; poses of unknown confidence (NaN) are used.",
    )
}

/// Returns true if a pose of this confidence is used.
pub(crate) fn is_enough(parameters: &Parameters, confidence: f32) -> bool {
    confidence.is_nan() || f64::from(confidence) >= parameters.get::<f64>("min_confidence")
}
