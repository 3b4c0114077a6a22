//! Rendered and labelled frames per second of `egotac sim generate`.

use std::time::Instant;

use egotac::error::{Error, Result};
use egotac::sim::{Generate, RolloutOptions, Scene, Workers, generate_isolated};
use serde::{Deserialize, Serialize};

/// Frames per second, planning and writing included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Throughput {
    /// Width and height of the picture, pixels.
    pub size: u32,
    /// Scenes, taken in turn.
    pub scenes: Vec<String>,
    /// Episodes altogether.
    pub episodes: usize,
    /// Frames altogether.
    pub frames: usize,
    /// Jobs and frames per second.
    pub rates: Vec<Rate>,
}

/// Speed with a number of jobs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    /// Episodes simulated at the same time.
    pub jobs: usize,
    /// Frames per second.
    pub frames_per_second: f64,
}

/// Width and height of the pictures, pixels.
pub const SIZE: u32 = 224;

/// Generates the same store with each number of jobs in turn, in worker processes as `egotac sim generate` does,
/// `repetitions` times; the best time of each counts. The `workers` know the scenes and [`SIZE`].
///
/// # Errors
/// If there is no OpenGL, a rollout fails, or the temporary folder can't be written.
pub fn measure(
    scenes: &[Scene],
    episodes: usize,
    seed: u64,
    jobs: &[usize],
    options: &RolloutOptions,
    workers: &WorkerCommand,
    repetitions: usize,
) -> Result<Throughput> {
    let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir()))?;
    let mut least = vec![f64::INFINITY; jobs.len()];
    let mut frames = 0;
    for repetition in 0..repetitions.max(1) {
        for (jobs, least) in jobs.iter().zip(&mut least) {
            let options = RolloutOptions { picture: Some((SIZE, SIZE)), ..options.clone() };
            let plan = DatasetPlan { scenes: scenes.to_vec(), episodes, seed, jobs: *jobs, options };
            let out = folder.path().join(format!("{repetition}_{jobs}.zarr"));
            let begun = Instant::now();
            frames = generate_in_processes(&plan, workers, false, &out, |_| ())?.frames;
            *least = least.min(begun.elapsed().as_secs_f64());
            std::fs::remove_dir_all(&out).map_err(Error::io(&out))?;
        }
    }
    let rate = |(jobs, least): (&usize, f64)| Rate { jobs: *jobs, frames_per_second: frames as f64 / least };
    Ok(Throughput {
        size: SIZE,
        scenes: scenes.iter().map(|scene| scene.name.clone()).collect(),
        episodes,
        frames,
        rates: jobs.iter().zip(least).map(rate).collect(),
    })
}
