//! Training jobs inside a running program: on given stores, or in rounds on recordings that are still growing.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use candle_core::Device;

use super::run::lock_folder;
use super::source::TrainingSource;
use super::{Config, Control, Event, Outcome, train};
use crate::dataset::zarr::ZarrReader;
use crate::error::{Error, Result};
use crate::file::{self, input, limits};

/// Time between two looks for recordings.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// A training job.
pub struct Job {
    /// Configuration of the run. In a live job, its data are used beside the recordings, and its steps are the sum over all
    /// rounds.
    pub config: Config,
    /// True to resume from the state in the run's folder.
    pub resume: bool,
    /// Recordings to learn from while they grow; None trains on the stores of `config` alone.
    pub live: Option<LiveRecordings>,
}

/// Recordings that grow while a job runs.
pub struct LiveRecordings {
    /// Lists the stores that exist now, oldest first.
    pub stores: Box<dyn Fn() -> Vec<PathBuf> + Send>,
    /// Frames that must exist before the first round.
    pub least_frames: usize,
    /// Steps per round; each round uses the recordings that exist at its start.
    pub round_steps: usize,
}

/// Event of a job, for its observer.
#[derive(Debug)]
pub enum JobEvent<'a> {
    /// The job waits for recordings: number of frames that exist, and that are needed.
    Waiting(usize, usize),
    /// Event of the current run, with the number of steps that earlier rounds have taken.
    Training(usize, &'a Event<'a>),
    /// A round of a live job has ended with this checkpoint.
    RoundEnded(&'a Path),
}

/// Runs a job until its last step or until `stop` is set; in both cases checkpoint and state are saved. A stopped job is not
/// validated.
///
/// # Errors
/// As [`train()`], and if recordings can't be read.
pub fn run(job: &Job, device: &Device, stop: &AtomicBool, observe: &mut dyn FnMut(JobEvent)) -> Result<Outcome> {
    let control = || if stop.load(Ordering::Relaxed) { Control::StopUnvalidated } else { Control::Continue };
    let Some(live) = &job.live else {
        return train(&job.config, job.resume, device, &mut |event| {
            observe(JobEvent::Training(0, &event));
            control()
        });
    };
    // Each round locks its own folder; the folder of them all gets the checkpoint.
    let _lock = lock_folder(&job.config.out)?;
    let mut taken = 0;
    let mut last: Option<Outcome> = None;
    while taken < job.config.steps && !stop.load(Ordering::Relaxed) {
        let round = job.config.out.join(format!("round_{:04}", taken / live.round_steps.max(1)));
        let snapshot = round.join("recordings");
        let Some(stores) = wait(live, &snapshot, stop, observe)? else { break };
        let config = round_config(&job.config, live, taken, &round, stores, last.as_ref());
        let outcome = train(&config, false, device, &mut |event| {
            observe(JobEvent::Training(taken, &event));
            control()
        });
        // The links kept evicted recordings alive; the names of the stores stay in the round's config.yaml.
        fs::remove_dir_all(&snapshot).map_err(Error::io(&snapshot))?;
        let outcome = outcome?;
        taken += outcome.steps;
        observe(JobEvent::RoundEnded(&outcome.checkpoint));
        last = Some(outcome);
    }
    let Some(last) = last else {
        return Err(Error::value("live recordings", format!("at least {} frames", live.least_frames), "none in time"));
    };
    let checkpoint = job.config.out.join("checkpoint.safetensors");
    file::write(&checkpoint, &input::read(&last.checkpoint, limits::WEIGHTS)?)?;
    Ok(Outcome { checkpoint, steps: taken, ..last })
}

/// Returns the configuration of the round that begins after `taken` steps.
fn round_config(
    whole: &Config,
    live: &LiveRecordings,
    taken: usize,
    out: &Path,
    stores: Vec<PathBuf>,
    last: Option<&Outcome>,
) -> Config {
    let steps = live.round_steps.min(whole.steps - taken);
    let mut config = Config { out: out.to_path_buf(), steps, seed: whole.seed + taken as u64, ..whole.clone() };
    config.data.push(TrainingSource { mirror: true, ..TrainingSource::of(stores) });
    if let Some(last) = last {
        config.init = Some(last.checkpoint.clone());
        config.optimizer.warmup = 0.0;
    }
    config.optimizer.encoder_factor = Some(whole.encoder_factor());
    if taken + steps < whole.steps {
        // The learning rate decays in the last round only: each round may bring new recordings.
        config.optimizer.final_learning_rate = config.optimizer.learning_rate;
    }
    config.validate_every = whole.validate_every.min(steps).max(1);
    config
}

/// Waits for enough frames, and hard-links their stores into `snapshot`, where they survive an eviction.
fn wait(
    live: &LiveRecordings,
    snapshot: &Path,
    stop: &AtomicBool,
    observe: &mut dyn FnMut(JobEvent),
) -> Result<Option<Vec<PathBuf>>> {
    loop {
        if snapshot.exists() {
            fs::remove_dir_all(snapshot).map_err(Error::io(snapshot))?;
        }
        let mut linked = Vec::new();
        let mut frames = 0;
        for store in (live.stores)() {
            let target = snapshot.join(store.file_name().unwrap_or_default());
            // A store that is evicted at this moment is left out.
            if hard_link_all(&store, &target).is_ok()
                && let Ok(reader) = ZarrReader::open(&target)
            {
                frames += reader.len();
                linked.push(target);
            }
        }
        if frames >= live.least_frames.max(1) {
            return Ok(Some(linked));
        }
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        observe(JobEvent::Waiting(frames, live.least_frames));
        std::thread::sleep(POLL_INTERVAL);
    }
}

/// Hard-links every file of a folder, recursively.
fn hard_link_all(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        match entry.file_type()?.is_dir() {
            true => hard_link_all(&entry.path(), &target)?,
            false => fs::hard_link(entry.path(), target)?,
        }
    }
    Ok(())
}
