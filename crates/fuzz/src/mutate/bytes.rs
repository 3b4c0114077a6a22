//! Changes of binary fields.

use rand::Rng as _;

use super::{Rng, below, extreme, pick, times};

/// Largest size of a changed input, bytes.
const LARGEST: usize = 1 << 21;

/// Changes one field, or the order or number of stretches.
pub fn change(rng: &mut Rng, bytes: &mut Vec<u8>) {
    let n = bytes.len();
    if n == 0 {
        return bytes.push(rng.random());
    }
    let at = below(rng, n);
    let length = (*pick(rng, &[1usize, 2, 4, 8, 16, 64, 256])).min(n - at);
    match below(rng, 10) {
        0 => bytes.truncate(at),
        1 => {
            let copy = bytes[at..at + length].to_vec();
            let copies = times(rng).min(LARGEST.saturating_sub(n) / length.max(1));
            bytes.splice(at..at, copy.repeat(copies));
        }
        2 => drop(bytes.drain(at..at + length)),
        3 => {
            let other = below(rng, n);
            for i in 0..length.min(n - at.max(other)) {
                bytes.swap(at + i, other + i);
            }
        }
        4 => bytes[at] = rng.random(),
        _ => put(rng, bytes, at & !3, extreme_width),
    }
}

/// Writes an extreme number at `at`, as wide as `width` draws, in either byte order.
fn put(rng: &mut Rng, bytes: &mut [u8], at: usize, width: fn(&mut Rng) -> usize) {
    let (value, width) = (extreme(rng), width(rng));
    let mut field = value.to_le_bytes();
    let field = &mut field[..width];
    if rng.random_bool(0.3) {
        field.reverse();
    }
    for (to, from) in bytes.iter_mut().skip(at).zip(field) {
        *to = *from;
    }
}

fn extreme_width(rng: &mut Rng) -> usize {
    *pick(rng, &[1, 2, 4, 4, 4, 8, 8])
}
