//! Verification: labels (a) and (b), or anybody's predictions, against the simulator's forces.
//!
//! ```text
//! rollout | store | recording --> episode::EpisodeScorer --> report::Report --> table, picture, gate
//! ```
//!
//! An episode's sums add up ([`crate::score::agreement::Sums`]); a report makes scores and confidence intervals of them.

pub mod candidate;
pub mod episode;
pub mod gate;
pub mod picture;
pub mod predictions;
pub mod recording;
pub mod report;
pub mod stretches;

pub use candidate::{Candidate, Settings};
pub use episode::{Episode, EpisodeScorer};
pub use gate::Bar;
pub use report::Report;
