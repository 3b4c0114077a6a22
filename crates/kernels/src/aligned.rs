//! Arrays that begin on a cache line, so that no vector load crosses one.

use std::marker::PhantomData;
use std::mem::MaybeUninit;

use rayon::prelude::*;

/// A cache line.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
struct Line([u8; 64]);

/// Plain numbers: any bit pattern is a value, and zero bytes are zero. Sealed, since [`Aligned`] relies on it.
pub trait Number: Copy + Send + Sync + private::Sealed {}

mod private {
    pub trait Sealed {}
}

macro_rules! numbers {
    ($($type:ty),*) => {$(
        impl Number for $type {}
        impl private::Sealed for $type {}
    )*};
}
numbers!(f32, u32, u16, i8, u8);

/// A fixed number of values, zero at first.
#[derive(Debug, Clone)]
pub struct Aligned<T> {
    lines: Vec<Line>,
    len: usize,
    kind: PhantomData<T>,
}

impl<T: Number> Aligned<T> {
    /// Creates an array of `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let lines = (len * size_of::<T>()).div_ceil(size_of::<Line>());
        Self { lines: vec![Line([0; 64]); lines], len, kind: PhantomData }
    }
}

impl<T: Number> Aligned<T> {
    /// Creates an array of pieces of these lengths, which fill whole cache lines. `f` writes each on one of rayon's threads, given its
    /// number and its zeros: zeros that one thread wrote for all would have left the caches before use.
    ///
    /// # Panics
    /// If a piece ends within a cache line.
    pub fn by_pieces(lengths: impl Iterator<Item = usize>, f: impl Fn(usize, &mut [T]) + Sync) -> Self {
        let per_line = size_of::<Line>() / size_of::<T>();
        let pieces: Vec<usize> = lengths
            .map(|length| {
                assert!(length.is_multiple_of(per_line), "a piece of {length} values ends within a cache line");
                length / per_line
            })
            .collect();
        let count = pieces.iter().sum();
        let mut lines: Vec<Line> = Vec::with_capacity(count);
        let mut rest = &mut lines.spare_capacity_mut()[..count];
        let rooms: Vec<_> = pieces.into_iter().map(|piece| rest.split_off_mut(..piece).unwrap_or_default()).collect();
        rooms.into_par_iter().enumerate().for_each(|(index, room)| {
            room.fill(MaybeUninit::new(Line([0; 64])));
            // SAFETY: the line above initialised all of `room`, which this task alone borrows. A line is aligned to 64 bytes, more than
            // any `Number` needs, and every byte pattern is a value of a `Number`, which is sealed.
            f(index, unsafe { std::slice::from_raw_parts_mut(room.as_mut_ptr().cast(), room.len() * per_line) });
        });
        // SAFETY: the capacity is at least `count`, and the pieces, all of the first `count` lines, were initialised above.
        unsafe { lines.set_len(count) };
        Self { lines, len: count * per_line, kind: PhantomData }
    }
}

impl<T: Number> Default for Aligned<T> {
    fn default() -> Self {
        Self::zeros(0)
    }
}

/// Makes room for `len` values; forgets those that are there if there is too little.
pub fn grow<T: Number>(buffer: &mut Aligned<T>, len: usize) {
    if buffer.len() < len {
        *buffer = Aligned::zeros(len);
    }
}

impl<T: Number> std::ops::Deref for Aligned<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        // SAFETY: `zeros` allocates lines for at least `len` values and nothing resizes them. A line is aligned to 64
        // bytes, more than any `Number` needs, and every byte pattern is a value of a `Number`, which is sealed.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.len) }
    }
}

impl<T: Number> std::ops::DerefMut for Aligned<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        // SAFETY: as in `deref`; the exclusive borrow of `self` makes the slice the only reference to the lines.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.len) }
    }
}
