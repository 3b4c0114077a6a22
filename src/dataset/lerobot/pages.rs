//! Sizes of the pages of a Parquet file, checked before the library allocates them.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

use parquet::file::metadata::ParquetMetaData;

use crate::error::{Error, Result};
use crate::file::limits;

/// Sizes of the reads of a page's header, bytes: that of most headers, then that of one with long statistics.
const HEADER: [u64; 2] = [1 << 12, 1 << 22];
/// Largest ratio of decompressed to compressed size at which a page may exceed its limit: images hardly shrink.
const RATIO: u64 = 4;
/// Largest depth of structures in a page's header.
const DEPTH: usize = 8;

/// Checks all pages of the file at `path`, which `file` is, and returns the size of the largest, bytes.
///
/// # Errors
/// If a place or size is negative or outside of the file, or a page is larger than [`limits::PAGE`], and holds a single cell or
/// its compressed bytes do not account for that.
pub(super) fn check(path: &Path, file: &File, metadata: &ParquetMetaData) -> Result<u64> {
    let invalid = |what: &str| Error::file(path, format!("expected an intact Parquet file, got {what}"));
    let size = file.metadata().map_err(Error::io(path))?.len();
    let rows = u64::try_from(metadata.file_metadata().num_rows()).map_err(|_| invalid("a negative number of rows"))?;
    limits::FRAMES.check(path, "rows", rows)?;
    let mut largest = 0;
    for group in metadata.row_groups() {
        u64::try_from(group.num_rows()).map_err(|_| invalid("a negative number of rows"))?;
        for column in group.columns() {
            let start = column.dictionary_page_offset().unwrap_or(column.data_page_offset());
            let (Ok(start), Ok(length)) = (u64::try_from(start), u64::try_from(column.compressed_size())) else {
                return Err(invalid("a negative offset of a column"));
            };
            let end = start.checked_add(length).filter(|end| *end <= size);
            let end = end.ok_or_else(|| invalid("a column that ends outside of the file"))?;
            let mut at = start;
            while at < end {
                let page = page(file, at, end).map_err(Error::io(path))?;
                let page = page.ok_or_else(|| invalid(&format!("no page header at byte {at}")))?;
                if page.values <= 1 || page.decompressed > RATIO.saturating_mul(page.compressed) {
                    limits::PAGE.check(path, &format!("the page at byte {at}"), page.decompressed)?;
                }
                largest = largest.max(page.decompressed);
                at = at.saturating_add(page.header).saturating_add(page.compressed);
            }
        }
    }
    Ok(largest)
}

/// Sizes of a page, bytes, and its number of values.
struct Page {
    values: u64,
    header: u64,
    compressed: u64,
    decompressed: u64,
}

/// Reads the header of the page at `at`; None if there is none.
fn page(file: &File, at: u64, end: u64) -> std::io::Result<Option<Page>> {
    for length in HEADER {
        let mut bytes = vec![0; length.min(end - at) as usize];
        file.read_exact_at(&mut bytes, at)?;
        if let Some(page) = (Thrift { bytes: &bytes, at: 0 }).page() {
            return Ok(Some(page));
        }
    }
    Ok(None)
}

/// Reader of the compact protocol of Thrift.
struct Thrift<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Thrift<'_> {
    fn page(&mut self) -> Option<Page> {
        let (mut field, mut sizes, mut values) = (0, [None; 2], 0);
        loop {
            let head = self.byte()?;
            if head == 0 {
                let [decompressed, compressed] = sizes;
                let header = self.at as u64;
                return Some(Page { values, header, compressed: compressed?, decompressed: decompressed? });
            }
            field = self.field(field, head)?;
            match (field, head & 0x0f) {
                (2 | 3, 5) => sizes[field as usize - 2] = Some(u64::try_from(self.zigzag()?).ok()?),
                // Headers of a data page, a dictionary, and a data page of version 2.
                (5 | 7 | 8, 12) => values = self.values()?,
                (_, kind) => self.skip(kind, DEPTH)?,
            }
        }
    }

    /// Reads the header of one kind of page; returns its number of values.
    fn values(&mut self) -> Option<u64> {
        let (mut field, mut values) = (0, 0);
        loop {
            let head = self.byte()?;
            if head == 0 {
                return Some(values);
            }
            field = self.field(field, head)?;
            match (field, head & 0x0f) {
                (1, 5) => values = u64::try_from(self.zigzag()?).ok()?,
                (_, kind) => self.skip(kind, DEPTH)?,
            }
        }
    }

    /// Returns the number of the field that begins with `head`, after field `before`.
    fn field(&mut self, before: i64, head: u8) -> Option<i64> {
        match head >> 4 {
            0 => self.zigzag(),
            step => before.checked_add(i64::from(step)),
        }
    }

    fn skip(&mut self, kind: u8, depth: usize) -> Option<()> {
        match kind {
            1 | 2 => {}
            3 => self.pass(1)?,
            4..=6 => drop(self.varint()?),
            7 => self.pass(8)?,
            8 => {
                let length = self.varint()?;
                self.pass(length)?;
            }
            9 | 10 => {
                let head = self.byte()?;
                let count = if head >> 4 == 15 { self.varint()? } else { u64::from(head >> 4) };
                for _ in 0..count {
                    // A truth value of a list takes a byte.
                    self.skip(if head & 0x0f <= 2 { 3 } else { head & 0x0f }, depth.checked_sub(1)?)?;
                }
            }
            12 => {
                let mut field = 0;
                loop {
                    let head = self.byte()?;
                    if head == 0 {
                        break;
                    }
                    field = self.field(field, head)?;
                    self.skip(head & 0x0f, depth.checked_sub(1)?)?;
                }
            }
            _ => return None,
        }
        Some(())
    }

    fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    fn pass(&mut self, length: u64) -> Option<()> {
        self.at = self.at.checked_add(usize::try_from(length).ok()?).filter(|at| *at <= self.bytes.len())?;
        Some(())
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn zigzag(&mut self) -> Option<i64> {
        let value = self.varint()?;
        Some((value >> 1) as i64 ^ -((value & 1) as i64))
    }
}
