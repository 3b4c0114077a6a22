//! The action's goals: checked, trained, answered.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use anyhow::{Context as _, ensure};
use candle_core::Device;
use futures::{FutureExt, Stream, StreamExt};
use r2r::egotac_msgs::action::Train;
use r2r::{ActionServerCancelRequest, ActionServerGoal, ActionServerGoalRequest};

use super::progress::{self, Progress, flat, native};
use crate::message::{Header, TrainerStatus};
use crate::node::diagnostics::{Level, Report, Tally};
use crate::node::episode_recorder::SharedRing;
use crate::node::log::Log;
use crate::node::params::Parameters;
use crate::node::runtime::{Publisher, Runtime};
use crate::train::job::{self, Job, LiveRecordings};
use crate::train::source::TrainingSource;
use crate::train::{Config, Outcome};

/// Takes goals, one at a time.
pub struct Trainer {
    ring: SharedRing,
    folder: PathBuf,
    device: Device,
    parameters: Arc<Parameters>,
    progress: Arc<Mutex<Progress>>,
    active: Option<Active>,
    log: Log,
}

/// A goal at work.
struct Active {
    goal: ActionServerGoal<Train::Action>,
    cancels: Box<dyn Stream<Item = ActionServerCancelRequest> + Unpin>,
    cancelled: bool,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<crate::Result<Outcome>>,
}

impl Trainer {
    /// Learns from what `ring` holds and from stores, with results below `folder`.
    pub fn new(ring: SharedRing, folder: PathBuf, device: Device, parameters: Arc<Parameters>, log: Log) -> Self {
        Self { ring, folder, device, parameters, progress: Arc::default(), active: None, log }
    }

    /// Stops the goal at work and waits until its state is saved.
    pub fn stop(&mut self) {
        if let Some(active) = self.active.take() {
            active.stop.store(true, Ordering::Relaxed);
            drop(active.thread.join());
        }
    }

    /// Begins a goal, or refuses it.
    pub fn take(&mut self, request: ActionServerGoalRequest<Train::Action>) {
        let job = match &self.active {
            Some(_) => Err(anyhow::anyhow!("a goal is at work")),
            None => self.job(&request.goal),
        };
        let job = match job {
            Ok(job) => job,
            Err(error) => {
                self.log.error(format!("goal refused: {error:#}"));
                // The reason stands in the status, too: a rejection carries none.
                self.set(|progress| progress.message = format!("goal refused: {error:#}"));
                if let Err(error) = request.reject() {
                    self.log.error(format!("the goal's refusal could not be sent: {error}"));
                }
                return;
            }
        };
        let (goal, cancels) = match request.accept() {
            Ok((goal, cancels)) => (goal, Box::new(cancels)),
            Err(error) => return self.log.error(format!("a goal could not be accepted: {error}")),
        };
        let steps = job.config.steps;
        self.set(|progress| *progress = Progress { state: "training", steps, ..Progress::default() });
        let stop = Arc::new(AtomicBool::new(false));
        let (progress, device, stopped) = (Arc::clone(&self.progress), self.device.clone(), Arc::clone(&stop));
        let work = move || job::run(&job, &device, &stopped, &mut |news| progress::tell(&progress, steps, &news));
        match std::thread::Builder::new().name("training".into()).spawn(work) {
            Ok(thread) => self.active = Some(Active { goal, cancels, cancelled: false, stop, thread }),
            Err(error) => {
                let mut goal = goal;
                let message = format!("no thread: {error}");
                self.log.error(message.clone());
                drop(goal.abort(Train::Result { message, ..Train::Result::default() }));
            }
        }
    }

    /// What a goal asks for, checked.
    fn job(&self, goal: &Train::Goal) -> anyhow::Result<Job> {
        let file = match goal.config.is_empty() {
            true => self.parameters.get::<String>("config"),
            false => goal.config.clone(),
        };
        ensure!(!file.is_empty(), "config: expected a YAML file in the goal or in the parameter config, got none");
        ensure!(!(goal.live && goal.resume), "resume: expected false with live, got true");
        let mut config = Config::read_unchecked(Path::new(&file))?;
        if !goal.data.is_empty() {
            config.data = goal.data.iter().map(TrainingSource::path).collect();
        } else if goal.live && config.data.iter().all(|source| source.stores.iter().all(|store| !store.exists())) {
            // What the file names is for a run without topics.
            config.data.clear();
        }
        if !goal.base_checkpoint.is_empty() {
            config.init = Some(PathBuf::from(&goal.base_checkpoint));
        }
        if !goal.out.is_empty() {
            config.out = PathBuf::from(&goal.out);
        } else if config.out.is_relative() {
            config.out = self.folder.join("runs").join(&config.out);
        }
        if goal.steps > 0 {
            config.steps = goal.steps as usize;
        }
        let live = goal.live.then(|| {
            let ring = Arc::clone(&self.ring);
            LiveRecordings {
                stores: Box::new(move || ring.lock().unwrap_or_else(PoisonError::into_inner).stores()),
                least_frames: self.parameters.get::<i64>("min_live_frames") as usize,
                round_steps: self.parameters.get::<i64>("round_steps") as usize,
            }
        });
        match &live {
            // The recordings are data that is not there yet.
            Some(_) if config.data.is_empty() => {
                let here = Config { data: vec![TrainingSource::path(&self.folder)], ..config.clone() };
                here.check().with_context(|| file.clone())?;
            }
            _ => config.check().with_context(|| file.clone())?,
        }
        Ok(Job { config, resume: goal.resume, live })
    }

    /// Publishes the status and looks after the goal; gives the checkpoint of one that has just succeeded.
    pub fn tick(&mut self, publisher: &Publisher<TrainerStatus>, runtime: &Runtime) -> Option<PathBuf> {
        let status = self.status(runtime);
        if let Err(error) = publisher.publish(&status) {
            self.log.warn_throttled("status", format!("~/status: {error:#}"));
        }
        let active = self.active.as_mut()?;
        while let Some(Some(request)) = active.cancels.next().now_or_never() {
            request.accept();
            active.cancelled = true;
            active.stop.store(true, Ordering::Relaxed);
        }
        if !active.thread.is_finished() {
            if let Err(error) = active.goal.publish_feedback(Train::Feedback { status: native(&status) }) {
                self.log.warn_throttled("feedback", format!("the goal's feedback could not be sent: {error}"));
            }
            return None;
        }
        let Active { goal, cancelled, thread, .. } = self.active.take()?;
        let outcome = match thread.join() {
            Ok(outcome) => outcome.map_err(|error| error.to_string()),
            Err(_) => Err("the training thread panicked".to_owned()),
        };
        self.finish(goal, cancelled, outcome)
    }

    fn finish(
        &mut self,
        mut goal: ActionServerGoal<Train::Action>,
        cancelled: bool,
        outcome: Result<Outcome, String>,
    ) -> Option<PathBuf> {
        let mut result = Train::Result::default();
        if let Ok(outcome) = &outcome {
            let scores = outcome.validation.as_ref().map(|report| flat(&serde_json::json!(report))).unwrap_or_default();
            result.checkpoint = outcome.checkpoint.display().to_string();
            result.sha256.clone_from(&outcome.sha256);
            result.steps = outcome.steps as u32;
            (result.names, result.values) = scores.into_iter().unzip();
        }
        let (state, sent, checkpoint) = match outcome {
            Ok(_) if cancelled => {
                result.message = "cancelled; the state to resume from is saved".into();
                ("cancelled", goal.cancel(result.clone()), None)
            }
            Ok(outcome) => {
                result.success = true;
                ("succeeded", goal.succeed(result.clone()), Some(outcome.checkpoint))
            }
            Err(error) => {
                self.log.error(format!("training failed: {error}"));
                result.message = error;
                ("failed", goal.abort(result.clone()), None)
            }
        };
        if let Err(error) = sent {
            self.log.error(format!("the goal's result could not be sent: {error}"));
        }
        self.set(|progress| {
            progress.state = state;
            progress.message.clone_from(&result.message);
            progress.remaining_secs = f64::NAN;
        });
        self.log.info(format!("goal {state} after {} steps", result.steps));
        checkpoint
    }

    fn status(&self, runtime: &Runtime) -> TrainerStatus {
        let counts = self.ring.lock().unwrap_or_else(PoisonError::into_inner).counts();
        let progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let (names, values) = progress.losses.into_iter().chain(progress.scores).unzip();
        TrainerStatus {
            header: Header { stamp: runtime.clock().now(), frame_id: String::new() },
            state: progress.state.into(),
            message: progress.message,
            recorded_frames: counts.frames,
            recorded_episodes: counts.episodes,
            evicted_episodes: counts.evicted,
            recorded_bytes: counts.bytes,
            step: progress.step as u32,
            steps: progress.steps as u32,
            names,
            values,
            windows_per_s: progress.windows_per_s,
            remaining_secs: progress.remaining_secs,
        }
    }

    /// For the diagnostics.
    pub fn report(&self, tally: &Tally) -> Report {
        let mut counts = tally.counts();
        let rates = counts.rates();
        let progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        let level = if progress.state == "failed" { Level::Error } else { Level::Ok };
        let message = format!("{}, step {} of {}", progress.state, progress.step, progress.steps);
        Report { task: "training", level, message, values: counts.values(rates) }
    }

    fn set(&self, change: impl FnOnce(&mut Progress)) {
        change(&mut self.progress.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
