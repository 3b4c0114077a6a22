//! Tensors by name for a network's constructor, with every misfit written down.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Mutex;

use candle_core::{DType, Device, Shape, Tensor};
use candle_nn::var_builder::SimpleBackend;
use candle_nn::{Init, VarBuilder};

use crate::error::{Error, Result};

/// Misfits named in one message.
const MAX_NAMED: usize = 8;

/// Hands out tensors to constructors and writes down every misfit, so that one message can name them all.
#[derive(Clone)]
pub(super) struct Loader(std::sync::Arc<LoaderState>);

struct LoaderState {
    tensors: BTreeMap<String, Tensor>,
    asked: Mutex<Asked>,
}

#[derive(Default)]
struct Asked {
    names: BTreeSet<String>,
    count: usize,
    misfits: Vec<String>,
}

impl Loader {
    /// Has these to give.
    pub fn new(tensors: BTreeMap<String, Tensor>) -> Self {
        Self(std::sync::Arc::new(LoaderState { tensors, asked: Mutex::default() }))
    }

    /// For constructors, in f32.
    pub fn var_builder(&self, device: &Device) -> VarBuilder<'static> {
        self.var_builder_of(DType::F32, device)
    }

    /// For constructors, in another format.
    pub fn var_builder_of(&self, dtype: DType, device: &Device) -> VarBuilder<'static> {
        VarBuilder::from_backend(Box::new(self.clone()), dtype, device.clone())
    }

    /// Elements of all tensors asked for so far.
    pub fn count(&self) -> Result<usize> {
        self.0.asked.lock().map(|asked| asked.count).map_err(|_| Error::value("loader", "an intact one", "a dead one"))
    }

    /// Says what did not fit, once everything has been asked for.
    pub fn finish(&self, path: &Path) -> Result<()> {
        let Ok(asked) = self.0.asked.lock() else { return Err(Error::file(path, "a thread died while loading")) };
        let unexpected = self.0.tensors.iter().filter(|(name, _)| !asked.names.contains(*name));
        let unexpected = unexpected.map(|(name, t)| format!("{name}: expected no such tensor, found {:?}", t.dims()));
        let misfits: Vec<String> = asked.misfits.iter().cloned().chain(unexpected).collect();
        if misfits.is_empty() {
            return Ok(());
        }
        let more = match misfits.len() {
            n if n > MAX_NAMED => format!("; and {} more", n - MAX_NAMED),
            _ => String::new(),
        };
        let named = misfits[..misfits.len().min(MAX_NAMED)].join("; ");
        Err(Error::file(path, format!("{} of the network's tensors do not fit: {named}{more}", misfits.len())))
    }
}

impl SimpleBackend for Loader {
    fn get(&self, shape: Shape, name: &str, _: Init, dtype: DType, device: &Device) -> candle_core::Result<Tensor> {
        let Ok(mut asked) = self.0.asked.lock() else { candle_core::bail!("a thread died while loading") };
        asked.names.insert(name.to_string());
        asked.count += shape.elem_count();
        let found = match self.0.tensors.get(name) {
            Some(tensor) if tensor.shape() == &shape => return tensor.to_device(device)?.to_dtype(dtype),
            Some(tensor) => format!("found {:?}", tensor.dims()),
            None => "found none".into(),
        };
        asked.misfits.push(format!("{name}: expected {:?}, {found}", shape.dims()));
        // Goes on with zeros; `finish` turns the misfits into the error.
        Tensor::zeros(shape, dtype, device)
    }

    fn get_unchecked(&self, name: &str, _: DType, _: &Device) -> candle_core::Result<Tensor> {
        candle_core::bail!("tensor {name} was asked for without a shape")
    }

    fn contains_tensor(&self, name: &str) -> bool {
        self.0.tensors.contains_key(name)
    }
}
