//! The operations of the parent module on a GPU, with their gradients.

use std::sync::OnceLock;

use candle_core::cuda_backend::cudarc::driver::CudaSlice;
use candle_core::{Result, Shape, Tensor, bail};

use super::gpu::{Factor, Gpu, Matrix, Pointer, Value, slice_pointer, tensor_pointer};
use super::operation::{Operand, Operation, apply};

/// Rows of attention weights begin at multiples of this many values, as tensor cores read them.
const ALIGNED: usize = 8;

/// See [`super::super::linear`].
pub fn linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    apply(Linear, [x, weight, bias])
}

/// See [`super::super::gelu_linear`].
pub fn gelu_linear(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor> {
    apply(GeluLinear::default(), [x, weight, bias])
}

/// See [`super::super::self_attention`].
pub fn self_attention(x: &Tensor, weight: &Tensor, bias: &Tensor, heads: usize) -> Result<Tensor> {
    apply(SelfAttention { heads, kept: OnceLock::new() }, [x, weight, bias])
}

/// See [`super::super::layer_norm`].
pub fn layer_norm(x: &Tensor, affine: Option<(&Tensor, &Tensor)>, eps: f64) -> Result<Tensor> {
    let (weight, bias) = affine.unwrap_or((x, x));
    apply(LayerNorm { eps: eps as f32, affine: affine.is_some() }, [x, weight, bias])
}

/// See [`super::super::modulated_norm`]; without gradients.
pub fn modulated_norm(h: &Tensor, modulation: &Tensor, eps: f64) -> Result<Tensor> {
    apply(ModulatedNorm { eps: eps as f32 }, [h, modulation, modulation])
}

/// See [`super::super::scaled_residual`].
pub fn scaled_residual(h: &Tensor, y: &Tensor, lambda: &Tensor) -> Result<Tensor> {
    apply(ScaledResidual, [h, y, lambda])
}

/// Returns rows and columns of a tensor whose last dimension is the columns.
fn rows(dims: &[usize]) -> Result<[usize; 2]> {
    match dims.split_last() {
        Some((last, front)) if *last > 0 => Ok([front.iter().product(), *last]),
        _ => bail!("expected rows of values, got {dims:?}"),
    }
}

/// `x Wᵀ + b`. `x`: `(.., k)`, `weight`: `(n, k)`, `bias`: `(n)`.
struct Linear;

/// Returns the shape of `x Wᵀ + b`, and its rows, outputs and inputs (m, n, k).
fn linear_shape(operands: [Operand; 3]) -> Result<(Shape, [usize; 3])> {
    let shape = super::super::linear::shape(operands.map(|operand| operand.dims()))?;
    let [x, weight, _] = operands;
    let (n, k) = weight.layout.shape().dims2()?;
    Ok((shape, [x.count() / k.max(1), n, k]))
}

/// Queues y = x Wᵀ, without bias.
fn product<T: Value>(gpu: &Gpu<T>, x: Pointer, weight: Pointer, [m, n, k]: [usize; 3]) -> Result<CudaSlice<T>> {
    let out = gpu.empty::<T>(m * n)?;
    gpu.multiply(
        Matrix::new(slice_pointer(&out), n),
        Matrix::new(x, k),
        Matrix::new(weight, k).t(),
        [m, n, k],
        1,
        1.0,
    )?;
    Ok(out)
}

/// Queues the gradient of the input of a linear layer: that of the output, `(m, n)`, times the weights, `(n, k)`.
fn input_gradient<T: Value>(gpu: &Gpu<T>, grad: Pointer, weight: &Tensor, m: usize) -> Result<CudaSlice<T>> {
    let (n, k) = weight.dims2()?;
    let out = gpu.empty::<T>(m * k)?;
    let weight = Matrix::new(tensor_pointer::<T>(weight)?, k);
    gpu.multiply(Matrix::new(slice_pointer(&out), k), Matrix::new(grad, n), weight, [m, k, n], 1, 1.0)?;
    Ok(out)
}

/// Queues the gradients of weight and bias; `None` for one that is not a variable.
fn parameter_gradients<T: Value>(
    gpu: &Gpu<T>,
    x: Pointer,
    weight: &Tensor,
    bias: &Tensor,
    grad: Pointer,
    m: usize,
) -> Result<[Option<Tensor>; 2]> {
    let (n, k) = weight.dims2()?;
    let dweight = match weight.track_op() {
        true => {
            let out = gpu.empty::<T>(n * k)?;
            let grad = Matrix::new(grad, n).t();
            gpu.multiply(Matrix::new(slice_pointer(&out), k), grad, Matrix::new(x, k), [n, k, m], 1, 1.0)?;
            Some(gpu.tensor(out, (n, k)))
        }
        false => None,
    };
    let dbias = match bias.track_op() {
        true => Some(gpu.column_sums(grad, Factor::One, [m, n])?),
        false => None,
    };
    Ok([dweight, dbias])
}

/// Queues the gradients of input, weight and bias of a linear layer; `None` for one that is not a variable. `grad`: that of the output.
fn gradients<T: Value>(gpu: &Gpu<T>, [x, weight, bias]: [&Tensor; 3], grad: Pointer) -> Result<[Option<Tensor>; 3]> {
    let [m, _] = rows(x.dims())?;
    let dx = match x.track_op() {
        true => Some(gpu.tensor(input_gradient(gpu, grad, weight, m)?, x.shape())),
        false => None,
    };
    let [dweight, dbias] = parameter_gradients(gpu, tensor_pointer::<T>(x)?, weight, bias, grad, m)?;
    Ok([dx, dweight, dbias])
}

impl Operation for Linear {
    const NAME: &'static str = "linear-gpu";

    fn forward<T: Value>(&self, gpu: &Gpu<T>, operands: [Operand; 3]) -> Result<(CudaSlice<T>, Shape)> {
        let (shape, sizes @ [m, n, _]) = linear_shape(operands)?;
        let [x, weight, bias] = operands;
        let out = product(gpu, x.at, weight.at, sizes)?;
        gpu.add_bias(slice_pointer(&out), bias.at, n, m * n)?;
        Ok((out, shape))
    }

    fn backward<T: Value>(&self, gpu: &Gpu<T>, operands: [&Tensor; 3], grad: &Tensor) -> Result<[Option<Tensor>; 3]> {
        gradients(gpu, operands, tensor_pointer::<T>(grad)?)
    }
}

/// `(x Φ(x)) Wᵀ + b`.
#[derive(Default)]
struct GeluLinear {
    /// x Φ(x), kept for the backward pass.
    activated: OnceLock<Tensor>,
}

impl Operation for GeluLinear {
    const NAME: &'static str = "gelu-linear-gpu";

    fn forward<T: Value>(&self, gpu: &Gpu<T>, operands: [Operand; 3]) -> Result<(CudaSlice<T>, Shape)> {
        let (shape, sizes @ [m, n, _]) = linear_shape(operands)?;
        let [x, weight, bias] = operands;
        let activated = gpu.empty::<T>(x.count())?;
        let at = slice_pointer(&activated);
        gpu.gelu(x.at, at, x.count())?;
        let out = product(gpu, at, weight.at, sizes)?;
        gpu.add_bias(slice_pointer(&out), bias.at, n, m * n)?;
        // Fails only if the forward pass runs twice, with the same input and so the same values.
        let _ = self.activated.set(gpu.tensor(activated, x.dims()));
        Ok((out, shape))
    }

    fn backward<T: Value>(
        &self,
        gpu: &Gpu<T>,
        [x, weight, bias]: [&Tensor; 3],
        grad: &Tensor,
    ) -> Result<[Option<Tensor>; 3]> {
        let Some(activated) = self.activated.get() else { bail!("gelu: backward without forward") };
        let [m, _] = rows(x.dims())?;
        let grad = tensor_pointer::<T>(grad)?;
        let dx = input_gradient(gpu, grad, weight, m)?;
        gpu.gelu_gradient(tensor_pointer::<T>(x)?, slice_pointer(&dx), x.elem_count())?;
        let [dweight, dbias] = parameter_gradients(gpu, tensor_pointer::<T>(activated)?, weight, bias, grad, m)?;
        Ok([Some(gpu.tensor(dx, x.shape())), dweight, dbias])
    }
}

/// softmax(q kᵀ / √size) v per head, of q, k and v side by side, `x Wᵀ + b`.
struct SelfAttention {
    heads: usize,
    /// q, k and v by head, `(3, B, heads, N, size)`, and attention weights, `(B heads, N, stride)`, kept for the backward pass.
    kept: OnceLock<(Tensor, Tensor)>,
}

/// Sizes of an attention: images, tokens and width, heads and their width, and values from row to row of the weights.
#[derive(Clone, Copy)]
struct Sizes {
    images: usize,
    n: usize,
    d: usize,
    heads: usize,
    size: usize,
    stride: usize,
}

impl Sizes {
    /// `dims`: shape of queries, keys and values side by side.
    fn new(dims: &[usize], heads: usize) -> Result<Self> {
        match *dims {
            [images, n, d3] if heads > 0 && n > 0 && d3 > 0 && d3 % (3 * heads) == 0 => {
                let (d, stride) = (d3 / 3, n.next_multiple_of(ALIGNED));
                Ok(Self { images, n, d, heads, size: d / heads, stride })
            }
            _ => bail!("self-attention: {heads} heads, expected (B, N, 3 x a multiple of them), got {dims:?}"),
        }
    }

    /// Sizes of `parts` sorted by head.
    fn sorted(&self, parts: usize) -> [usize; 5] {
        [parts, self.images, self.heads, self.n, self.size]
    }

    /// Number of attentions: one per image and head.
    fn count(&self) -> usize {
        self.images * self.heads
    }

    /// Rows of attention weights.
    fn rows(&self) -> usize {
        self.count() * self.n
    }

    /// 1/√size.
    fn scale(&self) -> f32 {
        1.0 / (self.size as f32).sqrt()
    }

    /// The n-th of several arrays `(B heads, N, size)` behind each other.
    fn head<T>(&self, first: Pointer, part: usize) -> Matrix {
        let values = part * self.count() * self.n * self.size;
        Matrix::batch(first + (values * size_of::<T>()) as u64, self.n, self.size)
    }

    /// Attention weights, or their gradients.
    fn weights(&self, at: Pointer) -> Matrix {
        Matrix { at, stride: self.stride, step: self.n * self.stride, transposed: false }
    }
}

impl Operation for SelfAttention {
    const NAME: &'static str = "self-attention-gpu";

    fn forward<T: Value>(&self, gpu: &Gpu<T>, operands: [Operand; 3]) -> Result<(CudaSlice<T>, Shape)> {
        let (shape, linear) = linear_shape(operands)?;
        let sizes = Sizes::new(shape.dims(), self.heads)?;
        let Sizes { images, n, d, size, stride, .. } = sizes;
        let [x, weight, bias] = operands;
        let projected = product(gpu, x.at, weight.at, linear)?;
        let sorted = gpu.empty::<T>(3 * images * n * d)?;
        let qkv = slice_pointer(&sorted);
        gpu.split_heads(slice_pointer(&projected), Some(bias.at), qkv, sizes.sorted(3))?;
        let weights = gpu.empty::<T>(sizes.rows() * stride)?;
        let a = sizes.weights(slice_pointer(&weights));
        let [q, k, v] = [0, 1, 2].map(|part| sizes.head::<T>(qkv, part));
        gpu.multiply(a, q, k.t(), [n, n, size], sizes.count(), 1.0)?;
        gpu.softmax(a.at, n, stride, sizes.rows(), sizes.scale())?;
        let attended = gpu.empty::<T>(images * n * d)?;
        let by_head = slice_pointer(&attended);
        gpu.multiply(sizes.head::<T>(by_head, 0), a, v, [n, size, n], sizes.count(), 1.0)?;
        let out = gpu.empty::<T>(images * n * d)?;
        gpu.join_heads(by_head, slice_pointer(&out), sizes.sorted(1))?;
        let kept = (gpu.tensor(sorted, 3 * images * n * d), gpu.tensor(weights, sizes.rows() * stride));
        // Fails only if the forward pass runs twice, with the same input and so the same values.
        let _ = self.kept.set(kept);
        Ok((out, Shape::from((images, n, d))))
    }

    /// With a the weights and g the gradient of the output: dv = aᵀ g, s = the gradient of a, g vᵀ, through the softmax, dq = s k,
    /// dk = sᵀ q.
    fn backward<T: Value>(&self, gpu: &Gpu<T>, operands: [&Tensor; 3], grad: &Tensor) -> Result<[Option<Tensor>; 3]> {
        let Some((sorted, weights)) = self.kept.get() else { bail!("self-attention: backward without forward") };
        let (images, n, d) = grad.dims3()?;
        let sizes = Sizes::new(&[images, n, 3 * d], self.heads)?;
        let (size, stride, count) = (sizes.size, sizes.stride, sizes.count());
        let by_head = gpu.empty::<T>(images * n * d)?;
        gpu.split_heads(tensor_pointer::<T>(grad)?, None, slice_pointer(&by_head), sizes.sorted(1))?;
        let g = sizes.head::<T>(slice_pointer(&by_head), 0);
        let qkv = tensor_pointer::<T>(sorted)?;
        let [q, k, v] = [0, 1, 2].map(|part| sizes.head::<T>(qkv, part));
        let a = sizes.weights(tensor_pointer::<T>(weights)?);
        let by_part = gpu.empty::<T>(3 * images * n * d)?;
        let [dq, dk, dv] = [0, 1, 2].map(|part| sizes.head::<T>(slice_pointer(&by_part), part));
        let scores = gpu.empty::<T>(sizes.rows() * stride)?;
        let s = sizes.weights(slice_pointer(&scores));
        gpu.multiply(dv, a.t(), g, [n, size, n], count, 1.0)?;
        gpu.multiply(s, g, v.t(), [n, n, size], count, 1.0)?;
        gpu.softmax_gradient(a.at, s.at, n, stride, sizes.rows(), sizes.scale())?;
        gpu.multiply(dq, s, k, [n, size, n], count, 1.0)?;
        gpu.multiply(dk, s.t(), q, [n, size, n], count, 1.0)?;
        let projected = gpu.empty::<T>(3 * images * n * d)?;
        let projected_grad = slice_pointer(&projected);
        gpu.join_heads(dq.at, projected_grad, sizes.sorted(3))?;
        gradients(gpu, operands, projected_grad)
    }
}

/// Layer norm; without `affine`, weight and bias are not read.
struct LayerNorm {
    eps: f32,
    affine: bool,
}

impl Operation for LayerNorm {
    const NAME: &'static str = "layer-norm-gpu";

    fn forward<T: Value>(&self, gpu: &Gpu<T>, [x, weight, bias]: [Operand; 3]) -> Result<(CudaSlice<T>, Shape)> {
        let sizes @ [_, d] = rows(x.dims())?;
        if self.affine && (weight.dims() != [d] || bias.dims() != [d]) {
            bail!("layer norm: x {:?}, weight {:?}, bias {:?}", x.dims(), weight.dims(), bias.dims());
        }
        let out = gpu.empty::<T>(x.count())?;
        let affine = self.affine.then_some([weight.at, bias.at]);
        gpu.layer_norm(x.at, affine, slice_pointer(&out), sizes, self.eps)?;
        Ok((out, x.layout.shape().clone()))
    }

    fn backward<T: Value>(
        &self,
        gpu: &Gpu<T>,
        [x, weight, bias]: [&Tensor; 3],
        grad: &Tensor,
    ) -> Result<[Option<Tensor>; 3]> {
        let sizes = rows(x.dims())?;
        let (at, grad) = (tensor_pointer::<T>(x)?, tensor_pointer::<T>(grad)?);
        let scale = match self.affine {
            true => Some(tensor_pointer::<T>(weight)?),
            false => None,
        };
        let dx = gpu.empty::<T>(x.elem_count())?;
        let statistics = gpu.layer_norm_gradient(at, scale, grad, slice_pointer(&dx), sizes, self.eps)?;
        let dx = Some(gpu.tensor(dx, x.shape()));
        if !self.affine || !(weight.track_op() || bias.track_op()) {
            return Ok([dx, None, None]);
        }
        let normalised = Factor::Normalised(at, slice_pointer(&statistics));
        let dweight = gpu.column_sums(grad, normalised, sizes)?;
        Ok([dx, Some(dweight), Some(gpu.column_sums(grad, Factor::One, sizes)?)])
    }
}

/// `(1 + γ) LN(h) + β` with γ and β side by side, per image.
struct ModulatedNorm {
    eps: f32,
}

impl Operation for ModulatedNorm {
    const NAME: &'static str = "modulated-norm-gpu";

    fn forward<T: Value>(&self, gpu: &Gpu<T>, [h, modulation, _]: [Operand; 3]) -> Result<(CudaSlice<T>, Shape)> {
        let (images, steps, d) = h.layout.shape().dims3()?;
        if modulation.dims() != [images, 2 * d] {
            bail!("modulated norm: h {:?}, modulation {:?}", h.dims(), modulation.dims());
        }
        let out = gpu.empty::<T>(h.count())?;
        gpu.modulated_norm(h.at, modulation.at, slice_pointer(&out), [images * steps, d, steps], self.eps)?;
        Ok((out, h.layout.shape().clone()))
    }

    fn backward<T: Value>(&self, _: &Gpu<T>, _: [&Tensor; 3], _: &Tensor) -> Result<[Option<Tensor>; 3]> {
        bail!("modulated norm: no gradients on a GPU")
    }
}

/// `h + λ y`, with λ per channel.
struct ScaledResidual;

impl Operation for ScaledResidual {
    const NAME: &'static str = "scaled-residual-gpu";

    fn forward<T: Value>(&self, gpu: &Gpu<T>, [h, y, lambda]: [Operand; 3]) -> Result<(CudaSlice<T>, Shape)> {
        let [_, d] = rows(h.dims())?;
        if y.dims() != h.dims() || lambda.dims() != [d] {
            bail!("scaled residual: h {:?}, y {:?}, lambda {:?}", h.dims(), y.dims(), lambda.dims());
        }
        let out = gpu.empty::<T>(h.count())?;
        gpu.residual(h.at, y.at, lambda.at, slice_pointer(&out), d, h.count())?;
        Ok((out, h.layout.shape().clone()))
    }

    fn backward<T: Value>(
        &self,
        gpu: &Gpu<T>,
        [h, y, lambda]: [&Tensor; 3],
        grad: &Tensor,
    ) -> Result<[Option<Tensor>; 3]> {
        let sizes @ [_, d] = rows(h.dims())?;
        let at = tensor_pointer::<T>(grad)?;
        let dy = gpu.empty::<T>(y.elem_count())?;
        gpu.scale_columns(at, tensor_pointer::<T>(lambda)?, slice_pointer(&dy), d, y.elem_count())?;
        let dlambda = match lambda.track_op() {
            true => Some(gpu.column_sums(at, Factor::Values(tensor_pointer::<T>(y)?), sizes)?),
            false => None,
        };
        Ok([Some(grad.clone()), Some(gpu.tensor(dy, y.shape())), dlambda])
    }
}
