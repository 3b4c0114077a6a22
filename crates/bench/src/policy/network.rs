//! The policy: a small network from two pictures, touch and own commands to a change of the grip.
//!
//! All arms have the same network. It sees by convolutions whose stride is their kernel, so that each is one matrix
//! product. An arm without touch gets zeros in its place.

use candle_core::{Device, Tensor};
use candle_nn::{Init, VarBuilder, VarMap};
use egotac::error::{Error, Result};
use egotac::model::init;

use super::senses::{OWN, PICTURE, SIDE, TOUCH};

/// Side of a patch, pixels, and of the square of patches that the second layer joins.
const PATCH: usize = 4;
const JOINED: usize = 4;
/// Patches per side.
const GRID: usize = SIDE / PATCH;
/// Values of a patch: two pictures of three channels.
const PATCH_VALUES: usize = 2 * 3 * PATCH * PATCH;
/// Widths of the layers.
const SEEN: [usize; 3] = [24, 48, 64];
const FELT: usize = 32;
const OWNED: usize = 16;
const HIDDEN: usize = 64;

/// Newtons, and metres, that make one unit of input.
const TOUCH_UNIT: f32 = 2.0;
const OWN_UNITS: [f32; OWN] = [4.0, 0.05];

/// Inputs of a policy.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Inputs {
    /// (B, 256, 96) patches, those of each square of 4 x 4 patches together.
    patches: Vec<f32>,
    /// (B, 68) touch now and earlier.
    touch: Vec<f32>,
    /// (B, 2) own commands.
    own: Vec<f32>,
}

/// Shift and brightness of a pair of pictures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Shift to the right and down, pixels; the border is repeated.
    pub shift: [i32; 2],
    /// Factor on all values.
    pub brightness: f32,
}

impl Look {
    /// Pictures as they are.
    pub const PLAIN: Self = Self { shift: [0, 0], brightness: 1.0 };
}

impl Inputs {
    /// Adds an observation: pictures (64, 64, 3) and touch (34; zeros for an arm without), now and earlier, and own commands.
    pub fn push(&mut self, pictures: [&[u8]; 2], look: Look, touch: [&[f32]; 2], own: &[f32]) {
        let inside = |at: i32| at.clamp(0, SIDE as i32 - 1) as usize;
        let values: [f32; 256] = std::array::from_fn(|value| value as f32 * look.brightness / 255.0 - 0.5);
        self.patches.reserve(2 * PICTURE);
        for square in 0..(GRID / JOINED).pow(2) {
            let (top, left) = (square / (GRID / JOINED) * JOINED, square % (GRID / JOINED) * JOINED);
            for patch in 0..JOINED * JOINED {
                let (y, x) = ((top + patch / JOINED) * PATCH, (left + patch % JOINED) * PATCH);
                let columns: [usize; PATCH] = std::array::from_fn(|column| inside((x + column) as i32 - look.shift[0]));
                for picture in pictures {
                    for row in y..y + PATCH {
                        let start = inside(row as i32 - look.shift[1]) * SIDE;
                        for column in columns {
                            let at = 3 * (start + column);
                            self.patches
                                .extend_from_slice(&[at, at + 1, at + 2].map(|at| values[picture[at] as usize]));
                        }
                    }
                }
            }
        }
        self.touch.extend(touch.into_iter().flatten().map(|force| force / TOUCH_UNIT));
        self.own.extend(own.iter().zip(OWN_UNITS).map(|(value, unit)| value / unit));
    }

    /// Returns the number of observations.
    fn len(&self) -> usize {
        self.own.len() / OWN
    }
}

/// A linear layer.
#[derive(Debug)]
struct Linear {
    weight: Tensor, // (k, n)
    bias: Tensor,   // (n)
}

impl Linear {
    fn new(k: usize, n: usize, vb: VarBuilder) -> candle_core::Result<Self> {
        let bound = (3.0 / k as f64).sqrt();
        let weight = vb.get_with_hints((k, n), "weight", Init::Uniform { lo: -bound, up: bound })?;
        let bias = vb.get_with_hints(n, "bias", Init::Const(0.0))?;
        Ok(Self { weight, bias })
    }

    /// `x`: `(rows, k)`. Returns `(rows, n)`.
    fn forward(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        x.matmul(&self.weight)?.broadcast_add(&self.bias)
    }
}

/// A policy's network.
#[derive(Debug)]
pub struct Policy {
    see: [Linear; 3],
    feel: Linear,
    own: Linear,
    join: Linear,
    decide: Linear,
}

impl Policy {
    /// Creates a policy on `varmap`; variables that it lacks are drawn from `seed` and their name.
    ///
    /// # Errors
    /// If a variable has another shape.
    pub fn new(varmap: &VarMap, seed: u64) -> Result<Self> {
        let vb = init::var_builder(varmap, seed, &Device::Cpu);
        let joined = JOINED * JOINED;
        Ok(Self {
            see: [
                Linear::new(PATCH_VALUES, SEEN[0], vb.pp("see0"))?,
                Linear::new(joined * SEEN[0], SEEN[1], vb.pp("see1"))?,
                Linear::new((GRID / JOINED).pow(2) * SEEN[1], SEEN[2], vb.pp("see2"))?,
            ],
            feel: Linear::new(2 * TOUCH, FELT, vb.pp("feel"))?,
            own: Linear::new(OWN, OWNED, vb.pp("own"))?,
            join: Linear::new(SEEN[2] + FELT + OWNED, HIDDEN, vb.pp("join"))?,
            decide: Linear::new(HIDDEN, 1, vb.pp("decide"))?,
        })
    }

    /// Loads a policy.
    ///
    /// # Errors
    /// If the file can't be read, or a tensor is missing or has another shape.
    pub fn load(path: &std::path::Path) -> Result<Self> {
        let mut varmap = VarMap::new();
        let policy = Self::new(&varmap, 0)?;
        varmap.load(path).map_err(|error| Error::file(path, error))?;
        // The layers share their storage with the variables.
        Ok(policy)
    }

    /// Returns the change of the grip as a share of the largest, `(B)`.
    ///
    /// # Errors
    /// If the device is out of memory.
    pub fn forward(&self, inputs: &Inputs) -> Result<Tensor> {
        let n = inputs.len();
        let squares = (GRID / JOINED).pow(2);
        let [patches, joined, whole] = &self.see;
        let x = Tensor::from_slice(&inputs.patches, (n * GRID * GRID, PATCH_VALUES), &Device::Cpu)?;
        debug_assert_eq!(inputs.patches.len(), n * 2 * PICTURE);
        let x = patches.forward(&x)?.relu()?.reshape((n * squares, JOINED * JOINED * SEEN[0]))?;
        let x = joined.forward(&x)?.relu()?.reshape((n, squares * SEEN[1]))?;
        let seen = whole.forward(&x)?.relu()?;
        let felt = self.feel.forward(&Tensor::from_slice(&inputs.touch, (n, 2 * TOUCH), &Device::Cpu)?)?.relu()?;
        let own = self.own.forward(&Tensor::from_slice(&inputs.own, (n, OWN), &Device::Cpu)?)?.relu()?;
        let all = self.join.forward(&Tensor::cat(&[seen, felt, own], 1)?)?.relu()?;
        Ok(self.decide.forward(&all)?.flatten_all()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Value of a pixel that tells its place and channel.
    fn pixel(y: usize, x: usize, channel: usize) -> u8 {
        ((7 * y + 3 * x + 80 * channel) % 251) as u8
    }

    fn picture(shift: [i32; 2]) -> Vec<u8> {
        let inside = |at: usize, shift: i32| (at as i32 - shift).clamp(0, SIDE as i32 - 1) as usize;
        let at = |i: usize| (i / 3 / SIDE, i / 3 % SIDE, i % 3);
        (0..PICTURE).map(at).map(|(y, x, c)| pixel(inside(y, shift[1]), inside(x, shift[0]), c)).collect()
    }

    #[test]
    fn a_shift_of_the_look_is_a_shift_of_the_picture() {
        let (plain, moved) = (picture([0, 0]), picture([3, -2]));
        let (mut a, mut b) = (Inputs::default(), Inputs::default());
        let (touch, own) = ([0.5; TOUCH], [1.0, 0.02]);
        a.push([&plain, &plain], Look { shift: [3, -2], brightness: 1.0 }, [&touch, &touch], &own);
        b.push([&moved, &moved], Look::PLAIN, [&touch, &touch], &own);
        assert_eq!(a, b);
        assert_eq!(a.patches.len(), 2 * PICTURE);
        // Each value comes exactly once.
        let mut values: Vec<i32> = a.patches.iter().map(|v| ((v + 0.5) * 255.0).round() as i32).collect();
        let mut expected: Vec<i32> = moved.iter().chain(&moved).map(|v| i32::from(*v)).collect();
        values.sort_unstable();
        expected.sort_unstable();
        assert_eq!(values, expected);
    }

    #[test]
    fn an_observation_alone_and_in_a_batch_gives_the_same_action() {
        let policy = Policy::new(&VarMap::new(), 3).unwrap();
        let (dark, bright) = (vec![20; PICTURE], picture([0, 0]));
        let touches: Vec<[f32; TOUCH]> = (0..3).map(|i| [i as f32; TOUCH]).collect();
        let mut batch = Inputs::default();
        let mut alone = Vec::new();
        for (i, touch) in touches.iter().enumerate() {
            let pictures: [&[u8]; 2] = [&bright, &dark];
            let mut one = Inputs::default();
            for inputs in [&mut one, &mut batch] {
                inputs.push(pictures, Look::PLAIN, [touch, &touches[0]], &[i as f32, 0.01]);
            }
            alone.extend(policy.forward(&one).unwrap().to_vec1::<f32>().unwrap());
        }
        let together = policy.forward(&batch).unwrap().to_vec1::<f32>().unwrap();
        for (a, b) in alone.iter().zip(&together) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
        assert!(alone[0] != alone[1], "touch and commands matter");
    }
}
