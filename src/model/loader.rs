//! Tensors by name for the constructors of a network, with a record of every mismatch.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use candle_core::{DType, Device, Shape, Tensor};
use candle_nn::var_builder::SimpleBackend;
use candle_nn::{Init, VarBuilder};

use crate::error::{Error, Result};

/// Mismatches listed in one message.
const MAX_NAMED: usize = 8;

/// Gives tensors to constructors and records every mismatch, so that one message can list them all.
#[derive(Clone)]
pub(super) struct Loader(std::sync::Arc<LoaderState>);

struct LoaderState {
    tensors: BTreeMap<String, Tensor>,
    requests: Mutex<Requests>,
}

#[derive(Default)]
struct Requests {
    names: BTreeSet<String>,
    count: usize,
    mismatches: Vec<String>,
}

impl Loader {
    /// Creates a loader of these tensors.
    pub fn new(tensors: BTreeMap<String, Tensor>) -> Self {
        Self(std::sync::Arc::new(LoaderState { tensors, requests: Mutex::default() }))
    }

    /// Returns a builder for constructors, in f32.
    pub fn var_builder(&self, device: &Device) -> VarBuilder<'static> {
        self.var_builder_of(DType::F32, device)
    }

    /// Returns a builder for constructors, in another format.
    pub fn var_builder_of(&self, dtype: DType, device: &Device) -> VarBuilder<'static> {
        VarBuilder::from_backend(Box::new(self.clone()), dtype, device.clone())
    }

    /// Returns the number of elements of all tensors requested so far.
    pub fn count(&self) -> usize {
        self.requests().count
    }

    /// The record of requests; it stays valid if another thread panics.
    fn requests(&self) -> MutexGuard<'_, Requests> {
        self.0.requests.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Checks, after all requests, that each tensor was requested and fitted.
    ///
    /// # Errors
    /// Lists the mismatches, and `path` as the file.
    pub fn finish(&self, path: &Path) -> Result<()> {
        let requests = self.requests();
        let unexpected = self.0.tensors.iter().filter(|(name, _)| !requests.names.contains(*name));
        let unexpected = unexpected.map(|(name, t)| format!("{name}: expected no such tensor, found {:?}", t.dims()));
        let mismatches: Vec<String> = requests.mismatches.iter().cloned().chain(unexpected).collect();
        if mismatches.is_empty() {
            return Ok(());
        }
        let more = match mismatches.len() {
            n if n > MAX_NAMED => format!("; and {} more", n - MAX_NAMED),
            _ => String::new(),
        };
        let named = mismatches[..mismatches.len().min(MAX_NAMED)].join("; ");
        Err(Error::file(path, format!("{} of the network's tensors do not fit: {named}{more}", mismatches.len())))
    }
}

impl SimpleBackend for Loader {
    fn get(&self, shape: Shape, name: &str, _: Init, dtype: DType, device: &Device) -> candle_core::Result<Tensor> {
        let mut requests = self.requests();
        requests.names.insert(name.to_string());
        requests.count += shape.elem_count();
        let found = match self.0.tensors.get(name) {
            Some(tensor) if tensor.shape() == &shape => return tensor.to_device(device)?.to_dtype(dtype),
            Some(tensor) => format!("found {:?}", tensor.dims()),
            None => "found none".into(),
        };
        requests.mismatches.push(format!("{name}: expected {:?}, {found}", shape.dims()));
        // Continues with zeros, to find all mismatches; `finish` reports them.
        Tensor::zeros(shape, dtype, device)
    }

    fn get_unchecked(&self, name: &str, _: DType, _: &Device) -> candle_core::Result<Tensor> {
        candle_core::bail!("tensor {name} was requested without a shape")
    }

    fn contains_tensor(&self, name: &str) -> bool {
        self.0.tensors.contains_key(name)
    }
}
