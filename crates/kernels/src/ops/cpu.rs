//! Custom operations on slices of candle's tensors, and loops over slices on all threads.

use std::mem::MaybeUninit;

use candle_core::{CpuStorage, CustomOp3, DType, Layout, Result, Shape, Storage, Tensor, bail};
use rayon::prelude::*;

use crate::simd;

/// Values that one task of an elementwise loop takes: 64 KiB, a small part of a cache and far more work than a task costs.
pub const CHUNK: usize = 16_384;
/// Rows whose contributions to a sum over rows one task adds up. Fixed, so that the sum does not depend on the number of
/// threads.
pub const ROWS: usize = 64;

/// An argument of an [`Operation`]: the values of a contiguous f32 tensor, and its layout.
#[derive(Clone, Copy)]
pub struct Operand<'a> {
    /// The values, row-major.
    pub values: &'a [f32],
    /// Shape of the tensor.
    pub layout: &'a Layout,
}

impl<'a> Operand<'a> {
    fn new(storage: &'a CpuStorage, layout: &'a Layout) -> Result<Self> {
        Ok(Self { values: slice(storage, layout)?, layout })
    }

    /// Dimensions of the tensor.
    pub fn dims(&self) -> &'a [usize] {
        self.layout.dims()
    }
}

/// A differentiable operation on three tensors, written on slices. [`apply`] makes it one of candle's.
pub trait Operation: Send + Sync + 'static {
    /// Name in candle's messages.
    const NAME: &'static str;

    /// Computes values and shape of the result.
    fn forward(&self, operands: [Operand; 3]) -> Result<(Vec<f32>, Shape)>;

    /// Computes the gradients of the arguments from that of the result, which is contiguous; `None` where none is wanted.
    fn backward(&self, arguments: [&Tensor; 3], result: &Tensor, grad: &Tensor) -> Result<[Option<Tensor>; 3]>;
}

/// Applies an operation to three tensors.
pub fn apply(operation: impl Operation, arguments: [&Tensor; 3]) -> Result<Tensor> {
    let [a, b, c] = arguments;
    a.contiguous()?.apply_op3(&b.contiguous()?, &c.contiguous()?, Adapter(operation))
}

/// An [`Operation`] as candle calls it.
struct Adapter<T>(T);

impl<T: Operation> CustomOp3 for Adapter<T> {
    fn name(&self) -> &'static str {
        T::NAME
    }

    fn cpu_fwd(
        &self,
        a: &CpuStorage,
        a_layout: &Layout,
        b: &CpuStorage,
        b_layout: &Layout,
        c: &CpuStorage,
        c_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let operands = [Operand::new(a, a_layout)?, Operand::new(b, b_layout)?, Operand::new(c, c_layout)?];
        let (values, shape) = self.0.forward(operands)?;
        Ok((CpuStorage::F32(values), shape))
    }

    fn bwd(
        &self,
        a: &Tensor,
        b: &Tensor,
        c: &Tensor,
        result: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let [a, b, c] = self.0.backward([a, b, c], result, &grad.contiguous()?)?;
        Ok((a, b, c))
    }
}

/// True if the fused forms accept these tensors: f32 on the CPU.
pub fn takes(tensors: &[&Tensor]) -> bool {
    tensors.iter().all(|t| t.device().is_cpu() && t.dtype() == DType::F32)
}

/// Returns the values of a contiguous f32 tensor from its storage and layout.
pub fn slice<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    match (storage, layout.contiguous_offsets()) {
        (CpuStorage::F32(values), Some((start, end))) => Ok(&values[start..end]),
        _ => bail!("a fused operation takes contiguous f32 tensors"),
    }
}

/// Runs `f` on the values of a contiguous f32 tensor on the CPU.
pub(super) fn with_slice<R>(tensor: &Tensor, f: impl FnOnce(&[f32]) -> Result<R>) -> Result<R> {
    let (storage, layout) = tensor.storage_and_layout();
    match &*storage {
        Storage::Cpu(storage) => f(slice(storage, layout)?),
        _ => bail!("a fused operation takes tensors on the CPU"),
    }
}

/// Runs `f` on the values of f32 tensors on the CPU, all borrowed together. A tensor that is not contiguous is copied first.
///
/// # Errors
/// If a tensor is of another type or device, or `f` fails.
pub fn with_slices<R, E: From<candle_core::Error>>(
    tensors: &[&Tensor],
    f: impl FnOnce(&[&[f32]]) -> std::result::Result<R, E>,
) -> std::result::Result<R, E> {
    let tensors = tensors.iter().map(|tensor| tensor.contiguous()).collect::<Result<Vec<Tensor>>>()?;
    // A tensor's storage is behind a lock: each guard must live as long as the slice that is borrowed through it.
    let guards: Vec<_> = tensors.iter().map(Tensor::storage_and_layout).collect();
    let slices = guards.iter().map(|(storage, layout)| match &**storage {
        Storage::Cpu(storage) => slice(storage, layout),
        _ => bail!("a fused operation takes tensors on the CPU"),
    });
    f(&slices.collect::<Result<Vec<&[f32]>>>()?)
}

/// Creates a tensor of these values with shape and device of `like`.
pub fn tensor_like(values: Vec<f32>, like: &Tensor) -> Result<Tensor> {
    Tensor::from_vec(values, like.shape(), like.device())
}

/// Creates `len` values. `f` writes them block by block on all threads, given the number of the block and its zeros.
///
/// Each thread sets its own block to zero: zeros that one thread wrote for all would have left the caches before use.
pub fn filled(len: usize, block: usize, f: impl Fn(usize, &mut [f32]) + Sync) -> Vec<f32> {
    let mut out: Vec<f32> = Vec::with_capacity(len);
    out.spare_capacity_mut()[..len].par_chunks_mut(block.max(1)).enumerate().for_each(|(index, room)| {
        room.fill(MaybeUninit::new(0.0));
        // SAFETY: the line above initialised all of `room`, which this task alone borrows; `MaybeUninit<f32>` has the layout
        // of f32.
        f(index, unsafe { std::slice::from_raw_parts_mut(room.as_mut_ptr().cast(), room.len()) });
    });
    // SAFETY: the capacity is at least `len`, and the blocks, all of the first `len` values, were initialised above.
    unsafe { out.set_len(len) };
    out
}

/// Returns the `index`-th block of `len` values; the last one may be shorter.
pub fn block(values: &[f32], index: usize, len: usize) -> &[f32] {
    &values[index * len..values.len().min((index + 1) * len)]
}

/// Computes `f(a, b)` element by element. `b` is as long as `a`, or one row that is combined with every row of `a`.
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

/// Computes `N` sums over rows, of `d` values each. `f(rows, sums)` adds the contributions of a range of rows.
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

/// Adds `b` to `a`.
#[inline(always)]
pub fn add(a: &mut [f32], b: &[f32]) {
    for (a, b) in a.iter_mut().zip(b) {
        *a += b;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_block_begins_as_zeros_and_keeps_what_is_written() {
        for (len, block) in [(0, 4), (1, 4), (8, 4), (11, 3), (11, 0)] {
            let values = filled(len, block, |index, out| {
                for (i, value) in out.iter_mut().enumerate() {
                    *value += (index * block.max(1) + i) as f32;
                }
            });
            assert_eq!(values, (0..len).map(|i| i as f32).collect::<Vec<_>>(), "{len} values in blocks of {block}");
        }
    }
}
