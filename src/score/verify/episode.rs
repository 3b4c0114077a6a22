//! One episode's scores.

use std::collections::BTreeMap;

use super::candidate::Candidate;
use crate::error::{Error, Result};
use crate::geometry::Sampling;
use crate::score::agreement::{Scorer, Sums, TruthFrame, VertexGroups};
use crate::tactile::{CONTACT_FORCE_N, N_FIELD, TactileField, Validity};

/// What an episode says about each candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// Scene, or where it comes from.
    pub name: String,
    /// Seed, where it has one.
    pub seed: Option<u64>,
    /// Frames that guards refused, by reason; they are not scored.
    pub refused: BTreeMap<&'static str, u64>,
    /// Sums of each candidate.
    pub sums: Vec<Sums>,
    /// Whether the places of contacts were known in each frame.
    pub has_contacts: bool,
    /// How finely the things were sampled for label (a); empty where no distances were needed.
    pub samplings: Vec<Sampling>,
}

/// Distances of the 1556 vertices from the nearest thing, m; infinity where it is far.
#[derive(Debug, Clone, Copy)]
pub struct VertexDistances<'a> {
    /// From the nearest point of a resampled surface.
    pub points: &'a [f32],
    /// From the nearest surface, negative inside.
    pub surface: &'a [f32],
}

/// Scores an episode frame by frame.
#[derive(Debug, Clone)]
pub struct EpisodeScorer {
    candidates: Vec<Candidate>,
    scorers: Vec<Scorer>,
    refused: BTreeMap<&'static str, u64>,
    has_contacts: bool,
}

impl EpisodeScorer {
    /// Starts an episode.
    pub fn new(parts: &VertexGroups, candidates: &[Candidate]) -> Self {
        let scorers = vec![Scorer::new(parts.clone()); candidates.len()];
        Self { candidates: candidates.to_vec(), scorers, refused: BTreeMap::new(), has_contacts: true }
    }

    /// Takes a frame: the truth, and what its candidates need of distances and prediction.
    ///
    /// # Errors
    /// If a candidate lacks what it needs, an array has another length, or time goes back.
    pub fn push(
        &mut self,
        truth: &TruthFrame,
        near: Option<VertexDistances>,
        prediction: Option<&TactileField>,
    ) -> Result<()> {
        self.has_contacts &= truth.has_contacts();
        for (candidate, scorer) in self.candidates.iter().zip(&mut self.scorers) {
            let lacks = |what: &str| Error::value(format!("candidate {}", candidate.name()), what, "none");
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
            };
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

/// Contact as predicted; of a prediction that has forces alone, where they exceed the threshold of truth.
fn contact(field: &TactileField) -> Vec<f32> {
    let unknown = field.contact.len() == N_FIELD && field.contact.iter().all(|c| c.is_nan());
    match unknown {
        true => field.force.iter().map(|f| if f.is_nan() { *f } else { f32::from(*f > CONTACT_FORCE_N) }).collect(),
        false => field.contact.clone(),
    }
}
