//! Scores: the paper's metrics, agreement of labels with measured forces, gates.

#[doc(hidden)]
pub mod agreement;
pub mod metrics;
#[doc(hidden)]
pub mod verify;
