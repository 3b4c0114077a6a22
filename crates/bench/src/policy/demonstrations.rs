//! Demonstrations of the expert, with all that any policy may sense.

use std::path::Path;

use candle_core::{DType, Device, Tensor};
use egotac::error::{Error, Result};

use super::arm::Arm;
use super::control::{Disturbance, expert};
use super::cores::on_all_cores;
use super::network::Policy;
use super::recent::{LAG, Recent};
use super::senses::{OWN, PICTURE, RENDERED, SIDE, Senser, Senses, TOUCH};
use super::task::{MAX_CHANGE, Trial};

/// Demonstrations, frame by frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Demonstrations {
    /// (N, 64, 64, 3) pictures.
    pub pictures: Vec<u8>,
    /// (N, 34) true force on the regions, N.
    pub true_touch: Vec<f32>,
    /// (N, 34) predicted force on the regions, N.
    pub predicted_touch: Vec<f32>,
    /// (N, 2) own commands.
    pub own: Vec<f32>,
    /// (N) the expert's change of the grip, as a share of the largest.
    pub action: Vec<f32>,
    /// (N) index of the first frame of the frame's trial.
    pub first: Vec<u32>,
}

impl Demonstrations {
    /// Records the trial of a seed with the expert's actions. Executed are the actions of `learner`, a policy with the touch
    /// of its arm, or the expert's with a disturbance.
    ///
    /// # Errors
    /// If the trial can't be simulated, or a network fails.
    pub fn record(seed: u64, senser: &mut Senser, learner: Option<(&Policy, Arm)>) -> Result<Self> {
        let mut trial = Trial::start(seed, Some(RENDERED))?;
        let mut disturbance = Disturbance::new(seed);
        let mut recent = Recent::default();
        let mut all = Self::default();
        senser.reset();
        loop {
            let change = expert(&trial)?;
            let senses = senser.sense(&trial, true)?;
            recent.push(senses.clone());
            all.push(senses, (change / MAX_CHANGE) as f32);
            let executed = match learner {
                Some((policy, arm)) => recent.decide(policy, arm)?,
                None => change + disturbance.next(trial.grasp()?.fingers),
            };
            if !trial.act(executed, false)? {
                return Ok(all);
            }
        }
    }

    fn push(&mut self, senses: Senses, action: f32) {
        self.pictures.extend(senses.picture);
        self.true_touch.extend(senses.true_touch);
        self.predicted_touch.extend(senses.predicted_touch);
        self.own.extend(senses.own);
        self.action.push(action);
        self.first.push(0);
    }

    /// Appends another lot.
    pub fn append(&mut self, mut other: Self) {
        let before = self.len() as u32;
        self.pictures.append(&mut other.pictures);
        self.true_touch.append(&mut other.true_touch);
        self.predicted_touch.append(&mut other.predicted_touch);
        self.own.append(&mut other.own);
        self.action.append(&mut other.action);
        self.first.extend(other.first.into_iter().map(|first| first + before));
    }

    /// Returns the number of frames.
    pub fn len(&self) -> usize {
        self.action.len()
    }

    /// Returns true if there is no frame.
    pub fn is_empty(&self) -> bool {
        self.action.is_empty()
    }

    /// Returns the index of the frame [`LAG`] frames earlier, or of the trial's first frame.
    pub fn earlier(&self, frame: usize) -> usize {
        frame.saturating_sub(LAG).max(self.first[frame] as usize)
    }

    /// Writes a file that [`Self::read`] reads.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let n = self.len();
        let tensors = vec![
            ("pictures", Tensor::from_slice(&self.pictures, (n, SIDE, SIDE, 3), &Device::Cpu)?),
            ("true_touch", Tensor::from_slice(&self.true_touch, (n, TOUCH), &Device::Cpu)?),
            ("predicted_touch", Tensor::from_slice(&self.predicted_touch, (n, TOUCH), &Device::Cpu)?),
            ("own", Tensor::from_slice(&self.own, (n, OWN), &Device::Cpu)?),
            ("action", Tensor::from_slice(&self.action, n, &Device::Cpu)?),
            ("first", Tensor::from_slice(&self.first, n, &Device::Cpu)?),
        ];
        super::save(tensors, path)
    }

    /// Reads a file of [`Self::write`].
    ///
    /// # Errors
    /// If it can't be read, or an array is missing or has another size.
    pub fn read(path: &Path) -> Result<Self> {
        let mut tensors = candle_core::safetensors::load(path, &Device::Cpu).map_err(|e| Error::file(path, e))?;
        let mut take = |name: &str| -> Result<Tensor> {
            tensors.remove(name).ok_or_else(|| Error::file(path, format!("expected an array {name}, got none")))
        };
        let mut floats =
            |name: &str| -> Result<Vec<f32>> { Ok(take(name)?.to_dtype(DType::F32)?.flatten_all()?.to_vec1()?) };
        let all = Self {
            true_touch: floats("true_touch")?,
            predicted_touch: floats("predicted_touch")?,
            own: floats("own")?,
            action: floats("action")?,
            pictures: take("pictures")?.flatten_all()?.to_vec1()?,
            first: take("first")?.to_vec1()?,
        };
        let n = all.len();
        let sizes = [
            ("pictures", all.pictures.len(), n * PICTURE),
            ("true_touch", all.true_touch.len(), n * TOUCH),
            ("predicted_touch", all.predicted_touch.len(), n * TOUCH),
            ("own", all.own.len(), n * OWN),
            ("first", all.first.len(), n),
        ];
        match sizes.iter().find(|(_, got, expected)| got != expected) {
            Some((name, got, expected)) => {
                Err(Error::file(path, format!("{name}: expected {expected} values, got {got}")))
            }
            None => Ok(all),
        }
    }
}

/// Reads the lot of `seeds` from `path`, or records it on all cores and writes it.
///
/// # Errors
/// As [`Demonstrations::record`], and if the file can't be written.
pub fn lot(
    path: &Path,
    seeds: &[u64],
    senser: &Senser,
    learner: Option<(&Policy, Arm)>,
    mut done: impl FnMut(),
) -> Result<Demonstrations> {
    if path.is_file() {
        seeds.iter().for_each(|_| done());
        return Demonstrations::read(path);
    }
    let record = |senser: &mut Senser, seed: &u64| Demonstrations::record(*seed, senser, learner);
    let mut all = Demonstrations::default();
    for demonstration in on_all_cores(seeds, || senser.clone(), record, &mut done)? {
        all.append(demonstration);
    }
    all.write(path)?;
    Ok(all)
}
