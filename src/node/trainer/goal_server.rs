//! Action `~/train`: accepts one goal at a time, trains it on its own thread, and sends feedback and result.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use candle_core::Device;
use futures::{FutureExt, Stream, StreamExt};
use r2r::egotac_msgs::action::Train;
use r2r::{ActionServerCancelRequest, ActionServerGoal, ActionServerGoalRequest};

use super::goal_job;
use super::progress::{Progress, native_status};
use crate::message::{Header, TrainerStatus};
use crate::node::diagnostics::{Level, Tally, TaskReport};
use crate::node::episode_recorder::SharedRing;
use crate::node::flatten::flatten;
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::node::params::Parameters;
use crate::node::publisher::Publisher;
use crate::node::runtime::Runtime;
use crate::train::job::{self, Job};
use crate::train::{Outcome, memory};

/// Serves goals, one at a time.
pub(super) struct GoalServer {
    ring: SharedRing,
    folder: PathBuf,
    device: Device,
    parameters: Arc<Parameters>,
    progress: Arc<Mutex<Progress>>,
    active: Option<ActiveGoal>,
    log: Log,
}

/// Goal whose training runs.
struct ActiveGoal {
    goal: ActionServerGoal<Train::Action>,
    cancel_requests: CancelRequests,
    cause: Cause,
    /// True for training in rounds; the checkpoint of each is announced.
    is_live: bool,
    /// Tells the training thread to stop and save its state.
    stop: Arc<AtomicBool>,
    thread: JoinHandle<crate::Result<Outcome>>,
}

/// Cause of the end of a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cause {
    /// Its last step, or an error.
    Itself,
    /// A cancel request.
    Cancelled,
    /// The end of the node.
    Shutdown,
}

type CancelRequests = Box<dyn Stream<Item = ActionServerCancelRequest> + Unpin>;

impl GoalServer {
    /// Live goals train on the episodes of `ring`; runs without a folder go below `folder`. The allocator keeps freed memory only
    /// while a goal trains.
    pub(super) fn new(
        ring: SharedRing,
        folder: PathBuf,
        device: Device,
        parameters: Arc<Parameters>,
        log: Log,
    ) -> Self {
        memory::keep(false);
        Self { ring, folder, device, parameters, progress: Arc::default(), active: None, log }
    }

    /// Stops the active goal, waits until its state is saved, and aborts it with a result. Returns true if there was one.
    pub(super) fn stop(&mut self) -> bool {
        let Some(active) = self.active.take() else { return false };
        active.stop.store(true, Ordering::Relaxed);
        self.join(ActiveGoal { cause: Cause::Shutdown, ..active });
        true
    }

    /// Starts a goal, or rejects it if it is invalid or another goal is active.
    pub(super) fn take(&mut self, request: ActionServerGoalRequest<Train::Action>) {
        let job = match &self.active {
            Some(_) => Err(anyhow::anyhow!("another goal is active")),
            None if !self.parameters.get::<bool>("enabled") => Err(anyhow::anyhow!("the node is disabled")),
            None => goal_job::job(&request.goal, &self.parameters, &self.folder, &self.ring),
        };
        let job = match job {
            Ok(job) => job,
            Err(error) => return self.reject(request, &error),
        };
        match request.accept() {
            Ok((goal, cancel_requests)) => self.start(goal, Box::new(cancel_requests), job),
            Err(error) => self.log.error(format!("cannot accept a goal: {error}")),
        }
    }

    fn reject(&self, request: ActionServerGoalRequest<Train::Action>, error: &anyhow::Error) {
        self.log.error(format!("goal rejected: {error:#}"));
        // A rejection carries no reason, so the status gives it.
        self.update(|progress| progress.message = format!("goal rejected: {error:#}"));
        if let Err(error) = request.reject() {
            self.log.error(format!("cannot send the rejection of a goal: {error}"));
        }
    }

    /// Starts the training thread of an accepted goal.
    fn start(&mut self, mut goal: ActionServerGoal<Train::Action>, cancel_requests: CancelRequests, job: Job) {
        let (steps, is_live) = (job.config.steps, job.live.is_some());
        self.update(|progress| *progress = Progress { state: TrainerStatus::TRAINING, steps, ..Progress::default() });
        let stop = Arc::new(AtomicBool::new(false));
        let (progress, device, stopped) = (Arc::clone(&self.progress), self.device.clone(), Arc::clone(&stop));
        let work = move || {
            job::run(&job, &device, &stopped, &mut |event| {
                lock(&progress).update(&event);
            })
        };
        match std::thread::Builder::new().name("training".into()).spawn(work) {
            Ok(thread) => {
                self.active = Some(ActiveGoal { goal, cancel_requests, cause: Cause::Itself, is_live, stop, thread });
            }
            Err(error) => {
                let message = format!("cannot start the training thread: {error}");
                self.log.error(message.clone());
                drop(goal.abort(Train::Result { message, ..Train::Result::default() }));
            }
        }
    }

    /// Publishes the status and serves the active goal; returns the checkpoint of a goal that succeeded just now, or of a round
    /// that ended.
    pub(super) fn tick(&mut self, publisher: &Publisher<TrainerStatus>, runtime: &Runtime) -> Option<PathBuf> {
        let status = self.status(runtime);
        if let Err(error) = publisher.publish(&status) {
            self.log.warn_throttled("status", format!("~/status: {error:#}"));
        }
        let active = self.active.as_mut()?;
        while let Some(Some(request)) = active.cancel_requests.next().now_or_never() {
            request.accept();
            active.cause = Cause::Cancelled;
            active.stop.store(true, Ordering::Relaxed);
        }
        if !active.thread.is_finished() {
            if let Err(error) = active.goal.publish_feedback(Train::Feedback { status: native_status(&status) }) {
                self.log.warn_throttled("feedback", format!("cannot send the goal's feedback: {error}"));
            }
            return lock(&self.progress).round_checkpoint.take();
        }
        let active = self.active.take()?;
        let last_round = lock(&self.progress).round_checkpoint.take();
        self.join(active).or(last_round)
    }

    /// Waits for the end of a training and sends its result; returns the checkpoint if it succeeded and was not announced before.
    fn join(&mut self, active: ActiveGoal) -> Option<PathBuf> {
        let ActiveGoal { goal, cause, is_live, thread, .. } = active;
        let outcome = match thread.join() {
            Ok(outcome) => outcome.map_err(|error| error.to_string()),
            Err(_) => Err("the training thread panicked".to_owned()),
        };
        memory::keep(false);
        // The last round of a live goal has the same weights.
        self.finish(goal, cause, outcome).filter(|_| !is_live)
    }

    /// Sends the result of a goal; returns the checkpoint if it succeeded.
    fn finish(
        &mut self,
        mut goal: ActionServerGoal<Train::Action>,
        cause: Cause,
        outcome: Result<Outcome, String>,
    ) -> Option<PathBuf> {
        let mut result = outcome.as_ref().map(result_of).unwrap_or_default();
        let (state, sent, checkpoint) = match outcome {
            outcome if cause == Cause::Shutdown => {
                let saved = match outcome {
                    Ok(_) => "checkpoint and the state to resume from are saved".to_owned(),
                    Err(error) => error,
                };
                result.message = format!("the node was shut down; {saved}");
                ("aborted", goal.abort(result.clone()), None)
            }
            Ok(_) if cause == Cause::Cancelled => {
                result.message = "cancelled; the state to resume from is saved".into();
                (TrainerStatus::CANCELLED, goal.cancel(result.clone()), None)
            }
            Ok(outcome) => {
                result.success = true;
                (TrainerStatus::SUCCEEDED, goal.succeed(result.clone()), Some(outcome.checkpoint))
            }
            Err(error) => {
                self.log.error(format!("training failed: {error}"));
                result.message = error;
                (TrainerStatus::FAILED, goal.abort(result.clone()), None)
            }
        };
        if let Err(error) = sent {
            self.log.error(format!("cannot send the goal's result: {error}"));
        }
        self.update(|progress| {
            progress.state = state;
            progress.message.clone_from(&result.message);
            progress.remaining_secs = f64::NAN;
        });
        self.log.info(format!("goal {state} after {} steps", result.steps));
        checkpoint
    }

    fn status(&self, runtime: &Runtime) -> TrainerStatus {
        let counts = lock(&self.ring).counts();
        let progress = lock(&self.progress).clone();
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

    /// Returns the state of the training, with the counts of live images, for `/diagnostics`.
    pub(super) fn task_report(&self, tally: &Tally) -> TaskReport {
        let mut counts = tally.counts();
        let rates = counts.rates();
        let progress = lock(&self.progress);
        let level = if progress.state == TrainerStatus::FAILED { Level::Error } else { Level::Ok };
        let message = format!("{}, step {} of {}", progress.state, progress.step, progress.steps);
        TaskReport { task: "training".into(), level, message, values: counts.values(rates) }
    }

    fn update(&self, change: impl FnOnce(&mut Progress)) {
        change(&mut lock(&self.progress));
    }
}

/// Returns checkpoint, steps and scores of a training, without success or message.
fn result_of(outcome: &Outcome) -> Train::Result {
    let scores = outcome.validation.as_ref().map(|report| flatten(&serde_json::json!(report))).unwrap_or_default();
    let (names, values) = scores.into_iter().unzip();
    Train::Result {
        checkpoint: outcome.checkpoint.display().to_string(),
        sha256: outcome.sha256.clone(),
        steps: outcome.steps as u32,
        names,
        values,
        ..Train::Result::default()
    }
}
