//! Bags as rosbag2 writes them: folders with MCAP files and a `metadata.yaml`, or an MCAP file by itself.

mod bag;
mod chunk;
mod copy;
mod metadata;
mod piece;
mod records;
mod survey;

pub use bag::{BagWriter, file_name};
pub use chunk::{Content, Skeleton};
pub use copy::CopyWriter;
pub(crate) use copy::put_text;
pub use metadata::{BagFile, BagTopic, metadata_yaml};
pub use piece::{Piece, Pieces};
pub use records::{Lost, Part, Record, Records};
pub use survey::{Survey, Topic, bag_files, survey};

pub use ::mcap::records::op;
