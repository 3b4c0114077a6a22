//! What is scored against truth: a distance rule at a threshold, or a prediction.

use crate::error::{Error, Result};
use crate::geometry::SPACING;

/// Thresholds of the sweep, m.
const THRESHOLDS: [f32; 5] = [0.0, 0.001, 0.002, 0.005, 0.010];
/// Beyond this nothing is near, m.
const MOST_DISTANCE: f32 = 0.1;

/// A way to label vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Candidate {
    /// Label (c) itself: what a perfect label scores.
    Truth,
    /// Label (a): a point of the resampled surface within so many metres.
    Points(f32),
    /// Label (b): the surface within so many metres.
    Surface(f32),
    /// Somebody's prediction.
    Prediction,
}

/// Which labels to score, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepSettings {
    /// Thresholds of labels (a) and (b), m, growing.
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
    /// Refuses what makes no sense.
    ///
    /// # Errors
    /// If there is no threshold, or one is not a length from 0 to 0.1 m above the one before; or the spacing is not a
    /// length from 0.5 mm to 1 m.
    pub fn check(&self) -> Result<()> {
        let grow = self.thresholds.windows(2).all(|pair| pair[0] < pair[1]);
        if self.thresholds.is_empty() || !grow || self.thresholds.iter().any(|t| !(0.0..=MOST_DISTANCE).contains(t)) {
            let expected = format!("growing lengths from 0 to {MOST_DISTANCE} m");
            return Err(Error::value("thresholds", expected, format!("{:?} m", self.thresholds)));
        }
        if !(5e-4..=1.0).contains(&self.spacing) {
            return Err(Error::value("spacing", "0.0005 to 1 m", self.spacing));
        }
        Ok(())
    }

    /// The labels of the sweep, label (c) first.
    pub fn sweep(&self) -> Vec<Candidate> {
        let points = self.thresholds.iter().map(|t| Candidate::Points(*t));
        let surface = self.thresholds.iter().map(|t| Candidate::Surface(*t));
        std::iter::once(Candidate::Truth).chain(points).chain(surface).collect()
    }

    /// How far distances need be known, m.
    pub fn reach(&self) -> f32 {
        self.thresholds.iter().copied().fold(0.0, f32::max)
    }
}

impl Candidate {
    /// Name in tables, JSON and gates, for instance `b_5mm`.
    pub fn name(self) -> String {
        // Thresholds come from millimetres: back to their shortest decimals.
        let millimetres = |metres: f32| (f64::from(metres) * 1e6).round() / 1e3;
        match self {
            Self::Truth => "c".into(),
            Self::Points(threshold) => format!("a_{}mm", millimetres(threshold)),
            Self::Surface(threshold) => format!("b_{}mm", millimetres(threshold)),
            Self::Prediction => "prediction".into(),
        }
    }
}
