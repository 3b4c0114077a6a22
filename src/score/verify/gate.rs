//! Gate for continuous integration: scores that must be reached.

use crate::error::{Error, Result};
use crate::score::agreement::scores::{self, Direction, SCORES, Score};

/// A bound on one score, for instance `f1=0.7`: a lower bound if higher is better, else an upper bound.
#[derive(Debug, Clone)]
pub struct Requirement {
    /// Candidate that the bound applies to; None = the prediction, or the only one.
    pub candidate: Option<String>,
    /// The score.
    pub score: &'static Score,
    /// Lower or upper bound.
    pub bound: f64,
}

impl Requirement {
    /// Parses requirements such as `f1=0.7,missed_force=0.2`, or `b_5mm:f1=0.7` for one candidate of several.
    ///
    /// # Errors
    /// If one is not `NAME=NUMBER`, or its score is unknown or only descriptive; the error lists the names.
    pub fn parse_all(text: &str) -> Result<Vec<Self>> {
        text.split(',').map(str::trim).filter(|text| !text.is_empty()).map(Self::parse).collect()
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
        if score.direction == Direction::Descriptive {
            let fit = SCORES.iter().filter(|score| score.direction != Direction::Descriptive).map(|score| score.name);
            return Err(Error::unknown("score that can be required", name, fit));
        }
        Ok(Self { candidate, score, bound })
    }

    /// Describes by how much `value` misses the bound; None if it does not.
    pub fn missed(&self, value: Option<f64>) -> Option<String> {
        let Self { score, bound, .. } = self;
        let (side, miss) = match score.direction {
            Direction::LowerIsBetter => ("at most", value.map(|value| value - bound)),
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
    fn requirements_bound_scores_from_below_and_errors_from_above() {
        let requirements = Requirement::parse_all("f1=0.7, missed_force=0.2,b_5mm:pooled_f1=0.5").unwrap();
        assert_eq!(requirements.len(), 3);
        assert_eq!((requirements[0].score.name, requirements[2].score.name), ("frame_mean.f1", "pooled.f1"));
        assert_eq!(requirements[2].candidate.as_deref(), Some("b_5mm"));
        assert_eq!((requirements[0].missed(Some(0.7)), requirements[1].missed(Some(0.2))), (None, None));
        assert!(requirements[0].missed(Some(0.65)).unwrap().contains("misses by 0.0500"));
        assert!(
            requirements[1]
                .missed(Some(0.5))
                .unwrap()
                .contains("at most 0.2 is required, got 0.5000, which misses by 0.3")
        );
        assert!(requirements[1].missed(None).unwrap().contains("undefined"));
        assert!(Requirement::parse_all("").unwrap().is_empty());
    }

    #[test]
    fn an_invalid_requirement_is_refused_with_the_valid_ones() {
        let error = |text: &str| Requirement::parse_all(text).unwrap_err().to_string();
        assert!(error("f2=0.5").contains("missed_force") && error("f2=0.5").contains("\"f2\""));
        assert!(error("f1").contains("NAME=NUMBER") && error("f1=high").contains("NAME=NUMBER"));
        assert!(error("f1=nan").contains("NAME=NUMBER"));
        assert!(error("contact_ratio=0.1").contains("can be required"));
    }
}
