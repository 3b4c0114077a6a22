//! Scores of predicted touch against truth, as the paper's appendix defines them.
//!
//! | score | file | undefined when |
//! |---|---|---|
//! | MAE, active MAE, temporal Pearson | `force` | nothing valid (active); fewer than two frames or a constant trace |
//! | precision, recall, F1, IoU, AUROC | [`contact`] | no positives (AUROC: nor negatives) |
//! | force cosine, rise F1, fall F1 | `dynamics` | a trace that is zero everywhere; no event on either side |
//! | DFT Pearson, spectral convergence, dominant frequency | `spectrum` | fewer than three frames or a constant trace |
//!
//! An undefined score is `None` here, `null` in JSON and `undefined` in a table; it is never NaN and never an invented
//! number. A score is also undefined if the prediction is unknown (NaN) at a valid vertex.

pub(crate) mod bootstrap;
mod compare;
pub mod contact;
mod dynamics;
mod evaluate;
pub(crate) mod force;
mod frame_score;
mod running;
mod spectrum;
mod statistics;
mod summary;
mod table;
mod trace;
mod vertex_group;

pub use compare::{Comparison, Difference, compare};
pub use contact::{Confusion, ContactScores};
pub use dynamics::Calibration;
pub use evaluate::{EvalOptions, evaluate};
pub use force::ForceErrors;
pub use frame_score::FrameScore;
pub use running::RunningSummary;
pub use summary::{EntryCounts, Metrics, summarize};
pub use table::{comparison_table, groups_table, table};
pub use vertex_group::VertexGroup;
