//! The node `trainer`: an action that trains, on stores or on what comes live.

mod goal;
mod progress;

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use candle_core::Device;
use r2r::egotac_msgs::action::Train;
use r2r::egotac_msgs::srv::LoadModel;

use super::diagnostics::{self, Tally};
use super::episode_recorder::{self, Recording};
use super::params::{Allowed, Parameter};
use super::runtime::Runtime;
use super::{Shutdown, images, qos};
use crate::message::TactileTruth;
use goal::Trainer;

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
        images::transport(),
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

    let trainer = Rc::new(RefCell::new(Trainer::new(opened.ring, folder, device, parameters, log)));
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
    trainer.borrow_mut().stop();
    drop(runtime);
    episode_recorder::join(opened.writer)
}

/// Feeds the recording while `record` is set.
fn subscribe(runtime: &mut Runtime, recording: Rc<RefCell<Recording>>, tally: &Tally) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let (pictures, records, log, counts) =
        (Rc::clone(&recording), Arc::clone(&parameters), runtime.log().clone(), tally.clone());
    images::subscribe(runtime, qos::every_input(), move |payload| {
        counts.received();
        match images::decode(&payload, &records) {
            Ok((header, image)) if records.get("record") => {
                pictures.borrow_mut().image(&header, image);
                counts.processed(None);
            }
            Ok(_) => counts.dropped("disabled"),
            Err(error) => {
                counts.dropped("malformed");
                log.warn_throttled("image", format!("image left out: {error}"));
            }
        }
    })?;
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
