//! Slices of candle's tensors, and loops over them on all threads.

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

/// `f(a, b)`, element by element; `b` repeats.
///
/// `b` is as long as `a`, or a row that every row of `a` is combined with.
pub fn zip(a: &[f32], b: &[f32], f: impl Fn(f32, f32) -> f32 + Sync) -> Vec<f32> {
    let mut out = vec![0.0; a.len()];
    let rows = (CHUNK / b.len().max(1)).max(1) * b.len();
    match b.len() == a.len() {
        true => {
            out.par_chunks_mut(CHUNK).zip(a.par_chunks(CHUNK)).zip(b.par_chunks(CHUNK)).for_each(|((out, a), b)| {
                simd::dispatch(
                    #[inline(always)]
                    || {
                        for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                            *out = f(*a, *b);
                        }
                    },
                )
            })
        }
        false => out.par_chunks_mut(rows.max(1)).zip(a.par_chunks(rows.max(1))).for_each(|(out, a)| {
            simd::dispatch(
                #[inline(always)]
                || {
                    for (out, a) in out.chunks_exact_mut(b.len()).zip(a.chunks_exact(b.len())) {
                        for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                            *out = f(*a, *b);
                        }
                    }
                },
            )
        }),
    }
    out
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
