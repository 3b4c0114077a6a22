//! Arrays that begin on a cache line, so that no vector load crosses one.

use std::marker::PhantomData;

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
