//! Seeded random initial parameters of a network.

use candle_core::{DType, Device, Result, Shape, Tensor, Var, bail};
use candle_nn::var_builder::SimpleBackend;
use candle_nn::{Init, VarBuilder, VarMap};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use sha2::{Digest, Sha256};

/// Standard deviation of initial tokens and embeddings, as in DINOv2.
pub(crate) const STD: f64 = 0.02;

/// Number of inputs whose weights DINOv2 draws with standard deviation [`STD`].
const STD_WIDTH: f64 = 768.0;

/// Initial distribution of weight and bias of a linear layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scheme {
    /// PyTorch's distribution for a linear layer of k inputs: both uniform in ±1/√k (Kaiming with a = √5).
    Torch,
    /// Distribution of DINOv2 base: weight N(0, 0.02) at 768 inputs, bias zero. Other widths keep its gain, 0.02 √(768/k):
    /// with 0.02 at 128 inputs, each layer would scale its input by 0.2, and six layers would leave almost nothing.
    Dinov2,
    /// Both zero, for AdaLN.
    Zero,
}

impl Scheme {
    /// Returns the distribution of the weight of a layer with `k` inputs.
    pub fn weight(self, k: usize) -> Init {
        match self {
            Scheme::Torch => symmetric(k),
            Scheme::Dinov2 => Init::Randn { mean: 0.0, stdev: STD * (STD_WIDTH / k as f64).sqrt() },
            Scheme::Zero => Init::Const(0.0),
        }
    }

    /// Returns the distribution of the bias of a layer with `k` inputs.
    pub fn bias(self, k: usize) -> Init {
        match self {
            Scheme::Torch => symmetric(k),
            Scheme::Dinov2 | Scheme::Zero => Init::Const(0.0),
        }
    }
}

fn symmetric(k: usize) -> Init {
    let bound = 1.0 / (k as f64).sqrt();
    Init::Uniform { lo: -bound, up: bound }
}

/// Returns a builder whose tensors are the variables of `varmap`; missing ones are drawn from `seed`.
///
/// A variable depends on the seed and its name alone, not on the order of construction. candle's own builder draws from a
/// generator that can't be seeded on the CPU.
pub fn var_builder(varmap: &VarMap, seed: u64, device: &Device) -> VarBuilder<'static> {
    let backend = Seeded { varmap: varmap.clone(), seed };
    VarBuilder::from_backend(Box::new(backend), DType::F32, device.clone())
}

/// Returns a builder whose tensors are the variables of `varmap`, converted to another format; none may be missing.
/// Gradients pass through the conversion, so the variables stay f32.
pub(crate) fn cast_builder(varmap: &VarMap, dtype: DType, device: &Device) -> VarBuilder<'static> {
    VarBuilder::from_backend(Box::new(Cast(Seeded { varmap: varmap.clone(), seed: 0 })), dtype, device.clone())
}

struct Cast(Seeded);

impl SimpleBackend for Cast {
    fn get(&self, shape: Shape, name: &str, init: Init, dtype: DType, device: &Device) -> Result<Tensor> {
        match self.0.contains_tensor(name) {
            true => self.0.get(shape, name, init, DType::F32, device)?.to_dtype(dtype),
            false => bail!("variable {name} is missing"),
        }
    }

    fn get_unchecked(&self, name: &str, dtype: DType, device: &Device) -> Result<Tensor> {
        self.0.get_unchecked(name, DType::F32, device)?.to_dtype(dtype)
    }

    fn contains_tensor(&self, name: &str) -> bool {
        self.0.contains_tensor(name)
    }
}

struct Seeded {
    varmap: VarMap,
    seed: u64,
}

impl SimpleBackend for Seeded {
    fn get(&self, shape: Shape, name: &str, init: Init, dtype: DType, device: &Device) -> Result<Tensor> {
        let Ok(mut vars) = self.varmap.data().lock() else { bail!("a thread panicked while it held the variables") };
        if let Some(var) = vars.get(name) {
            if var.shape() != &shape {
                bail!("variable {name}: expected shape {:?}, got {:?}", shape.dims(), var.dims());
            }
            return Ok(var.as_tensor().clone());
        }
        let values = draw(self.seed, name, shape.elem_count(), init)?;
        let var = Var::from_tensor(&Tensor::from_vec(values, shape, device)?.to_dtype(dtype)?)?;
        let tensor = var.as_tensor().clone();
        vars.insert(name.to_string(), var);
        Ok(tensor)
    }

    fn get_unchecked(&self, name: &str, _: DType, _: &Device) -> Result<Tensor> {
        match self.varmap.data().lock() {
            Ok(vars) if vars.contains_key(name) => Ok(vars[name].as_tensor().clone()),
            _ => bail!("variable {name} is missing"),
        }
    }

    fn contains_tensor(&self, name: &str) -> bool {
        self.varmap.data().lock().is_ok_and(|vars| vars.contains_key(name))
    }
}

fn draw(seed: u64, name: &str, count: usize, init: Init) -> Result<Vec<f32>> {
    let digest = Sha256::new().chain_update(seed.to_le_bytes()).chain_update(name).finalize();
    let mut rng = ChaCha8Rng::from_seed(digest.into());
    Ok(match init {
        Init::Const(value) => vec![value as f32; count],
        Init::Uniform { lo, up } => (0..count).map(|_| rng.random_range(lo..up) as f32).collect(),
        Init::Randn { mean, stdev } => {
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            (0..count).map(|_| (mean + stdev * normal()) as f32).collect()
        }
        Init::Kaiming { .. } => bail!("variable {name}: expected the uniform bounds of a Kaiming distribution"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_variable_depends_on_seed_and_name_alone() {
        let start = |seed, names: [&str; 2]| {
            let vb = var_builder(&VarMap::new(), seed, &Device::Cpu);
            names.map(|name| {
                let tensor = vb.get_with_hints(64, name, Scheme::Torch.weight(16)).unwrap();
                tensor.to_vec1::<f32>().unwrap()
            })
        };
        let [a, b] = start(1, ["a", "b"]);
        let [b_first, a_second] = start(1, ["b", "a"]);
        assert_eq!((&a, &b), (&a_second, &b_first));
        assert_ne!(a, b);
        assert_ne!(a, start(2, ["a", "b"])[0]);
        assert!(a.iter().all(|x| x.abs() <= 0.25) && a.iter().any(|x| x.abs() > 0.2), "uniform in ±1/√16");
    }
}
