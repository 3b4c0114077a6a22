//! A gate: bars that scores must clear, for continuous integration.

use crate::error::{Error, Result};
use crate::score::agreement::scores::{self, Direction, SCORES, Score};

/// One bar, for instance `f1=0.7`: at least so much of a score that is better higher, at most of another.
#[derive(Debug, Clone)]
pub struct Requirement {
    /// Candidate it is for; None = the only one.
    pub candidate: Option<String>,
    /// The score.
    pub score: &'static Score,
    /// The least or the most it may be.
    pub bound: f64,
}

impl Requirement {
    /// Reads bars such as `f1=0.7,missed_force=0.2`, or `b_5mm:f1=0.7` for one candidate of several.
    ///
    /// # Errors
    /// If one is no `NAME=NUMBER`, or its score is unknown or has no better side; the error lists the names.
    pub fn parse_all(text: &str) -> Result<Vec<Self>> {
        text.split(',').map(str::trim).filter(|bar| !bar.is_empty()).map(Self::parse).collect()
    }

    fn parse(text: &str) -> Result<Self> {
        let wrong = || Error::value("require", "NAME=NUMBER, separated by commas", text);
        let (name, bound) = text.split_once('=').ok_or_else(wrong)?;
        let bound: f64 = bound.trim().parse().ok().filter(|bound: &f64| bound.is_finite()).ok_or_else(wrong)?;
        let (candidate, name) = match name.trim().split_once(':') {
            Some((candidate, name)) => (Some(candidate.to_owned()), name),
            None => (None, name.trim()),
        };
        let score = scores::find(name)?;
        if score.better == Direction::Neither {
            let fit = SCORES.iter().filter(|score| score.better != Direction::Neither).map(|score| score.name);
            return Err(Error::unknown("score with a better side", name, fit));
        }
        Ok(Self { candidate, score, bound })
    }

    /// What is missing to clear the bar, in words; None = nothing.
    pub fn missed(&self, value: Option<f64>) -> Option<String> {
        let Self { score, bound, .. } = self;
        let (side, miss) = match score.better {
            Direction::Lower => ("at most", value.map(|value| value - bound)),
            _ => ("at least", value.map(|value| bound - value)),
        };
        match (value, miss) {
            (Some(value), Some(miss)) if miss > 0.0 => {
                Some(format!("{}: {side} {bound} is required, got {value:.4}, which misses by {miss:.4}", score.name))
            }
            (Some(_), Some(_)) => None,
            _ => Some(format!("{}: {side} {bound} is required, but it is undefined here", score.name)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_are_lower_bounds_of_scores_and_upper_bounds_of_errors() {
        let bars = Requirement::parse_all("f1=0.7, missed_force=0.2,b_5mm:frame_mean.iou=0.5").unwrap();
        assert_eq!(bars.len(), 3);
        assert_eq!(bars[0].score.name, "pooled.f1");
        assert_eq!(bars[2].candidate.as_deref(), Some("b_5mm"));
        assert_eq!((bars[0].missed(Some(0.7)), bars[1].missed(Some(0.2))), (None, None));
        assert!(bars[0].missed(Some(0.65)).unwrap().contains("misses by 0.0500"));
        assert!(
            bars[1].missed(Some(0.5)).unwrap().contains("at most 0.2 is required, got 0.5000, which misses by 0.3")
        );
        assert!(bars[1].missed(None).unwrap().contains("undefined"));
        assert!(Requirement::parse_all("").unwrap().is_empty());
    }

    #[test]
    fn what_is_no_bar_is_refused_with_what_would_be() {
        let error = |text: &str| Requirement::parse_all(text).unwrap_err().to_string();
        assert!(error("f2=0.5").contains("missed_force") && error("f2=0.5").contains("\"f2\""));
        assert!(error("f1").contains("NAME=NUMBER") && error("f1=high").contains("NAME=NUMBER"));
        assert!(error("f1=nan").contains("NAME=NUMBER"));
        assert!(error("contact_ratio=0.1").contains("better side"));
    }
}
