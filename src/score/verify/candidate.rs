//! Candidates that are scored against truth: distance labels at several thresholds, or a prediction beside baselines.

use crate::error::{Error, Result};
use crate::geometry::SPACING;

/// Default distance thresholds of the sweep, m.
const THRESHOLDS: [f32; 5] = [0.0, 0.001, 0.002, 0.005, 0.010];
/// Largest distance threshold, m: a hand's breadth, beyond which a vertex is near nothing.
const MAX_THRESHOLD: f32 = 0.1;

/// A way to label vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Candidate {
    /// Label (c) itself; gives the scores of a perfect label.
    Truth,
    /// Label (a): a point of the resampled surface within the given distance, m.
    Points(f32),
    /// Label (b): the surface within the given distance, m.
    Surface(f32),
    /// A prediction.
    Prediction,
    /// No touch at all.
    Zero,
    /// The truth of the frame before.
    Persistence,
}

impl Candidate {
    /// A prediction, beside those that see no image.
    pub const PREDICTIONS: [Self; 3] = [Self::Prediction, Self::Zero, Self::Persistence];
}

/// Settings of the sweep over labels (a) and (b).
#[derive(Debug, Clone, PartialEq)]
pub struct SweepSettings {
    /// Distance thresholds, m, growing.
    pub thresholds: Vec<f32>,
    /// Spacing of the points of label (a), m.
    pub spacing: f32,
}

impl Default for SweepSettings {
    fn default() -> Self {
        Self { thresholds: THRESHOLDS.to_vec(), spacing: SPACING }
    }
}

impl SweepSettings {
    /// Validates thresholds and spacing.
    ///
    /// # Errors
    /// If there is no threshold, or one is not a length from 0 to 0.1 m above the one before; or the spacing is not a
    /// length from 0.5 mm to 1 m.
    pub fn check(&self) -> Result<()> {
        let grow = self.thresholds.windows(2).all(|pair| pair[0] < pair[1]);
        if self.thresholds.is_empty() || !grow || self.thresholds.iter().any(|t| !(0.0..=MAX_THRESHOLD).contains(t)) {
            let expected = format!("growing lengths from 0 to {MAX_THRESHOLD} m");
            return Err(Error::value("thresholds", expected, format!("{:?} m", self.thresholds)));
        }
        if !(5e-4..=1.0).contains(&self.spacing) {
            return Err(Error::value("spacing", "0.0005 to 1 m", self.spacing));
        }
        Ok(())
    }

    /// Returns the candidates of the sweep, label (c) first.
    pub fn sweep(&self) -> Vec<Candidate> {
        let points = self.thresholds.iter().map(|t| Candidate::Points(*t));
        let surface = self.thresholds.iter().map(|t| Candidate::Surface(*t));
        std::iter::once(Candidate::Truth).chain(points).chain(surface).collect()
    }

    /// Returns the largest threshold, m: distances need not be known beyond it.
    pub fn reach(&self) -> f32 {
        self.thresholds.iter().copied().fold(0.0, f32::max)
    }
}

impl Candidate {
    /// Returns the name in tables, JSON and gates, for instance `b_5mm`.
    pub fn name(self) -> String {
        // Rounds to micrometres, so that 5 mm in f32 is written as 5.
        let millimetres = |metres: f32| (f64::from(metres) * 1e6).round() / 1e3;
        match self {
            Self::Truth => "c".into(),
            Self::Points(threshold) => format!("a_{}mm", millimetres(threshold)),
            Self::Surface(threshold) => format!("b_{}mm", millimetres(threshold)),
            Self::Prediction => "prediction".into(),
            Self::Zero => "zero".into(),
            Self::Persistence => "persistence".into(),
        }
    }
}
