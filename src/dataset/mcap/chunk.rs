//! What lies in a chunk of an MCAP file.

use std::io::Read;

use mcap::records::op;

use super::records::{PREFIX, Part, Records, chunk_header};
use crate::error::Result;

/// A chunk's records, uncompressed.
#[derive(Debug)]
pub struct Content {
    /// Whole records, opcode and length included.
    pub records: Vec<u8>,
    /// Whether these are all of the chunk's.
    pub whole: bool,
}

/// Reads a chunk, whole or not at all; of one that is cut off since the file ends, what is there. Else says what is wrong.
///
/// # Errors
/// If the file can't be read.
pub fn open_chunk(file: &Records, part: &Part) -> Result<std::result::Result<Content, String>> {
    let (record, cut_off) = match part {
        Part::Record(record) => (record, false),
        Part::CutOff(record) => (record, true),
        Part::Lost(lost) => return Ok(Err(lost.reason.clone())),
    };
    let body = file.body(record)?;
    let Some((header, start)) = chunk_header(&body) else {
        return Ok(Err("a chunk without a proper head".into()));
    };
    let compressed = &body[start..];
    let wanted = header.uncompressed_size;
    let mut records = Vec::new();
    let unpacked = match header.compression.as_str() {
        "" => compressed.take(wanted).read_to_end(&mut records),
        "zstd" => zstd::Decoder::new(compressed).and_then(|decoder| decoder.take(wanted).read_to_end(&mut records)),
        "lz4" => lz4::Decoder::new(compressed).and_then(|decoder| decoder.take(wanted).read_to_end(&mut records)),
        other => return Ok(Err(format!("a chunk with unknown compression {other:?}"))),
    };
    if cut_off {
        let whole_records = inner_records(&records).last().map_or(0, |(end, ..)| end);
        records.truncate(whole_records);
        return Ok(Ok(Content { records, whole: false }));
    }
    if let Err(error) = unpacked {
        return Ok(Err(format!("a chunk that can't be decompressed: {error}")));
    }
    if records.len() as u64 != wanted {
        return Ok(Err(format!("a chunk of {} bytes where {wanted} should be", records.len())));
    }
    if header.uncompressed_crc != 0 && crc32fast::hash(&records) != header.uncompressed_crc {
        return Ok(Err("a chunk whose checksum is wrong".into()));
    }
    if inner_records(&records).last().map_or(0, |(end, ..)| end) != records.len() {
        return Ok(Err("a chunk whose records do not add up".into()));
    }
    Ok(Ok(Content { records, whole: true }))
}

/// Opcode and content of each record in a chunk, up to the first that is not whole; with the offset of its end.
pub fn inner_records(records: &[u8]) -> impl Iterator<Item = (usize, u8, &[u8])> {
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
