//! HDF5 files as h5py writes them by default: superblock 0, symbol tables, headers of version 1.

use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;

const UNDEFINED: u64 = u64::MAX;
/// Half the number of entries in a leaf of a group's tree: a group may have twice as many members.
const LEAF_K: u16 = 128;

/// Element type of an array.
#[derive(Clone, Copy)]
pub enum Type {
    U8,
    I64,
    F32,
    F64,
}

/// A group or an array.
pub enum Node {
    /// Members and text attributes.
    Group(Vec<(String, Node)>, Vec<(&'static str, String)>),
    /// Shape, type and content, row-major; rows per chunk, compressed, or 0 = in one piece.
    Array(Vec<u64>, Type, Vec<u8>, u64),
    /// A list of bytes of varying length per row.
    Lists(Vec<Vec<u8>>),
}

impl Node {
    pub fn group<const N: usize>(members: [(&str, Node); N]) -> Self {
        Self::Group(members.into_iter().map(|(name, node)| (name.to_string(), node)).collect(), Vec::new())
    }

    pub fn f32s(shape: &[u64], values: impl IntoIterator<Item = f32>) -> Self {
        Self::Array(shape.to_vec(), Type::F32, values.into_iter().flat_map(f32::to_le_bytes).collect(), 0)
    }

    pub fn f64s(shape: &[u64], values: impl IntoIterator<Item = f64>) -> Self {
        Self::Array(shape.to_vec(), Type::F64, values.into_iter().flat_map(f64::to_le_bytes).collect(), 0)
    }

    pub fn i64s(values: impl IntoIterator<Item = i64>) -> Self {
        let bytes: Vec<u8> = values.into_iter().flat_map(i64::to_le_bytes).collect();
        Self::Array(vec![bytes.len() as u64 / 8], Type::I64, bytes, 0)
    }

    pub fn u8s(shape: &[u64], bytes: Vec<u8>) -> Self {
        Self::Array(shape.to_vec(), Type::U8, bytes, 0)
    }

    /// Lays an array out in compressed chunks of `rows` rows.
    pub fn chunked(self, rows: u64) -> Self {
        let Self::Array(shape, dtype, bytes, _) = self else { panic!("only arrays have chunks") };
        Self::Array(shape, dtype, bytes, rows)
    }

    /// Returns the file whose root is this group.
    pub fn file(self) -> Vec<u8> {
        let mut out = vec![0; 96];
        let root = self.write(&mut out);
        let mut head = b"\x89HDF\r\n\x1a\n".to_vec();
        head.extend([0, 0, 0, 0, 0, 8, 8, 0]);
        head.extend(LEAF_K.to_le_bytes());
        head.extend(16u16.to_le_bytes());
        head.extend(0u32.to_le_bytes());
        for address in [0, UNDEFINED, out.len() as u64, UNDEFINED, 0, root] {
            head.extend(address.to_le_bytes());
        }
        head.resize(96, 0);
        out[..96].copy_from_slice(&head);
        out
    }

    /// Appends the node and returns the address of its header.
    fn write(self, out: &mut Vec<u8>) -> u64 {
        match self {
            Self::Group(members, attributes) => {
                let table = table(members, out);
                let attributes = attributes.iter().map(|(name, text)| (0x0c, attribute(name, text)));
                header(std::iter::once((0x11, table)).chain(attributes).collect(), out)
            }
            Self::Array(shape, dtype, bytes, rows) => {
                let size = dtype.size();
                let mut messages = vec![(1, space(&shape)), (3, dtype.message()), (5, vec![2, 2, 0, 0])];
                if rows == 0 {
                    let at = append(&bytes, out);
                    let place = [at.to_le_bytes(), (bytes.len() as u64).to_le_bytes()].concat();
                    messages.push((8, [vec![3, 1], place].concat()));
                } else {
                    let tree = chunks(&shape, size, &bytes, rows, out);
                    let dims = std::iter::once(rows).chain(shape[1..].iter().copied()).chain([size as u64]);
                    let mut layout = vec![3, 2, shape.len() as u8 + 1];
                    layout.extend(tree.to_le_bytes());
                    dims.for_each(|length| layout.extend((length as u32).to_le_bytes()));
                    messages.push((8, layout));
                    messages.push((0x0b, filters(size as u32)));
                }
                header(messages, out)
            }
            Self::Lists(lists) => {
                let mut references = Vec::new();
                let collection = (out.len() as u64).next_multiple_of(8);
                for (index, list) in lists.iter().enumerate() {
                    references.extend((list.len() as u32).to_le_bytes());
                    references.extend(collection.to_le_bytes());
                    references.extend((index as u32 + 1).to_le_bytes());
                }
                append(&heap(&lists), out);
                let at = append(&references, out);
                let place = [at.to_le_bytes(), (references.len() as u64).to_le_bytes()].concat();
                let mut list = vec![0x19, 0, 0, 0];
                list.extend(16u32.to_le_bytes());
                list.extend(Type::U8.message());
                let messages = vec![
                    (1, space(&[lists.len() as u64])),
                    (3, list),
                    (5, vec![2, 2, 0, 0]),
                    (8, [vec![3, 1], place].concat()),
                ];
                header(messages, out)
            }
        }
    }
}

impl Type {
    fn size(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::F32 => 4,
            Self::I64 | Self::F64 => 8,
        }
    }

    fn message(self) -> Vec<u8> {
        let bits = 8 * self.size() as u8;
        match self {
            Self::U8 => vec![0x10, 0, 0, 0, 1, 0, 0, 0, 0, 0, bits, 0],
            Self::I64 => vec![0x10, 8, 0, 0, 8, 0, 0, 0, 0, 0, bits, 0],
            Self::F32 => vec![0x11, 0x20, 31, 0, 4, 0, 0, 0, 0, 0, bits, 0, 23, 8, 0, 23, 127, 0, 0, 0],
            Self::F64 => vec![0x11, 0x20, 63, 0, 8, 0, 0, 0, 0, 0, bits, 0, 52, 11, 0, 52, 0xff, 3, 0, 0],
        }
    }
}

fn append(bytes: &[u8], out: &mut Vec<u8>) -> u64 {
    out.resize(out.len().next_multiple_of(8), 0);
    let at = out.len() as u64;
    out.extend(bytes);
    at
}

fn padded(mut bytes: Vec<u8>) -> Vec<u8> {
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    bytes
}

fn header(messages: Vec<(u16, Vec<u8>)>, out: &mut Vec<u8>) -> u64 {
    let count = messages.len() as u16;
    let mut body = Vec::new();
    for (kind, message) in messages {
        let message = padded(message);
        body.extend(kind.to_le_bytes());
        body.extend((message.len() as u16).to_le_bytes());
        body.extend([0; 4]);
        body.extend(message);
    }
    let mut bytes = vec![1, 0];
    bytes.extend(count.to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    bytes.extend((body.len() as u32).to_le_bytes());
    bytes.extend([0; 4]);
    bytes.extend(body);
    append(&bytes, out)
}

fn space(shape: &[u64]) -> Vec<u8> {
    let mut bytes = vec![1, shape.len() as u8, 0, 0, 0, 0, 0, 0];
    shape.iter().for_each(|length| bytes.extend(length.to_le_bytes()));
    bytes
}

fn attribute(name: &str, text: &str) -> Vec<u8> {
    let mut dtype = vec![0x13, 0x11, 0, 0]; // a text in UTF-8, padded with zeros
    dtype.extend((text.len() as u32).to_le_bytes());
    let space = space(&[]);
    let mut bytes = vec![1, 0];
    for length in [name.len() + 1, dtype.len(), space.len()] {
        bytes.extend((length as u16).to_le_bytes());
    }
    bytes.extend(padded([name.as_bytes(), b"\0"].concat()));
    bytes.extend(padded(dtype));
    bytes.extend(padded(space));
    bytes.extend(text.as_bytes());
    bytes
}

/// Writes a group's members, heap and tree; returns the message that points to them.
fn table(mut members: Vec<(String, Node)>, out: &mut Vec<u8>) -> Vec<u8> {
    assert!(members.len() <= 2 * usize::from(LEAF_K));
    members.sort_by(|a, b| a.0.cmp(&b.0));
    let (mut names, mut entries, mut last) = (vec![0; 8], Vec::new(), 0);
    let count = members.len() as u16;
    for (name, node) in members {
        last = names.len() as u64;
        names.extend(padded([name.as_bytes(), b"\0"].concat()));
        entries.extend(last.to_le_bytes());
        entries.extend(node.write(out).to_le_bytes());
        entries.extend([0; 24]);
    }
    let names_at = append(&names, out);
    let mut local = b"HEAP\0\0\0\0".to_vec();
    for value in [names.len() as u64, 1, names_at] {
        local.extend(value.to_le_bytes());
    }
    let local = append(&local, out);
    let mut leaf = b"SNOD\x01\0".to_vec();
    leaf.extend(count.to_le_bytes());
    leaf.extend(entries);
    leaf.resize(8 + 40 * 2 * usize::from(LEAF_K), 0);
    let leaf = append(&leaf, out);
    let mut tree = b"TREE\0\0\x01\0".to_vec();
    for value in [UNDEFINED, UNDEFINED, 0, leaf, last] {
        tree.extend(value.to_le_bytes());
    }
    tree.resize(24 + 8 * (2 * 32 + 1), 0);
    let tree = append(&tree, out);
    [tree.to_le_bytes(), local.to_le_bytes()].concat()
}

fn filters(size: u32) -> Vec<u8> {
    let mut bytes = vec![1, 2, 0, 0, 0, 0, 0, 0];
    for (filter, value) in [(2u16, size), (1, 6)] {
        bytes.extend(filter.to_le_bytes());
        bytes.extend([0, 0, 1, 0, 1, 0]);
        bytes.extend(value.to_le_bytes());
        bytes.extend([0; 4]);
    }
    bytes
}

/// Writes shuffled and compressed chunks of `rows` rows, and their tree.
fn chunks(shape: &[u64], size: usize, bytes: &[u8], rows: u64, out: &mut Vec<u8>) -> u64 {
    let row = size * shape[1..].iter().product::<u64>() as usize;
    let mut keys = Vec::new();
    for first in (0..shape[0]).step_by(rows as usize) {
        let mut chunk = bytes[first as usize * row..].to_vec();
        chunk.resize(rows as usize * row, 0);
        let count = chunk.len() / size;
        let shuffled: Vec<u8> = (0..chunk.len()).map(|at| chunk[(at % count) * size + at / count]).collect();
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(&shuffled).unwrap();
        let compressed = encoder.finish().unwrap();
        keys.push((first, compressed.len() as u32, append(&compressed, out)));
    }
    assert!(keys.len() <= 64);
    let mut tree = b"TREE\x01\0".to_vec();
    tree.extend((keys.len() as u16).to_le_bytes());
    tree.extend([0xff; 16]);
    let key = |first: u64, length: u32| {
        let mut bytes = [length.to_le_bytes(), [0; 4]].concat();
        bytes.extend(first.to_le_bytes());
        bytes.extend(vec![0; 8 * shape.len()]);
        bytes
    };
    for (first, length, at) in &keys {
        tree.extend(key(*first, *length));
        tree.extend(at.to_le_bytes());
    }
    tree.extend(key(shape[0].next_multiple_of(rows), 0));
    tree.resize(24 + 65 * (16 + 8 * shape.len()) + 64 * 8, 0);
    append(&tree, out)
}

/// Returns a collection of the global heap with these objects.
fn heap(lists: &[Vec<u8>]) -> Vec<u8> {
    let mut objects = Vec::new();
    for (index, list) in lists.iter().enumerate() {
        objects.extend((index as u16 + 1).to_le_bytes());
        objects.extend(1u16.to_le_bytes());
        objects.extend([0; 4]);
        objects.extend((list.len() as u64).to_le_bytes());
        objects.extend(padded(list.clone()));
    }
    let size = (16 + objects.len() + 16).max(4096);
    let mut bytes = b"GCOL\x01\0\0\0".to_vec();
    bytes.extend((size as u64).to_le_bytes());
    bytes.extend(&objects);
    let free = size - bytes.len();
    bytes.extend([0; 8]);
    bytes.extend((free as u64).to_le_bytes());
    bytes.resize(size, 0);
    bytes
}
