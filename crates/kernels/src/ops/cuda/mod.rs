//! The operations on an NVIDIA GPU, in f32 and bf16: matrix products by cuBLAS, the rest by the kernels of `kernels.cu`, which
//! join what candle would do in several passes over memory.

#[allow(unsafe_code)] // launches of kernels and cuBLAS, which take pointers
mod gpu;
mod operation;
mod operations;
mod optimizer;
#[allow(unsafe_code)] // a recording is sent between threads
mod recording;

pub use gpu::{AdamStep, takes};
pub use operations::{gelu_linear, layer_norm, linear, modulated_norm, scaled_residual, self_attention};
pub use optimizer::{Stepping, adamw, squares};
pub use recording::Recording;
