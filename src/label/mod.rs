//! Labels for what people have recorded, in the formats they keep it in: `egotac label`.
//!
//! A labelling has two halves. The network passes over the images of each unit (an episode, a file of a bag) and its labels
//! go to a journal beside the output, block by block; a killed process loses the block at hand and nothing else. When the
//! journals of all units are complete, the output is put together from the input and the journals, and gets its name at the
//! very end. So an output is whole or absent, the input is only read, shards are processes that fill different journals, and
//! memory does not grow with the length of a recording.

mod bag;
mod copy;
mod images;
mod inference;
mod input;
mod job;
mod journal;
mod labelled;
mod lerobot;
mod manifest;
mod output;
mod prefetch;
mod provenance;
mod source;
mod statistics;
mod store;
mod summary;
mod to_bag;
mod to_store;
mod to_tensors;
mod video;
mod workspace;

pub use bag::TOPIC;
pub(crate) use copy::copy_folder;
pub use images::image_files;
pub use inference::Times;
pub use input::{Choices, Found, Item, Kind, Target, images_of, items};
pub use job::{Effort, Job, Outcome, Shard};
pub use journal::{Journal, Label, Labels, Progress};
pub use labelled::Labelled;
pub use manifest::{MANIFEST, write_manifest};
pub use output::{Journals, Output};
pub use provenance::{CONTACT_THRESHOLD, NAME, Provenance, Thresholds};
pub use source::{Picture, Shot, Shots, Source, Unit};
pub use summary::{About, Fault, Summary};
