//! Scores of one episode.

use std::collections::BTreeMap;

use super::candidate::Candidate;
use crate::error::{Error, Result};
use crate::geometry::Sampling;
use crate::score::agreement::{Scorer, Sums, TruthFrame, VertexGroups};
use crate::tactile::{CONTACT_FORCE_N, N_FIELD, TactileField, Validity};

/// Sums of one episode for each candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// Name of the scene, or path of the source.
    pub name: String,
    /// Seed of the rollout, if there is one.
    pub seed: Option<u64>,
    /// Number of frames that guards refused, by reason; they are not scored.
    pub refused: BTreeMap<&'static str, u64>,
    /// Sums of each candidate.
    pub sums: Vec<Sums>,
    /// True if the contact points were known in every frame.
    pub has_contacts: bool,
    /// Sampling density of each object for label (a); empty where no distances were needed.
    pub samplings: Vec<Sampling>,
}

/// Distances of the 1556 vertices from the nearest object, m; infinite beyond the largest threshold.
#[derive(Debug, Clone, Copy)]
pub struct VertexDistances<'a> {
    /// Distance from the nearest point of a resampled surface.
    pub points: &'a [f32],
    /// Signed distance from the nearest surface, negative inside.
    pub surface: &'a [f32],
}

/// Scores an episode for all candidates, frame by frame.
#[derive(Debug, Clone)]
pub struct EpisodeScorer {
    candidates: Vec<Candidate>,
    scorers: Vec<Scorer>,
    refused: BTreeMap<&'static str, u64>,
    has_contacts: bool,
    /// (1556) last known truth of each vertex: touched, and force, N; 0 before.
    before: [Vec<f32>; 2],
}

impl EpisodeScorer {
    /// Starts an episode.
    pub fn new(groups: &VertexGroups, candidates: &[Candidate]) -> Self {
        let scorers = vec![Scorer::new(groups.clone()); candidates.len()];
        let before = [vec![0.0; N_FIELD], vec![0.0; N_FIELD]];
        Self { candidates: candidates.to_vec(), scorers, refused: BTreeMap::new(), has_contacts: true, before }
    }

    /// Adds a frame: the truth, with the distances or the prediction that the candidates need.
    ///
    /// # Errors
    /// If a candidate lacks its input, an array has another length, or time does not grow.
    pub fn push(
        &mut self,
        truth: &TruthFrame,
        near: Option<VertexDistances>,
        prediction: Option<&TactileField>,
    ) -> Result<()> {
        self.has_contacts &= truth.has_contacts();
        for (candidate, scorer) in self.candidates.iter().zip(&mut self.scorers) {
            let lacks = |input: &str| Error::value(format!("candidate {}", candidate.name()), input, "none");
            let within = |distances: &[f32], threshold: f32| -> Vec<f32> {
                distances.iter().map(|distance| f32::from(*distance <= threshold)).collect()
            };
            match *candidate {
                Candidate::Truth => scorer.push(truth, truth.touched(), truth.force())?,
                Candidate::Points(threshold) => {
                    let near = near.ok_or_else(|| lacks("distances"))?;
                    scorer.push(truth, &within(near.points, threshold), &[])?
                }
                Candidate::Surface(threshold) => {
                    let near = near.ok_or_else(|| lacks("distances"))?;
                    scorer.push(truth, &within(near.surface, threshold), &[])?
                }
                Candidate::Prediction => {
                    let field = prediction.ok_or_else(|| lacks("a prediction"))?;
                    scorer.push(truth, &contact(field), &field.force)?
                }
                Candidate::Zero => scorer.push(truth, &[0.0; N_FIELD], &[0.0; N_FIELD])?,
                Candidate::Persistence => scorer.push(truth, &self.before[0], &self.before[1])?,
            };
        }
        for (before, now) in self.before.iter_mut().zip([truth.touched(), truth.force()]) {
            before.iter_mut().zip(now).filter(|(_, now)| !now.is_nan()).for_each(|(before, now)| *before = *now);
        }
        Ok(())
    }

    /// Leaves out a frame that a guard refused.
    pub fn refuse(&mut self, validity: Validity) {
        *self.refused.entry(validity.reason()).or_default() += 1;
        self.scorers.iter_mut().for_each(Scorer::refuse);
    }

    /// Ends the episode.
    pub fn finish(self, name: impl Into<String>, seed: Option<u64>, samplings: Vec<Sampling>) -> Episode {
        let Self { scorers, refused, has_contacts, .. } = self;
        let sums = scorers.into_iter().map(Scorer::finish).collect();
        Episode { name: name.into(), seed, refused, sums, has_contacts, samplings }
    }
}

/// Returns the predicted contact; for a prediction of forces alone, contact where the force exceeds the threshold of truth.
fn contact(field: &TactileField) -> Vec<f32> {
    let unknown = field.contact.len() == N_FIELD && field.contact.iter().all(|c| c.is_nan());
    match unknown {
        true => field.force.iter().map(|f| if f.is_nan() { *f } else { f32::from(*f > CONTACT_FORCE_N) }).collect(),
        false => field.contact.clone(),
    }
}
