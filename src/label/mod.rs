//! The engine behind `egotac label`: predicted touch for recordings of any format.
//!
//! A `Job` labels one recording in two phases:
//!
//! 1. **Inference.** Decoder threads read the images of each unit (an episode, or a file of a bag) and the network labels
//!    them in order. The labels go to the unit's journal in a hidden workspace folder beside the output.
//! 2. **Assembly.** When the journals of all units are complete, the format's
//!    `LabelOutput` reads input and journals and writes the output into the workspace.
//!
//! - *Journal and resume*: labels are appended in blocks with checksums. A killed process loses the block in progress. The
//!   next run cuts the journal after its last valid block, replays the images that the network's window needs, and goes on.
//! - *Atomic publish*: a rename gives the finished output its name, so the output is complete or absent. The input is only
//!   read.
//! - *Shards*: processes with different shards fill different journals; file locks keep them apart. The process that
//!   completes the last journal assembles the output.
//! - *Memory*: bounded queues and streaming readers; it does not grow with the length of a recording.

mod budget;
mod inference;
mod input;
#[cfg(test)]
mod interleavings;
mod job;
mod journal;
mod labeller;
mod manifest;
pub mod physics;
#[cfg(feature = "sim")]
pub mod replay;
mod workspace;

pub use input::{FormatOptions, LabelTask, LabelTasks, OutputFormat, find_tasks};
pub(crate) use job::is_within;
pub use job::{Job, LabelTiming, Outcome, Shard};
pub use journal::{Journal, Progress};
pub use labeller::{InferenceTiming, Labeller};
pub(crate) use manifest::write_manifest;
