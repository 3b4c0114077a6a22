//! Computation time of deterministic runs on a shared machine.

use std::time::Instant;

use nix::time::ClockId;

use crate::sim::Rollout;

/// The least time that each part of a run took over several repetitions, s.
///
/// A run repeats bit by bit, so part k does the same work in each repetition. Other programs rarely slow down the same
/// part, a few milliseconds long, in all of them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Clock {
    least: Vec<f64>,
}

impl Clock {
    /// Adds the time of part `index`; the parts of a repetition come in order.
    pub fn add(&mut self, index: usize, seconds: f64) {
        match self.least.get_mut(index) {
            Some(least) => *least = least.min(seconds),
            None => self.least.push(seconds),
        }
    }

    /// Returns the time of a whole run, s.
    pub fn total(&self) -> f64 {
        self.least.iter().sum()
    }

    /// Runs an episode and adds the time of each frame after the first: steps, control, guards and the state, without
    /// labels and pictures. Returns the simulated time of these frames, s.
    pub fn add_episode(&mut self, mut rollout: Rollout) -> f64 {
        rollout.skip_frame();
        for part in 0.. {
            let stopwatch = Stopwatch::start();
            if !rollout.skip_frame() {
                break;
            }
            self.add(part, stopwatch.seconds());
        }
        self.least.len() as f64 * rollout.interval()
    }
}

/// Measures the processor time of the calling thread, which does not grow while other programs run; the wall clock where
/// the system does not report processor time.
#[derive(Debug, Clone, Copy)]
pub struct Stopwatch {
    processor: Option<f64>,
    wall: Instant,
}

impl Stopwatch {
    /// Starts.
    pub fn start() -> Self {
        Self { processor: thread_seconds(), wall: Instant::now() }
    }

    /// Returns the seconds since the start.
    pub fn seconds(&self) -> f64 {
        match (self.processor, thread_seconds()) {
            (Some(start), Some(now)) => now - start,
            _ => self.wall.elapsed().as_secs_f64(),
        }
    }
}

fn thread_seconds() -> Option<f64> {
    let time = ClockId::CLOCK_THREAD_CPUTIME_ID.now().ok()?;
    Some(time.tv_sec() as f64 + 1e-9 * time.tv_nsec() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleeping_takes_no_processor_time() {
        let stopwatch = Stopwatch::start();
        std::thread::sleep(std::time::Duration::from_millis(50));
        assert!((0.0..0.04).contains(&stopwatch.seconds()));
    }

    #[test]
    fn each_part_counts_with_its_best_repetition() {
        let mut clock = Clock::default();
        for run in [[3.0, 1.0, 5.0], [1.0, 4.0, 2.0]] {
            run.into_iter().enumerate().for_each(|(index, seconds)| clock.add(index, seconds));
        }
        assert_eq!(clock.total(), 4.0);
    }
}
