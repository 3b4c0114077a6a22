//! Forces from motion for recorded stores: poses and meshes in, arrays of forces out.

mod bodies;
mod fields;
mod read;
mod write;

pub use bodies::BodyOptions;
pub use fields::FrameFields;
pub use read::{EpisodeTake, read};
pub use write::{ESTIMATED, FrameCounts, Label, label};
