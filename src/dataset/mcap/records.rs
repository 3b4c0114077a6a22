//! Records of an MCAP file in order and in constant memory; damage is skipped and reported.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use mcap::MAGIC;
use mcap::records::{ChunkHeader, Record as Parsed, op};

use crate::dataset::source::LostBytes;
use crate::error::{Error, Result};
use crate::file::input;

/// Size of opcode and length, which precede the content of each record, bytes.
pub(super) const PREFIX: u64 = 9;
/// Number of valid records in a row that end a damaged stretch. One or two can be valid by chance.
const CHAIN: usize = 4;
/// Size of the window in which the end of damage is searched, bytes.
const WINDOW: usize = 1 << 20;

/// Kind and place of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Record {
    /// Kind, one of [`op`].
    pub opcode: u8,
    /// Offset of its opcode in the file, bytes.
    pub offset: u64,
    /// Length of its content, bytes.
    pub length: u64,
}

/// A stretch of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FileSpan {
    /// A record of the data section, or its end.
    Record(Record),
    /// A chunk that the end of the file truncates.
    CutOff(Record),
    /// Damage.
    Lost(LostBytes),
}

/// Reads the records from the file's header to the end of its data section.
#[derive(Debug)]
pub struct Records {
    path: PathBuf,
    file: File,
    size: u64,
    at: u64,
    done: bool,
}

impl Records {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// If it can't be read, or lacks the magic bytes of MCAP.
    pub fn open(path: &Path) -> Result<Self> {
        let file = input::open(path)?;
        let size = file.metadata().map_err(Error::io(path))?.len();
        let mut magic = [0; MAGIC.len()];
        if size >= MAGIC.len() as u64 {
            file.read_exact_at(&mut magic, 0).map_err(Error::io(path))?;
        }
        if magic != *MAGIC {
            return Err(Error::file(path, "expected an MCAP file"));
        }
        Ok(Self { path: path.to_path_buf(), file, size, at: MAGIC.len() as u64, done: false })
    }

    /// Returns the size of the file, bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Returns the path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the file.
    pub fn file(&self) -> &File {
        &self.file
    }

    /// Reads the content of a record, up to the end of the file.
    ///
    /// # Errors
    /// If the file can't be read.
    pub fn body(&self, record: &Record) -> Result<Vec<u8>> {
        let start = record.offset + PREFIX;
        let length = record.length.min(self.size.saturating_sub(start));
        // Not `read_exact_at`: zeroing its buffer takes nearly as long as reading a large chunk.
        let mut body = Vec::with_capacity(length as usize);
        let mut file = &self.file;
        let read = file.seek(SeekFrom::Start(start)).and_then(|_| file.take(length).read_to_end(&mut body));
        match read.map_err(Error::io(&self.path))? as u64 == length {
            true => Ok(body),
            false => Err(Error::file(&self.path, "became shorter while it was read")),
        }
    }

    /// Returns the damage report of `record`.
    pub fn lost(&self, record: &Record, reason: impl ToString) -> LostBytes {
        let bytes = record.length.saturating_add(PREFIX).min(self.size - record.offset);
        self.lost_bytes(record.offset, bytes, reason)
    }

    fn lost_bytes(&self, offset: u64, bytes: u64, reason: impl ToString) -> LostBytes {
        let file = self.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        LostBytes { file, offset, bytes, reason: reason.to_string() }
    }

    /// Returns the next stretch; None after the end of the data section.
    ///
    /// # Errors
    /// If the file can't be read.
    pub fn next_part(&mut self) -> Result<Option<FileSpan>> {
        if self.done {
            return Ok(None);
        }
        if let Some(record) = self.header_at(self.at)? {
            self.at = record.offset + PREFIX + record.length;
            self.done = record.opcode == op::DATA_END;
            return Ok(Some(FileSpan::Record(record)));
        }
        if let Some(record) = self.cut_off_chunk()? {
            self.done = true;
            return Ok(Some(FileSpan::CutOff(record)));
        }
        let start = self.at;
        let lost = match self.find_chain(start + 1)? {
            Some(next) => {
                self.at = next;
                self.lost_bytes(start, next - start, "no record")
            }
            None => {
                self.done = true;
                self.lost_bytes(start, self.size - start, "the file ends here, without the end of a recording")
            }
        };
        Ok(Some(FileSpan::Lost(lost)))
    }

    /// Returns the record that begins at `offset`, if it fits into the file.
    fn header_at(&self, offset: u64) -> Result<Option<Record>> {
        let mut prefix = [0; PREFIX as usize];
        if offset + PREFIX > self.size {
            return Ok(None);
        }
        self.file.read_exact_at(&mut prefix, offset).map_err(Error::io(&self.path))?;
        Ok(self.header_of(&prefix, offset))
    }

    /// Returns the record at `offset` that begins with `prefix`, if it fits into the file.
    fn header_of(&self, prefix: &[u8], offset: u64) -> Option<Record> {
        let record = record_of(prefix, offset);
        let fits = record.length <= self.size - offset - PREFIX;
        // Opcodes from 0x80 on are private; those in between are not assigned.
        let known = (op::HEADER..=op::DATA_END).contains(&record.opcode) || record.opcode >= 0x80;
        (fits && known).then_some(record)
    }

    /// Returns the chunk at the present offset, if its header is valid and only its end is missing.
    fn cut_off_chunk(&self) -> Result<Option<Record>> {
        if self.at + PREFIX > self.size {
            return Ok(None);
        }
        let mut prefix = [0; PREFIX as usize];
        self.file.read_exact_at(&mut prefix, self.at).map_err(Error::io(&self.path))?;
        let record = record_of(&prefix, self.at);
        if record.opcode != op::CHUNK {
            return Ok(None);
        }
        let start = self.body(&Record { length: record.length.min(128), ..record })?;
        Ok(chunk_header(&start)
            .filter(|(header, at)| header.compressed_size.checked_add(*at as u64) == Some(record.length))
            .map(|_| record))
    }

    /// Returns the first offset from `from` on at which [`CHAIN`] valid records follow each other.
    fn find_chain(&self, from: u64) -> Result<Option<u64>> {
        let mut window = vec![0; WINDOW];
        let mut start = from;
        while start + PREFIX <= self.size {
            let length = ((self.size - start) as usize).min(WINDOW);
            self.file.read_exact_at(&mut window[..length], start).map_err(Error::io(&self.path))?;
            for (at, prefix) in window[..length].windows(PREFIX as usize).enumerate() {
                let offset = start + at as u64;
                let plausible = (op::HEADER..=op::DATA_END).contains(&prefix[0])
                    && record_of(prefix, offset).length <= self.size - offset - PREFIX;
                if plausible && self.chain_at(offset, (start, &window[..length]))? {
                    return Ok(Some(offset));
                }
            }
            // Overlap the windows, so that a record header on the border is found.
            start += (length - PREFIX as usize + 1) as u64;
        }
        Ok(None)
    }

    /// True if [`CHAIN`] valid records follow each other from `offset` on. `window`: its offset and content; damage may hold
    /// millions of places that look like a record, so the file is read only beyond it.
    fn chain_at(&self, mut offset: u64, (start, window): (u64, &[u8])) -> Result<bool> {
        for _ in 0..CHAIN {
            let place = (offset - start) as usize;
            let header = match window.get(place..place.saturating_add(PREFIX as usize)) {
                Some(prefix) => self.header_of(prefix, offset),
                None => self.header_at(offset)?,
            };
            match header {
                // The record that ends the data section holds four bytes: random bytes hardly match it.
                Some(Record { opcode: op::DATA_END, length, .. }) => return Ok(length == 4),
                Some(record) if record.length > 0 && record.opcode <= op::DATA_END => {
                    offset += PREFIX + record.length;
                }
                _ => return Ok(false),
            }
        }
        Ok(true)
    }
}

/// Parses the header of a chunk; also returns the offset of its data.
pub(super) fn chunk_header(body: &[u8]) -> Option<(ChunkHeader, usize)> {
    // Start time, end time, size, CRC-32, then the name of the compression.
    const NAME: usize = 8 + 8 + 8 + 4;
    let length = u32::from_le_bytes(body.get(NAME..NAME + 4)?.try_into().ok()?) as usize;
    if !["", "zstd", "lz4"].map(str::len).contains(&length) {
        return None;
    }
    let data = NAME + 4 + length + 8;
    // The parser expects the data as well: set its length to 0 to parse the header alone.
    let mut head = body.get(..data)?.to_vec();
    let size = head.len() - 8;
    let compressed_size = u64::from_le_bytes(head[size..].try_into().ok()?);
    head[size..].fill(0);
    match mcap::parse_record(op::CHUNK, &head) {
        Ok(Parsed::Chunk { header, .. }) => Some((ChunkHeader { compressed_size, ..header }, data)),
        _ => None,
    }
}

fn record_of(prefix: &[u8], offset: u64) -> Record {
    let mut length = [0; 8];
    length.copy_from_slice(&prefix[1..PREFIX as usize]);
    Record { opcode: prefix[0], offset, length: u64::from_le_bytes(length) }
}
