//! Index of the attachments of an MCAP file.

use std::fs::File;
use std::os::unix::fs::FileExt;

use crc32fast::Hasher;
use mcap::records::AttachmentIndex;

use super::records::{PREFIX, Record};

/// Size of the buffer, bytes.
const BUFFER: usize = 1 << 20;

/// Returns the index record of an attachment at its new `offset`; None if its checksum or header is invalid.
pub(super) fn attachment_index(file: &File, record: &Record, offset: u64) -> std::io::Result<Option<AttachmentIndex>> {
    let start = record.offset + PREFIX;
    // Layout: log time, creation time, name, media type, data size, data, CRC-32.
    let mut head = vec![0; record.length.min(64 << 10) as usize];
    file.read_exact_at(&mut head, start)?;
    let text = |at: usize| -> Option<(String, usize)> {
        let length = u32::from_le_bytes(*head.get(at..)?.first_chunk()?) as usize;
        let text = head.get(at + 4..at.checked_add(4)?.checked_add(length)?)?;
        Some((String::from_utf8_lossy(text).into_owned(), at + 4 + length))
    };
    let number = |at: usize| head.get(at..).and_then(|rest| rest.first_chunk()).map(|n| u64::from_le_bytes(*n));
    let parsed = || {
        let (name, at) = text(16)?;
        let (media_type, at) = text(at)?;
        let data_size = number(at)?;
        ((at as u64 + 8).checked_add(data_size)?.checked_add(4)? == record.length).then_some(())?;
        let (log_time, create_time) = (number(0)?, number(8)?);
        let length = PREFIX + record.length;
        Some(AttachmentIndex { offset, length, log_time, create_time, data_size, name, media_type })
    };
    let Some(index) = parsed() else { return Ok(None) };
    let (mut crc, mut buffer, mut done) = (Hasher::new(), vec![0; BUFFER], 0);
    let checked = record.length - 4;
    while done < checked {
        let length = (checked - done).min(BUFFER as u64) as usize;
        file.read_exact_at(&mut buffer[..length], start + done)?;
        crc.update(&buffer[..length]);
        done += length as u64;
    }
    let mut stored = [0; 4];
    file.read_exact_at(&mut stored, start + checked)?;
    let stored = u32::from_le_bytes(stored);
    Ok((stored == 0 || stored == crc.finalize()).then_some(index))
}
