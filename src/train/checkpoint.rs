//! Resumable state of a run: weights, optimiser moments, averages and step.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::Tensor;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};

use super::config::MAX_BATCH;
use super::optimizer::AdamW;
use super::param::Param;
use crate::error::{Error, Result};
use crate::file::{self, input, limits};

/// Tensors of a variable's state; each is named KIND.VARIABLE in the file.
const STATE_KINDS: [&str; 4] = ["weight", "moment1", "moment2", "average"];

/// Steps that a run has taken, and the number of ranks that it began with, which determines the size of its batches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Steps taken.
    pub step: usize,
    /// Ranks at the first step.
    pub ranks: usize,
}

/// Saves the state of a run atomically; equal states give equal bytes. `config` identifies the run: [`load`] refuses the state of another one.
///
/// # Errors
/// If the file can't be written.
pub fn save(path: &Path, optimizer: &AdamW, progress: Progress, config: &str) -> Result<()> {
    let bytes = |values: &[f32]| values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let mut tensors = Vec::new();
    for param in optimizer.params() {
        let weight = param.var.flatten_all()?.to_vec1::<f32>()?;
        let [moment1, moment2, average] = &param.state()?;
        for (kind, values) in STATE_KINDS.into_iter().zip([&weight, &**moment1, moment2, average]) {
            tensors.push((format!("{kind}.{}", param.name), param.var.dims().to_vec(), bytes(values)));
        }
    }
    let mut views = Vec::new();
    for (name, shape, data) in &tensors {
        let view = TensorView::new(Dtype::F32, shape.clone(), data);
        views.push((name.as_str(), view.map_err(|e| Error::file(path, format!("{name}: {e}")))?));
    }
    let metadata = BTreeMap::from([
        ("step".to_string(), progress.step.to_string()),
        ("ranks".to_string(), progress.ranks.to_string()),
        ("optimizer_steps".to_string(), optimizer.steps().to_string()),
        ("config".to_string(), config.to_string()),
    ]);
    file::write(path, &file::tensors::to_bytes(path, views, &metadata)?)
}

/// Restores a saved state into variables and optimiser. A state without a number of ranks is that of one.
///
/// # Errors
/// If the file is not a state, belongs to another configuration, has taken more steps than it asks for, or its variables are
/// not the network's.
pub fn load(path: &Path, optimizer: &mut AdamW, config: &str, steps: usize) -> Result<Progress> {
    let bytes = input::read(path, limits::WEIGHTS)?;
    let invalid = |error: &dyn std::fmt::Display| Error::file(path, format!("is not a training state: {error}"));
    let tensors = SafeTensors::deserialize(&bytes).map_err(|e| invalid(&e))?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| invalid(&e))?;
    let metadata = header.metadata().clone().unwrap_or_default();
    let number = |key: &str| {
        metadata.get(key).and_then(|text| text.parse::<usize>().ok()).ok_or_else(|| invalid(&format!("no {key} in it")))
    };
    let (step, optimizer_steps) = (number("step")?, number("optimizer_steps")?);
    let ranks = if metadata.contains_key("ranks") { number("ranks")? } else { 1 };
    check_config(path, metadata.get("config").map_or("", String::as_str), config)?;
    for (name, value, most) in
        [("step", step, steps), ("optimizer_steps", optimizer_steps, step), ("ranks", ranks, MAX_BATCH)]
    {
        if value > most {
            return Err(Error::file(path, Error::value(name, format!("at most {most}"), value)));
        }
    }
    let read = |kind: &str, param: &Param| -> Result<Vec<f32>> {
        let name = format!("{kind}.{}", param.name);
        let tensor = tensors.tensor(&name).map_err(|e| invalid(&e))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != param.var.dims() {
            let got = format!("{:?} {:?}", tensor.dtype(), tensor.shape());
            return Err(Error::file(path, format!("{name}: expected F32 {:?}, got {got}", param.var.dims())));
        }
        Ok(tensor.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
    };
    optimizer.restore(optimizer_steps, |param| {
        let [weight, moment1, moment2, average] = STATE_KINDS.map(|kind| read(kind, param));
        param.var.set(&Tensor::from_vec(weight?, param.var.shape(), param.var.device())?)?;
        param.set_state([moment1?, moment2?, average?])
    })?;
    Ok(Progress { step, ranks: ranks.max(1) })
}

/// Checks that the configuration in a run's file is that of this run.
///
/// # Errors
/// If it differs; names the first line that does.
pub fn check_config(path: &Path, saved: &str, now: &str) -> Result<()> {
    match first_difference(saved, now) {
        Some(difference) => {
            Err(Error::file(path, format!("belongs to a run with another configuration: {difference}")))
        }
        None => Ok(()),
    }
}

/// Describes the first line in which two configurations differ; None if they are equal.
fn first_difference(saved: &str, now: &str) -> Option<String> {
    if saved == now {
        return None;
    }
    let differs = saved.lines().zip(now.lines()).find(|(a, b)| a != b);
    Some(differs.map_or("its length".into(), |(a, b)| format!("`{}` then, `{}` now", a.trim(), b.trim())))
}
