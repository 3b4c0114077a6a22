//! Zip archives with damaged or lying headers.

use std::io::{Cursor, Write};

use rand::Rng as _;
use zip::CompressionMethod;
use zip::write::{SimpleFileOptions, ZipWriter};

use super::{Rng, below, chance, extreme, pick};

/// Packs named members, stored or deflated, and rarely changes a field of a header.
pub fn zip(rng: &mut Rng, members: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        let method = if chance(rng, 0.2) { CompressionMethod::Deflated } else { CompressionMethod::Stored };
        let options = SimpleFileOptions::default().compression_method(method);
        // A name that stands twice is refused: the archive then has one of them.
        if writer.start_file(name.as_str(), options).is_ok() {
            let _ = writer.write_all(bytes);
        }
    }
    let mut bytes = writer.finish().map(Cursor::into_inner).unwrap_or_default();
    if chance(rng, 0.3) {
        change_header(rng, &mut bytes);
    }
    bytes
}

/// Writes an extreme number into a header: local (3, 4), central (1, 2) or the end record (5, 6).
fn change_header(rng: &mut Rng, bytes: &mut [u8]) {
    let kind = *pick(rng, &[[1u8, 2], [3, 4], [5, 6]]);
    let magic = [b'P', b'K', kind[0], kind[1]];
    let places: Vec<usize> = bytes.windows(4).enumerate().filter(|(_, w)| *w == magic).map(|(at, _)| at).collect();
    if places.is_empty() {
        return;
    }
    let at = pick(rng, &places) + 4 + 2 * below(rng, 21);
    let value = extreme(rng).to_le_bytes();
    let width = if rng.random_bool(0.5) { 4 } else { 2 };
    for (to, from) in bytes.iter_mut().skip(at).zip(&value[..width]) {
        *to = *from;
    }
}
