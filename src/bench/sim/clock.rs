//! Times of deterministic runs on a shared machine: part by part the least of several interleaved repetitions.

use std::time::Instant;

use nix::time::ClockId;

use super::knob::Setup;
use crate::sim::{Rollout, RolloutOptions, Scene};

/// The least seconds that each part of a run took.
///
/// A run repeats bit by bit, so the k-th part does the same work each time. What disturbs a machine that others use too
/// rarely slows one part of a few milliseconds in all repetitions.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Clock {
    least: Vec<f64>,
}

impl Clock {
    /// Takes down part `index`; parts come in order in each repetition.
    pub fn add(&mut self, index: usize, seconds: f64) {
        match self.least.get_mut(index) {
            Some(least) => *least = least.min(seconds),
            None => self.least.push(seconds),
        }
    }

    /// Seconds of a whole run.
    pub fn total(&self) -> f64 {
        self.least.iter().sum()
    }

    /// Parts of a run.
    pub fn len(&self) -> usize {
        self.least.len()
    }

    /// Whether nothing was timed.
    pub fn is_empty(&self) -> bool {
        self.least.is_empty()
    }
}

/// Measures the processor time of this thread, which other programs on the machine don't lengthen by waiting; where the
/// system doesn't tell it, the time on the wall.
#[derive(Debug, Clone, Copy)]
pub struct Stopwatch {
    processor: Option<f64>,
    wall: Instant,
}

impl Stopwatch {
    /// Begins now.
    pub fn start() -> Self {
        Self { processor: processor_seconds(), wall: Instant::now() }
    }

    /// Seconds since the start.
    pub fn seconds(&self) -> f64 {
        match (self.processor, processor_seconds()) {
            (Some(begun), Some(now)) => now - begun,
            _ => self.wall.elapsed().as_secs_f64(),
        }
    }
}

fn processor_seconds() -> Option<f64> {
    let time = ClockId::CLOCK_THREAD_CPUTIME_ID.now().ok()?;
    Some(time.tv_sec() as f64 + 1e-9 * time.tv_nsec() as f64)
}

/// Seconds of computation per simulated second for each setup: steps, control, guards and the state at each frame, but
/// no labels and no picture. `None` for a setup that the scene refuses.
pub fn time_setups(
    scene: &Scene,
    seed: u64,
    setups: &[&Setup],
    options: &RolloutOptions,
    repetitions: usize,
) -> Vec<Option<f64>> {
    let mut clocks = vec![Clock::default(); setups.len()];
    let mut simulated = vec![0.0; setups.len()];
    for _ in 0..repetitions {
        for ((setup, clock), simulated) in setups.iter().zip(&mut clocks).zip(&mut simulated) {
            let rollout = setup.options(scene, options).and_then(|options| Rollout::new(scene, seed, &options));
            let Ok(mut rollout) = rollout else { continue };
            rollout.skip_frame();
            for part in 0.. {
                let begun = Stopwatch::start();
                if !rollout.skip_frame() {
                    break;
                }
                clock.add(part, begun.seconds());
            }
            *simulated = clock.len() as f64 * rollout.interval();
        }
    }
    clocks.iter().zip(simulated).map(|(clock, time)| (time > 0.0).then(|| clock.total() / time)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waiting_takes_no_processor_time() {
        let begun = Stopwatch::start();
        std::thread::sleep(std::time::Duration::from_millis(50));
        assert!((0.0..0.04).contains(&begun.seconds()));
    }

    #[test]
    fn each_part_counts_with_its_best_repetition() {
        let mut clock = Clock::default();
        for run in [[3.0, 1.0, 5.0], [1.0, 4.0, 2.0]] {
            run.into_iter().enumerate().for_each(|(index, seconds)| clock.add(index, seconds));
        }
        assert_eq!((clock.total(), clock.len()), (4.0, 3));
    }
}
