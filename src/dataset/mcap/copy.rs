//! Writer of an MCAP file from copied records, byte for byte, and new records.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

use crc32fast::Hasher;
use mcap::MAGIC;
use mcap::records::{AttachmentIndex, Record as Parsed, op};

use super::attachment::attachment_index;
use super::chunk::{ChunkOutline, log_time};
use super::parse::parse;
use super::records::{PREFIX, Record, Records, chunk_header};
use crate::error::{Error, Result};

/// Size at which a chunk of new records is compressed and written, bytes.
const CHUNK: usize = 1 << 20;
/// Level of zstd for new chunks: the fastest, since labels are small beside images and hardly shrink at higher levels.
const LEVEL: i32 = 1;
/// Size of the copy buffer, bytes.
const COPY: usize = 1 << 20;

/// Writer of one file; its indexes and summary cover copied and new records.
pub struct CopyWriter {
    path: PathBuf,
    out: BufWriter<File>,
    at: u64,
    crc: Hasher,
    chunked: bool,
    open: OpenChunk,
    /// Thread that compresses the last full chunk.
    packing: Option<JoinHandle<std::io::Result<Packed>>>,
    // Schemas and channels by id, which the summary repeats.
    schemas: BTreeMap<u16, Vec<u8>>,
    channels: BTreeMap<u16, Vec<u8>>,
    chunks: Vec<ChunkEntry>,
    attachments: Vec<AttachmentIndex>,
    metadata: Vec<(u64, u64, String)>,
    counts: BTreeMap<u16, u64>,
    times: Option<(u64, u64)>,
}

/// Content of a chunk's record, and its definitions and message index.
type Packed = (Vec<u8>, ChunkOutline);

/// New records of a chunk that is not full yet.
#[derive(Default)]
struct OpenChunk {
    records: Vec<u8>,
    skeleton: ChunkOutline,
}

impl OpenChunk {
    fn pack(self) -> std::io::Result<Packed> {
        let Self { records, skeleton } = self;
        let packed = zstd::bulk::compress(&records, LEVEL)?;
        let times = || skeleton.index.values().flatten().map(|(time, _)| *time);
        let (start, end) = (times().min().unwrap_or(0), times().max().unwrap_or(0));
        let mut body = Vec::with_capacity(packed.len() + 64);
        for number in [start, end, records.len() as u64] {
            body.extend_from_slice(&number.to_le_bytes());
        }
        body.extend_from_slice(&crc32fast::hash(&records).to_le_bytes());
        put_text(&mut body, "zstd");
        body.extend_from_slice(&(packed.len() as u64).to_le_bytes());
        body.extend_from_slice(&packed);
        Ok((body, skeleton))
    }
}

struct ChunkEntry {
    times: (u64, u64),
    offset: u64,
    length: u64,
    index_offsets: BTreeMap<u16, u64>,
    index_length: u64,
    compression: String,
    compressed: u64,
    uncompressed: u64,
}

impl CopyWriter {
    /// Starts the file at `path`. With `chunked`, new messages go into chunks, as in the original file.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn create(path: &Path, chunked: bool) -> Result<Self> {
        let file = File::create(path).map_err(Error::io(path))?;
        let mut writer = Self {
            path: path.to_path_buf(),
            out: BufWriter::with_capacity(COPY, file),
            at: 0,
            crc: Hasher::new(),
            chunked,
            open: OpenChunk::default(),
            packing: None,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            chunks: Vec::new(),
            attachments: Vec::new(),
            metadata: Vec::new(),
            counts: BTreeMap::new(),
            times: None,
        };
        writer.write(MAGIC)?;
        Ok(writer)
    }

    /// Returns the number of messages by channel.
    pub fn counts(&self) -> &BTreeMap<u16, u64> {
        &self.counts
    }

    /// Returns first and last log time, ns; None without a message.
    pub fn times(&self) -> Option<(u64, u64)> {
        self.times
    }

    /// Returns the contents of the channel records by id.
    pub fn channels(&self) -> &BTreeMap<u16, Vec<u8>> {
        &self.channels
    }

    /// Returns the contents of the schema records by id.
    pub fn schemas(&self) -> &BTreeMap<u16, Vec<u8>> {
        &self.schemas
    }

    /// Writes a record unchanged. In a chunked file, messages, schemas and channels go into a new chunk, which
    /// [`CopyWriter::flush_if_full`] writes.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn record(&mut self, opcode: u8, body: &[u8]) -> Result<()> {
        if self.chunked && matches!(opcode, op::MESSAGE | op::SCHEMA | op::CHANNEL) {
            let OpenChunk { records, skeleton } = &mut self.open;
            skeleton.add(opcode, body, records.len() as u64);
            put_record(records, opcode, body);
            return Ok(());
        }
        match (opcode, body.first_chunk(), log_time(body)) {
            (op::MESSAGE, Some(id), Some(time)) => self.count(u16::from_le_bytes(*id), time),
            (op::METADATA, ..) => {
                if let Some(Parsed::Metadata(metadata)) = parse(opcode, body) {
                    self.metadata.push((self.at, PREFIX + body.len() as u64, metadata.name));
                }
            }
            (op::SCHEMA | op::CHANNEL, ..) => self.define(opcode, body.to_vec()),
            _ => {}
        }
        self.plain(opcode, body)
    }

    /// Writes a chunk's record unchanged, and its message indexes from `skeleton`.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn chunk(&mut self, body: &[u8], skeleton: ChunkOutline) -> Result<()> {
        let ChunkOutline { definitions, index } = skeleton;
        definitions.into_iter().for_each(|(opcode, body)| self.define(opcode, body));
        for (channel, entries) in &index {
            entries.iter().for_each(|(time, _)| self.count(*channel, *time));
        }
        let offset = self.at;
        self.plain(op::CHUNK, body)?;
        let (length, index_start) = (self.at - offset, self.at);
        let mut index_offsets = BTreeMap::new();
        for (channel, mut entries) in index {
            entries.sort_unstable();
            index_offsets.insert(channel, self.at);
            let mut body = channel.to_le_bytes().to_vec();
            body.extend_from_slice(&(16 * entries.len() as u32).to_le_bytes());
            for (time, offset) in entries {
                body.extend_from_slice(&time.to_le_bytes());
                body.extend_from_slice(&offset.to_le_bytes());
            }
            self.plain(op::MESSAGE_INDEX, &body)?;
        }
        if let Some((header, _)) = chunk_header(body) {
            self.chunks.push(ChunkEntry {
                times: (header.message_start_time, header.message_end_time),
                offset,
                length,
                index_offsets,
                index_length: self.at - index_start,
                compression: header.compression,
                compressed: header.compressed_size,
                uncompressed: header.uncompressed_size,
            });
        }
        Ok(())
    }

    /// Copies an attachment of the file `original`; false = its checksum is wrong and it was left out.
    ///
    /// # Errors
    /// If a file can't be read or written.
    pub fn attachment(&mut self, original: &Records, record: &Record) -> Result<bool> {
        let (start, file, from) = (record.offset + PREFIX, original.file(), original.path());
        let Some(index) = attachment_index(file, record, self.at).map_err(Error::io(from))? else {
            return Ok(false);
        };
        let mut prefix = vec![record.opcode];
        prefix.extend_from_slice(&record.length.to_le_bytes());
        self.write(&prefix)?;
        let mut buffer = vec![0; COPY];
        let mut done = 0;
        while done < record.length {
            let length = (record.length - done).min(COPY as u64) as usize;
            file.read_exact_at(&mut buffer[..length], start + done).map_err(Error::io(from))?;
            self.write(&buffer[..length])?;
            done += length as u64;
        }
        self.attachments.push(index);
        Ok(true)
    }

    /// Writes the summary and closes the file.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn finish(&mut self) -> Result<()> {
        self.end_chunk()?;
        self.write_packed()?;
        let crc = std::mem::take(&mut self.crc).finalize();
        self.plain(op::DATA_END, &crc.to_le_bytes())?;
        self.crc = Hasher::new();
        let summary_start = self.at;
        let mut groups = Vec::new();
        for (opcode, bodies) in self.summary() {
            let start = self.at;
            for body in &bodies {
                self.plain(opcode, body)?;
            }
            if self.at > start {
                groups.push((opcode, start, self.at - start));
            }
        }
        let offsets_start = self.at;
        for (opcode, start, length) in groups {
            let body: Vec<u8> = [&[opcode][..], &start.to_le_bytes(), &length.to_le_bytes()].concat();
            self.plain(op::SUMMARY_OFFSET, &body)?;
        }
        let mut footer = [summary_start.to_le_bytes(), offsets_start.to_le_bytes()].concat();
        self.write(&[op::FOOTER])?;
        self.write(&20u64.to_le_bytes())?;
        self.write(&footer)?;
        footer.clear();
        let crc = std::mem::take(&mut self.crc).finalize();
        self.write(&crc.to_le_bytes())?;
        self.write(MAGIC)?;
        self.out.flush().map_err(Error::io(&self.path))
    }

    /// Returns the records of the summary in the order of the specification.
    fn summary(&self) -> Vec<(u8, Vec<Vec<u8>>)> {
        let (start, end) = self.times.unwrap_or((0, 0));
        let mut statistics = Vec::new();
        statistics.extend_from_slice(&self.counts.values().sum::<u64>().to_le_bytes());
        statistics.extend_from_slice(&(self.schemas.len() as u16).to_le_bytes());
        statistics.extend_from_slice(&(self.channels.len() as u32).to_le_bytes());
        statistics.extend_from_slice(&(self.attachments.len() as u32).to_le_bytes());
        statistics.extend_from_slice(&(self.metadata.len() as u32).to_le_bytes());
        statistics.extend_from_slice(&(self.chunks.len() as u32).to_le_bytes());
        statistics.extend_from_slice(&start.to_le_bytes());
        statistics.extend_from_slice(&end.to_le_bytes());
        put_map(&mut statistics, &self.counts);
        let chunk = |chunk: &ChunkEntry| {
            let mut body = Vec::new();
            for number in [chunk.times.0, chunk.times.1, chunk.offset, chunk.length] {
                body.extend_from_slice(&number.to_le_bytes());
            }
            put_map(&mut body, &chunk.index_offsets);
            body.extend_from_slice(&chunk.index_length.to_le_bytes());
            put_text(&mut body, &chunk.compression);
            body.extend_from_slice(&chunk.compressed.to_le_bytes());
            body.extend_from_slice(&chunk.uncompressed.to_le_bytes());
            body
        };
        let attachment = |index: &AttachmentIndex| {
            let mut body = Vec::new();
            let AttachmentIndex { offset, length, log_time, create_time, data_size, name, media_type } = index;
            for number in [offset, length, log_time, create_time, data_size] {
                body.extend_from_slice(&number.to_le_bytes());
            }
            put_text(&mut body, name);
            put_text(&mut body, media_type);
            body
        };
        let metadata = |(offset, length, name): &(u64, u64, String)| {
            let mut body = [offset.to_le_bytes(), length.to_le_bytes()].concat();
            put_text(&mut body, name);
            body
        };
        vec![
            (op::SCHEMA, self.schemas.values().cloned().collect()),
            (op::CHANNEL, self.channels.values().cloned().collect()),
            (op::STATISTICS, vec![statistics]),
            (op::CHUNK_INDEX, self.chunks.iter().map(chunk).collect()),
            (op::ATTACHMENT_INDEX, self.attachments.iter().map(attachment).collect()),
            (op::METADATA_INDEX, self.metadata.iter().map(metadata).collect()),
        ]
    }

    /// Records a schema or channel for the summary.
    fn define(&mut self, opcode: u8, body: Vec<u8>) {
        let Some(id) = body.first_chunk().map(|id| u16::from_le_bytes(*id)) else { return };
        let there = if opcode == op::SCHEMA { &mut self.schemas } else { &mut self.channels };
        there.insert(id, body);
    }

    /// Counts a message for the summary.
    fn count(&mut self, channel: u16, time: u64) {
        *self.counts.entry(channel).or_default() += 1;
        let (start, end) = self.times.unwrap_or((time, time));
        self.times = Some((start.min(time), end.max(time)));
    }

    /// Starts to compress the open chunk, and writes the previous one.
    fn end_chunk(&mut self) -> Result<()> {
        self.write_packed()?;
        let chunk = std::mem::take(&mut self.open);
        if !chunk.records.is_empty() {
            self.packing = Some(std::thread::spawn(|| chunk.pack()));
        }
        Ok(())
    }

    /// Waits for the chunk that is being compressed, and writes it with its indexes.
    fn write_packed(&mut self) -> Result<()> {
        let Some(packing) = self.packing.take() else { return Ok(()) };
        let died = |_| Err(std::io::Error::other("the thread that compresses new messages died"));
        let (body, skeleton) = packing.join().unwrap_or_else(died).map_err(Error::io(&self.path))?;
        self.chunk(&body, skeleton)
    }

    /// Ends the open chunk if it is full.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn flush_if_full(&mut self) -> Result<()> {
        match self.open.records.len() >= CHUNK {
            true => self.end_chunk(),
            false => Ok(()),
        }
    }

    fn plain(&mut self, opcode: u8, body: &[u8]) -> Result<()> {
        let mut prefix = vec![opcode];
        prefix.extend_from_slice(&(body.len() as u64).to_le_bytes());
        self.write(&prefix)?;
        self.write(body)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.crc.update(bytes);
        self.at += bytes.len() as u64;
        self.out.write_all(bytes).map_err(Error::io(&self.path))
    }
}

impl std::fmt::Debug for CopyWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CopyWriter").field("path", &self.path).field("at", &self.at).finish_non_exhaustive()
    }
}

fn put_record(out: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    out.push(opcode);
    out.extend_from_slice(&(body.len() as u64).to_le_bytes());
    out.extend_from_slice(body);
}

/// Appends a string in the form of MCAP: length, then bytes.
pub(crate) fn put_text(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(&(text.len() as u32).to_le_bytes());
    out.extend_from_slice(text.as_bytes());
}

fn put_map(out: &mut Vec<u8>, map: &BTreeMap<u16, u64>) {
    out.extend_from_slice(&(10 * map.len() as u32).to_le_bytes());
    for (key, value) in map {
        out.extend_from_slice(&key.to_le_bytes());
        out.extend_from_slice(&value.to_le_bytes());
    }
}
