//! Notes about chunks, taken during inference, that spare a second decompression when the chunks are copied.

use std::iter::Peekable;

use mcap::records::op;
use serde::{Deserialize, Serialize};

use super::messages::MessageRecord;
use super::{ChunkContent, ChunkOutline, FileSpan, Piece, Record, Records};
use crate::dataset::labels::Notes;
use crate::error::{Error, Result};
use crate::message::{Header, Image, Message, Reader, Time};

/// Largest memory of a note before it becomes text, bytes: a chunk of very many small messages is better read again.
pub(super) const LARGEST: usize = 1 << 20;

/// An undamaged chunk with images, as it was during inference.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ChunkNote {
    /// Offset of its record in the file, bytes.
    offset: u64,
    /// CRC-32 of the record's content, which detects a change of the file.
    crc: u32,
    /// Definitions and message index.
    pub skeleton: ChunkOutline,
    /// Its images in order.
    pub images: Vec<ImageHead>,
}

/// Times and header of an image's message, which its label copies.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct ImageHead {
    pub log_time: u64,
    pub publish_time: u64,
    stamp: (i32, u32),
    frame_id: String,
}

impl ImageHead {
    /// Reads times and header of a message. If the payload has no header, the log time is the stamp.
    pub fn of(message: &MessageRecord) -> Self {
        let header = Reader::leading::<Header>(Image::TYPE, message.payload)
            .unwrap_or_else(|_| Header { stamp: Time::from_nanos(message.log_time as i64), frame_id: String::new() });
        let Header { stamp: Time { sec, nanosec }, frame_id } = header;
        let MessageRecord { log_time, publish_time, .. } = *message;
        Self { log_time, publish_time, stamp: (sec, nanosec), frame_id }
    }

    /// Returns the memory of this value, bytes.
    pub fn memory(&self) -> usize {
        size_of::<Self>() + self.frame_id.len()
    }

    /// Returns the message's header.
    pub fn header(&self) -> Header {
        let (sec, nanosec) = self.stamp;
        Header { stamp: Time { sec, nanosec }, frame_id: self.frame_id.clone() }
    }
}

impl ChunkNote {
    /// Returns the note of the chunk at `offset` as text; None if the chunk is damaged, holds no image or too much else.
    pub fn of(offset: u64, content: &ChunkContent, images: Vec<ImageHead>) -> Option<String> {
        if content.lost.is_some() || images.is_empty() {
            return None;
        }
        let skeleton = ChunkOutline::of(content.records());
        if skeleton.memory() + images.iter().map(ImageHead::memory).sum::<usize>() > LARGEST {
            return None;
        }
        let note = Self { offset, crc: crc32fast::hash(content.body()), skeleton, images };
        // Serialisation can fail without harm: a chunk without a note is decompressed again.
        serde_json::to_string(&note).ok()
    }
}

/// A piece of the file that is copied.
pub(super) enum OriginalPiece {
    /// A piece without a note, decompressed.
    Piece(Piece),
    /// A chunk with a note: content of its record, still compressed.
    Noted(Vec<u8>, ChunkNote),
}

/// Pieces of a file; chunks with a note stay compressed.
pub(super) struct OriginalPieces<'a> {
    records: Records,
    notes: Peekable<Box<dyn Iterator<Item = Result<ChunkNote>> + Send + 'a>>,
}

impl<'a> OriginalPieces<'a> {
    /// Reads the file in `records`, whose chunks have `notes`.
    pub fn new(records: Records, notes: Notes<'a>) -> Self {
        let parse = |note: Result<String>| {
            serde_json::from_str(&note?).map_err(|e| Error::value("a journal of labels", "the note of a chunk", e))
        };
        let notes: Box<dyn Iterator<Item = _> + Send> = Box::new(notes.map(parse));
        Self { records, notes: notes.peekable() }
    }

    fn next_original(&mut self) -> Result<Option<OriginalPiece>> {
        let Some(part) = self.records.next_part()? else { return Ok(None) };
        if let FileSpan::Record(record @ Record { opcode: op::CHUNK, .. }) = part
            && let Some(note) = self.note_at(record.offset)?
        {
            let body = self.records.body(&record)?;
            // Ignore the note if the file has changed since.
            if crc32fast::hash(&body) == note.crc {
                return Ok(Some(OriginalPiece::Noted(body, note)));
            }
        }
        Ok(self.records.piece(part)?.map(OriginalPiece::Piece))
    }

    /// Returns the note of the chunk at `offset`. Notes are in the order of the file.
    fn note_at(&mut self, offset: u64) -> Result<Option<ChunkNote>> {
        self.notes.next_if(|note| note.as_ref().map_or(true, |note| note.offset == offset)).transpose()
    }
}

impl Iterator for OriginalPieces<'_> {
    type Item = Result<OriginalPiece>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_original().transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Bag, BagWriter, Pieces, file_name};
    use super::*;
    use crate::dataset::source::ImageSource;

    /// Creates a bag of six images; returns its file and the notes of its chunks.
    fn noted(folder: &std::path::Path) -> (std::path::PathBuf, Vec<String>) {
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
        let file = bag.join(file_name(&bag));
        let source = Bag::open(&file, None, "/touch").unwrap();
        let notes = source.frames(0, 0).unwrap().filter_map(|frame| frame.unwrap().note).collect();
        (file, notes)
    }

    fn originals(file: &std::path::Path, notes: &[String]) -> Vec<OriginalPiece> {
        let notes = Box::new(notes.iter().cloned().map(Ok));
        OriginalPieces::new(Records::open(file).unwrap(), notes).map(Result::unwrap).collect()
    }

    #[test]
    fn a_note_matches_the_decompressed_chunk() {
        let folder = tempfile::tempdir().unwrap();
        let (file, notes) = noted(folder.path());
        let pieces = Pieces::open(&file).unwrap();
        let mut chunks = pieces.filter_map(|piece| match piece.unwrap() {
            Piece::Chunk(offset, content) => Some((offset, content)),
            _ => None,
        });
        let mut stamps = Vec::new();
        for original in originals(&file, &notes) {
            let OriginalPiece::Noted(body, note) = original else { continue };
            let (offset, content) = chunks.next().unwrap();
            assert_eq!((note.offset, body.as_slice()), (offset, content.body()));
            assert_eq!(note.skeleton, ChunkOutline::of(content.records()));
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
    fn a_note_is_ignored_if_its_chunk_has_changed() {
        let folder = tempfile::tempdir().unwrap();
        let (file, notes) = noted(folder.path());
        let places = |kind: fn(&OriginalPiece) -> bool| originals(&file, &notes).iter().filter(|o| kind(o)).count();
        let is_noted = |original: &OriginalPiece| matches!(original, OriginalPiece::Noted(..));
        let is_lost = |original: &OriginalPiece| matches!(original, OriginalPiece::Piece(Piece::Lost(_)));
        let before = places(is_noted);
        assert!(before > 1 && places(is_lost) == 0);
        let offset = originals(&file, &notes).iter().find_map(|original| match original {
            OriginalPiece::Noted(body, note) => Some(note.offset as usize + body.len() / 2),
            OriginalPiece::Piece(_) => None,
        });
        let mut bytes = std::fs::read(&file).unwrap();
        bytes[offset.unwrap()] ^= 1;
        std::fs::write(&file, bytes).unwrap();
        assert_eq!((places(is_noted), places(is_lost)), (before - 1, 1));
    }
}
