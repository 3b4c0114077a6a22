//! The node `trainer`: an action that trains networks, on stores or on live topics.

mod goal_job;
mod goal_server;
mod progress;

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use r2r::egotac_msgs::action::Train;
use r2r::egotac_msgs::srv::LoadModel;

use super::diagnostics::{self, Tally};
use super::enabled::serve_set_enabled;
use super::episode_recorder::{EpisodeRecorder, ImageSource, Limits};
use super::images::ImageTransport;
use super::input_topics::{InputTopic, Need, reliability_parameter};
use super::params::{Allowed, Parameter, Parameters};
use super::rectify::Rectification;
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::{allowed_folder, device, program, qos};
use crate::message::TactileTruth;
use goal_server::GoalServer;

/// Time between two statuses, and between two feedbacks of a goal.
const STATUS_PERIOD: Duration = Duration::from_millis(500);
/// Time in which the result of an aborted goal leaves before the node ends.
const GOODBYE_TIME: Duration = Duration::from_millis(300);
/// Longest wait for the response of the service `notify`, which loads and runs the checkpoint first.
const NOTIFY_TIMEOUT: Duration = Duration::from_secs(30);

/// Runs the program `egotac_trainer`.
pub fn main() -> ExitCode {
    program::run("trainer", "Trains networks on stores and on live topics.", parameters(), run)
}

/// Parameters of the node.
fn parameters() -> Vec<Parameter> {
    vec![
        Parameter::new("config", "", Allowed::Any, "Configuration file (YAML) of goals that name none."),
        Parameter::fixed(
            "folder",
            "trainer",
            Allowed::Any,
            "Folder of the recorded episodes, and of runs whose configuration has a relative folder.",
        ),
        device::parameter(),
        ImageTransport::parameter(),
        reliability_parameter("match"),
        Rectification::parameter(),
        Parameter::new("record", true, Allowed::Any, "Record each image that has a truth of equal stamp."),
        Parameter::new(
            "enabled",
            true,
            Allowed::Any,
            "Record and take goals; an active goal goes on without. ~/set_enabled sets it, too.",
        ),
        Parameter::fixed(
            "max_recorded_mb",
            2000.0,
            Allowed::Doubles(0.001, 1e9),
            "Largest size of all recorded episodes on disk, MB; beyond it the oldest are deleted.",
        ),
        Parameter::fixed(
            "max_waiting_mb",
            256.0,
            Allowed::Doubles(1.0, 1e6),
            "Largest size of the images that wait in memory, MB: half of it for their truth, half for the disk; beyond it images \
             are lost and counted.",
        ),
        Parameter::fixed(
            "episode_secs",
            10.0,
            Allowed::Doubles(0.1, 3600.0),
            "Longest duration of a recorded episode, seconds.",
        ),
        Parameter::new(
            "min_live_frames",
            200,
            Allowed::Integers(1, 100_000_000),
            "Number of recorded frames that a live goal waits for.",
        ),
        Parameter::new(
            "round_steps",
            200,
            Allowed::Integers(1, 100_000_000),
            "Steps of a live goal per round; each round takes the newest episodes.",
        ),
        Parameter::new(
            "notify",
            "",
            Allowed::Any,
            "Service (egotac_msgs/srv/LoadModel) called with each new checkpoint, for instance /predictor/load_model; empty = \
             none.",
        ),
        allowed_folder::parameter(),
    ]
}

/// Runs the node until `shutdown`, which stops an active training and saves its state.
///
/// # Errors
/// If ROS refuses a topic or the action, or the folder cannot be written.
fn run(mut runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let folder = PathBuf::from(parameters.get::<String>("folder"));
    let device = device::open(&parameters)?;
    let limits = Limits {
        bytes: (parameters.get::<f64>("max_recorded_mb") * 1e6) as u64,
        episode_secs: parameters.get("episode_secs"),
        waiting_bytes: (parameters.get::<f64>("max_waiting_mb") * 1e6) as usize,
    };
    let tally = Tally::default();
    let transport = ImageTransport::of(&parameters);
    let images = ImageSource {
        transport,
        rectification: Rectification::subscribe(&mut runtime, "camera_info")?,
        tally: tally.clone(),
    };
    let (recorder, ring, writer) =
        EpisodeRecorder::open(&folder.join("live"), limits, images, runtime.log(), shutdown)?;
    subscribe(&mut runtime, recorder, &tally)?;
    let server = GoalServer::new(ring, folder, device, parameters, runtime.log().clone());
    let server = Rc::new(RefCell::new(server));
    serve_goals(&mut runtime, &server)?;
    serve_set_enabled(&mut runtime)?;
    let states = Rc::clone(&server);
    diagnostics::publish(&mut runtime, String::new, move |_| vec![states.borrow().task_report(&tally)])?;

    runtime.spin(shutdown);
    if server.borrow_mut().stop() {
        runtime.spin_for(GOODBYE_TIME);
    }
    runtime.finish(writer)
}

/// Offers the action and publishes `~/status`.
fn serve_goals(runtime: &mut Runtime, server: &Rc<RefCell<GoalServer>>) -> anyhow::Result<()> {
    let goals = Rc::clone(server);
    runtime.action_server::<Train::Action>("~/train", move |request| goals.borrow_mut().take(request))?;
    let publisher = runtime.publisher("~/status", qos::output())?;
    let statuses = Rc::clone(server);
    runtime.every(STATUS_PERIOD, move |runtime| {
        let finished = statuses.borrow_mut().tick(&publisher, runtime);
        if let Some(checkpoint) = finished {
            notify(runtime, &checkpoint);
        }
    });
    Ok(())
}

/// Passes images and truths to the recorder while the parameters `record` and `enabled` are set.
fn subscribe(runtime: &mut Runtime, recorder: EpisodeRecorder, tally: &Tally) -> anyhow::Result<()> {
    let recorder = Rc::new(RefCell::new(recorder));
    let transport = ImageTransport::of(runtime.parameters());
    let (images, tally) = (Rc::clone(&recorder), tally.clone());
    let parameters = Arc::clone(runtime.parameters());
    let input = InputTopic::new(runtime, "image", "images", qos::every_input(), Need::Optional);
    transport.subscribe(runtime, input, move |payload| {
        tally.received();
        match records(&parameters) {
            true => images.borrow_mut().push_image(payload),
            false => tally.dropped("disabled"),
        }
    })?;
    let (parameters, log) = (Arc::clone(runtime.parameters()), runtime.log().clone());
    let input = InputTopic::new(runtime, "truth", "truth", qos::every_input(), Need::Optional);
    runtime.input::<TactileTruth>(input, move |truth| match truth {
        Ok(truth) if records(&parameters) => recorder.borrow_mut().push_truth(truth),
        Ok(_) => {}
        Err(error) => log.warn_throttled("truth", format!("truth: message dropped: {error}")),
    })
}

/// True while images and truths are recorded.
fn records(parameters: &Parameters) -> bool {
    parameters.get("record") && parameters.get("enabled")
}

/// Calls the service that the parameter `notify` names with a new checkpoint.
fn notify(runtime: &mut Runtime, checkpoint: &Path) {
    let service = runtime.parameters().get::<String>("notify");
    if service.is_empty() {
        return;
    }
    let log = runtime.log().clone();
    let path = checkpoint.canonicalize().unwrap_or_else(|_| checkpoint.to_path_buf());
    let request = LoadModel::Request { model: path.display().to_string() };
    let name = service.clone();
    let called =
        runtime.call::<LoadModel::Service>(&service, &request, NOTIFY_TIMEOUT, move |response| match response {
            Some(response) if response.success => log.info(format!("{name} runs {}", response.model_id)),
            Some(response) => log.error(format!("{name} refused {}: {}", path.display(), response.message)),
            None => log.error(format!("{name} did not respond")),
        });
    if let Err(error) = called {
        runtime.log().error(format!("notify: {error:#}"));
    }
}
