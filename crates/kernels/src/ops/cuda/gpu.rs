//! Memory, matrix products and kernel launches on one GPU.
//!
//! # Unsafe code
//!
//! Kernels take plain pointers. They point into tensors that live until the launch is queued, and memory is freed in the
//! order of the device's one stream, behind the kernels that use it. Sizes are those of the tensors, which the callers check.

use std::marker::PhantomData;

use candle_core::cuda_backend::cudarc::cublas::{result, sys};
use candle_core::cuda_backend::cudarc::driver::result as driver;
use candle_core::cuda_backend::cudarc::driver::{
    CudaSlice, DevicePtr as _, DeviceRepr, LaunchArgs, LaunchConfig, PushKernelArg as _,
};
use candle_core::cuda_backend::{CudaDType, CudaDevice, CudaStorage, WrapErr as _};
use candle_core::op::BackpropOp;
use candle_core::{DType, Layout, Result, Shape, Storage, Tensor, bail};
use half::bf16;

/// Address of values on the GPU.
pub type Pointer = u64;

/// PTX of `kernels.cu`.
mod ptx {
    include!(concat!(env!("OUT_DIR"), "/ptx.rs"));
}

/// Threads of a block of an elementwise kernel.
const THREADS: u32 = 256;
/// Values that a thread of an elementwise kernel takes at once: 16 bytes of bf16.
const VALUES: usize = 8;
/// Most blocks of an elementwise kernel, whose threads then take values several times.
const BLOCKS: usize = 8192;
/// Threads that share a row of a layer norm, `ROW_THREADS` in `kernels.cu`.
const ROW_THREADS: u32 = 128;
/// Rows of a softmax per block, one warp each.
const SOFTMAX_ROWS: usize = 4;
/// Block of a sum over rows, `COLUMNS` and `ROWS` in `kernels.cu`.
const COLUMN_BLOCK: (u32, u32) = (32, 16);
/// Rows that one block of a sum over rows adds up.
const CHUNK: usize = 256;
/// Blocks that share an array of weights, `SHARED_BLOCKS` in `kernels.cu`; of 256 threads, as its sums expect.
const SHARED_BLOCKS: u32 = 64;

/// A number format of the kernels.
pub trait Value: CudaDType + DeviceRepr + Send + Sync + 'static {
    /// End of the kernels' names.
    const SUFFIX: &str;
    /// Name of the format in cuBLAS.
    const TYPE: sys::cudaDataType_t;
}

impl Value for f32 {
    const SUFFIX: &str = "f32";
    const TYPE: sys::cudaDataType_t = sys::cudaDataType_t::CUDA_R_32F;
}

impl Value for bf16 {
    const SUFFIX: &str = "bf16";
    const TYPE: sys::cudaDataType_t = sys::cudaDataType_t::CUDA_R_16BF;
}

/// One GPU, for values of type T.
pub struct Gpu<'a, T> {
    device: &'a CudaDevice,
    format: PhantomData<T>,
}

/// A batch of matrices, row-major: rows `stride` values apart, matrices `step` values apart.
#[derive(Clone, Copy)]
pub struct Matrix {
    /// First value.
    pub at: Pointer,
    /// Values from row to row.
    pub stride: usize,
    /// Values from matrix to matrix.
    pub step: usize,
    /// True if the transposed matrix is meant.
    pub transposed: bool,
}

impl Matrix {
    /// One matrix whose rows of `columns` values lie one behind the other.
    pub fn new(at: Pointer, columns: usize) -> Self {
        Self { at, stride: columns, step: 0, transposed: false }
    }

    /// A batch of `(rows, columns)`.
    pub fn batch(at: Pointer, rows: usize, columns: usize) -> Self {
        Self { step: rows * columns, ..Self::new(at, columns) }
    }

    /// The transposed matrix.
    pub fn t(self) -> Self {
        Self { transposed: !self.transposed, ..self }
    }
}

/// Numbers of one step of AdamW that all weights share.
#[derive(Debug, Clone, Copy)]
pub struct AdamStep {
    /// Factor of the gradient, which clips it.
    pub scale: f32,
    /// 1 - β₁ᵗ and 1 - β₂ᵗ.
    pub corrections: [f32; 2],
    /// β₁ and β₂.
    pub betas: [f32; 2],
    /// ε.
    pub eps: f32,
    /// Factor of the moving average of the weights.
    pub decay: f32,
}

/// An array of weights, and what its step reads and writes: as many values each.
#[derive(Debug, Clone, Copy)]
pub struct Weight {
    /// Weights, gradient, first and second moment, average.
    pub arrays: [Pointer; 5],
    /// Number of values.
    pub count: usize,
    /// Learning rate.
    pub rate: f32,
    /// Factor of the weights: one less the decay.
    pub shrink: f32,
}

/// Queues a kernel; the arguments are plain values and pointers.
macro_rules! launch {
    ($gpu:expr, $name:expr, $config:expr, $($arg:expr),+ $(,)?) => {{
        let config = $config;
        let function = $gpu.device.get_or_load_custom_func(&$name, "egotac", ptx::KERNELS)?;
        let mut builder = function.builder();
        candle_core::builder_arg!(builder, $($arg),+);
        start(&mut builder, config)?;
    }};
}

/// Queues a kernel that has been given its arguments.
fn start(kernel: &mut LaunchArgs, config: LaunchConfig) -> Result<()> {
    // SAFETY: `launch!` gave it the arguments of the kernel, in number and type; for the pointers see the head of this module.
    unsafe { kernel.launch(config) }.w()?;
    Ok(())
}

/// Returns the configuration of a kernel on `count` values, which count in 32 bits.
fn elementwise(count: usize) -> Result<LaunchConfig> {
    if count > i32::MAX as usize {
        bail!("a kernel takes at most {} values, got {count}", i32::MAX);
    }
    let blocks = count.div_ceil(THREADS as usize * VALUES).clamp(1, BLOCKS) as u32;
    Ok(LaunchConfig { grid_dim: (blocks, 1, 1), block_dim: (THREADS, 1, 1), shared_mem_bytes: 0 })
}

/// Returns the configuration of a kernel on all of `arrays` arrays at once.
fn shared(arrays: usize) -> LaunchConfig {
    LaunchConfig { grid_dim: (SHARED_BLOCKS, arrays as u32, 1), block_dim: (256, 1, 1), shared_mem_bytes: 0 }
}

fn rows_of_blocks(blocks: usize, threads: u32) -> LaunchConfig {
    LaunchConfig { grid_dim: (blocks as u32, 1, 1), block_dim: (threads, 1, 1), shared_mem_bytes: 0 }
}

/// Returns the address of the values of a contiguous tensor of type T.
pub fn pointer<T: Value>(storage: &CudaStorage, layout: &Layout) -> Result<Pointer> {
    let slice = storage.as_cuda_slice::<T>()?;
    match layout.contiguous_offsets() {
        Some((start, end)) => {
            let view = slice.slice(start..end);
            let (pointer, _) = view.device_ptr(slice.stream());
            Ok(pointer)
        }
        None => bail!("a fused operation takes contiguous tensors"),
    }
}

/// Returns the address of the values of a contiguous tensor of type T. They stay there as long as the tensor.
pub fn tensor_pointer<T: Value>(tensor: &Tensor) -> Result<Pointer> {
    match &*tensor.storage_and_layout().0 {
        Storage::Cuda(storage) => pointer::<T>(storage, tensor.layout()),
        _ => bail!("a fused operation takes tensors on the GPU"),
    }
}

/// Queues a copy of the values of a contiguous tensor to those of another one of the same type and size.
pub fn copy(to: &Tensor, from: &Tensor) -> Result<()> {
    let bytes = from.elem_count() * from.dtype().size_in_bytes();
    let (to_at, from_at) = match (to.dtype(), from.dtype()) {
        _ if to.shape() != from.shape() => bail!("copy: expected {:?}, got {:?}", to.dims(), from.dims()),
        (DType::F32, DType::F32) => (tensor_pointer::<f32>(to)?, tensor_pointer::<f32>(from)?),
        (DType::BF16, DType::BF16) => (tensor_pointer::<bf16>(to)?, tensor_pointer::<bf16>(from)?),
        (to, from) => bail!("copy: expected {to:?}, got {from:?}"),
    };
    let stream = device(to)?.cuda_stream();
    // SAFETY: both tensors are of this size, see also the head of this module.
    unsafe { driver::memcpy_dtod_async(to_at, from_at, bytes, stream.cu_stream()) }.w()
}

/// Returns the address of values on the GPU.
pub fn slice_pointer<T>(slice: &CudaSlice<T>) -> Pointer {
    let (pointer, _) = slice.device_ptr(slice.stream());
    pointer
}

/// Returns the device of a tensor.
///
/// # Errors
/// If it is not a GPU.
pub fn device(tensor: &Tensor) -> Result<CudaDevice> {
    tensor.device().as_cuda_device().cloned()
}

impl<'a, T: Value> Gpu<'a, T> {
    /// Takes the device.
    pub fn new(device: &'a CudaDevice) -> Self {
        Self { device, format: PhantomData }
    }

    fn name(&self, kernel: &str) -> String {
        format!("{kernel}_{}", T::SUFFIX)
    }

    /// Allocates memory whose values mean nothing.
    pub fn empty<V: DeviceRepr>(&self, count: usize) -> Result<CudaSlice<V>> {
        // SAFETY: each caller queues a kernel that writes every value before one that reads it.
        unsafe { self.device.alloc::<V>(count) }
    }

    /// Makes a tensor of values.
    pub fn tensor(&self, values: CudaSlice<T>, shape: impl Into<Shape>) -> Tensor {
        let storage = CudaStorage::wrap_cuda_slice(values, self.device.clone());
        Tensor::from_storage(Storage::Cuda(storage), shape, BackpropOp::none(), false)
    }

    /// Computes `count` products c = alpha a b, where a is (m, k), b is (k, n) and c is (m, n).
    pub fn multiply(
        &self,
        c: Matrix,
        a: Matrix,
        b: Matrix,
        [m, n, k]: [usize; 3],
        count: usize,
        alpha: f32,
    ) -> Result<()> {
        let operation = |matrix: Matrix| match matrix.transposed {
            true => sys::cublasOperation_t::CUBLAS_OP_T,
            false => sys::cublasOperation_t::CUBLAS_OP_N,
        };
        let (alpha, beta) = (alpha, 0f32);
        // cuBLAS is column-major: it sees each matrix transposed, and cᵀ = bᵀ aᵀ.
        // SAFETY: the matrices lie inside tensors of their sizes; alpha and beta are f32, as the compute type wants.
        let done = unsafe {
            result::gemm_strided_batched_ex(
                *self.device.cublas_handle().handle(),
                operation(b),
                operation(a),
                n as i32,
                m as i32,
                k as i32,
                (&raw const alpha).cast(),
                b.at as *const _,
                T::TYPE,
                b.stride as i32,
                b.step as i64,
                a.at as *const _,
                T::TYPE,
                a.stride as i32,
                a.step as i64,
                (&raw const beta).cast(),
                c.at as *mut _,
                T::TYPE,
                c.stride as i32,
                c.step as i64,
                count as i32,
                sys::cublasComputeType_t::CUBLAS_COMPUTE_32F,
                sys::cublasGemmAlgo_t::CUBLAS_GEMM_DEFAULT,
            )
        };
        done.w()
    }

    /// Adds a bias `(n)` to each row of `y`, of `count` values in all.
    pub fn add_bias(&self, y: Pointer, bias: Pointer, n: usize, count: usize) -> Result<()> {
        launch!(self, self.name("add_bias"), elementwise(count)?, y, bias, n as u32, count as u32);
        Ok(())
    }

    /// Sorts rows (images, tokens, parts, heads, size) as (parts, images, heads, tokens, size), and adds a bias (parts, heads, size).
    pub fn split_heads(
        &self,
        x: Pointer,
        bias: Option<Pointer>,
        y: Pointer,
        [parts, images, heads, tokens, size]: [usize; 5],
    ) -> Result<()> {
        let config = elementwise(parts * images * heads * tokens * size)?;
        launch!(
            self,
            self.name("split_heads"),
            config,
            x,
            bias.unwrap_or(0),
            y,
            parts as u32,
            images as u32,
            heads as u32,
            tokens as u32,
            size as u32,
        );
        Ok(())
    }

    /// The inverse of [`Gpu::split_heads`], without bias.
    pub fn join_heads(&self, x: Pointer, y: Pointer, [parts, images, heads, tokens, size]: [usize; 5]) -> Result<()> {
        let config = elementwise(parts * images * heads * tokens * size)?;
        launch!(
            self,
            self.name("join_heads"),
            config,
            x,
            y,
            parts as u32,
            images as u32,
            heads as u32,
            tokens as u32,
            size as u32
        );
        Ok(())
    }

    /// Replaces rows of n values, `stride` apart, by the softmax of `scale` times them.
    pub fn softmax(&self, x: Pointer, n: usize, stride: usize, rows: usize, scale: f32) -> Result<()> {
        let config = rows_of_blocks(rows.div_ceil(SOFTMAX_ROWS), 32 * SOFTMAX_ROWS as u32);
        launch!(self, self.name("softmax"), config, x, n as u32, stride as u32, rows as u32, scale);
        Ok(())
    }

    /// Replaces the gradients `grad` behind a softmax with weights `a` by those before it.
    pub fn softmax_gradient(
        &self,
        a: Pointer,
        grad: Pointer,
        n: usize,
        stride: usize,
        rows: usize,
        scale: f32,
    ) -> Result<()> {
        let config = rows_of_blocks(rows.div_ceil(SOFTMAX_ROWS), 32 * SOFTMAX_ROWS as u32);
        launch!(self, self.name("softmax_gradient"), config, a, grad, n as u32, stride as u32, rows as u32, scale);
        Ok(())
    }

    /// Normalises rows of `d` values, then applies weight and bias `(d)` if there are any.
    pub fn layer_norm(
        &self,
        x: Pointer,
        affine: Option<[Pointer; 2]>,
        y: Pointer,
        [rows, d]: [usize; 2],
        eps: f32,
    ) -> Result<()> {
        let ([weight, bias], with) = (affine.unwrap_or([x, x]), u32::from(affine.is_some()));
        let config = rows_of_blocks(rows, ROW_THREADS);
        launch!(
            self,
            self.name("layer_norm"),
            config,
            x,
            weight,
            bias,
            y,
            d as u32,
            eps,
            with,
            0f32,
            rows as u32,
            0u32,
            0u32
        );
        Ok(())
    }

    /// Normalises rows of `d` values, then computes (1 + γ) y + β; `group` rows each share γ and β, which lie side by side in a
    /// row of `modulation`, `(rows / group, 2 d)`.
    pub fn modulated_norm(
        &self,
        x: Pointer,
        modulation: Pointer,
        y: Pointer,
        [rows, d, group]: [usize; 3],
        eps: f32,
    ) -> Result<()> {
        let (config, d) = (rows_of_blocks(rows, ROW_THREADS), d as u32);
        launch!(
            self,
            self.name("layer_norm"),
            config,
            x,
            modulation,
            modulation,
            y,
            d,
            eps,
            1u32,
            1f32,
            group as u32,
            2 * d,
            d
        );
        Ok(())
    }

    /// Computes the gradient of the input of [`Gpu::layer_norm`], and mean and inverse deviation of each row, `(rows, 2)`.
    pub fn layer_norm_gradient(
        &self,
        x: Pointer,
        weight: Option<Pointer>,
        grad: Pointer,
        dx: Pointer,
        [rows, d]: [usize; 2],
        eps: f32,
    ) -> Result<CudaSlice<f32>> {
        let statistics = self.empty::<f32>(2 * rows)?;
        let (config, with) = (rows_of_blocks(rows, ROW_THREADS), u32::from(weight.is_some()));
        let out = slice_pointer(&statistics);
        launch!(
            self,
            self.name("layer_norm_gradient"),
            config,
            x,
            weight.unwrap_or(x),
            grad,
            dx,
            out,
            d as u32,
            eps,
            with
        );
        Ok(statistics)
    }

    /// Sums over rows `(rows, n)` of `grad`, times `factor` if there is one. Returns `(n)`.
    pub fn column_sums(&self, grad: Pointer, factor: Factor, [rows, n]: [usize; 2]) -> Result<Tensor> {
        let chunks = rows.div_ceil(CHUNK).max(1);
        let partial = self.empty::<f32>(chunks * n)?;
        let (columns, lines) = COLUMN_BLOCK;
        let config = LaunchConfig {
            grid_dim: (n.div_ceil(columns as usize) as u32, chunks as u32, 1),
            block_dim: (columns, lines, 1),
            shared_mem_bytes: 0,
        };
        let (y, statistics, with) = match factor {
            Factor::One => (grad, grad, 0),
            Factor::Values(y) => (y, grad, 1u32),
            Factor::Normalised(x, statistics) => (x, statistics, 2),
        };
        let (from, chunk) = (slice_pointer(&partial), CHUNK as u32);
        launch!(self, self.name("column_sums"), config, grad, y, statistics, from, rows as u32, n as u32, chunk, with);
        let sums = self.empty::<T>(n)?;
        let to = slice_pointer(&sums);
        launch!(self, self.name("sum_partial"), elementwise(n)?, from, to, chunks as u32, n as u32);
        Ok(self.tensor(sums, n))
    }

    /// Computes y = x Φ(x).
    pub fn gelu(&self, x: Pointer, y: Pointer, count: usize) -> Result<()> {
        launch!(self, self.name("gelu"), elementwise(count)?, x, y, count as u32);
        Ok(())
    }

    /// Multiplies `grad` by the derivative of x Φ(x).
    pub fn gelu_gradient(&self, x: Pointer, grad: Pointer, count: usize) -> Result<()> {
        launch!(self, self.name("gelu_gradient"), elementwise(count)?, x, grad, count as u32);
        Ok(())
    }

    /// Computes out = h + λ y, with λ `(n)`.
    pub fn residual(
        &self,
        h: Pointer,
        y: Pointer,
        lambda: Pointer,
        out: Pointer,
        n: usize,
        count: usize,
    ) -> Result<()> {
        launch!(self, self.name("residual"), elementwise(count)?, h, y, lambda, out, n as u32, count as u32);
        Ok(())
    }

    /// Computes out = λ grad, with λ `(n)`.
    pub fn scale_columns(&self, grad: Pointer, lambda: Pointer, out: Pointer, n: usize, count: usize) -> Result<()> {
        launch!(self, self.name("scale_columns"), elementwise(count)?, grad, lambda, out, n as u32, count as u32);
        Ok(())
    }
}

impl Gpu<'_, f32> {
    /// Copies a list of weights to the GPU, as `Weight` of `kernels.cu`.
    fn list(&self, weights: &[Weight]) -> Result<CudaSlice<u64>> {
        let words = weights.iter().flat_map(|weight| {
            let factors = u64::from(weight.rate.to_bits()) | u64::from(weight.shrink.to_bits()) << 32;
            weight.arrays.into_iter().chain([weight.count as u64, factors])
        });
        self.device.clone_htod(&words.collect::<Vec<u64>>())
    }

    /// Takes one step of AdamW on all weights.
    pub fn adamw(&self, weights: &[Weight], step: AdamStep) -> Result<()> {
        let AdamStep { scale, corrections: [c1, c2], betas: [b1, b2], eps, decay } = step;
        let list = self.list(weights)?;
        let at = slice_pointer(&list);
        launch!(self, "adamw", shared(weights.len()), at, scale, c1, c2, b1, b2, eps, decay);
        Ok(())
    }

    /// Sums the squares of all gradients, in f64.
    pub fn squares(&self, weights: &[Weight]) -> Result<f64> {
        let sums = self.empty::<f64>(weights.len() * SHARED_BLOCKS as usize)?;
        let (list, out) = (self.list(weights)?, slice_pointer(&sums));
        let at = slice_pointer(&list);
        launch!(self, "squares", shared(weights.len()), at, out);
        Ok(self.device.clone_dtoh(&sums)?.iter().sum())
    }
}

/// Factor of each term in a sum over rows.
#[derive(Clone, Copy)]
pub enum Factor {
    /// Nothing.
    One,
    /// Values of the same shape.
    Values(Pointer),
    /// Values of the same shape after normalisation, with the statistics of their rows.
    Normalised(Pointer, Pointer),
}

/// True if the kernels accept these tensors: all f32 or all bf16, on a GPU.
pub fn takes(tensors: &[&Tensor]) -> bool {
    let kind = tensors.first().map(|tensor| tensor.dtype());
    matches!(kind, Some(DType::F32 | DType::BF16))
        && tensors.iter().all(|tensor| tensor.device().is_cuda() && Some(tensor.dtype()) == kind)
}
