//! Labels of one unit on disk while the work goes on: appended block by block, read back whole or cut at the last whole block.
//!
//! A block is its length (u64), the CRC-32 of what follows (u32), the length of its head (u32), the head in JSON, and the
//! labels, compressed: 1556 forces and 1556 contacts per labelled frame, little-endian f32. What a killed process left half
//! written ends the file and is cut off when the work goes on. Heads have what can be told without the labels: their
//! numbers, and the source's notes.

use std::fs::{File, OpenOptions};
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::summary::Counts;
use crate::error::{Error, Result};
use crate::file;
use crate::hand::Topology;
use crate::tactile::{N_FIELD, TactileField};

/// Bytes before a block's head.
const PREFIX: usize = 16;
/// More than any block has, bytes: a length beyond it is damage.
const LARGEST: u64 = 1 << 30;
/// Compression: fast, since the network waits for it.
const LEVEL: i32 = 1;

/// What is known about one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Label {
    /// The image's stamp, s.
    pub stamp_secs: f64,
    /// Whether the network's window was not full yet.
    pub warming_up: bool,
    /// Force and contact, or why there are none.
    pub touch: std::result::Result<TactileField, String>,
}

/// Where a unit's work stands.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Progress {
    /// Images that have a label or a reason for none.
    pub frames: usize,
    /// Numbers of the earlier images that the next one's window needs.
    pub kept: Vec<usize>,
    /// Whether the unit's last image is among them.
    pub complete: bool,
}

impl Progress {
    /// Of the journal at `path`, which another process may be writing.
    ///
    /// # Errors
    /// If the file can't be read.
    pub fn read(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path))?;
        Ok(Self::scan(&file).map_err(Error::io(path))?.0)
    }

    /// Also where the last whole block ends.
    fn scan(file: &File) -> std::io::Result<(Self, u64)> {
        let (mut progress, mut end) = (Self::default(), 0);
        let mut reader = BufReader::with_capacity(1 << 20, file);
        while let Some((head, _, size)) = next_block(&mut reader)? {
            if head.first != progress.frames {
                break;
            }
            progress = Self { frames: head.first + head.stamps.len(), kept: head.kept, complete: head.last };
            end += size;
        }
        Ok((progress, end))
    }
}

/// What a block says about its images.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Head {
    /// Number of the first image.
    pub first: usize,
    /// Why images have no label, by place in this block.
    pub faults: Vec<(usize, String)>,
    /// What the source noted, in order.
    pub notes: Vec<String>,
    /// The block's labels in numbers.
    pub counts: Counts,
    /// Bits of the stamps: exact, and any number at all.
    stamps: Vec<u64>,
    warming_up: Vec<bool>,
    kept: Vec<usize>,
    last: bool,
}

/// Appends the labels of one unit; one process at a time.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    progress: Progress,
    head: Head,
    fields: Vec<u8>,
}

impl Journal {
    /// Opens the journal at `path`, new or left by an earlier process; None = another process has it.
    ///
    /// # Errors
    /// If the file can't be read or written.
    pub fn open(path: &Path) -> Result<Option<Self>> {
        let io = || Error::io(path);
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(io())?;
        if !file::lock(&file) {
            return Ok(None);
        }
        let (progress, end) = Progress::scan(&file).map_err(io())?;
        file.set_len(end).map_err(io())?;
        file.seek(SeekFrom::Start(end)).map_err(io())?;
        let head = Head { first: progress.frames, ..Default::default() };
        Ok(Some(Self { path: path.to_path_buf(), file, progress, head, fields: Vec::new() }))
    }

    /// Where the work stands on disk.
    pub fn progress(&self) -> &Progress {
        &self.progress
    }

    /// Labels that are not on disk yet.
    pub fn pending(&self) -> usize {
        self.head.stamps.len()
    }

    /// Takes the label of the next image, and what the source noted beside it.
    pub fn push(&mut self, label: &Label, note: Option<String>) {
        let place = self.head.stamps.len();
        self.head.counts.count(label);
        self.head.notes.extend(note);
        self.head.stamps.push(label.stamp_secs.to_bits());
        self.head.warming_up.push(label.warming_up);
        match &label.touch {
            Ok(field) => {
                let values = field.force.iter().chain(&field.contact);
                self.fields.extend(values.flat_map(|value| value.to_le_bytes()));
            }
            Err(reason) => self.head.faults.push((place, reason.clone())),
        }
    }

    /// Writes what was pushed; `kept` are the earlier images that the next one's window needs.
    ///
    /// # Errors
    /// If the disk is full, for instance.
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
        self.file.write_all(&block).map_err(Error::io(&self.path))?;
        self.fields.clear();
        self.progress = Progress { frames, kept: head.kept, complete: last };
        self.head.first = frames;
        Ok(())
    }
}

/// Reads the labels of one complete unit, in order.
#[derive(Debug)]
pub struct Labels {
    path: PathBuf,
    reader: BufReader<File>,
    topology: Topology,
    waiting: std::vec::IntoIter<Label>,
}

impl Labels {
    /// Opens the journal at `path`.
    ///
    /// # Errors
    /// If it can't be read.
    pub fn open(path: &Path, topology: Topology) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path))?;
        let reader = BufReader::with_capacity(1 << 20, file);
        Ok(Self { path: path.to_path_buf(), reader, topology, waiting: Vec::new().into_iter() })
    }

    fn block(&mut self) -> Result<Option<Vec<Label>>> {
        let Some((head, fields, _)) = next_block(&mut self.reader).map_err(Error::io(&self.path))? else {
            return Ok(None);
        };
        let frame = 2 * N_FIELD * 4;
        let labelled = head.stamps.len() - head.faults.len().min(head.stamps.len());
        let fields = zstd::bulk::decompress(&fields, labelled * frame).map_err(Error::io(&self.path))?;
        if fields.len() != labelled * frame {
            return Err(Error::file(&self.path, format!("expected {labelled} labels in a block")));
        }
        let mut values = fields.chunks_exact(frame);
        let mut faults = head.faults.into_iter().peekable();
        let mut labels = Vec::with_capacity(head.stamps.len());
        for (place, (stamp, warming_up)) in head.stamps.into_iter().zip(head.warming_up).enumerate() {
            let touch = match faults.next_if(|(at, _)| *at == place) {
                Some((_, reason)) => Err(reason),
                None => Ok(field(values.next().unwrap_or_default(), self.topology)),
            };
            labels.push(Label { stamp_secs: f64::from_bits(stamp), warming_up, touch });
        }
        Ok(Some(labels))
    }
}

impl Iterator for Labels {
    type Item = Result<Label>;

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

/// Reads what the blocks of one unit say about their images, in order, and unpacks no label.
#[derive(Debug)]
pub struct Heads {
    path: PathBuf,
    reader: BufReader<File>,
}

impl Heads {
    /// Opens the journal at `path`.
    ///
    /// # Errors
    /// If it can't be read.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(Error::io(path))?;
        Ok(Self { path: path.to_path_buf(), reader: BufReader::with_capacity(1 << 20, file) })
    }
}

impl Iterator for Heads {
    type Item = Result<Head>;

    fn next(&mut self) -> Option<Self::Item> {
        let block = next_block(&mut self.reader).map_err(Error::io(&self.path)).transpose()?;
        Some(block.map(|(head, ..)| head))
    }
}

fn field(bytes: &[u8], topology: Topology) -> TactileField {
    let mut force: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let contact = force.split_off(N_FIELD.min(force.len()));
    TactileField { topology, force, contact }
}

/// The next whole block: head, compressed fields, size in bytes. None at the end, or where damage begins.
fn next_block(reader: &mut impl Read) -> std::io::Result<Option<(Head, Vec<u8>, u64)>> {
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

/// Whether the whole buffer could be filled.
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

    fn label(index: usize) -> Label {
        if index % 5 == 3 {
            return Label { stamp_secs: f64::NAN, warming_up: false, touch: Err(format!("frame {index}: cut off")) };
        }
        let mut field = TactileField::zeros(Topology::EgotacHand1);
        field.force[index] = 0.1 * index as f32;
        field.contact[N_FIELD - 1 - index] = 0.25;
        Label { stamp_secs: 1.0 / 3.0 + index as f64, warming_up: index < 2, touch: Ok(field) }
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

    fn read(path: &Path) -> Vec<Label> {
        Labels::open(path, Topology::EgotacHand1).unwrap().map(Result::unwrap).collect()
    }

    #[test]
    fn what_is_cut_anywhere_goes_on_at_the_last_whole_block() {
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
            // NaN is never equal: compare what is printed.
            assert_eq!(format!("{labels:?}"), format!("{expected:?}"), "cut at {cut}");
            let heads: Vec<_> = Heads::open(&path).unwrap().map(Result::unwrap).collect();
            let notes: Vec<_> = heads.iter().flat_map(|head| &head.notes).collect();
            assert_eq!(notes, ["chunk 0", "chunk 3", "chunk 6", "chunk 9", "chunk 12", "chunk 15"], "cut at {cut}");
            let (mut sum, mut counts) = (Counts::default(), Counts::default());
            heads.iter().for_each(|head| sum.add(&head.counts));
            expected.iter().for_each(|label| counts.count(label));
            assert_eq!(sum, counts, "cut at {cut}");
        }
    }

    #[test]
    fn a_flipped_bit_ends_the_journal_before_it() {
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
    fn a_second_process_does_not_get_the_journal() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.labels");
        let first = Journal::open(&path).unwrap();
        assert!(first.is_some() && Journal::open(&path).unwrap().is_none());
    }
}
