//! Stretches of an episode without a gap.

/// Total force over consecutive frames without a gap, N.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Run {
    /// Predicted.
    pub pred: Vec<f64>,
    /// True, as many values.
    pub target: Vec<f64>,
}
