//! Bags: MCAP files with lying records, chunks and summaries.

use egotac::message::{CompressedImage, Header, Image, Message, Time};
use image::RgbImage;

use super::seed;
use crate::case::Case;
use crate::mutate::{Rng, below, bomb, bytes, chance, extreme, often, pick};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// Makes a bag of three images, in which one field may be extreme.
pub fn file(rng: &mut Rng) -> Case {
    let mut records = vec![record(rng, 0x01, [text("ros2"), text("fuzz")].concat())];
    let (schema, channel) = (often(rng, 1) as u16, often(rng, 1) as u16);
    let compressed = chance(rng, 0.4);
    let kind = if compressed { "sensor_msgs/msg/CompressedImage" } else { "sensor_msgs/msg/Image" };
    let mut inner = vec![schema_record(rng, schema, kind), channel_record(rng, channel, schema)];
    for index in 0..3 {
        let payload = payload(rng, compressed, index);
        let id = if chance(rng, 0.05) { extreme(rng) as u16 } else { channel };
        let body =
            [&id.to_le_bytes()[..], &index.to_le_bytes(), &time(rng, index), &time(rng, index), &payload].concat();
        inner.push(record(rng, 0x05, body));
    }
    shuffle(rng, &mut inner);
    match chance(rng, 0.6) {
        true => {
            let start = (MAGIC.len() + records.concat().len()) as u64;
            let content = inner.concat();
            let chunk = chunk_record(rng, &content);
            records.push(chunk.clone());
            records.push(index_record(rng, channel));
            records.push(record(rng, 0x0f, vec![0; 4]));
            let summary = [inner[..2].concat(), chunk_index(rng, start, chunk.len(), content.len(), channel)].concat();
            records.push(if chance(rng, 0.7) { summary } else { Vec::new() });
        }
        false => {
            records.extend(inner);
            records.push(record(rng, 0x0f, vec![0; 4]));
        }
    }
    if chance(rng, 0.3) {
        let body = [&[0; 8][..], &number(rng, 2), &[0; 20], &text("x")].concat();
        let opcode = *pick(rng, &[0x09, 0x0b, 0x0c, 0x0d, 0x80, 0xff]);
        records.push(record(rng, opcode, body));
    }
    shuffle(rng, &mut records);
    let footer = [number(rng, 0), number(rng, 0), vec![0; 4]].concat();
    records.push(record(rng, 0x02, footer));
    let mut file = [MAGIC, &records.concat(), MAGIC].concat();
    if chance(rng, 0.2) {
        bytes::change(rng, &mut file);
    }
    Case::File(file)
}

/// Rarely leaves out, repeats or swaps a record.
fn shuffle(rng: &mut Rng, records: &mut Vec<Vec<u8>>) {
    let at = below(rng, records.len());
    match below(rng, 20) {
        0 => drop(records.remove(at)),
        1 => records.insert(at, records[at].clone()),
        2 => records.swap(0, at),
        _ => {}
    }
}

fn record(rng: &mut Rng, opcode: u8, body: Vec<u8>) -> Vec<u8> {
    let length = if chance(rng, 0.02) { extreme(rng) } else { body.len() as i64 };
    [&[opcode][..], &length.to_le_bytes(), &body].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

fn number(rng: &mut Rng, usual: i64) -> Vec<u8> {
    often(rng, usual).to_le_bytes().to_vec()
}

fn time(rng: &mut Rng, index: u32) -> Vec<u8> {
    number(rng, 1_000_000_000 + 40_000_000 * i64::from(index))
}

fn schema_record(rng: &mut Rng, id: u16, kind: &str) -> Vec<u8> {
    let body = [&id.to_le_bytes()[..], &text(kind), &text("ros2msg"), &text(&Image::schema())].concat();
    record(rng, 0x03, body)
}

fn channel_record(rng: &mut Rng, id: u16, schema: u16) -> Vec<u8> {
    let schema = if chance(rng, 0.05) { extreme(rng) as u16 } else { schema };
    let topic = *pick(rng, &["/image", "/image", "/image", "/\u{1b}[2J", "", "/tactile"]);
    let metadata = [text("offered_qos_profiles"), text("")].concat();
    let length = often(rng, metadata.len() as i64) as u32;
    let ids = [id.to_le_bytes(), schema.to_le_bytes()].concat();
    record(rng, 0x04, [ids, text(topic), text("cdr"), length.to_le_bytes().to_vec(), metadata].concat())
}

fn payload(rng: &mut Rng, compressed: bool, index: u32) -> Vec<u8> {
    let header =
        Header { stamp: Time { sec: often(rng, 1) as i32, nanosec: index * 40_000_000 }, frame_id: String::new() };
    let mut payload = match compressed {
        true => CompressedImage { header, format: "jpeg".into(), data: seed("tests/data/ros/photo.jpg") }.to_cdr(),
        false => Image::from_rgb(header, &RgbImage::new(8, 8)).to_cdr(),
    };
    if chance(rng, 0.1) {
        bytes::change(rng, &mut payload);
    }
    payload
}

/// A chunk whose compression, sizes or checksum may be wrong, or that expands to gigabytes.
fn chunk_record(rng: &mut Rng, content: &[u8]) -> Vec<u8> {
    let (compression, packed, size) = match below(rng, 12) {
        0 => ("zstd", bomb::zstd(4 << 30, None), often(rng, 4 << 30)),
        1 => ("zstd", bomb::zstd(1 << 30, Some(extreme(rng) as u64)), often(rng, 1 << 20)),
        2 => ("lz4", bomb::lz4(1 << 30), often(rng, 1 << 30)),
        3 => ("lz4", bomb::lz4(256 << 20), often(rng, 100)),
        4 => (*pick(rng, &["zstd", "lz4", "bz2", "\0"]), content.to_vec(), often(rng, content.len() as i64)),
        _ => ("", content.to_vec(), often(rng, content.len() as i64)),
    };
    let crc = if chance(rng, 0.5) { 0 } else { crc32fast::hash(content) };
    let times = [number(rng, 1_000_000_000), number(rng, 1_080_000_000)].concat();
    let told = often(rng, packed.len() as i64).to_le_bytes();
    let body = [&times[..], &size.to_le_bytes(), &crc.to_le_bytes(), &text(compression), &told, &packed].concat();
    record(rng, 0x06, body)
}

fn index_record(rng: &mut Rng, channel: u16) -> Vec<u8> {
    let entries = [number(rng, 1_000_000_000), number(rng, 200)].concat();
    let length = often(rng, entries.len() as i64) as u32;
    record(rng, 0x07, [&channel.to_le_bytes()[..], &length.to_le_bytes(), &entries].concat())
}

fn chunk_index(rng: &mut Rng, start: u64, length: usize, content: usize, channel: u16) -> Vec<u8> {
    let mut body = [number(rng, 1_000_000_000), number(rng, 1_080_000_000)].concat();
    body.extend(number(rng, start as i64));
    body.extend(number(rng, length as i64));
    body.extend((often(rng, 10) as u32).to_le_bytes());
    body.extend(channel.to_le_bytes());
    body.extend(number(rng, (start as usize + length) as i64));
    body.extend(number(rng, 31));
    body.extend(text(""));
    body.extend(number(rng, content as i64));
    body.extend(number(rng, content as i64));
    record(rng, 0x08, body)
}
