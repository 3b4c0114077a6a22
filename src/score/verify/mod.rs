//! Verification of labels (a) and (b), or of predictions, against the simulator's forces.
//!
//! ```text
//! rollout | store | recording --> episode::EpisodeScorer --> report::VerifyReport --> table, picture, gate
//! ```
//!
//! The sums of episodes add up ([`crate::score::agreement::Sums`]); a report turns them into scores with confidence
//! intervals.

pub mod candidate;
pub mod episode;
pub mod episode_splitter;
pub mod gate;
pub mod picture;
pub mod predictions;
pub mod recording;
pub mod report;

pub use candidate::{Candidate, SweepSettings};
pub use episode::{Episode, EpisodeScorer};
pub use gate::Requirement;
pub use report::VerifyReport;
