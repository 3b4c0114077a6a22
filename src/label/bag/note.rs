//! What is noted of a chunk while its images are labelled, so that the chunk can be copied without being unpacked again.

use std::iter::Peekable;

use mcap::records::op;
use serde::{Deserialize, Serialize};

use super::super::journal::Heads;
use super::ImageMessage;
use crate::dataset::mcap::{Content, Part, Piece, Record, Records, Skeleton};
use crate::error::{Error, Result};
use crate::message::{Header, Image, Message, Reader, Time};

/// A whole chunk that holds images, as it was when they were labelled.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ChunkNote {
    /// Where its record begins.
    offset: u64,
    /// CRC-32 of the record's content.
    crc: u32,
    /// What indexes say about it.
    pub skeleton: Skeleton,
    /// Its images, in order.
    pub images: Vec<ImageHead>,
}

/// What a label takes over from its image's message.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct ImageHead {
    pub log_time: u64,
    pub publish_time: u64,
    stamp: (i32, u32),
    frame_id: String,
}

impl ImageHead {
    /// That of a message; its log time is the stamp where the payload has none.
    pub fn of(message: &ImageMessage) -> Self {
        let header = Reader::leading::<Header>(Image::TYPE, message.payload)
            .unwrap_or_else(|_| Header { stamp: Time::from_nanos(message.log_time as i64), frame_id: String::new() });
        let Header { stamp: Time { sec, nanosec }, frame_id } = header;
        let ImageMessage { log_time, publish_time, .. } = *message;
        Self { log_time, publish_time, stamp: (sec, nanosec), frame_id }
    }

    /// The message's header.
    pub fn header(&self) -> Header {
        let (sec, nanosec) = self.stamp;
        Header { stamp: Time { sec, nanosec }, frame_id: self.frame_id.clone() }
    }
}

impl ChunkNote {
    /// The note of the chunk at `offset`, in text; None if there is nothing to copy as it is.
    pub fn of(offset: u64, content: &Content, images: Vec<ImageHead>) -> Option<String> {
        if content.lost.is_some() || images.is_empty() {
            return None;
        }
        let skeleton = Skeleton::of(content.records());
        let note = Self { offset, crc: crc32fast::hash(content.body()), skeleton, images };
        // Without a note the chunk is unpacked again.
        serde_json::to_string(&note).ok()
    }
}

/// A piece of a file that is copied.
pub(super) enum Original {
    /// Unpacked, as it may hold anything.
    Piece(Piece),
    /// The content of a chunk's record that is the one which was noted.
    Noted(Vec<u8>, ChunkNote),
}

/// The pieces of a file; chunks with a note stay packed.
pub(super) struct Originals {
    records: Records,
    notes: Peekable<Box<dyn Iterator<Item = Result<ChunkNote>> + Send>>,
}

impl Originals {
    /// Those of the file in `records`, of which `heads` have the notes.
    pub fn new(records: Records, heads: Heads) -> Self {
        let parse = |note: String| {
            serde_json::from_str(&note).map_err(|e| Error::value("a journal of labels", "the note of a chunk", e))
        };
        let notes = heads.flat_map(move |head| match head {
            Ok(head) => head.notes.into_iter().map(parse).collect(),
            Err(error) => vec![Err(error)],
        });
        let notes: Box<dyn Iterator<Item = _> + Send> = Box::new(notes);
        Self { records, notes: notes.peekable() }
    }

    fn next_original(&mut self) -> Result<Option<Original>> {
        let Some(part) = self.records.next_part()? else { return Ok(None) };
        if let Part::Record(record @ Record { opcode: op::CHUNK, .. }) = part
            && let Some(note) = self.note_at(record.offset)?
        {
            let body = self.records.body(&record)?;
            // A file that was changed meanwhile is read as if nothing were known.
            if crc32fast::hash(&body) == note.crc {
                return Ok(Some(Original::Noted(body, note)));
            }
        }
        Ok(self.records.piece(part)?.map(Original::Piece))
    }

    /// The note of the chunk at `offset`; notes are in the order of the file.
    fn note_at(&mut self, offset: u64) -> Result<Option<ChunkNote>> {
        self.notes.next_if(|note| note.as_ref().map_or(true, |note| note.offset == offset)).transpose()
    }
}

impl Iterator for Originals {
    type Item = Result<Original>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_original().transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::journal::{Journal, Label};
    use super::super::super::source::Source;
    use super::super::Bag;
    use super::*;
    use crate::dataset::mcap::{BagWriter, file_name};
    use crate::hand::Topology;
    use crate::tactile::TactileField;

    /// A bag of six images, and what was noted while they were labelled.
    fn noted(folder: &std::path::Path) -> (std::path::PathBuf, std::path::PathBuf) {
        let bag = folder.join("bag");
        let mut writer = BagWriter::create(&bag).unwrap();
        writer.add_topic("/camera", Image::TYPE, &Image::schema(), false).unwrap();
        writer.add_topic("/other", Header::TYPE, "", false).unwrap();
        for index in 0..6u32 {
            let header = Header { stamp: Time { sec: 5, nanosec: index }, frame_id: "head".into() };
            let (data, encoding) = (vec![index as u8; 3 << 20], "rgb8".into());
            let image = Image { header, height: 1024, width: 1024, encoding, is_bigendian: 0, step: 3072, data };
            let time = 1000 + u64::from(index);
            writer.write("/other", &[0, 1, 0, 0], time, time).unwrap();
            writer.write("/camera", &image.to_cdr(), time, time).unwrap();
        }
        writer.finish().unwrap();
        let (file, path) = (bag.join(file_name(&bag)), folder.join("journal"));
        let source = Bag::open(&file, None, "/touch").unwrap();
        let mut journal = Journal::open(&path).unwrap().unwrap();
        for shot in source.shots(0, 0).unwrap() {
            let touch = Ok(TactileField::zeros(Topology::default()));
            journal.push(&Label { stamp_secs: shot.stamp_secs, warming_up: false, touch }, shot.note);
        }
        journal.flush(Vec::new(), true).unwrap();
        (file, path)
    }

    fn originals(file: &std::path::Path, journal: &std::path::Path) -> Vec<Original> {
        let originals = Originals::new(Records::open(file).unwrap(), Heads::open(journal).unwrap());
        originals.map(Result::unwrap).collect()
    }

    #[test]
    fn a_noted_chunk_is_what_unpacking_it_says() {
        let folder = tempfile::tempdir().unwrap();
        let (file, journal) = noted(folder.path());
        let pieces = crate::dataset::mcap::Pieces::open(&file).unwrap();
        let mut chunks = pieces.filter_map(|piece| match piece.unwrap() {
            Piece::Chunk(offset, content) => Some((offset, content)),
            _ => None,
        });
        let mut stamps = Vec::new();
        for original in originals(&file, &journal) {
            let Original::Noted(body, note) = original else { continue };
            let (offset, content) = chunks.next().unwrap();
            assert_eq!((note.offset, body.as_slice()), (offset, content.body()));
            assert_eq!(note.skeleton, Skeleton::of(content.records()));
            for image in &note.images {
                assert_eq!(image.header().frame_id, "head");
                assert_eq!(
                    (image.log_time, image.publish_time),
                    (1000 + stamps.len() as u64, 1000 + stamps.len() as u64)
                );
                stamps.push(image.header().stamp);
            }
        }
        assert!(chunks.next().is_none());
        assert_eq!(stamps, [0, 1, 2, 3, 4, 5].map(|nanosec| Time { sec: 5, nanosec }));
    }

    #[test]
    fn a_chunk_that_changed_since_is_read_anew() {
        let folder = tempfile::tempdir().unwrap();
        let (file, journal) = noted(folder.path());
        let places = |kind: fn(&Original) -> bool| originals(&file, &journal).iter().filter(|o| kind(o)).count();
        let is_noted = |original: &Original| matches!(original, Original::Noted(..));
        let is_lost = |original: &Original| matches!(original, Original::Piece(Piece::Lost(_)));
        let before = places(is_noted);
        assert!(before > 1 && places(is_lost) == 0);
        let offset = originals(&file, &journal).iter().find_map(|original| match original {
            Original::Noted(body, note) => Some(note.offset as usize + body.len() / 2),
            Original::Piece(_) => None,
        });
        let mut bytes = std::fs::read(&file).unwrap();
        bytes[offset.unwrap()] ^= 1;
        std::fs::write(&file, bytes).unwrap();
        assert_eq!((places(is_noted), places(is_lost)), (before - 1, 1));
    }
}
