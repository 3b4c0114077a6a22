//! Pickles as lists of operations.

use rand::Rng as _;

use super::{Rng, below, extreme, pick, times};

/// Largest size of a pickle that is made, bytes.
const LARGEST: usize = 1 << 20;

/// Operations that make, copy or name values.
const OPERATIONS: [&[u8]; 27] = [
    b"(",
    b"]",
    b"}",
    b")",
    b"N",
    b"\x88",
    b"0",
    b"1",
    b"2",
    b"a",
    b"e",
    b"s",
    b"u",
    b"t",
    b"\x85",
    b"\x86",
    b"\x87",
    b"R",
    b"b",
    b"\x81",
    b"\x94",
    b"K\x01",
    b"q\x00",
    b"h\x00",
    b"X\x01\x00\x00\x00a",
    b"cnumpy\ndtype\n",
    b"cnumpy.core.multiarray\n_reconstruct\n",
];

/// Splits a pickle into operations; the rest is one item if it can't be split.
pub fn split(mut bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut operations = Vec::new();
    while let Some(length) = length(bytes).filter(|length| *length <= bytes.len() && *length > 0) {
        let (operation, rest) = bytes.split_at(length);
        operations.push(operation.to_vec());
        bytes = rest;
    }
    if !bytes.is_empty() {
        operations.push(bytes.to_vec());
    }
    operations
}

/// Length of the first operation, bytes.
fn length(bytes: &[u8]) -> Option<usize> {
    let line = |from: usize| bytes[from.min(bytes.len())..].iter().position(|b| *b == b'\n').map(|at| from + at + 1);
    let count = |width: usize| {
        let field = bytes.get(1..1 + width)?;
        let value = field.iter().rev().fold(0u64, |sum, byte| sum << 8 | u64::from(*byte));
        usize::try_from(value).ok()?.checked_add(1 + width)
    };
    match bytes.first()? {
        b'F' | b'I' | b'L' | b'S' | b'V' | b'P' | b'p' | b'g' => line(1),
        b'c' | b'i' => line(1).and_then(line),
        b'K' | b'h' | b'q' | 0x80 | 0x82 => Some(2),
        b'M' | 0x83 => Some(3),
        b'J' | b'j' | b'r' | 0x84 => Some(5),
        b'G' | 0x95 => Some(9),
        b'U' | 0x8c | b'C' | 0x8a => count(1),
        b'T' | b'X' | b'B' | 0x8b => count(4),
        0x8d | 0x8e | 0x96 => count(8),
        _ => Some(1),
    }
}

/// Changes operations of a pickle.
pub fn change(rng: &mut Rng, bytes: &[u8]) -> Vec<u8> {
    let mut operations = split(bytes);
    for _ in 0..1 + below(rng, 3) {
        let at = below(rng, operations.len());
        match below(rng, 9) {
            _ if operations.is_empty() => operations.push(b".".to_vec()),
            0 => drop(operations.remove(at)),
            1 => {
                let copy = operations[at].clone();
                let copies = times(rng).min(LARGEST / copy.len().max(1));
                operations.splice(at..at, vec![copy; copies]);
            }
            2 => {
                let other = below(rng, operations.len());
                operations.swap(at, other);
            }
            3 => {
                let new = pick(rng, &OPERATIONS).to_vec();
                let copies = times(rng).min(LARGEST / new.len());
                operations.splice(at..at, vec![new; copies]);
            }
            4 => drop(operations.splice(at..at, doubling(rng))),
            5 => operations.insert(at, integer(extreme(rng))),
            6 => operations.truncate(at),
            _ => change_argument(rng, &mut operations),
        }
    }
    operations.concat()
}

/// Writes an extreme number into the content of a string or of bytes, as which arrays lie in a pickle.
pub fn change_content(rng: &mut Rng, bytes: &[u8]) -> Vec<u8> {
    /// Size of an operation's code and length, bytes.
    const START: usize = 5;
    let mut operations = split(bytes);
    let places: Vec<usize> = (0..operations.len())
        .filter(|i| operations[*i].len() > START + 8 && b"TBX".contains(&operations[*i][0]))
        .collect();
    if places.is_empty() {
        return bytes.to_vec();
    }
    // Small arrays are rather indices, which decide more than coordinates.
    let (one, other) = (*pick(rng, &places), *pick(rng, &places));
    let at = if operations[one].len() < operations[other].len() { one } else { other };
    let content = &mut operations[at][START..];
    let width = *pick(rng, &[4, 8]);
    let place = below(rng, content.len() / width) * width;
    let value = extreme(rng).to_le_bytes();
    for (to, from) in content.iter_mut().skip(place).zip(&value[..width]) {
        *to = *from;
    }
    operations.concat()
}

/// Replaces the number of an operation that has one: an integer, a length or a place in the memo.
fn change_argument(rng: &mut Rng, operations: &mut [Vec<u8>]) {
    let numeric =
        |operation: &Vec<u8>| operation.first().is_some_and(|code| b"KMJIhjqrTXBUC\x8c\x8a\x8b".contains(code));
    let places: Vec<usize> = (0..operations.len()).filter(|i| numeric(&operations[*i])).collect();
    if places.is_empty() {
        return;
    }
    let operation = &mut operations[*pick(rng, &places)];
    if b"KMJI".contains(&operation[0]) && rng.random_bool(0.7) {
        *operation = integer(extreme(rng));
        return;
    }
    let value = extreme(rng).to_le_bytes();
    let width = if b"JjrTXB\x8b".contains(&operation[0]) { 4 } else { 1 };
    for (to, from) in operation.iter_mut().skip(1).zip(&value[..width]) {
        *to = *from;
    }
}

/// An operation that pushes an integer of any size.
pub fn integer(value: i64) -> Vec<u8> {
    match i32::try_from(value) {
        Ok(value) => [&b"J"[..], &value.to_le_bytes()].concat(),
        Err(_) => [&b"\x8a\x08"[..], &value.to_le_bytes()].concat(),
    }
}

/// Operations whose value doubles with each, or nests by one with each.
fn doubling(rng: &mut Rng) -> Vec<Vec<u8>> {
    let levels = *pick(rng, &[20, 40, 1000, 200_000]);
    match below(rng, 3) {
        0 => vec![b"2\x86".to_vec(); levels.min(1000)],
        1 => vec![b"\x85".to_vec(); levels],
        _ => vec![b"]".to_vec(); levels].into_iter().chain(vec![b"a".to_vec(); levels]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_split_pickle_is_whole_and_ends_with_stop() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/hand");
        for name in ["small_python2_0.pkl", "small_python2_2.pkl", "small_python3_4.pkl"] {
            let bytes = std::fs::read(folder.join(name)).unwrap();
            let operations = split(&bytes);
            assert_eq!(operations.concat(), bytes);
            assert_eq!(operations.last().unwrap(), b".", "{name}");
        }
    }
}
