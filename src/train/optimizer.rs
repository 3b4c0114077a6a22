//! AdamW with an exponential moving average of the weights; the state is where the weights are.

use std::collections::{BTreeMap, BTreeSet};

use candle_core::backprop::GradStore;
use candle_core::{DType, Tensor, Var};
use candle_nn::VarMap;
use rayon::prelude::*;

use super::config::{Config, OptimizerConfig};
use super::gradients::Gradients;
#[cfg(feature = "cuda")]
use super::param::State;
use super::param::{Param, with_host};
use crate::error::{Error, Result};
use crate::model::checkpoint::ENCODER;

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
const EPS: f32 = 1e-8;

/// AdamW with decoupled weight decay on matrices only, and an exponential moving average of the weights.
#[derive(Debug)]
pub struct AdamW {
    params: Vec<Param>, // by name
    config: OptimizerConfig,
    encoder_factor: f64,
    ema: f32,
    steps: usize,
}

impl AdamW {
    /// Creates an optimiser of the variables of `varmap`; the average starts at their values.
    ///
    /// # Errors
    /// If a variable is not f32.
    pub fn new(varmap: &VarMap, config: &Config) -> Result<Self> {
        let vars: BTreeMap<String, Var> = match varmap.data().lock() {
            Ok(vars) => vars.iter().map(|(name, var)| (name.clone(), var.clone())).collect(),
            Err(_) => return Err(Error::value("variables", "unlocked ones", "a thread died while it held them")),
        };
        let mut params = Vec::new();
        for (name, var) in vars {
            if var.dtype() != DType::F32 {
                return Err(Error::value(&name, "dtype f32", format!("{:?}", var.dtype())));
            }
            params.push(Param::new(name, var)?);
        }
        Ok(Self {
            params,
            config: config.optimizer,
            encoder_factor: config.encoder_factor(),
            ema: config.ema as f32,
            steps: 0,
        })
    }

    /// Returns the number of steps taken.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Returns the variables with their state, sorted by name.
    pub fn params(&self) -> &[Param] {
        &self.params
    }

    /// Restores a saved state: calls `state` for each variable, in the order of [`Self::params`].
    ///
    /// # Errors
    /// If `state` fails.
    pub fn restore(&mut self, steps: usize, mut state: impl FnMut(&mut Param) -> Result<()>) -> Result<()> {
        self.params.iter_mut().try_for_each(&mut state)?;
        self.steps = steps;
        Ok(())
    }

    /// Adds the gradients of one batch to a sum.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn gather(&self, gathered: &mut Option<GradStore>, mut more: GradStore) -> Result<()> {
        let Some(sum) = gathered else {
            *gathered = Some(more);
            return Ok(());
        };
        for param in &self.params {
            let var = param.var.as_tensor();
            if let Some(new) = more.remove(var) {
                let both = match sum.get(var) {
                    Some(old) => (old + new)?,
                    None => new,
                };
                sum.insert(var, both);
            }
        }
        Ok(())
    }

    /// Takes one step with `grads`, clipped to the maximum norm. Returns the norm before clipping.
    ///
    /// If the norm is not finite, nothing changes.
    ///
    /// # Errors
    /// If a variable can't be read or set.
    pub fn step(&mut self, grads: &GradStore, learning_rate: f64) -> Result<f64> {
        #[cfg(feature = "cuda")]
        if self.is_on_gpu() {
            let grads = self.params.iter().map(|param| grads.get(&param.var).cloned()).collect();
            return self.step_on_gpu(grads, learning_rate);
        }
        self.apply(&Gradients::new(&self.params, Some(grads))?, learning_rate)
    }

    /// As [`AdamW::step`], with gradients in host memory.
    ///
    /// # Errors
    /// If a variable can't be read or set.
    pub fn apply(&mut self, gradients: &Gradients, learning_rate: f64) -> Result<f64> {
        let gradients = gradients.by_variable();
        #[cfg(feature = "cuda")]
        if self.is_on_gpu() {
            let tensor = |(param, grad): (&Param, Option<&[f32]>)| -> Result<Option<Tensor>> {
                let made = grad.map(|grad| Tensor::from_slice(grad, param.var.shape(), param.var.device()));
                Ok(made.transpose()?)
            };
            let grads = self.params.iter().zip(gradients).map(tensor).collect::<Result<_>>()?;
            return self.step_on_gpu(grads, learning_rate);
        }
        let squares =
            gradients.par_iter().flatten().map(|grad| grad.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>());
        // Collects first: a parallel sum would add in another order each time, and the bits would vary.
        let norm = squares.collect::<Vec<f64>>().iter().sum::<f64>().sqrt();
        let Some(numbers) = self.numbers(norm, learning_rate) else { return Ok(norm) };
        self.steps += 1;
        self.params.par_iter_mut().zip(&gradients).try_for_each(|(param, grad)| -> Result<()> {
            let Numbers { scale, decay, corrections: [correction1, correction2], .. } = numbers;
            let (rate, shrink) = numbers.of(param);
            let mut weights = with_host(param.var.as_tensor(), <[f32]>::to_vec)?;
            let Some([moment1, moment2, average]) = param.state.host() else {
                return Err(Error::value(&param.name, "a variable on the CPU", "one on a GPU"));
            };
            if let Some(grad) = grad {
                let state = moment1.iter_mut().zip(moment2);
                for ((weight, grad), (m, v)) in weights.iter_mut().zip(*grad).zip(state) {
                    let grad = grad * scale;
                    *m += (1.0 - BETA1) * (grad - *m);
                    *v += (1.0 - BETA2) * (grad * grad - *v);
                    *weight = *weight * shrink - rate * (*m / correction1) / ((*v / correction2).sqrt() + EPS);
                }
            }
            for (average, weight) in average.iter_mut().zip(&weights) {
                *average += (1.0 - decay) * (weight - *average);
            }
            let shape = param.var.shape().clone();
            param.var.set(&Tensor::from_vec(weights, shape, param.var.device())?)?;
            Ok(())
        })?;
        Ok(norm)
    }

    /// Returns the numbers of the next step; None if the norm is not finite.
    fn numbers(&self, norm: f64, learning_rate: f64) -> Option<Numbers> {
        let steps = self.steps + 1;
        norm.is_finite().then(|| Numbers {
            scale: (self.config.max_grad_norm / norm.max(1e-12)).min(1.0) as f32,
            corrections: [BETA1, BETA2].map(|beta| 1.0 - beta.powi(steps as i32)),
            // A smaller decay in the first steps, so that the average forgets the initial weights.
            decay: self.ema.min((1.0 + steps as f32) / (10.0 + steps as f32)),
            rate: learning_rate,
            encoder_factor: self.encoder_factor,
            weight_decay: self.config.weight_decay as f32,
        })
    }

    #[cfg(feature = "cuda")]
    fn is_on_gpu(&self) -> bool {
        self.params.iter().any(|param| matches!(param.state, State::Gpu(_)))
    }

    /// As [`AdamW::apply`], where weights, gradients and state are on one GPU; nothing but the norm is copied from it.
    #[cfg(feature = "cuda")]
    fn step_on_gpu(&mut self, grads: Vec<Option<Tensor>>, learning_rate: f64) -> Result<f64> {
        use egotac_kernels::ops::cuda::{self, AdamStep, Stepping};
        let mut stepping = Vec::new();
        for (param, grad) in self.params.iter().zip(&grads) {
            let State::Gpu(state) = &param.state else {
                return Err(Error::value(&param.name, "a variable on the GPU, as the others", "one on the CPU"));
            };
            if let Some(grad) = grad {
                let weight = param.var.as_tensor();
                stepping.push((param, Stepping { weight, grad: grad.contiguous()?, state, rate: 0.0, shrink: 1.0 }));
            }
        }
        let (params, mut stepping): (Vec<&Param>, Vec<Stepping>) = stepping.into_iter().unzip();
        let norm = cuda::squares(&stepping)?.sqrt();
        let Some(numbers) = self.numbers(norm, learning_rate) else { return Ok(norm) };
        for (param, variable) in params.into_iter().zip(&mut stepping) {
            (variable.rate, variable.shrink) = numbers.of(param);
        }
        let Numbers { scale, decay, corrections, .. } = numbers;
        cuda::adamw(&stepping, AdamStep { scale, corrections, betas: [BETA1, BETA2], eps: EPS, decay })?;
        self.steps += 1;
        // Without a gradient, the average alone moves.
        for (param, _) in self.params.iter_mut().zip(&grads).filter(|(_, grad)| grad.is_none()) {
            if let State::Gpu([_, _, average]) = &mut param.state {
                let difference = (param.var.as_tensor() - &*average)?;
                *average = (&*average + (difference * f64::from(1.0 - decay))?)?;
            }
        }
        Ok(norm)
    }

    /// Sets the variables of `varmap` to the averages of the same names, or to the current weights without averaging.
    ///
    /// # Errors
    /// If one has another shape.
    pub fn write_average(&self, varmap: &mut VarMap) -> Result<()> {
        let present: BTreeSet<String> = match varmap.data().lock() {
            Ok(vars) => vars.keys().cloned().collect(),
            Err(_) => return Err(Error::value("variables", "unlocked ones", "a thread died while it held them")),
        };
        for param in self.params.iter().filter(|param| present.contains(&param.name)) {
            let tensor = match self.ema > 0.0 {
                true => {
                    let [_, _, average] = param.state()?;
                    Tensor::from_slice(&average, param.var.shape(), param.var.device())?
                }
                false => param.var.as_tensor().clone(),
            };
            varmap.set_one(&param.name, tensor)?;
        }
        Ok(())
    }
}

/// Numbers of one step.
#[derive(Clone, Copy)]
struct Numbers {
    /// Factor of the gradient, which clips it.
    scale: f32,
    /// 1 - β₁ᵗ and 1 - β₂ᵗ.
    corrections: [f32; 2],
    /// Factor of the moving average.
    decay: f32,
    rate: f64,
    encoder_factor: f64,
    weight_decay: f32,
}

impl Numbers {
    /// Returns the learning rate of a variable, and the factor by which its weights decay.
    fn of(&self, param: &Param) -> (f32, f32) {
        let encoder = param.name.starts_with(ENCODER);
        let rate = (self.rate * if encoder { self.encoder_factor } else { 1.0 }) as f32;
        let decays = param.var.rank() >= 2;
        (rate, 1.0 - if decays { rate * self.weight_decay } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use candle_core::Device;

    use super::*;

    fn config(extra: &str) -> Config {
        serde_yaml::from_str(&format!("{{name: a, data: [.], out: x, model: toy, seed: 1, steps: 100, {extra}}}"))
            .unwrap()
    }

    /// Sum of squares of w - 1 under a matrix and a vector.
    fn problem() -> (VarMap, Vec<Var>) {
        let varmap = VarMap::new();
        let vars: Vec<Var> = [("a", vec![2, 2]), ("b", vec![3])]
            .into_iter()
            .map(|(name, shape)| {
                let var = Var::from_tensor(&Tensor::full(3f32, shape, &Device::Cpu).unwrap()).unwrap();
                varmap.data().lock().unwrap().insert(name.to_string(), var.clone());
                var
            })
            .collect();
        (varmap, vars)
    }

    fn loss(vars: &[Var]) -> Tensor {
        let parts: Vec<Tensor> =
            vars.iter().map(|v| (v.as_tensor() - 1.0).unwrap().sqr().unwrap().sum_all().unwrap()).collect();
        (&parts[0] + &parts[1]).unwrap()
    }

    #[test]
    fn steps_agree_with_candle_s_adamw() {
        use candle_nn::Optimizer as _;
        // Without decay, because candle decays every variable.
        let (varmap, vars) = problem();
        let mut ours = AdamW::new(&varmap, &config("optimizer: {weight_decay: 0.0, max_grad_norm: 1000}")).unwrap();
        let (_, reference) = problem();
        let params = candle_nn::ParamsAdamW { lr: 0.1, weight_decay: 0.0, ..Default::default() };
        let mut theirs = candle_nn::AdamW::new(reference.clone(), params).unwrap();
        for _ in 0..20 {
            ours.step(&loss(&vars).backward().unwrap(), 0.1).unwrap();
            theirs.step(&loss(&reference).backward().unwrap()).unwrap();
        }
        for (a, b) in vars.iter().zip(&reference) {
            let [a, b] = [a, b].map(|v| v.flatten_all().unwrap().to_vec1::<f32>().unwrap());
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-5), "{a:?} {b:?}");
        }
    }

    #[test]
    fn only_matrices_decay_and_clipping_bounds_the_gradient() {
        let (varmap, vars) = problem();
        let mut adamw = AdamW::new(&varmap, &config("optimizer: {weight_decay: 0.5, max_grad_norm: 1e-3}")).unwrap();
        // Not exactly zero: candle drops a product with zero from the graph.
        let tiny = (vars[0].sum_all().unwrap() * 1e-30).unwrap();
        adamw.step(&tiny.backward().unwrap(), 0.1).unwrap();
        assert!((vars[0].flatten_all().unwrap().to_vec1::<f32>().unwrap()[0] - 3.0 * 0.95).abs() < 1e-6);
        assert_eq!(vars[1].to_vec1::<f32>().unwrap(), [3.0; 3]);
        let norm = adamw.step(&loss(&vars).backward().unwrap(), 0.1).unwrap();
        assert!(norm > 9.0, "the norm is the one before clipping: {norm}");
        let moment: f32 =
            adamw.params().iter().flat_map(|p| p.state().unwrap()[0].to_vec()).map(|m| m * m).sum::<f32>().sqrt();
        assert!((moment - 1e-4).abs() < 1e-6, "{moment}");
    }

    #[test]
    fn a_gradient_that_is_not_finite_changes_nothing() {
        let (varmap, vars) = problem();
        let mut adamw = AdamW::new(&varmap, &config("ema: 0.9")).unwrap();
        let broken = (loss(&vars) * f64::NAN).unwrap();
        assert!(adamw.step(&broken.backward().unwrap(), 0.1).unwrap().is_nan());
        assert_eq!((vars[1].to_vec1::<f32>().unwrap(), adamw.steps()), (vec![3.0; 3], 0));
    }

    #[test]
    fn the_average_lies_between_initial_and_current_weights() {
        let (varmap, vars) = problem();
        let mut adamw = AdamW::new(&varmap, &config("ema: 0.99")).unwrap();
        for _ in 0..10 {
            adamw.step(&loss(&vars).backward().unwrap(), 0.1).unwrap();
        }
        let (mut averaged, copies) = problem();
        adamw.write_average(&mut averaged).unwrap();
        let (average, present) = (copies[1].to_vec1::<f32>().unwrap()[0], vars[1].to_vec1::<f32>().unwrap()[0]);
        assert!(present < average && average < 3.0, "{present} {average}");
    }
}
