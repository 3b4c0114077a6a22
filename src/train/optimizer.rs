//! AdamW with an exponential moving average of the weights; the state is in plain vectors.

use std::collections::{BTreeMap, BTreeSet};

use candle_core::backprop::GradStore;
use candle_core::{DType, Tensor, Var};
use candle_nn::VarMap;
use rayon::prelude::*;

use super::config::{Config, OptimizerConfig};
use super::gradients::Gradients;
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
            let average = var.flatten_all()?.to_vec1::<f32>()?;
            let zeros = vec![0.0; average.len()];
            params.push(Param { name, var, moment1: zeros.clone(), moment2: zeros, average });
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
        self.apply(&Gradients::new(&self.params, Some(grads))?, learning_rate)
    }

    /// As [`AdamW::step`], with gradients in host memory.
    ///
    /// # Errors
    /// If a variable can't be read or set.
    pub fn apply(&mut self, gradients: &Gradients, learning_rate: f64) -> Result<f64> {
        let gradients = gradients.by_variable();
        let squares =
            gradients.par_iter().flatten().map(|grad| grad.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>());
        // Collects first: a parallel sum would add in another order each time, and the bits would vary.
        let norm = squares.collect::<Vec<f64>>().iter().sum::<f64>().sqrt();
        if !norm.is_finite() {
            return Ok(norm);
        }
        self.steps += 1;
        let scale = (self.config.max_grad_norm / norm.max(1e-12)).min(1.0) as f32;
        let correction1 = 1.0 - BETA1.powi(self.steps as i32);
        let correction2 = 1.0 - BETA2.powi(self.steps as i32);
        // A smaller decay in the first steps, so that the average forgets the initial weights.
        let decay = self.ema.min((1.0 + self.steps as f32) / (10.0 + self.steps as f32));
        let Self { params, config, encoder_factor, .. } = self;
        params.par_iter_mut().zip(&gradients).try_for_each(|(param, grad)| -> Result<()> {
            let encoder = param.name.starts_with(ENCODER);
            let rate = (learning_rate * if encoder { *encoder_factor } else { 1.0 }) as f32;
            let decays = param.var.rank() >= 2;
            let shrink = 1.0 - if decays { rate * config.weight_decay as f32 } else { 0.0 };
            let mut weights = with_host(param.var.as_tensor(), <[f32]>::to_vec)?;
            if let Some(grad) = grad {
                let state = param.moment1.iter_mut().zip(&mut param.moment2);
                for ((weight, grad), (m, v)) in weights.iter_mut().zip(*grad).zip(state) {
                    let grad = grad * scale;
                    *m += (1.0 - BETA1) * (grad - *m);
                    *v += (1.0 - BETA2) * (grad * grad - *v);
                    *weight = *weight * shrink - rate * (*m / correction1) / ((*v / correction2).sqrt() + EPS);
                }
            }
            for (average, weight) in param.average.iter_mut().zip(&weights) {
                *average += (1.0 - decay) * (weight - *average);
            }
            let shape = param.var.shape().clone();
            param.var.set(&Tensor::from_vec(weights, shape, param.var.device())?)?;
            Ok(())
        })?;
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
                true => Tensor::from_slice(&param.average, param.var.shape(), param.var.device())?,
                false => param.var.as_tensor().clone(),
            };
            varmap.set_one(&param.name, tensor)?;
        }
        Ok(())
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
        let moment: f32 = adamw.params().iter().flat_map(|p| &p.moment1).map(|m| m * m).sum::<f32>().sqrt();
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
