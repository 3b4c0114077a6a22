//! Initial weights from statistics of the data and from the geometry.
//!
//! Random weights predict every vertex at chance and give all patches the same position. The mean of each vertex and the
//! position of each patch are known before training; learning them by gradient takes a small network most of its steps.

use candle_core::{Tensor, Var};
use candle_nn::VarMap;

use super::data::Statistics;
use crate::error::{Error, Result};
use crate::hand::{FieldMap, Topology};
use crate::model::Config;
use crate::tactile::N_FIELD;

/// Least distance of a contact rate from 0 and 1: keeps the initial logits where the sigmoid still has a gradient.
const MIN_RATE: f32 = 1e-4;

/// Amplitude of the position embeddings' waves: that of a patch embedding with random weights.
const AMPLITUDE: f64 = 0.5;

/// Longest and shortest wavelength of the position embeddings, in sides of the patch grid.
const WAVELENGTHS: (f64, f64) = (4.0, 0.25);

/// Sets the biases of the two heads to each vertex's training mean: force in normalised units, contact as the logit that
/// minimises the cross-entropy with `positive_weight`. Sets their weights to zero, since random weights would predict
/// half a unit of force on every vertex.
///
/// # Errors
/// If a head is missing.
pub fn heads(varmap: &VarMap, statistics: &Statistics, force_scale: f32, positive_weight: f32) -> Result<()> {
    let force: Vec<f32> = statistics.mean_force.iter().map(|force| force / force_scale).collect();
    let logit = |rate: &f32| {
        let rate = rate.clamp(MIN_RATE, 1.0 - MIN_RATE);
        (positive_weight * rate / (1.0 - rate)).ln()
    };
    let contact: Vec<f32> = statistics.contact_rate.iter().map(logit).collect();
    for (head, bias) in [("force_head", force), ("contact_head", contact)] {
        let weight = format!("{head}.weight");
        let count = variable(varmap, &weight)?.elem_count();
        set(varmap, &weight, vec![0.0; count])?;
        set(varmap, &format!("{head}.bias"), bias)?;
    }
    Ok(())
}

/// Multiplies the force head's output by `factor`.
///
/// # Errors
/// If the head is missing.
pub fn rescale_force(varmap: &VarMap, factor: f32) -> Result<()> {
    for name in ["force_head.weight", "force_head.bias"] {
        let var = variable(varmap, name)?;
        var.set(&(var.as_tensor() * f64::from(factor))?)?;
    }
    Ok(())
}

/// Carries the rows of both heads over to the vertices of `to`: contact from the nearest vertex, force by the shares of the
/// forces, so that what the heads predict moves with them.
///
/// # Errors
/// If a head is missing.
pub fn carry_heads(varmap: &VarMap, map: &FieldMap, to: Topology) -> Result<()> {
    for head in ["force_head", "contact_head"] {
        for part in ["weight", "bias"] {
            let var = variable(varmap, &format!("{head}.{part}"))?;
            // (1556, d) or (1556): with the vertices last, each channel is a field.
            let shape = var.shape().clone();
            let fields = var.reshape((N_FIELD, ()))?.t()?.flatten_all()?.to_vec1::<f32>()?;
            let carried = match head {
                "force_head" => map.force(to, &fields)?,
                _ => map.nearest(to, &fields)?,
            };
            let carried = Tensor::from_vec(carried, (fields.len() / N_FIELD, N_FIELD), var.device())?;
            var.set(&carried.t()?.contiguous()?.reshape(shape)?)?;
        }
    }
    Ok(())
}

/// Sets the position embeddings to plane waves over the patch grid (half along rows, half along columns; sine and
/// cosine), so that they tell patches apart from the first step. The embedding of CLS stays random.
///
/// # Errors
/// If the embeddings are missing.
pub fn positions(varmap: &VarMap, config: &Config) -> Result<()> {
    const NAME: &str = "encoder.embeddings.position_embeddings";
    let (dv, grid) = (config.vision_width, config.pretrain_grid());
    let var = variable(varmap, NAME)?;
    let mut values = var.flatten_all()?.to_vec1::<f32>()?;
    let quarter = (dv / 4).max(1);
    let (longest, shortest) = WAVELENGTHS;
    for (patch, out) in values.chunks_exact_mut(dv).skip(1).enumerate() {
        for (channel, out) in out.iter_mut().enumerate() {
            let (part, wave) = (channel / quarter, channel % quarter);
            let along = if part % 4 < 2 { patch / grid } else { patch % grid };
            let length = longest * (shortest / longest).powf(wave as f64 / quarter as f64) * grid as f64;
            let phase = std::f64::consts::TAU * along as f64 / length;
            *out = (AMPLITUDE * if part % 2 == 0 { phase.sin() } else { phase.cos() }) as f32;
        }
    }
    set(varmap, NAME, values)
}

fn set(varmap: &VarMap, name: &str, values: Vec<f32>) -> Result<()> {
    let var = variable(varmap, name)?;
    Ok(var.set(&Tensor::from_vec(values, var.shape().clone(), var.device())?)?)
}

fn variable(varmap: &VarMap, name: &str) -> Result<Var> {
    let vars = varmap.data().lock().ok();
    let var = vars.as_ref().and_then(|vars| vars.get(name));
    var.cloned().ok_or_else(|| Error::value("variables", name, "a network without it"))
}
