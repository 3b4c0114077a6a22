//! The node `trainer`: an action that trains, on stores or on what comes live.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use candle_core::Device;
use futures::{FutureExt, Stream, StreamExt};
use r2r::egotac_msgs::action::Train;
use r2r::egotac_msgs::srv::LoadModel;
use r2r::{ActionServerCancelRequest, ActionServerGoal, ActionServerGoalRequest};

use super::diagnostics::{self, Level, Report, Tally};
use super::log::Log;
use super::params::{Allowed, Parameter, Parameters};
use super::recording::{self, Recording, SharedRing};
use super::runtime::{Publisher, Runtime};
use super::{Shutdown, qos};
use crate::image::{self, RawImage};
use crate::message::{CompressedImage, Header, Image, TactileTruth, TrainerStatus};
use crate::train::job::{self, Job, Live, News};
use crate::train::pass::Losses;
use crate::train::source::Source;
use crate::train::{Config, Event, Outcome};

/// Time between two statuses, and feedbacks.
const STATUS: Duration = Duration::from_millis(500);
/// How long a predictor may take to answer.
const PATIENCE: Duration = Duration::from_secs(30);

/// The node's parameters.
pub fn parameters() -> Vec<Parameter> {
    vec![
        Parameter::new("config", "", Allowed::Any, "Configuration (YAML) of goals that name none."),
        Parameter::fixed(
            "folder",
            "trainer",
            Allowed::Any,
            "Folder for recorded episodes, and for runs that name none.",
        ),
        Parameter::fixed("device", "cpu", Allowed::OneOf(&["cpu", "cuda"]), "Where networks are trained."),
        Parameter::fixed(
            "image_transport",
            "raw",
            Allowed::OneOf(&["raw", "compressed"]),
            "Take sensor_msgs/Image on image, or sensor_msgs/CompressedImage (JPEG, PNG) on image/compressed.",
        ),
        Parameter::new("record", true, Allowed::Any, "Record images that come with a truth of the same stamp."),
        Parameter::fixed(
            "max_recorded_mb",
            2000.0,
            Allowed::Doubles(0.001, 1e9),
            "What recorded episodes may take on the disk, MB; the oldest are removed beyond it.",
        ),
        Parameter::fixed("episode_secs", 10.0, Allowed::Doubles(0.1, 3600.0), "Longest recorded episode, seconds."),
        Parameter::new(
            "min_live_frames",
            200,
            Allowed::Integers(1, 100_000_000),
            "Recorded frames that a live goal waits for.",
        ),
        Parameter::new(
            "round_steps",
            200,
            Allowed::Integers(1, 100_000_000),
            "Steps of a live goal between two looks for new episodes.",
        ),
        Parameter::new(
            "notify",
            "",
            Allowed::Any,
            "Service (egotac_msgs/srv/LoadModel) that hears of each new checkpoint, e.g. /predictor/load_model.",
        ),
        Parameter::use_sim_time(),
    ]
}

/// Creates the node and runs until `shutdown`.
///
/// # Errors
/// As [`run`].
pub fn start(shutdown: &Shutdown) -> anyhow::Result<()> {
    run(Runtime::create("trainer", &parameters())?, shutdown)
}

/// Runs the node until `shutdown`; a training that runs then is stopped, with its state saved.
///
/// # Errors
/// If ROS or the disk refuses something.
pub fn run(mut runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let folder = PathBuf::from(parameters.get::<String>("folder"));
    let device = match parameters.get::<String>("device").as_str() {
        "cuda" => Device::new_cuda(0).context("device cuda")?,
        _ => Device::Cpu,
    };
    let most_bytes = (parameters.get::<f64>("max_recorded_mb") * 1e6) as u64;
    let log = runtime.log().clone();
    let opened = Recording::open(&folder.join("live"), most_bytes, parameters.get("episode_secs"), &log, shutdown)?;
    let tally = Tally::default();
    subscribe(&mut runtime, Rc::new(RefCell::new(opened.recording)), &tally)?;

    let trainer = Rc::new(RefCell::new(Trainer {
        ring: opened.ring,
        folder,
        device,
        parameters,
        progress: Arc::default(),
        active: None,
        log,
    }));
    let goals = Rc::clone(&trainer);
    runtime.action_server::<Train::Action>("~/train", move |request| goals.borrow_mut().take(request))?;
    let publisher = runtime.publisher("~/status", qos::output())?;
    let statuses = Rc::clone(&trainer);
    runtime.every(STATUS, move |runtime| {
        let finished = statuses.borrow_mut().tick(&publisher, runtime);
        if let Some(checkpoint) = finished {
            notify(runtime, &checkpoint);
        }
    });
    let states = Rc::clone(&trainer);
    diagnostics::publish(&mut runtime, String::new, move |_| states.borrow().report(&tally))?;

    runtime.spin(shutdown);
    if let Some(active) = trainer.borrow_mut().active.take() {
        active.stop.store(true, Ordering::Relaxed);
        drop(active.thread.join());
    }
    drop(runtime);
    recording::join(opened.writer)
}

/// Feeds the recording while `record` is set.
fn subscribe(runtime: &mut Runtime, recording: Rc<RefCell<Recording>>, tally: &Tally) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let (images, records, log, counts) =
        (Rc::clone(&recording), Arc::clone(&parameters), runtime.log().clone(), tally.clone());
    let take = move |decoded: crate::Result<(Header, ::image::RgbImage)>| {
        counts.received();
        match decoded {
            Ok((header, image)) if records.get("record") => {
                images.borrow_mut().image(&header, image);
                counts.processed(None);
            }
            Ok(_) => counts.dropped("disabled"),
            Err(error) => {
                counts.dropped("malformed");
                log.warn_throttled("image", format!("image left out: {error}"));
            }
        }
    };
    match parameters.get::<String>("image_transport") == "compressed" {
        true => {
            let topic = format!("{}/compressed", runtime.resolve("image"));
            runtime.subscribe::<CompressedImage>(&topic, qos::every_input(), move |message| {
                take(message.and_then(|m| Ok((m.header, image::decode(&m.data)?))));
            })?;
        }
        false => {
            runtime.subscribe::<Image>("image", qos::every_input(), move |message| {
                take(message.and_then(|Image { header, height, width, encoding, step, data, .. }| {
                    let raw = RawImage { width, height, encoding: &encoding, step, data: &data };
                    let image = raw.to_rgb()?;
                    Ok((header, image))
                }));
            })?;
        }
    }
    let log = runtime.log().clone();
    runtime.subscribe::<TactileTruth>("truth", qos::every_input(), move |truth| match truth {
        Ok(truth) if parameters.get("record") => recording.borrow_mut().truth(truth),
        Ok(_) => {}
        Err(error) => log.warn_throttled("truth", format!("truth: message left out: {error}")),
    })
}

/// Tells a predictor, if one is to hear of it.
fn notify(runtime: &mut Runtime, checkpoint: &Path) {
    let service = runtime.parameters().get::<String>("notify");
    if service.is_empty() {
        return;
    }
    let log = runtime.log().clone();
    let path = checkpoint.canonicalize().unwrap_or_else(|_| checkpoint.to_path_buf());
    let request = LoadModel::Request { model: path.display().to_string() };
    let name = service.clone();
    let called = runtime.call::<LoadModel::Service>(&service, &request, PATIENCE, move |answer| match answer {
        Some(answer) if answer.success => log.info(format!("{name} runs {}", answer.model_id)),
        Some(answer) => log.error(format!("{name} refused {}: {}", path.display(), answer.message)),
        None => log.error(format!("{name} did not answer")),
    });
    if let Err(error) = called {
        runtime.log().error(format!("notify: {error:#}"));
    }
}

/// What the training thread tells.
#[derive(Debug, Clone)]
struct Progress {
    state: &'static str,
    message: String,
    step: usize,
    steps: usize,
    losses: Vec<(String, f64)>,
    scores: Vec<(String, f64)>,
    windows_per_s: f64,
    remaining_secs: f64,
}

impl Default for Progress {
    fn default() -> Self {
        Self {
            state: "idle",
            message: String::new(),
            step: 0,
            steps: 0,
            losses: Vec::new(),
            scores: Vec::new(),
            windows_per_s: f64::NAN,
            remaining_secs: f64::NAN,
        }
    }
}

struct Trainer {
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
    /// Begins a goal, or refuses it.
    fn take(&mut self, request: ActionServerGoalRequest<Train::Action>) {
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
        let work = move || job::run(&job, &device, &stopped, &mut |news| tell(&progress, steps, &news));
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
            config.data = goal.data.iter().map(Source::path).collect();
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
            Live {
                stores: Box::new(move || ring.lock().unwrap_or_else(PoisonError::into_inner).stores()),
                least_frames: self.parameters.get::<i64>("min_live_frames") as usize,
                round_steps: self.parameters.get::<i64>("round_steps") as usize,
            }
        });
        match &live {
            // The recordings are data that is not there yet.
            Some(_) if config.data.is_empty() => {
                let here = Config { data: vec![Source::path(&self.folder)], ..config.clone() };
                here.check().with_context(|| file.clone())?;
            }
            _ => config.check().with_context(|| file.clone())?,
        }
        Ok(Job { config, resume: goal.resume, live })
    }

    /// Publishes the status and looks after the goal; gives the checkpoint of one that has just succeeded.
    fn tick(&mut self, publisher: &Publisher<TrainerStatus>, runtime: &Runtime) -> Option<PathBuf> {
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

    fn report(&self, tally: &Tally) -> Report {
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

/// Writes down what the training thread says.
fn tell(progress: &Mutex<Progress>, steps: usize, news: &News) {
    const KEEP: f64 = 0.9;
    let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
    match news {
        News::Waiting(there, wanted) => {
            progress.state = "waiting";
            progress.message = format!("{there} of {wanted} live frames");
        }
        News::Training(before, Event::Stepped(step)) => {
            progress.state = "training";
            progress.message.clear();
            progress.step = before + step.step;
            progress.losses = Losses::NAMES
                .iter()
                .zip(step.losses.values())
                .map(|(name, value)| ((*name).to_owned(), value.into()))
                .collect();
            let now = step.windows as f64 / step.secs.max(1e-9);
            let smooth = progress.windows_per_s;
            progress.windows_per_s = if smooth.is_nan() { now } else { KEEP * smooth + (1.0 - KEEP) * now };
            let left = steps.saturating_sub(progress.step) as f64;
            progress.remaining_secs = left * step.windows as f64 / progress.windows_per_s;
        }
        News::Training(_, Event::Validated(_, report)) => progress.scores = flat(&serde_json::json!(report)),
        News::Training(..) => {}
    }
}

/// Numbers of a JSON object, by names with dots; null = NaN.
fn flat(value: &serde_json::Value) -> Vec<(String, f64)> {
    let mut values = Vec::new();
    super::verifier::flatten("", value, &mut values);
    values
}

/// r2r's form of a status.
fn native(status: &TrainerStatus) -> r2r::egotac_msgs::msg::TrainerStatus {
    let s = status.clone();
    let stamp = r2r::builtin_interfaces::msg::Time { sec: s.header.stamp.sec, nanosec: s.header.stamp.nanosec };
    r2r::egotac_msgs::msg::TrainerStatus {
        header: r2r::std_msgs::msg::Header { stamp, frame_id: s.header.frame_id },
        state: s.state,
        message: s.message,
        recorded_frames: s.recorded_frames,
        recorded_episodes: s.recorded_episodes,
        evicted_episodes: s.evicted_episodes,
        recorded_bytes: s.recorded_bytes,
        step: s.step,
        steps: s.steps,
        names: s.names,
        values: s.values,
        windows_per_s: s.windows_per_s,
        remaining_secs: s.remaining_secs,
    }
}
