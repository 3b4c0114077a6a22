//! Chunks of an MCAP file, decompressed.

use std::collections::BTreeMap;
use std::io::Read;
use std::ops::Range;

use mcap::records::op;
use serde::{Deserialize, Serialize};

use super::records::{PREFIX, Record, Records, chunk_header};
use crate::dataset::source::LostBytes;
use crate::error::Result;
use crate::file::limits;

/// Largest window of zstd, as the exponent of 2 of its bytes; the format's own recommendation for decoders is 23, and the
/// library's highest level takes 27.
const WINDOW: u32 = 27;

/// A chunk and its uncompressed records.
#[derive(Debug)]
pub struct ChunkContent {
    body: Vec<u8>,
    /// The decompressed data; None for a chunk without compression.
    unpacked: Option<Vec<u8>>,
    /// Place of the records in `unpacked`, or else in `body`.
    place: Range<usize>,
    /// The missing end of a truncated chunk; None = the chunk is complete.
    pub lost: Option<LostBytes>,
}

impl ChunkContent {
    /// Returns the content of the chunk's record as it lies in the file.
    pub fn body(&self) -> &[u8] {
        &self.body
    }

    /// Frees the compressed form, which only a copy of the chunk needs; [`Self::body`] is empty afterwards.
    pub fn forget_body(&mut self) {
        if self.unpacked.is_some() {
            self.body = Vec::new();
        }
    }

    /// Returns the complete records, opcode and length included.
    pub fn records(&self) -> &[u8] {
        &self.unpacked.as_ref().unwrap_or(&self.body)[self.place.clone()]
    }
}

/// Log time, ns, and offset among the chunk's records, bytes, of each message by channel.
pub(super) type MessageIndex = BTreeMap<u16, Vec<(u64, u64)>>;

/// Definitions and message index of a chunk: all that is needed to copy the chunk without decompressing it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChunkOutline {
    /// Opcode and content of its schema and channel records.
    pub definitions: Vec<(u8, Vec<u8>)>,
    pub(super) index: MessageIndex,
}

impl ChunkOutline {
    /// Indexes a chunk's uncompressed `records`.
    pub fn of(records: &[u8]) -> Self {
        let mut skeleton = Self::default();
        let mut start = 0;
        for (end, opcode, body) in inner_records(records) {
            skeleton.add(opcode, body, start);
            start = end as u64;
        }
        skeleton
    }

    /// Estimates the memory of definitions and index, bytes.
    pub fn memory(&self) -> usize {
        let definitions = self.definitions.iter().map(|(_, body)| body.len() + size_of::<(u8, Vec<u8>)>());
        let index = self.index.values().map(|messages| messages.len() * size_of::<(u64, u64)>());
        definitions.sum::<usize>() + index.sum::<usize>()
    }

    /// Adds the record at `offset`.
    pub(super) fn add(&mut self, opcode: u8, body: &[u8], offset: u64) {
        match (opcode, body.first_chunk(), log_time(body)) {
            (op::MESSAGE, Some(id), Some(time)) => {
                self.index.entry(u16::from_le_bytes(*id)).or_default().push((time, offset));
            }
            (op::SCHEMA | op::CHANNEL, ..) => self.definitions.push((opcode, body.to_vec())),
            _ => {}
        }
    }
}

/// Returns the log time of a message record, ns.
pub(super) fn log_time(body: &[u8]) -> Option<u64> {
    // It follows channel id (2 bytes) and sequence number (4 bytes).
    body.get(6..)?.first_chunk().map(|time| u64::from_le_bytes(*time))
}

/// Reads the chunk at `record`. A damaged chunk is lost as a whole; of a chunk that the end of the file truncates
/// (`cut_off`), the complete records are kept. The inner error describes the damage.
///
/// # Errors
/// If the file can't be read.
pub(super) fn open_chunk(
    file: &Records,
    record: &Record,
    cut_off: bool,
) -> Result<std::result::Result<ChunkContent, LostBytes>> {
    let lost = |reason: String| Ok(Err(file.lost(record, reason)));
    let body = file.body(record)?;
    let Some((header, start)) = chunk_header(&body) else {
        return lost("a chunk with an invalid header".into());
    };
    let compressed = &body[start..];
    let wanted = header.uncompressed_size;
    let most = limits::CHUNK.value();
    if wanted > most {
        let variable = limits::CHUNK.variable();
        return lost(format!("a chunk of {wanted} bytes, expected at most {most}; {variable} raises the limit"));
    }
    // Room for all, so that no larger buffer ever stands beside it; the system gives the memory as it is written.
    let mut unpacked = Vec::new();
    if !header.compression.is_empty() && unpacked.try_reserve_exact(wanted as usize).is_err() {
        return lost(format!("a chunk of {wanted} bytes, more than there is memory"));
    }
    let result = match header.compression.as_str() {
        "" => Ok(0),
        // Decompress into the final buffer where the chunk is whole: spares one copy.
        "zstd" if !cut_off => {
            zstd::bulk::Decompressor::new().and_then(|mut zstd| zstd.decompress_to_buffer(compressed, &mut unpacked))
        }
        "zstd" => zstd::Decoder::new(compressed).and_then(|mut decoder| {
            decoder.window_log_max(WINDOW)?;
            decoder.take(wanted).read_to_end(&mut unpacked)
        }),
        "lz4" => lz4::Decoder::new(compressed).and_then(|decoder| decoder.take(wanted).read_to_end(&mut unpacked)),
        other => return lost(format!("a chunk with unknown compression {other:?}")),
    };
    let (unpacked, place) = match header.compression.is_empty() {
        true => (None, start..body.len().min(start.saturating_add(usize::try_from(wanted).unwrap_or(usize::MAX)))),
        false => {
            let place = 0..unpacked.len();
            (Some(unpacked), place)
        }
    };
    let mut content = ChunkContent { body, unpacked, place, lost: None };
    let records = content.records();
    let whole_records = inner_records(records).last().map_or(0, |(end, ..)| end);
    if cut_off {
        let count = inner_records(records).count();
        content.place.end = content.place.start + whole_records;
        let reason = format!("the file ends within this chunk, of which {count} records were read");
        content.lost = Some(file.lost(record, reason));
        return Ok(Ok(content));
    }
    if let Err(error) = result {
        return lost(format!("a chunk that can't be decompressed: {error}"));
    }
    if records.len() as u64 != wanted {
        return lost(format!("a chunk of {} bytes, expected {wanted}", records.len()));
    }
    if header.uncompressed_crc != 0 && crc32fast::hash(records) != header.uncompressed_crc {
        return lost("a chunk whose checksum is wrong".into());
    }
    if whole_records != records.len() {
        return lost("a chunk whose records do not fill it".into());
    }
    Ok(Ok(content))
}

/// Returns end offset, opcode and content of each record in a chunk, up to the first incomplete one.
pub(super) fn inner_records(records: &[u8]) -> impl Iterator<Item = (usize, u8, &[u8])> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let opcode = *records.get(at)?;
        let start = at + PREFIX as usize;
        let length = u64::from_le_bytes(records.get(at + 1..start)?.try_into().ok()?);
        let end = start.checked_add(usize::try_from(length).ok()?)?;
        let body = records.get(start..end)?;
        let inside = matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) || opcode > op::DATA_END;
        at = end;
        inside.then_some((end, opcode, body))
    })
}
