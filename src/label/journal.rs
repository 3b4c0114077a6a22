//! Journal of one unit: an append-only file of labels that survives a killed process.
//!
//! A block holds, in this order: its length (u64), the CRC-32 of all that follows (u32), the length of its head (u32), the
//! head in JSON, and the compressed labels (1556 forces, 1556 contacts, 4 numbers of certainty and further numbers per labelled image,
//! little-endian f32). A block that a killed process left incomplete fails the length or checksum test; it ends the journal, and the next process
//! truncates the file there. Heads hold everything but the fields: counts, faults and the source's notes, so that summaries
//! and copies need no decompression.

use std::fs::{File, OpenOptions};
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::dataset::{LabelCounts, LabelFrame};
use crate::error::{Error, Result};
use crate::file::turn::turn;
use crate::file::{self, input};
use crate::hand::Topology;
use crate::tactile::{Certainty, N_FIELD, TactileField};

/// Size of a block before its head, bytes.
const PREFIX: usize = 16;
/// Upper limit of a block's length, bytes: a larger one is damage, and must not be allocated.
const LARGEST: u64 = 1 << 30;
/// Number of values of an image before the further ones.
const OWN_VALUES: usize = 2 * N_FIELD + Certainty::VALUES;
/// Level of zstd: the fastest, since the network waits for it.
const LEVEL: i32 = 1;

/// Progress of a unit.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Progress {
    /// Number of images with a label, or with a reason for none.
    pub frames: usize,
    /// Indices of the earlier images that the window of the next one needs.
    pub kept: Vec<usize>,
    /// True if the unit's last image is among them.
    pub complete: bool,
}

impl Progress {
    /// Reads the progress from the journal at `path`, which another process may be writing.
    ///
    /// # Errors
    /// If the file can't be read.
    pub fn read(path: &Path) -> Result<Self> {
        let file = input::open(path)?;
        Ok(Self::scan(&file).map_err(Error::io(path))?.0)
    }

    /// Returns the progress and the end of the last valid block, bytes.
    fn scan(file: &File) -> std::io::Result<(Self, u64)> {
        let (mut progress, mut end) = (Self::default(), 0);
        let mut reader = BufReader::with_capacity(1 << 20, file);
        while let Some((head, _, size)) = next_block(&mut reader)? {
            // A gap can only come from damage.
            if head.first != progress.frames {
                break;
            }
            progress = Self { frames: head.first + head.stamps.len(), kept: head.kept, complete: head.last };
            end += size;
        }
        Ok((progress, end))
    }
}

/// Head of a block: everything about its images but the fields.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct BlockHead {
    /// Index of the first image.
    pub first: usize,
    /// Reasons of images without a label, by index in this block.
    pub faults: Vec<(usize, String)>,
    /// Notes of the source in order.
    pub notes: Vec<String>,
    /// Counts of the block's labels.
    pub counts: LabelCounts,
    /// Bits of the stamps, s: exact also for NaN, which JSON has not.
    stamps: Vec<u64>,
    warming_up: Vec<bool>,
    kept: Vec<usize>,
    last: bool,
    /// Number of further numbers of each labelled image.
    #[serde(default)]
    further: usize,
}

/// Writer of one unit's labels; a file lock keeps other processes out.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    progress: Progress,
    head: BlockHead,
    fields: Vec<u8>,
}

impl Journal {
    /// Opens or creates the journal at `path` and cuts an incomplete block; None = another process holds it.
    ///
    /// # Errors
    /// If the file can't be read or written.
    pub fn open(path: &Path) -> Result<Option<Self>> {
        let io = || Error::io(path);
        turn();
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(io())?;
        if !file::lock(&file) {
            return Ok(None);
        }
        let (progress, end) = Progress::scan(&file).map_err(io())?;
        file.set_len(end).map_err(io())?;
        file.seek(SeekFrom::Start(end)).map_err(io())?;
        let head = BlockHead { first: progress.frames, ..Default::default() };
        Ok(Some(Self { path: path.to_path_buf(), file, progress, head, fields: Vec::new() }))
    }

    /// Returns the progress on disk.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Returns the number of labels that are not on disk yet.
    pub fn pending(&self) -> usize {
        self.head.stamps.len()
    }

    /// Adds the label of the next image and the source's note to the present block.
    pub fn push(&mut self, label: &LabelFrame, note: Option<String>) {
        let place = self.head.stamps.len();
        self.head.counts.count(label);
        self.head.notes.extend(note);
        self.head.stamps.push(label.stamp_secs.to_bits());
        self.head.warming_up.push(label.warming_up);
        match &label.touch {
            Ok(field) => {
                debug_assert!(self.head.further == 0 || self.head.further == label.further.len());
                self.head.further = label.further.len();
                let certainty = label.certainty.to_values();
                let values = field.force.iter().chain(&field.contact).chain(&certainty).chain(&label.further);
                self.fields.extend(values.flat_map(|value| value.to_le_bytes()));
            }
            Err(reason) => self.head.faults.push((place, reason.clone())),
        }
    }

    /// Writes the present block. `kept` are the earlier images that the window of the next one needs; `last` = the unit is
    /// complete.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn flush(&mut self, kept: Vec<usize>, last: bool) -> Result<()> {
        let frames = self.head.first + self.head.stamps.len();
        let mut head = std::mem::take(&mut self.head);
        (head.kept, head.last) = (kept, last);
        let json = serde_json::to_vec(&head).map_err(|e| Error::file(&self.path, e))?;
        let fields = zstd::bulk::compress(&self.fields, LEVEL).map_err(Error::io(&self.path))?;
        let mut block = vec![0; PREFIX];
        block.extend_from_slice(&json);
        block.extend_from_slice(&fields);
        block[12..16].copy_from_slice(&(json.len() as u32).to_le_bytes());
        let crc = crc32fast::hash(&block[12..]);
        let size = block.len() as u64;
        block[..8].copy_from_slice(&size.to_le_bytes());
        block[8..12].copy_from_slice(&crc.to_le_bytes());
        turn();
        self.file.write_all(&block).map_err(Error::io(&self.path))?;
        self.fields.clear();
        self.progress = Progress { frames, kept: head.kept, complete: last };
        self.head.first = frames;
        Ok(())
    }
}

/// Reader of one complete unit's labels in order.
#[derive(Debug)]
pub struct JournalLabels {
    path: PathBuf,
    reader: BufReader<File>,
    topology: Topology,
    waiting: std::vec::IntoIter<LabelFrame>,
}

impl JournalLabels {
    /// Opens the journal at `path`.
    ///
    /// # Errors
    /// If it can't be read.
    pub fn open(path: &Path, topology: Topology) -> Result<Self> {
        let file = input::open(path)?;
        let reader = BufReader::with_capacity(1 << 20, file);
        Ok(Self { path: path.to_path_buf(), reader, topology, waiting: Vec::new().into_iter() })
    }

    fn block(&mut self) -> Result<Option<Vec<LabelFrame>>> {
        let Some((head, fields, _)) = next_block(&mut self.reader).map_err(Error::io(&self.path))? else {
            return Ok(None);
        };
        let labelled = head.stamps.len() - head.faults.len().min(head.stamps.len());
        let damaged = || Error::file(&self.path, format!("{} further numbers per label", head.further));
        let frame =
            head.further.checked_mul(4).and_then(|size| size.checked_add(OWN_VALUES * 4)).ok_or_else(damaged)?;
        if frame.checked_mul(labelled).is_none_or(|size| size as u64 > LARGEST) {
            return Err(damaged());
        }
        let fields = zstd::bulk::decompress(&fields, labelled * frame).map_err(Error::io(&self.path))?;
        if fields.len() != labelled * frame {
            return Err(Error::file(&self.path, format!("expected {labelled} labels in a block")));
        }
        let mut values = fields.chunks_exact(frame);
        let mut faults = head.faults.into_iter().peekable();
        let mut labels = Vec::with_capacity(head.stamps.len());
        for (place, (stamp, warming_up)) in head.stamps.into_iter().zip(head.warming_up).enumerate() {
            let stamp_secs = f64::from_bits(stamp);
            labels.push(match faults.next_if(|(at, _)| *at == place) {
                Some((_, reason)) => LabelFrame { warming_up, ..LabelFrame::without(stamp_secs, reason) },
                None => {
                    let values = values.next().unwrap_or_default();
                    let (field, certainty, further) = field(values, self.topology).ok_or_else(damaged)?;
                    LabelFrame { stamp_secs, warming_up, touch: Ok(field), certainty, further }
                }
            });
        }
        Ok(Some(labels))
    }
}

impl Iterator for JournalLabels {
    type Item = Result<LabelFrame>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(label) = self.waiting.next() {
                return Some(Ok(label));
            }
            match self.block() {
                Ok(Some(labels)) => self.waiting = labels.into_iter(),
                Ok(None) => return None,
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// Reader of one unit's block heads in order; decompresses no fields.
#[derive(Debug)]
pub struct JournalHeads {
    path: PathBuf,
    reader: BufReader<File>,
}

impl JournalHeads {
    /// Opens the journal at `path`.
    ///
    /// # Errors
    /// If it can't be read.
    pub fn open(path: &Path) -> Result<Self> {
        let file = input::open(path)?;
        Ok(Self { path: path.to_path_buf(), reader: BufReader::with_capacity(1 << 20, file) })
    }
}

impl Iterator for JournalHeads {
    type Item = Result<BlockHead>;

    fn next(&mut self) -> Option<Self::Item> {
        let block = next_block(&mut self.reader).map_err(Error::io(&self.path)).transpose()?;
        Some(block.map(|(head, ..)| head))
    }
}

/// Decodes the field of one image, its certainty and its further numbers; None if they are damaged.
fn field(bytes: &[u8], topology: Topology) -> Option<(TactileField, Certainty, Vec<f32>)> {
    let mut force: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let mut contact = force.split_off(N_FIELD.min(force.len()));
    let mut certainty = contact.split_off(N_FIELD.min(contact.len()));
    let further = certainty.split_off(Certainty::VALUES.min(certainty.len()));
    Some((TactileField { topology, force, contact }, Certainty::from_values(&certainty)?, further))
}

/// Reads the next valid block: head, compressed fields, size in bytes. None at the end, or where damage begins.
fn next_block(reader: &mut impl Read) -> std::io::Result<Option<(BlockHead, Vec<u8>, u64)>> {
    let mut prefix = [0; PREFIX];
    if !fill(reader, &mut prefix)? {
        return Ok(None);
    }
    let [size_low, size_high, crc, head_len] =
        [0, 4, 8, 12].map(|at| u32::from_le_bytes([prefix[at], prefix[at + 1], prefix[at + 2], prefix[at + 3]]));
    let size = u64::from(size_low) | u64::from(size_high) << 32;
    if size < PREFIX as u64 || size > LARGEST {
        return Ok(None);
    }
    let mut body = Vec::new();
    let wanted = size - PREFIX as u64;
    if reader.take(wanted).read_to_end(&mut body)? as u64 != wanted {
        return Ok(None);
    }
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&prefix[12..]);
    hasher.update(&body);
    let head_len = head_len as usize;
    if hasher.finalize() != crc || head_len > body.len() {
        return Ok(None);
    }
    let fields = body.split_off(head_len);
    Ok(serde_json::from_slice(&body).ok().map(|head| (head, fields, size)))
}

/// Fills the buffer; false if the file ends before.
fn fill(reader: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<bool> {
    match reader.read_exact(buffer) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(index: usize) -> LabelFrame {
        if index % 5 == 3 {
            return LabelFrame::without(f64::NAN, format!("frame {index}: cut off"));
        }
        let mut field = TactileField::zeros(Topology::EgotacHand1);
        field.force[index] = 0.1 * index as f32;
        field.contact[N_FIELD - 1 - index] = 0.25;
        let further = vec![index as f32, -0.5];
        let certainty = Certainty { familiarity: Some(0.1 * index as f32), ..Certainty::default() };
        LabelFrame { stamp_secs: 1.0 / 3.0 + index as f64, warming_up: index < 2, touch: Ok(field), certainty, further }
    }

    fn write(path: &Path, frames: std::ops::Range<usize>) {
        let mut journal = Journal::open(path).unwrap().unwrap();
        assert_eq!(journal.progress().frames, frames.start);
        for index in frames.clone() {
            journal.push(&label(index), (index % 3 == 0).then(|| format!("chunk {index}")));
            if journal.pending() == 4 {
                journal.flush(vec![index - 1, index], false).unwrap();
            }
        }
    }

    fn read(path: &Path) -> Vec<LabelFrame> {
        JournalLabels::open(path, Topology::EgotacHand1).unwrap().map(Result::unwrap).collect()
    }

    #[test]
    fn a_journal_cut_anywhere_resumes_after_its_last_complete_block() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.labels");
        write(&path, 0..10);
        let whole = std::fs::read(&path).unwrap();
        let first = u64::from_le_bytes(whole[..8].try_into().unwrap()) as usize;
        for cut in [0, 7, first - 1, first, first + 1, first + 40, whole.len() - 1, whole.len()] {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let frames = if cut < first { 0 } else { 4 * (1 + usize::from(cut == whole.len())) };
            let journal = Journal::open(&path).unwrap().unwrap();
            assert_eq!(journal.progress().frames, frames, "cut at {cut}");
            assert_eq!(journal.progress().kept, if frames == 0 { vec![] } else { vec![frames - 2, frames - 1] });
            drop(journal);
            write(&path, frames..16);
            let (labels, expected): (Vec<_>, Vec<_>) = (read(&path), (0..16).map(label).collect());
            // NaN is not equal to itself: compare the printed form.
            assert_eq!(format!("{labels:?}"), format!("{expected:?}"), "cut at {cut}");
            let heads: Vec<_> = JournalHeads::open(&path).unwrap().map(Result::unwrap).collect();
            let notes: Vec<_> = heads.iter().flat_map(|head| &head.notes).collect();
            assert_eq!(notes, ["chunk 0", "chunk 3", "chunk 6", "chunk 9", "chunk 12", "chunk 15"], "cut at {cut}");
            let (mut sum, mut counts) = (LabelCounts::default(), LabelCounts::default());
            heads.iter().for_each(|head| sum.add(&head.counts));
            expected.iter().for_each(|label| counts.count(label));
            assert_eq!(sum, counts, "cut at {cut}");
        }
    }

    #[test]
    fn a_flipped_bit_ends_the_journal_before_its_block() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.labels");
        write(&path, 0..8);
        let mut bytes = std::fs::read(&path).unwrap();
        let last = bytes.len() - 3;
        bytes[last] ^= 4;
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(Journal::open(&path).unwrap().unwrap().progress().frames, 4);
    }

    #[test]
    fn a_second_opener_does_not_get_the_journal() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.labels");
        let first = Journal::open(&path).unwrap();
        assert!(first.is_some() && Journal::open(&path).unwrap().is_none());
    }
}
