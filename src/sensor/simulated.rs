//! A simulated glove: what its taxels read while known forces act on the vertices of the hands.

use std::collections::VecDeque;
use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use super::map::{HandTaxels, TaxelMap};
use crate::error::{Error, Result};
use crate::hand::Side;

/// Number of neighbours that share the crosstalk of a taxel.
const NEIGHBOURS: usize = 4;
/// Largest number of samples that wait for their delay.
const MAX_WAITING: usize = 1 << 16;

/// Sensor of a glove. Every imperfection is off unless it is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GloveSpec {
    /// Taxel map: the name of a shipped one, or a YAML file.
    pub sensor: String,
    /// Standard deviation of the taxels' gains around 1.
    #[serde(default)]
    pub gain: f64,
    /// Force, N, below which a taxel reads 0.
    #[serde(default)]
    pub floor: f64,
    /// Standard deviation of a sample's noise, N.
    #[serde(default)]
    pub noise: f64,
    /// Share of a taxel's force that its nearest neighbours read, 0 to 1.
    #[serde(default)]
    pub crosstalk: f64,
    /// Random walk of a taxel's zero, N per square root of a second.
    #[serde(default)]
    pub drift: f64,
    /// Samples per second; 0 = one per instant that is asked for.
    #[serde(default)]
    pub rate: f64,
    /// Age of a sample when it comes out, s.
    #[serde(default)]
    pub delay: f64,
}

impl GloveSpec {
    /// Returns a glove without imperfections.
    pub fn ideal(sensor: impl Into<String>) -> Self {
        Self {
            sensor: sensor.into(),
            gain: 0.0,
            floor: 0.0,
            noise: 0.0,
            crosstalk: 0.0,
            drift: 0.0,
            rate: 0.0,
            delay: 0.0,
        }
    }

    /// Checks that numbers are in range.
    ///
    /// # Errors
    /// Names the first key that is not.
    pub fn check(&self) -> Result<()> {
        let ranges = [
            ("gain", self.gain, 0.5),
            ("floor", self.floor, 100.0),
            ("noise", self.noise, 100.0),
            ("crosstalk", self.crosstalk, 1.0),
            ("drift", self.drift, 100.0),
            ("rate", self.rate, 100_000.0),
            ("delay", self.delay, 10.0),
        ];
        match ranges.into_iter().find(|(_, value, most)| !(0.0..=*most).contains(value)) {
            Some((key, value, most)) => {
                Err(Error::value(format!("glove.{key}"), format!("a number from 0 to {most}"), value))
            }
            None => Ok(()),
        }
    }
}

/// Gloves on both hands.
#[derive(Debug, Clone)]
pub struct SimulatedGlove {
    map: Arc<TaxelMap>,
    spec: GloveSpec,
    /// (N) gain and zero of each taxel, N, of each hand.
    gains: [Vec<f32>; 2],
    zeros: [Vec<f32>; 2],
    neighbours: [Vec<Vec<u32>>; 2],
    /// Samples with their times, oldest first; the first one has come out.
    samples: VecDeque<(f64, [Vec<f32>; 2])>,
    rng: ChaCha8Rng,
}

impl SimulatedGlove {
    /// Draws the gloves of one episode from `seed`.
    ///
    /// # Errors
    /// If a number of `spec` is out of range.
    pub fn new(map: Arc<TaxelMap>, spec: GloveSpec, seed: u64) -> Result<Self> {
        spec.check()?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(2);
        let channels = map.layout.channels;
        let mut gains = || (0..channels).map(|_| (1.0 + spec.gain * normal(&mut rng)).max(0.0) as f32).collect();
        let gains = [gains(), gains()];
        let neighbours = map.hands.each_ref().map(neighbours);
        let zeros = [vec![0.0; channels], vec![0.0; channels]];
        Ok(Self { map, spec, gains, zeros, neighbours, samples: VecDeque::new(), rng })
    }

    /// Taxel map of the gloves.
    pub fn map(&self) -> &TaxelMap {
        &self.map
    }

    /// Returns the readings of both hands' taxels, (N) N each, left first, at `time`, s, while the forces `force` act on the
    /// vertices of both hands, (1556) N. Times grow from call to call.
    ///
    /// # Errors
    /// If `force` does not have 1556 values.
    pub fn read(&mut self, time: f64, force: &[f32]) -> Result<[Vec<f32>; 2]> {
        if force.len() != crate::hand::N_FIELD {
            return Err(Error::shape("force", format!("[{}]", crate::hand::N_FIELD), [force.len()]));
        }
        let last = self.samples.back().map(|sample| sample.0);
        let interval = if self.spec.rate > 0.0 { 1.0 / self.spec.rate } else { 0.0 };
        // A tolerance of a thousandth keeps a rate that divides the frames' from losing samples to rounding.
        if last.is_none_or(|last| time - last >= 0.999 * interval) {
            let sample = self.sample(time - last.unwrap_or(time), force);
            self.samples.push_back((time, sample));
        }
        let due = time - self.spec.delay + 1e-9;
        while self.samples.len() > MAX_WAITING || self.samples.get(1).is_some_and(|next| next.0 <= due) {
            self.samples.pop_front();
        }
        let nothing = || [vec![0.0; self.map.layout.channels], vec![0.0; self.map.layout.channels]];
        Ok(self.samples.front().filter(|sample| sample.0 <= due).map_or_else(nothing, |sample| sample.1.clone()))
    }

    /// Takes a sample, `step` s after the one before.
    fn sample(&mut self, step: f64, force: &[f32]) -> [Vec<f32>; 2] {
        Side::BOTH.map(|side| {
            let mut taxels = loads(&self.map.hands[side as usize], &force[side.range()]);
            if self.spec.crosstalk > 0.0 {
                taxels = self.mixed(side, &taxels);
            }
            let walk = self.spec.drift * step.max(0.0).sqrt();
            for (taxel, newtons) in taxels.iter_mut().enumerate() {
                let zero = &mut self.zeros[side as usize][taxel];
                if walk > 0.0 {
                    *zero += (walk * normal(&mut self.rng)) as f32;
                }
                let noise = if self.spec.noise > 0.0 { (self.spec.noise * normal(&mut self.rng)) as f32 } else { 0.0 };
                let read = *newtons * self.gains[side as usize][taxel] + *zero + noise;
                *newtons = if f64::from(read) < self.spec.floor { 0.0 } else { read.max(0.0) };
            }
            taxels
        })
    }

    /// Returns the forces after crosstalk; their sum stays.
    fn mixed(&self, side: Side, taxels: &[f32]) -> Vec<f32> {
        let mut mixed = taxels.to_vec();
        for (taxel, near) in self.neighbours[side as usize].iter().enumerate().filter(|(_, near)| !near.is_empty()) {
            let leaves = taxels[taxel] * self.spec.crosstalk as f32;
            mixed[taxel] -= leaves;
            near.iter().for_each(|other| mixed[*other as usize] += leaves / near.len() as f32);
        }
        mixed
    }
}

/// Returns the force on each taxel, (N) N: every vertex hands its force, (778) N, to the taxels around it. Force on vertices
/// without a taxel is lost.
pub fn loads(hand: &HandTaxels, force: &[f32]) -> Vec<f32> {
    let mut taxels = vec![0f64; hand.spread.len()];
    for (list, force) in hand.reading.iter().zip(force).filter(|(_, force)| **force > 0.0) {
        list.iter().for_each(|&(taxel, weight)| taxels[taxel as usize] += f64::from(*force) * f64::from(weight));
    }
    taxels.into_iter().map(|newtons| newtons as f32).collect()
}

/// Returns the nearest taxels of each taxel.
fn neighbours(hand: &HandTaxels) -> Vec<Vec<u32>> {
    let places = &hand.positions;
    let of = |taxel: usize| {
        if places[taxel].is_nan() {
            return Vec::new();
        }
        let others = (0..places.len()).filter(|other| *other != taxel && !places[*other].is_nan());
        let mut by_distance: Vec<(f32, u32)> =
            others.map(|other| (places[other].distance_squared(places[taxel]), other as u32)).collect();
        by_distance.sort_by(|a, b| a.0.total_cmp(&b.0));
        by_distance.into_iter().take(NEIGHBOURS).map(|(_, other)| other).collect()
    };
    (0..places.len()).map(of).collect()
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}
