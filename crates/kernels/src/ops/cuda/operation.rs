//! Differentiable operations on three tensors, as candle calls them.

use candle_core::cuda_backend::CudaStorage;
use candle_core::cuda_backend::cudarc::driver::CudaSlice;
use candle_core::{CpuStorage, CustomOp3, DType, Layout, Result, Shape, Tensor, bail};
use half::bf16;

use super::gpu::{self, Gpu, Pointer, Value};

/// An argument of an [`Operation`]: the address of the values of a contiguous tensor, and its layout.
#[derive(Clone, Copy)]
pub struct Operand<'a> {
    /// First value.
    pub at: Pointer,
    /// Shape of the tensor.
    pub layout: &'a Layout,
}

impl<'a> Operand<'a> {
    /// Dimensions of the tensor.
    pub fn dims(&self) -> &'a [usize] {
        self.layout.dims()
    }

    /// Number of values.
    pub fn count(&self) -> usize {
        self.layout.shape().elem_count()
    }
}

/// A differentiable operation on three tensors. [`apply`] makes it one of candle's.
pub trait Operation: Send + Sync + 'static {
    /// Name in candle's messages.
    const NAME: &'static str;

    /// Queues the computation of the result. Returns its values and shape.
    fn forward<T: Value>(&self, gpu: &Gpu<T>, operands: [Operand; 3]) -> Result<(CudaSlice<T>, Shape)>;

    /// Queues the computation of the gradients of the arguments from that of the result, which is contiguous; `None` where none is
    /// wanted.
    fn backward<T: Value>(&self, gpu: &Gpu<T>, arguments: [&Tensor; 3], grad: &Tensor) -> Result<[Option<Tensor>; 3]>;
}

/// Applies an operation to three tensors.
pub fn apply(operation: impl Operation, arguments: [&Tensor; 3]) -> Result<Tensor> {
    let [a, b, c] = arguments;
    a.contiguous()?.apply_op3(&b.contiguous()?, &c.contiguous()?, Adapter(operation))
}

/// An [`Operation`] as candle calls it.
struct Adapter<O>(O);

impl<O: Operation> Adapter<O> {
    fn run<T: Value>(&self, storages: [&CudaStorage; 3], layouts: [&Layout; 3]) -> Result<(CudaStorage, Shape)> {
        let device = &storages[0].device;
        let operand = |i: usize| -> Result<Operand> {
            Ok(Operand { at: gpu::pointer::<T>(storages[i], layouts[i])?, layout: layouts[i] })
        };
        let (values, shape) = self.0.forward(&Gpu::<T>::new(device), [operand(0)?, operand(1)?, operand(2)?])?;
        Ok((CudaStorage::wrap_cuda_slice(values, device.clone()), shape))
    }
}

impl<O: Operation> CustomOp3 for Adapter<O> {
    fn name(&self) -> &'static str {
        O::NAME
    }

    fn cpu_fwd(
        &self,
        _: &CpuStorage,
        _: &Layout,
        _: &CpuStorage,
        _: &Layout,
        _: &CpuStorage,
        _: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        bail!("{}: the GPU's form was given tensors on the CPU", O::NAME)
    }

    fn cuda_fwd(
        &self,
        a: &CudaStorage,
        a_layout: &Layout,
        b: &CudaStorage,
        b_layout: &Layout,
        c: &CudaStorage,
        c_layout: &Layout,
    ) -> Result<(CudaStorage, Shape)> {
        use candle_core::backend::BackendStorage as _;
        let (storages, layouts) = ([a, b, c], [a_layout, b_layout, c_layout]);
        match a.dtype() {
            DType::F32 => self.run::<f32>(storages, layouts),
            _ => self.run::<bf16>(storages, layouts),
        }
    }

    fn bwd(
        &self,
        a: &Tensor,
        b: &Tensor,
        c: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let device = gpu::device(a)?;
        let (arguments, grad) = ([a, b, c], grad.contiguous()?);
        let [a, b, c] = match grad.dtype() {
            DType::F32 => self.0.backward(&Gpu::<f32>::new(&device), arguments, &grad)?,
            _ => self.0.backward(&Gpu::<bf16>::new(&device), arguments, &grad)?,
        };
        Ok((a, b, c))
    }
}
