//! Agreement of all ranks: on the run, its state, and the next step.

use candle_core::{Device, Tensor};

use super::Control;
use super::checkpoint::Progress;
use super::config::Config;
use super::optimizer::AdamW;
use super::param::with_host;
use super::ranks::Communicator;
use super::setup::Data;
use crate::error::{Error, Result};

/// Checks that configuration and training data are those of rank 0, and that all ranks sum gradients in the same way.
///
/// # Errors
/// If they differ, or another rank has failed.
pub fn same_run(ranks: &dyn Communicator, config: &Config, data: &Data, device: &Device) -> Result<()> {
    same_as_root(ranks, "devices (CPU or GPU)", u32::from(ranks.sums_on(device).is_some()))?;
    let yaml = serde_yaml::to_string(config).map_err(|e| Error::value("config", "one that YAML can hold", e))?;
    same_as_root(ranks, "configuration", crc32fast::hash(yaml.as_bytes()))?;
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&data.metadata.force_scale.to_le_bytes());
    for (store, episode) in data.training.episodes() {
        [store, episode.start, episode.end].iter().for_each(|number| hasher.update(&number.to_le_bytes()));
    }
    same_as_root(ranks, "training stores", hasher.finalize())
}

/// Checks that the weights are those of rank 0: the ranks take the same steps, so others mean that a machine computes wrongly.
///
/// # Errors
/// If they differ, a variable can't be read, or another rank has failed.
pub fn same_weights(ranks: &dyn Communicator, optimizer: &AdamW) -> Result<()> {
    if ranks.size() == 1 {
        return Ok(());
    }
    let mut hasher = crc32fast::Hasher::new();
    for param in optimizer.params() {
        with_host(param.var.as_tensor(), |weights| {
            weights.iter().for_each(|weight| hasher.update(&weight.to_le_bytes()));
        })?;
    }
    same_as_root(ranks, "weights", hasher.finalize())
}

/// Gives the state of rank 0 to all ranks, and returns its progress.
///
/// # Errors
/// If a variable can't be set, or another rank has failed.
pub fn share_state(ranks: &dyn Communicator, optimizer: &mut AdamW, progress: Progress) -> Result<Progress> {
    if ranks.size() == 1 {
        return Ok(progress);
    }
    let [step, began, steps] = [progress.step, progress.ranks, optimizer.steps()].map(|number| number as f64);
    let [step, began, steps] = of_root(ranks, [step, began, steps])?.map(|number| number as usize);
    optimizer.restore(steps, |param| {
        let mut weights = with_host(param.var.as_tensor(), <[f32]>::to_vec)?;
        ranks.broadcast(&mut weights)?;
        let mut state = param.state()?.map(std::borrow::Cow::into_owned);
        match step {
            // Moments are 0 on all ranks, and the average begins at the weights.
            0 => state[2].copy_from_slice(&weights),
            _ => state.iter_mut().try_for_each(|values| ranks.broadcast(values))?,
        }
        param.set_state(state)?;
        Ok(param.var.set(&Tensor::from_vec(weights, param.var.shape(), param.var.device())?)?)
    })?;
    Ok(Progress { step, ranks: began })
}

/// Returns what all ranks do next: they stop if one of them is asked to, and without validation if one is asked for that.
///
/// # Errors
/// If another rank has failed.
pub fn agree(ranks: &dyn Communicator, control: Control) -> Result<Control> {
    let mut asked = [Control::Stop, Control::StopUnvalidated].map(|answer| f64::from(u8::from(control == answer)));
    ranks.sum_f64(&mut asked)?;
    Ok(match asked {
        [_, unvalidated] if unvalidated > 0.0 => Control::StopUnvalidated,
        [stop, _] if stop > 0.0 => Control::Stop,
        _ => Control::Continue,
    })
}

fn same_as_root(ranks: &dyn Communicator, what: &str, checksum: u32) -> Result<()> {
    // A u32 is exact in f64.
    let [root] = of_root(ranks, [f64::from(checksum)])?;
    match root == f64::from(checksum) {
        true => Ok(()),
        false => Err(Error::value(format!("{what} of rank {}", ranks.rank()), "those of rank 0", "other ones")),
    }
}

/// Returns the values of rank 0.
fn of_root<const N: usize>(ranks: &dyn Communicator, values: [f64; N]) -> Result<[f64; N]> {
    let mut sums = if ranks.is_root() { values } else { [0.0; N] };
    ranks.sum_f64(&mut sums)?;
    Ok(sums)
}
