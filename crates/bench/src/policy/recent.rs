//! Observations that a policy decides on.

use std::collections::VecDeque;

use egotac::error::Result;

use super::arm::Arm;
use super::network::{Inputs, Look, Policy};
use super::senses::Senses;
use super::task::MAX_CHANGE;

/// Frames between the two pictures, and the two touches, that a policy is given.
pub const LAG: usize = 2;

/// The latest observations of a trial, oldest first.
#[derive(Debug, Default)]
pub struct Recent(VecDeque<Senses>);

impl Recent {
    /// Adds the newest observation.
    pub fn push(&mut self, senses: Senses) {
        self.0.push_back(senses);
        if self.0.len() > LAG + 1 {
            self.0.pop_front();
        }
    }

    /// Returns a policy's change of the grip, N; 0 before the first observation.
    ///
    /// # Errors
    /// If the network fails.
    pub fn decide(&self, policy: &Policy, arm: Arm) -> Result<f64> {
        let (Some(now), Some(earlier)) = (self.0.back(), self.0.front()) else { return Ok(0.0) };
        let places = [now, earlier];
        let mut inputs = Inputs::default();
        let touch = places.map(|at| arm.touch(&at.true_touch, &at.predicted_touch));
        inputs.push(places.map(|at| at.picture.as_slice()), Look::PLAIN, touch, &now.own);
        let shares = policy.forward(&inputs)?.to_vec1::<f32>()?;
        Ok(shares.first().map_or(0.0, |share| f64::from(*share) * MAX_CHANGE))
    }
}
