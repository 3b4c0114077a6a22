//! Pieces of an MCAP file: records and decompressed chunks.

use std::path::Path;

use mcap::records::op;

use super::chunk::{ChunkContent, inner_records, open_chunk};
use super::records::{FileSpan, Record, Records};
use crate::dataset::source::LostBytes;
use crate::error::Result;
use crate::file::limits;

/// A piece of a file with its content.
#[derive(Debug)]
pub enum Piece {
    /// A record outside of chunks, with its content. The content of an attachment stays in the file, since it may be of any
    /// size.
    Record(Record, Vec<u8>),
    /// A chunk and its offset in the file, bytes.
    Chunk(u64, ChunkContent),
    /// Damage.
    Lost(LostBytes),
}

impl Piece {
    /// Returns opcode and content of the record, or of each record in the chunk.
    pub fn records(&self) -> impl Iterator<Item = (u8, &[u8])> {
        self.entries().map(|(_, opcode, body)| (opcode, body))
    }

    /// Returns the records as [`Self::records`] does, each behind the offset of its end in [`Self::bytes`].
    pub fn entries(&self) -> impl Iterator<Item = (usize, u8, &[u8])> {
        let (single, chunk) = match self {
            Self::Record(record, body) => (Some((body.len(), record.opcode, body.as_slice())), None),
            Self::Chunk(_, content) => (None, Some(inner_records(content.records()))),
            Self::Lost(_) => (None, None),
        };
        single.into_iter().chain(chunk.into_iter().flatten())
    }

    /// Returns the content of the record, or all records of the chunk.
    pub fn bytes(&self) -> &[u8] {
        match self {
            Self::Record(_, body) => body,
            Self::Chunk(_, content) => content.records(),
            Self::Lost(_) => &[],
        }
    }

    /// Returns the offset of the piece in the file, bytes.
    pub fn offset(&self) -> u64 {
        match self {
            Self::Record(record, _) => record.offset,
            Self::Chunk(offset, _) => *offset,
            Self::Lost(lost) => lost.offset,
        }
    }
}

/// Pieces of one file in order, up to the end of its data section.
#[derive(Debug)]
pub struct Pieces(Records);

impl Pieces {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// If it can't be read, or lacks the magic bytes of MCAP.
    pub fn open(path: &Path) -> Result<Self> {
        Records::open(path).map(Self)
    }

    fn next_piece(&mut self) -> Result<Option<Piece>> {
        match self.0.next_part()? {
            Some(part) => self.0.piece(part),
            None => Ok(None),
        }
    }
}

impl Records {
    /// Reads the content of a stretch; None at the end of the data section.
    ///
    /// # Errors
    /// If the file can't be read.
    pub fn piece(&self, part: FileSpan) -> Result<Option<Piece>> {
        let (record, cut_off) = match part {
            FileSpan::Lost(lost) => return Ok(Some(Piece::Lost(lost))),
            FileSpan::CutOff(record) => (record, true),
            FileSpan::Record(record) => (record, false),
        };
        Ok(match record.opcode {
            op::DATA_END => None,
            op::ATTACHMENT => Some(Piece::Record(record, Vec::new())),
            _ if record.length > limits::RECORD.value() => Some(Piece::Lost(self.too_large(&record))),
            op::CHUNK => Some(match open_chunk(self, &record, cut_off)? {
                Ok(content) => Piece::Chunk(record.offset, content),
                Err(lost) => Piece::Lost(lost),
            }),
            _ => Some(Piece::Record(record, self.body(&record)?)),
        })
    }
}

impl Records {
    /// Returns the report of a record that is not read because of its length.
    fn too_large(&self, record: &Record) -> LostBytes {
        let (most, variable) = (limits::RECORD.value(), limits::RECORD.variable());
        let reason =
            format!("a record of {} bytes, expected at most {most}; {variable} raises the limit", record.length);
        self.lost(record, reason)
    }
}

impl Iterator for Pieces {
    type Item = Result<Piece>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_piece().transpose()
    }
}
