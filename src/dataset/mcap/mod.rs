//! Bags as rosbag2 writes them: folders with MCAP files and a `metadata.yaml`, or an MCAP file by itself.

mod attachment;
mod bag;
mod chunk;
mod convert;
mod copy;
mod ids;
mod images;
mod labels;
mod messages;
mod metadata;
mod note;
mod parse;
mod piece;
mod read_labels;
mod records;
mod survey;

pub use bag::{BagWriter, file_name};
pub(crate) use chunk::{ChunkContent, ChunkOutline};
pub(crate) use convert::BagOutput;
pub(crate) use copy::{CopyWriter, put_text};
pub(crate) use images::Bag;
pub(crate) use labels::{TOPIC, read_info};
pub(crate) use messages::for_each_message;
pub(crate) use metadata::{BagFile, BagTopic, metadata_yaml};
pub(crate) use piece::{Piece, Pieces};
pub(crate) use read_labels::read_labelled;
pub(crate) use records::{FileSpan, Record, Records};
pub(crate) use survey::{Survey, Topic, bag_files, survey};

pub(crate) use ::mcap::records::op;
