//! Raw image messages, PNG and JPEG files.

use std::io::Cursor;
use std::path::Path;

use egotac::image::{ENCODINGS, Filter, RawImage, Resize};
use egotac::message::{self, Header, Message};
use egotac::{Error, Result};
use image::{ImageFormat, RgbImage};

use super::seed;
use crate::case::Case;
use crate::mutate::{self, Rng, below, bytes, chance, extreme, often, pick};

/// Makes an image message whose numbers may contradict each other.
pub fn raw(rng: &mut Rng) -> Case {
    let (width, height) = (*pick(rng, &[1, 2, 7, 8, 64]), *pick(rng, &[1, 2, 5, 8, 64]));
    let pixel = *pick(rng, &[1, 2, 3, 4]);
    let padding = *pick(rng, &[0, 0, 0, 3]);
    let step = often(rng, width * pixel + padding);
    let data = (often(rng, width * pixel).unsigned_abs().min(1 << 12) * height as u64) as usize;
    let image = message::Image {
        header: Header::default(),
        height: often(rng, height) as u32,
        width: often(rng, width) as u32,
        encoding: pick(rng, &[&ENCODINGS[..], &["bayer_rggb8", "16UC1", ""]].concat()).to_string(),
        is_bigendian: 0,
        step: step as u32,
        data: vec![128; if chance(rng, 0.3) { data * 3 / 2 } else { data }],
    };
    Case::File(image.to_cdr())
}

/// Reads an image message and prepares it for the network.
pub fn read_raw(path: &Path, _scratch: &Path) -> Result<()> {
    let payload = std::fs::read(path).map_err(Error::io(path))?;
    decode(&message::Image::from_cdr(&payload)?)
}

/// Converts an image message and prepares it for the network.
pub fn decode(image: &message::Image) -> Result<()> {
    let message::Image { height, width, encoding, step, data, .. } = image;
    prepare(&RawImage { width: *width, height: *height, encoding, step: *step, data }.to_rgb()?)
}

/// Reads a PNG or JPEG file and prepares it for the network.
pub fn read_file(path: &Path, _scratch: &Path) -> Result<()> {
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    prepare(&egotac::image::decode(&bytes)?)
}

fn prepare(image: &RgbImage) -> Result<()> {
    for resize in [Resize::Crop, Resize::Centre, Resize::Letterbox, Resize::Squash] {
        egotac::image::resize(image, 56, resize, Filter::Triangle)?;
    }
    Ok(())
}

/// Changes fields of a PNG or JPEG file.
pub fn file(rng: &mut Rng) -> Case {
    if chance(rng, 0.4) {
        let mut jpeg = seed("tests/data/ros/photo.jpg");
        for _ in 0..1 + below(rng, 3) {
            jpeg_field(rng, &mut jpeg);
        }
        return Case::File(jpeg);
    }
    let mut png = Cursor::new(Vec::new());
    let picture = RgbImage::from_fn(9, 7, |x, y| image::Rgb([x as u8 * 20, y as u8 * 30, 7]));
    // Writing to memory cannot fail.
    let _ = picture.write_to(&mut png, ImageFormat::Png);
    Case::File(png_chunks(rng, &png.into_inner()))
}

/// Writes an extreme number behind a marker, or changes bytes anywhere.
fn jpeg_field(rng: &mut Rng, jpeg: &mut Vec<u8>) {
    let markers: Vec<usize> =
        (0..jpeg.len().saturating_sub(12)).filter(|at| jpeg[*at] == 0xff && jpeg[at + 1] > 0xbf).collect();
    if markers.is_empty() || chance(rng, 0.2) {
        return bytes::change(rng, jpeg);
    }
    let at = pick(rng, &markers) + *pick(rng, &[1, 2, 4, 5, 7, 9, 10, 11]);
    let value = (extreme(rng) as u16).to_be_bytes();
    jpeg[at] = value[0];
    jpeg[at + 1] = value[1];
}

/// Changes chunks of a PNG file and makes their checksums right again.
fn png_chunks(rng: &mut Rng, png: &[u8]) -> Vec<u8> {
    let (magic, mut rest) = png.split_at(8);
    let mut chunks = Vec::new();
    while rest.len() >= 12 {
        let length = u32::from_be_bytes([rest[0], rest[1], rest[2], rest[3]]) as usize;
        chunks.push(rest[4..8 + length].to_vec());
        rest = &rest[12 + length..];
    }
    for _ in 0..1 + below(rng, 3) {
        let at = below(rng, chunks.len());
        match below(rng, 6) {
            0 => chunks.swap(at, 0),
            1 => {
                let copy = chunks[at].clone();
                chunks.splice(at..at, vec![copy; mutate::times(rng).min(10_000)]);
            }
            2 => {
                let name = *pick(rng, &[b"iCCP", b"zTXt", b"iTXt", b"PLTE", b"tRNS", b"acTL", b"eXIf"]);
                let mut chunk = name.to_vec();
                chunk.extend(b"a\0\0");
                chunk.extend(mutate::bomb::deflate(*pick(rng, &[0, 1 << 20, 1 << 25])));
                chunks.insert(at, chunk);
            }
            3 => {
                let field = 4 + below(rng, 2) * 4;
                let value = (extreme(rng) as u32).to_be_bytes();
                for (to, from) in chunks[0].iter_mut().skip(field).zip(value) {
                    *to = from;
                }
            }
            _ => bytes::change(rng, &mut chunks[at]),
        }
    }
    let mut file = magic.to_vec();
    for chunk in chunks {
        file.extend((often(rng, chunk.len() as i64 - 4) as u32).to_be_bytes());
        file.extend(&chunk);
        file.extend(crc32fast::hash(&chunk).to_be_bytes());
    }
    file
}
