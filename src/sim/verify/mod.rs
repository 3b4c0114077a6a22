//! Scores of simulated episodes: live rollouts and recorded stores.

pub mod rollout;
pub mod store;
