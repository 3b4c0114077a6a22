//! Changes that keep the structure of a format, and put extreme values into it.

pub mod archive;
pub mod bomb;
pub mod bytes;
pub mod json;
pub mod pickle;
pub mod text;

use rand::Rng as _;
use rand::seq::IndexedRandom;
pub use rand_chacha::ChaCha8Rng as Rng;

/// Numbers at which readers overflow, allocate too much or loop too long.
const EXTREMES: [i64; 27] = [
    0,
    1,
    -1,
    2,
    3,
    -2,
    127,
    255,
    256,
    4096,
    i16::MAX as i64,
    1 << 15,
    u16::MAX as i64,
    1 << 16,
    100_000,
    1 << 20,
    1 << 24,
    1 << 28,
    i32::MAX as i64,
    1 << 31,
    u32::MAX as i64,
    1 << 32,
    1 << 34,
    1 << 53,
    1 << 62,
    i64::MAX,
    i64::MIN,
];

/// Draws one of [`EXTREMES`].
pub fn extreme(rng: &mut Rng) -> i64 {
    *pick(rng, &EXTREMES)
}

/// Returns `usual`, or rarely an extreme number.
pub fn often(rng: &mut Rng, usual: i64) -> i64 {
    if rng.random_bool(0.06) { extreme(rng) } else { usual }
}

/// Draws an item; `items` must not be empty.
pub fn pick<'a, T>(rng: &mut Rng, items: &'a [T]) -> &'a T {
    items.choose(rng).unwrap_or(&items[0])
}

/// Draws true with this probability.
pub fn chance(rng: &mut Rng, share: f64) -> bool {
    rng.random_bool(share)
}

/// Draws an index below `n`; 0 for none.
pub fn below(rng: &mut Rng, n: usize) -> usize {
    rng.random_range(0..n.max(1))
}

/// Draws a small number of repetitions, rarely a large one.
pub fn times(rng: &mut Rng) -> usize {
    *pick(rng, &[1, 1, 1, 2, 2, 3, 8, 64, 1000, 100_000])
}
