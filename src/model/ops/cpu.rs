//! Slices of candle's tensors, and loops over them on all threads.

use std::mem::MaybeUninit;

use candle_core::{CpuStorage, DType, Layout, Result, Storage, Tensor, bail};
use rayon::prelude::*;

use super::simd;

/// Values that one task of an elementwise loop takes: 64 KiB, small against a cache, large against a task's cost.
pub const CHUNK: usize = 16_384;
/// Rows whose contributions to a sum over rows are added up by one task. Fixed, so that the sum does not depend on the
/// number of threads.
pub const ROWS: usize = 64;

/// Whether the fused forms take these tensors.
pub fn takes(tensors: &[&Tensor]) -> bool {
    tensors.iter().all(|t| t.device().is_cpu() && t.dtype() == DType::F32)
}

/// The values of a contiguous f32 tensor, from what a custom operation is given.
pub fn slice<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    match (storage, layout.contiguous_offsets()) {
        (CpuStorage::F32(values), Some((start, end))) => Ok(&values[start..end]),
        _ => bail!("a fused operation takes contiguous f32 tensors"),
    }
}

/// Runs `f` on the values of a contiguous f32 tensor.
pub fn with_slice<R>(tensor: &Tensor, f: impl FnOnce(&[f32]) -> Result<R>) -> Result<R> {
    let (storage, layout) = tensor.storage_and_layout();
    match &*storage {
        Storage::Cpu(storage) => f(slice(storage, layout)?),
        _ => bail!("a fused operation takes tensors on the CPU"),
    }
}

/// A tensor of these values in the shape of `like`.
pub fn tensor_like(values: Vec<f32>, like: &Tensor) -> Result<Tensor> {
    Tensor::from_vec(values, like.shape(), like.device())
}

/// `len` values that `f` writes, block by block on all threads; each block is given its number and is zero at first.
///
/// A whole vector of zeros would be written by one thread, and leave the caches before it is used.
#[allow(unsafe_code)] // No safe way writes a vector's spare room on several threads.
pub fn filled(len: usize, block: usize, f: impl Fn(usize, &mut [f32]) + Sync) -> Vec<f32> {
    let mut out: Vec<f32> = Vec::with_capacity(len);
    out.spare_capacity_mut()[..len].par_chunks_mut(block.max(1)).enumerate().for_each(|(index, room)| {
        room.fill(MaybeUninit::new(0.0));
        // SAFETY: all of the room has just been written.
        f(index, unsafe { std::slice::from_raw_parts_mut(room.as_mut_ptr().cast(), room.len()) });
    });
    // SAFETY: the blocks are all of the first `len` values, and each was written above.
    unsafe { out.set_len(len) };
    out
}

/// The `index`-th block of this length; the last one may be shorter.
pub fn block(values: &[f32], index: usize, len: usize) -> &[f32] {
    &values[index * len..values.len().min((index + 1) * len)]
}

/// `f(a, b)`, element by element; `b` repeats.
///
/// `b` is as long as `a`, or a row that every row of `a` is combined with.
pub fn zip(a: &[f32], b: &[f32], f: impl Fn(f32, f32) -> f32 + Sync) -> Vec<f32> {
    let is_row = b.len() != a.len();
    let len = if is_row { (CHUNK / b.len().max(1)).max(1) * b.len() } else { CHUNK };
    filled(a.len(), len, |index, out| {
        let a = block(a, index, len);
        let b = if is_row { b } else { block(b, index, len) };
        simd::dispatch(
            #[inline(always)]
            || {
                for (out, a) in out.chunks_mut(b.len().max(1)).zip(a.chunks(b.len().max(1))) {
                    for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                        *out = f(*a, *b);
                    }
                }
            },
        )
    })
}

/// Sums over rows. `f(rows, sums)` adds the contributions of a range of rows to `N` sums of `d` values each.
pub fn sum_rows<const N: usize>(
    rows: usize,
    d: usize,
    f: impl Fn(std::ops::Range<usize>, &mut [Vec<f32>; N]) + Sync,
) -> [Vec<f32>; N] {
    let zeros = || std::array::from_fn(|_| vec![0.0; d]);
    let partial: Vec<[Vec<f32>; N]> = (0..rows.div_ceil(ROWS))
        .into_par_iter()
        .map(|block| {
            let mut sums = zeros();
            f(block * ROWS..rows.min((block + 1) * ROWS), &mut sums);
            sums
        })
        .collect();
    let mut total: [Vec<f32>; N] = zeros();
    for sums in &partial {
        for (total, sum) in total.iter_mut().zip(sums) {
            add(total, sum);
        }
    }
    total
}

/// `a += b`.
#[inline(always)]
pub fn add(a: &mut [f32], b: &[f32]) {
    for (a, b) in a.iter_mut().zip(b) {
        *a += b;
    }
}
