//! Scores of predicted touch against truth, as the paper's appendix defines them.
//!
//! | score | file | undefined when |
//! |---|---|---|
//! | MAE, active MAE | `force` | nothing valid (active) |
//! | precision, recall, F1, IoU, AUROC | [`contact`] | no positives (AUROC: nor negatives) |
//! | temporal Pearson | `trace` | the true total force does not change |
//! | force cosine, rise F1, fall F1 | `dynamics` | the same; no event on either side |
//! | DFT Pearson, spectral convergence, dominant frequency | `spectrum` | the same; fewer than three frames between gaps |
//!
//! An undefined score is `None` here, `null` in JSON and `undefined` in a table; it is never NaN and never an invented
//! number. A score is also undefined if the prediction is unknown (NaN) at a valid vertex.
//!
//! Contact scores are averages over the frames with a contact in truth (`frame_mean`, the paper's averaging), or over all
//! vertices of all frames (`pooled`). Frames without a contact in truth have the false-positive rate.
//!
//! Temporal scores are averages over the episodes on which they are defined ([`EpisodesDefined`]). A prediction that is
//! constant while the truth changes scores 0 in both correlations and 1 in spectral convergence; its dominant frequency is 0.
//! Its force cosine is that of any positive constant, the level to beat. A frame that is masked whole is a gap: it takes part
//! in no trace, and differences and spectra never cross it. Spectra of an episode with gaps are averages over its runs of
//! frames, weighted by their length.

pub mod baseline;
pub(crate) mod bootstrap;
mod compare;
pub mod contact;
mod dynamics;
pub mod egophi;
mod episode_terms;
mod evaluate;
pub(crate) mod force;
mod frame_score;
mod reliability;
mod run;
mod running;
mod spectrum;
mod statistics;
mod summary;
mod table;
mod trace;
mod vertex_group;

pub use compare::{Comparison, Difference, compare};
pub use contact::{Confusion, ContactScores};
pub use dynamics::{Calibration, Range};
pub use egophi::{EgophiScores, evaluate_egophi};
pub use episode_terms::{Intervals, intervals};
pub use evaluate::{EvalOptions, calibrate, evaluate};
pub use force::ForceErrors;
pub use frame_score::FrameScore;
pub use reliability::{Coverage, Reliability, coverage, fit_spread, reliability};
pub use running::{RunningSummary, summarize};
pub use summary::{EntryCounts, Metrics};
pub use table::{comparison_table, groups_table, table, table_with_intervals};
pub use trace::EpisodesDefined;
pub use vertex_group::VertexGroup;
