//! Weights of [`Presence`] as variables, and their loss on frozen tokens.

use std::collections::BTreeMap;

use candle_core::{D, Device, Tensor, Var};
use candle_nn::VarMap;
use egotac_kernels::ops;

use super::super::keypoints;
use super::samples::Truth;
use crate::error::Result;
use crate::model::init;
use crate::model::presence::{FEATURES, N_POINTS, PREFIX, Presence};

/// Weight of a keypoint that is not in view, relative to one that is: most are not, and one class holds them all.
const NOWHERE_WEIGHT: f32 = 0.3;

/// Weight and bias by the name of a layer.
pub struct Head {
    vars: BTreeMap<String, Var>,
}

impl Head {
    /// Creates random weights for tokens of `width` numbers. `keypoints`: weight and bias of a trained layer of keypoint
    /// logits, (42, width) and (42), to begin with.
    ///
    /// # Errors
    /// If `keypoints` has another shape, or memory runs out.
    pub fn new(width: usize, keypoints: Option<(Tensor, Tensor)>, seed: u64) -> Result<Self> {
        let varmap = VarMap::new();
        let vb = init::var_builder(&varmap, seed, &Device::Cpu);
        let mut vars = BTreeMap::new();
        for (name, shape) in Presence::shapes(width) {
            let stdev = match shape[..] {
                [_, inputs] => 1.0 / (inputs as f64).sqrt(),
                _ => 0.0,
            };
            let tensor = vb.get_with_hints(shape, &name, candle_nn::Init::Randn { mean: 0.0, stdev })?;
            vars.insert(name[PREFIX.len()..].to_owned(), Var::from_tensor(&tensor)?);
        }
        if let Some((weight, bias)) = keypoints {
            vars["keypoints.weight"].set(&weight.contiguous()?)?;
            vars["keypoints.bias"].set(&bias.contiguous()?)?;
        }
        Ok(Self { vars })
    }

    /// Returns the variables.
    pub fn vars(&self) -> Vec<Var> {
        self.vars.values().cloned().collect()
    }

    /// Returns the tensors of a checkpoint by name.
    pub fn tensors(&self) -> BTreeMap<String, Tensor> {
        self.vars.iter().map(|(name, var)| (format!("{PREFIX}{name}"), var.as_detached_tensor())).collect()
    }

    fn linear(&self, x: &Tensor, name: &str) -> Result<Tensor> {
        let of = |part: &str| self.vars[&format!("{name}.{part}")].as_tensor();
        Ok(ops::linear(x, of("weight"), of("bias"))?)
    }

    /// Computes the sum of three losses: cross-entropy of presence, cross-entropy of the patches of keypoints, and absolute
    /// error of the offsets, in sides of a patch. No weight is shared between them. `tokens`: (B, P, dv), CLS first.
    ///
    /// # Errors
    /// If shapes don't fit.
    pub fn loss(&self, tokens: &Tensor, truths: &[&Truth]) -> Result<Tensor> {
        let (b, p, width) = tokens.dims3()?;
        let patches = tokens.narrow(1, 1, p - 1)?.contiguous()?;
        let cls = tokens.narrow(1, 0, 1)?.squeeze(1)?.contiguous()?;
        let presence = self.presence_loss(&patches, truths)?;
        let keypoints = self.keypoint_loss(&patches, &cls, truths)?;
        let flat = patches.reshape((b * (p - 1), width))?;
        let offset = self.offset_loss(&flat, p - 1, truths)?;
        Ok(((presence + keypoints)? + offset)?)
    }

    fn presence_loss(&self, patches: &Tensor, truths: &[&Truth]) -> Result<Tensor> {
        let features = self.linear(patches, "features")?.relu()?; // (B, P - 1, 32)
        let pooled = Tensor::cat(&[features.max(1)?, features.mean(1)?], 1)?.contiguous()?; // (B, 64)
        debug_assert_eq!(pooled.dim(1)?, 2 * FEATURES);
        let logits = self.linear(&pooled, "hand")?; // (B, 2)
        let known: Vec<Option<bool>> = truths.iter().flat_map(|truth| truth.presence()).collect();
        let values = |of: &dyn Fn(&Option<bool>) -> f32| {
            Tensor::from_vec(known.iter().map(of).collect::<Vec<_>>(), (truths.len(), 2), &Device::Cpu)
        };
        let (mask, truth) =
            (values(&|known| f32::from(known.is_some()))?, values(&|known| f32::from(*known == Some(true)))?);
        // max(l, 0) - l y + ln(1 + e^-|l|)
        let soft = (logits.abs()?.neg()?.exp()? + 1.0)?.log()?;
        let entropy = ((logits.relu()? - (&logits * truth)?)? + soft)?;
        let count = known.iter().flatten().count().max(1);
        Ok(((entropy * mask)?.sum_all()? / count as f64)?)
    }

    fn keypoint_loss(&self, patches: &Tensor, cls: &Tensor, truths: &[&Truth]) -> Result<Tensor> {
        let n_patches = patches.dim(1)?;
        let places = self.linear(patches, "keypoints")?.transpose(1, 2)?; // (B, 42, P - 1)
        let nowhere = self.linear(cls, "nowhere")?.unsqueeze(2)?; // (B, 42, 1)
        let all = Tensor::cat(&[places, nowhere], 2)?.contiguous()?;
        let log_shares = candle_nn::ops::log_softmax(&all, D::Minus1)?;
        let mut weights = vec![0f32; truths.len() * N_POINTS * (n_patches + 1)];
        let mut sum = 0.0;
        let points = truths.iter().flat_map(|truth| &truth.places);
        for (row, place) in weights.chunks_exact_mut(n_patches + 1).zip(points) {
            let (at, weight) = match keypoints::patch(*place, n_patches.isqrt()) {
                Some(patch) => (patch, 1.0),
                None if place[0].is_nan() => continue,
                None => (n_patches, NOWHERE_WEIGHT),
            };
            row[at] = -weight;
            sum += weight;
        }
        let weights = Tensor::from_vec(weights, (truths.len(), N_POINTS, n_patches + 1), &Device::Cpu)?;
        Ok(((log_shares * weights)?.sum_all()? / f64::from(sum.max(1.0)))?)
    }

    fn offset_loss(&self, patches: &Tensor, n_patches: usize, truths: &[&Truth]) -> Result<Tensor> {
        let grid = n_patches.isqrt();
        let (mut rows, mut mask, mut truth) = (Vec::new(), Vec::new(), Vec::new());
        for (sample, places) in truths.iter().map(|truth| &truth.places).enumerate() {
            for (point, place) in places.iter().enumerate() {
                let Some(patch) = keypoints::patch(*place, grid) else { continue };
                rows.push((sample * n_patches + patch) as u32);
                let start = mask.len();
                mask.resize(start + 2 * N_POINTS, 0f32);
                truth.resize(start + 2 * N_POINTS, 0f32);
                for (axis, cell) in [patch % grid, patch / grid].into_iter().enumerate() {
                    mask[start + 2 * point + axis] = 1.0;
                    truth[start + 2 * point + axis] = place[axis] * grid as f32 - (cell as f32 + 0.5);
                }
            }
        }
        if rows.is_empty() {
            return Ok(Tensor::new(0f32, &Device::Cpu)?);
        }
        let n = rows.len();
        let chosen = patches.index_select(&Tensor::from_vec(rows, n, &Device::Cpu)?, 0)?;
        let [mask, truth] = [mask, truth].map(|values| Tensor::from_vec(values, (n, 2 * N_POINTS), &Device::Cpu));
        let error = ((self.linear(&chosen, "offset")? - truth?)?.abs()? * mask?)?;
        Ok((error.sum_all()? / (2 * n) as f64)?)
    }
}
