//! Controllers that know more, or less, than a policy: the expert and a constant grip.

use egotac::error::Result;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::task::{MAX_CHANGE, Outcome, Trial};

/// Fingers' force that the expert keeps on a ball that still lies on the table, N.
const BASE: f64 = 0.2;
/// Grip of the expert relative to the grip that just holds the load.
const MARGIN: f64 = 1.45;
/// Share of the missing force that the expert adds in one interval.
const CORRECTION: f64 = 0.6;

/// Correlation of the demonstrations' disturbance from one command to the next.
const NOISE_MEMORY: f64 = 0.7;
/// Standard deviation of the disturbance's steps, N, and per newton of the fingers' force.
const NOISE: [f64; 2] = [0.06, 0.12];

/// Share of demonstrations without disturbance.
const UNDISTURBED: f64 = 0.2;

/// Returns the expert's change of the grip, N.
///
/// The expert knows the forces between hand and ball, the load that the hand carries at this instant, the friction and the
/// hand's transmission: it grips with a margin above the cone of friction. It does not act on weight that still rests on
/// the table, so that a policy that feels the same forces can do the same.
///
/// # Errors
/// As [`Trial::grasp`].
pub fn expert(trial: &Trial) -> Result<f64> {
    let grasp = trial.grasp()?;
    let wanted = BASE + MARGIN * trial.holding(grasp.load.max(0.0));
    let change = CORRECTION * (wanted - grasp.fingers) / trial.hidden.gain;
    // Fingers that do not touch close as fast as they may.
    let change = if grasp.fingers > 0.0 { change } else { MAX_CHANGE };
    Ok(change.clamp(-MAX_CHANGE, MAX_CHANGE))
}

/// Returns the change towards a constant commanded grip, N.
pub fn constant(trial: &Trial, grip: f64) -> f64 {
    grip - trial.grip()
}

/// Runs a trial without pictures under a controller.
///
/// # Errors
/// If the trial can't be simulated, or the controller fails.
pub fn run(seed: u64, mut control: impl FnMut(&Trial) -> Result<f64>) -> Result<Outcome> {
    let mut trial = Trial::start(seed, None)?;
    loop {
        let change = control(&trial)?;
        if !trial.act(change, true)? {
            return Ok(trial.outcome());
        }
    }
}

/// Disturbance of the executed commands in demonstrations: it leads to states that the expert alone never sees, and the
/// expert shows how to leave them.
#[derive(Debug)]
pub struct Disturbance {
    rng: ChaCha8Rng,
    /// False in some demonstrations, which show how the task looks when it goes well.
    enabled: bool,
    value: f64,
}

impl Disturbance {
    /// Creates the disturbance of a seed.
    pub fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(78);
        let enabled = rng.random::<f64>() >= UNDISTURBED;
        Self { rng, enabled, value: 0.0 }
    }

    /// Returns the disturbance of the next command, N, for a force of the fingers, N.
    pub fn next(&mut self, fingers: f64) -> f64 {
        if !self.enabled {
            return 0.0;
        }
        let step: f64 = StandardNormal.sample(&mut self.rng);
        self.value = NOISE_MEMORY * self.value + (NOISE[0] + NOISE[1] * fingers) * step;
        self.value
    }
}
