//! A training that somebody asked for while the program runs: on stores, or in rounds on recordings that grow meanwhile.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use candle_core::Device;

use super::source::Source;
use super::{Config, Control, Event, Outcome, train};
use crate::dataset::zarr::ZarrReader;
use crate::error::{Error, Result};

/// How often a job that waits looks again.
const PATIENCE: Duration = Duration::from_millis(200);

/// What to train.
pub struct Job {
    /// The run; of a live job its data are learned from beside the recordings, and its steps are those of all rounds.
    pub config: Config,
    /// Whether to go on with the state in the run's folder.
    pub resume: bool,
    /// Recordings to learn from as they come.
    pub live: Option<Live>,
}

/// Recordings that grow while a job runs.
pub struct Live {
    /// The stores that are there now, oldest first.
    pub stores: Box<dyn Fn() -> Vec<PathBuf> + Send>,
    /// Frames that must be there before the first round.
    pub least_frames: usize,
    /// Steps between two looks for new recordings.
    pub round_steps: usize,
}

/// What a job tells.
#[derive(Debug)]
pub enum News<'a> {
    /// It waits for recordings: frames that are there, and that are wanted.
    Waiting(usize, usize),
    /// An event of the run, with the steps that earlier rounds have taken.
    Training(usize, &'a Event<'a>),
}

/// Runs a job until its last step or until `stop` is set; either way checkpoint and state are on the disk.
///
/// # Errors
/// As [`train()`], and if recordings can't be read.
pub fn run(job: &Job, device: &Device, stop: &AtomicBool, tell: &mut dyn FnMut(News)) -> Result<Outcome> {
    let control = || if stop.load(Ordering::Relaxed) { Control::Stop } else { Control::Continue };
    let Some(live) = &job.live else {
        return train(&job.config, job.resume, device, &mut |event| {
            tell(News::Training(0, &event));
            control()
        });
    };
    let mut taken = 0;
    let mut last: Option<Outcome> = None;
    while taken < job.config.steps && !stop.load(Ordering::Relaxed) {
        let round = job.config.out.join(format!("round_{:04}", taken / live.round_steps.max(1)));
        let snapshot = round.join("recordings");
        let Some(stores) = wait(live, &snapshot, stop, tell)? else { break };
        let config = round_config(&job.config, live, taken, &round, stores, last.as_ref());
        let outcome = train(&config, false, device, &mut |event| {
            tell(News::Training(taken, &event));
            control()
        });
        // What it learned from may be evicted by now; its names are in the round's config.yaml.
        fs::remove_dir_all(&snapshot).map_err(Error::io(&snapshot))?;
        let outcome = outcome?;
        taken += outcome.steps;
        last = Some(outcome);
    }
    let Some(last) = last else {
        return Err(Error::value("live recordings", format!("at least {} frames", live.least_frames), "none in time"));
    };
    let checkpoint = job.config.out.join("checkpoint.safetensors");
    let bytes = fs::read(&last.checkpoint).map_err(Error::io(&last.checkpoint))?;
    crate::file::write(&checkpoint, &bytes)?;
    Ok(Outcome { checkpoint, steps: taken, ..last })
}

/// The configuration of the round that begins after `taken` steps.
fn round_config(
    whole: &Config,
    live: &Live,
    taken: usize,
    out: &Path,
    stores: Vec<PathBuf>,
    last: Option<&Outcome>,
) -> Config {
    let steps = live.round_steps.min(whole.steps - taken);
    let mut config = Config { out: out.to_path_buf(), steps, seed: whole.seed + taken as u64, ..whole.clone() };
    config.data.push(Source { mirror: true, ..Source::of(stores) });
    if let Some(last) = last {
        config.init = Some(last.checkpoint.clone());
        config.optimizer.warmup = 0.0;
    }
    config.optimizer.encoder_factor = Some(whole.encoder_factor());
    if taken + steps < whole.steps {
        // The rate falls in the last round alone: what comes then may be new.
        config.optimizer.final_learning_rate = config.optimizer.learning_rate;
    }
    config.validate_every = whole.validate_every.min(steps).max(1);
    config
}

/// Waits for enough frames, and links their stores into `snapshot`: there they outlive an eviction.
fn wait(live: &Live, snapshot: &Path, stop: &AtomicBool, tell: &mut dyn FnMut(News)) -> Result<Option<Vec<PathBuf>>> {
    loop {
        if snapshot.exists() {
            fs::remove_dir_all(snapshot).map_err(Error::io(snapshot))?;
        }
        let mut linked = Vec::new();
        let mut frames = 0;
        for store in (live.stores)() {
            let target = snapshot.join(store.file_name().unwrap_or_default());
            // One that is evicted at this moment is left out.
            if link(&store, &target).is_ok()
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
        tell(News::Waiting(frames, live.least_frames));
        std::thread::sleep(PATIENCE);
    }
}

/// Links every file of a folder.
fn link(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let target = to.join(entry.file_name());
        match entry.file_type()?.is_dir() {
            true => link(&entry.path(), &target)?,
            false => fs::hard_link(entry.path(), target)?,
        }
    }
    Ok(())
}
