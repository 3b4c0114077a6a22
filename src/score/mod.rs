//! Scores: the paper's metrics, agreement of labels with measured forces, gates.

pub mod agreement;
pub mod metrics;
pub mod verify;
