//! Messages of a bag, read file by file and chunk by chunk in constant memory.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::records::{Record as Parsed, op};

use super::parse::parse;
use super::piece::{Piece, Pieces};
use super::survey::bag_files;
use crate::dataset::source::LostBytes;
use crate::error::{Error, Result};

/// A message as it lies in the file.
#[derive(Debug, Clone, Copy)]
pub struct MessageRecord<'a> {
    /// Topic.
    pub topic: &'a str,
    /// Type of the message, for instance `sensor_msgs/msg/Image`; empty without a schema.
    pub type_name: &'a str,
    /// Time of recording, ns.
    pub log_time: u64,
    /// Time of publication, ns.
    pub publish_time: u64,
    /// CDR with its encapsulation header.
    pub payload: &'a [u8],
}

/// Calls `take` with each message of the bag or MCAP file at `path`, in the order of `metadata.yaml` and of the files.
/// Returns the damaged stretches, which are skipped. `take` also gets the file.
///
/// # Errors
/// If a file can't be read, or `take` fails; the error then names file and topic.
pub fn for_each_message(
    path: &Path,
    mut take: impl FnMut(&Path, &MessageRecord) -> Result<()>,
) -> Result<Vec<LostBytes>> {
    let mut lost = Vec::new();
    for file in bag_files(path)? {
        // Channel ids are local to a file.
        let mut channels = Channels::default();
        for piece in Pieces::open(&file)? {
            let piece = piece?;
            match &piece {
                Piece::Lost(damage) => lost.push(damage.clone()),
                Piece::Chunk(_, content) => lost.extend(content.lost.clone()),
                Piece::Record(..) => {}
            }
            for (opcode, body) in piece.records() {
                if let Some(message) = channels.message(opcode, body) {
                    let named = |error| Error::file(&file, format!("{}: {error}", message.topic));
                    take(&file, &message).map_err(named)?;
                }
            }
        }
    }
    Ok(lost)
}

/// Schemas and channels of one file as far as it was read.
#[derive(Debug, Default)]
pub(super) struct Channels {
    schemas: BTreeMap<u16, String>,
    /// Topic and message type by channel id.
    channels: BTreeMap<u16, (String, String)>,
}

impl Channels {
    /// Takes the next record of the file; returns it if it is a message of a known channel.
    pub fn message<'a>(&'a mut self, opcode: u8, body: &'a [u8]) -> Option<MessageRecord<'a>> {
        if opcode != op::MESSAGE {
            self.define(opcode, body);
            return None;
        }
        // Layout: channel id u16, sequence u32, log time u64, publish time u64, payload.
        let id = u16::from_le_bytes(*body.first_chunk()?);
        let time = |at: usize| Some(u64::from_le_bytes(*body.get(at..)?.first_chunk()?));
        let (log_time, publish_time, payload) = (time(6)?, time(14)?, body.get(22..)?);
        let (topic, type_name) = self.channels.get(&id)?;
        Some(MessageRecord { topic, type_name, log_time, publish_time, payload })
    }

    /// Takes a schema or a channel.
    pub fn define(&mut self, opcode: u8, body: &[u8]) {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL) {
            return;
        }
        match parse(opcode, body) {
            Some(Parsed::Schema { header, .. }) => drop(self.schemas.insert(header.id, header.name)),
            Some(Parsed::Channel(channel)) => {
                let type_name = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                self.channels.insert(channel.id, (channel.topic, type_name));
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{BagWriter, file_name};
    use super::*;

    #[test]
    fn messages_come_in_the_order_of_the_metadata_and_damage_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        std::fs::create_dir(&bag).unwrap();
        for (name, first) in [("z.mcap", 0u8), ("a.mcap", 3)] {
            let single = folder.path().join(name.trim_end_matches(".mcap"));
            let mut writer = BagWriter::create(&single).unwrap();
            // Another number of topics per file: channel ids differ.
            for topic in ["/one", "/two"].iter().skip(usize::from(first > 0)) {
                writer.add_topic(topic, "test/msg/Byte", "uint8 data", false).unwrap();
            }
            (first..first + 3).for_each(|byte| writer.write("/two", &[byte], u64::from(byte), 7).unwrap());
            writer.finish().unwrap();
            std::fs::copy(single.join(file_name(&single)), bag.join(name)).unwrap();
        }
        let read = |bytes: &mut Vec<u8>| {
            bytes.clear();
            for_each_message(&bag, |_, message| {
                assert_eq!((message.topic, message.type_name, message.publish_time), ("/two", "test/msg/Byte", 7));
                assert_eq!(message.log_time, u64::from(message.payload[0]));
                bytes.push(message.payload[0]);
                Ok(())
            })
            .unwrap()
        };
        let mut bytes = Vec::new();
        read(&mut bytes);
        assert_eq!(bytes, [3, 4, 5, 0, 1, 2], "without metadata: by name");
        let metadata = "rosbag2_bagfile_information:\n  relative_file_paths: [z.mcap, a.mcap]\n";
        std::fs::write(bag.join("metadata.yaml"), metadata).unwrap();
        assert_eq!(read(&mut bytes), []);
        assert_eq!(bytes, [0, 1, 2, 3, 4, 5]);
        let file = std::fs::read(bag.join("z.mcap")).unwrap();
        std::fs::write(bag.join("z.mcap"), &file[..file.len() / 3]).unwrap();
        assert_eq!(read(&mut bytes).len(), 1);
        assert_eq!(bytes[bytes.len() - 3..], [3, 4, 5]);
    }
}
