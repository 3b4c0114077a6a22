//! Kernels of egotac.
//!
//! | module | contents |
//! |---|---|
//! | [`ops`] | operations on candle tensors with their gradients, for training and as the reference of inference |
//! | [`packed`], [`norm`], [`attention`] | layers laid out once for inference, on slices |
//! | [`activations`], [`rows`] | their inputs: rows of f32, and the same rows in 16 or 8 bits |
//! | [`team`] | threads that share the many short steps of one inference |
//! | [`gpu`] | NVIDIA GPUs, on which [`ops`] run too |
//! | [`peak`] | the most that the processor computes and reads |
//! | [`simd`] | loops compiled for the widest vectors of the processor at hand |
//!
//! From the bottom of the inference side: `tile`, `tile8` and `amx` multiply a few rows by a panel of weights in registers,
//! `packed` cuts a layer into such tiles and distributes them over a `team`. The network itself (which layer follows
//! which) is not known here.
//!
//! # Unsafe code
//!
//! All of it lies in the modules marked below. Everything public is safe to call: sizes are checked against slices
//! before a pointer is formed from them.

#[allow(unsafe_code)] // a pointer shared by tasks that write disjoint parts
pub mod activations;
#[allow(unsafe_code)] // plain numbers seen as bytes of cache lines, and back
mod aligned;
#[allow(unsafe_code)] // assembly, and pointers into panels
mod amx;
#[allow(unsafe_code)] // tiles that write disjoint parts of one result
pub mod attention;
#[allow(unsafe_code)] // settings of the device's memory
#[cfg(not(miri))]
pub mod gpu;
#[cfg(not(miri))]
pub mod norm;
#[cfg(not(miri))] // needs candle, which miri is not given
pub mod ops;
#[allow(unsafe_code)] // tiles that write disjoint parts of one result
pub mod packed;
#[allow(unsafe_code)] // vector instructions, and a block of the matrix unit
pub mod peak;
#[allow(unsafe_code)] // vector instructions
mod quantise;
pub mod rows;
pub mod simd;
#[allow(unsafe_code)] // a borrowed task and disjoint parts of one slice, shared between threads
pub mod team;
#[allow(unsafe_code)] // vector instructions and pointers into panels
mod tile;
#[allow(unsafe_code)] // vector instructions and pointers into panels
mod tile8;
