//! Compressed data that expand to far more than their size.

use std::io::Write;
use std::sync::OnceLock;

use flate2::Compression;
use flate2::write::{DeflateEncoder, GzEncoder};

/// Zeros in one member of a gzip bomb, bytes.
const MEMBER: usize = 16 << 20;
/// Largest block of zstd, bytes.
const BLOCK: usize = 128 << 10;

/// Returns a zstd frame that holds `size` zeros, in blocks of one repeated byte; `told` is the size in its header.
pub fn zstd(size: usize, told: Option<u64>) -> Vec<u8> {
    let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd];
    match told {
        // Eight bytes of content size, window descriptor of 128 KiB.
        Some(told) => {
            frame.extend([0xc0, 0x38]);
            frame.extend(told.to_le_bytes());
        }
        None => frame.extend([0x00, 0x38]),
    }
    let blocks = size.div_ceil(BLOCK).max(1);
    for block in 0..blocks {
        let length = (size - (block * BLOCK).min(size)).min(BLOCK);
        let header = (length << 3) | (1 << 1) | usize::from(block + 1 == blocks);
        frame.extend(&header.to_le_bytes()[..3]);
        frame.push(0);
    }
    frame
}

/// Returns gzip members that hold about `size` zeros.
pub fn gzip(size: usize) -> Vec<u8> {
    static ONE: OnceLock<Vec<u8>> = OnceLock::new();
    let one = ONE.get_or_init(|| {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        // Writing to a Vec cannot fail.
        let _ = encoder.write_all(&vec![0; MEMBER]);
        encoder.finish().unwrap_or_default()
    });
    one.repeat(size.div_ceil(MEMBER))
}

/// Returns deflated zeros.
pub fn deflate(size: usize) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
    let zeros = vec![0; 1 << 20];
    for _ in 0..size >> 20 {
        let _ = encoder.write_all(&zeros);
    }
    encoder.finish().unwrap_or_default()
}

/// Returns an lz4 frame of `size` zeros: one literal, then matches of distance 1, in blocks of 4 MB.
pub fn lz4(size: usize) -> Vec<u8> {
    // Magic, version 1 with independent blocks and no checksums, block size 4 MB, and the header's checksum byte.
    let mut frame = vec![0x04, 0x22, 0x4d, 0x18, 0x60, 0x70, 0x73];
    let block = 4 << 20;
    for _ in 0..size.div_ceil(block) {
        let mut content = vec![0x1f, 0, 1, 0];
        let rest = block - 1 - 19 - 5;
        content.extend(vec![255; rest / 255]);
        content.push((rest % 255) as u8);
        // The last five bytes are literals.
        content.extend([0x50, 0, 0, 0, 0, 0]);
        frame.extend((content.len() as u32).to_le_bytes());
        frame.extend(content);
    }
    frame.extend([0; 4]);
    frame
}
