//! The node `predictor`: images to touch.

mod input;
mod load_model;
mod network;
mod worker;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use r2r::std_srvs::srv::SetBool;

use super::diagnostics::{self, Level, Report, Tally};
use super::mailbox::Mailbox;
use super::params::{Allowed, Parameter};
use super::runtime::{self, Runtime};
use super::{Shutdown, images, points, qos};
use crate::hand::{HandModel, Side};
use crate::message::HandPose;
use crate::model::Precision;
use crate::model::predictor::{Options, Predictor};
use input::Input;
use load_model::{Slot, Terms};
use worker::{ModelId, Poses, Worker};

/// The node's parameters.
pub fn parameters() -> Vec<Parameter> {
    vec![
        Parameter::fixed(
            "model",
            "",
            Allowed::Any,
            "Checkpoint file; empty = the one that comes with egotac. With latency_budget_ms also a folder of them.",
        ),
        Parameter::fixed("device", "cpu", Allowed::OneOf(&["cpu", "cuda"]), "Where the network runs."),
        Parameter::fixed(
            "precision",
            "f32",
            Allowed::OneOf(&Precision::NAMES),
            "Number format of the network; without effect where latency_budget_ms decides.",
        ),
        Parameter::fixed(
            "latency_budget_ms",
            0.0,
            Allowed::Doubles(0.0, 60_000.0),
            "Take the best checkpoint and number format that needs at most so long for an image here; 0 = as told.",
        ),
        images::transport(),
        Parameter::fixed(
            "reliability",
            "best_effort",
            Allowed::OneOf(&["best_effort", "reliable", "match"]),
            "Quality of service of the image subscription; match = as the publishers, once there is one.",
        ),
        Parameter::new(
            "max_age_ms",
            0.0,
            Allowed::Doubles(0.0, 60_000.0),
            "Drop images older than this when their turn comes, milliseconds; 0 = take all.",
        ),
        Parameter::new(
            "contact_threshold",
            0.5,
            Allowed::Doubles(0.0, 1.0),
            "Contact probability above which a vertex of the point cloud counts as touching.",
        ),
        Parameter::new("publish_points", true, Allowed::Any, "Publish the point cloud when somebody listens."),
        Parameter::new("enabled", true, Allowed::Any, "Whether images are processed; also ~/set_enabled."),
        Parameter::use_sim_time(),
    ]
}

/// Creates the node, loads the checkpoint its parameters name, and runs until `shutdown`.
///
/// # Errors
/// If ROS refuses something, or there is no usable checkpoint.
pub fn start(shutdown: &Shutdown) -> anyhow::Result<()> {
    let runtime = Runtime::create("predictor", &parameters())?;
    let (predictor, path, options) = network::load(runtime.parameters(), runtime.log())?;
    run(runtime, predictor, (path, options), shutdown)
}

/// Runs the node with a network that is already loaded until `shutdown`; `path` is the file that `~/load_model` takes
/// when it is told none, `options` how networks are run.
///
/// # Errors
/// If ROS refuses something, or the network can't process an image at all.
pub fn run(
    mut runtime: Runtime,
    mut predictor: Predictor,
    (path, options): (PathBuf, Options),
    shutdown: &Shutdown,
) -> anyhow::Result<()> {
    let log = runtime.log().clone();
    log.info(format!("one image takes {:.0} ms", network::try_out(&mut predictor)? * 1e3));
    let info = network::info(&predictor, runtime.clock().now())?;
    if info.vertex_region.is_empty() {
        log.warn("regions of MANO's vertices are unknown without its file: ~/model_info has none, ~/points is off");
    }
    let info_publisher = runtime.publisher("~/model_info", qos::latched())?;
    info_publisher.publish(&info)?;

    let slot = Slot::default();
    let terms = Terms { path, options, topology: predictor.metadata().topology };
    load_model::serve(&mut runtime, slot.clone(), terms, info.model_id.clone())?;

    let hands = Side::BOTH.map(HandModel::builtin);
    let input = Arc::new(Mailbox::default());
    let tally = Tally::default();
    let poses = Arc::new(Mutex::new([None, None]));
    let model_id = Arc::new(Mutex::new(info.model_id));
    let worker = Worker {
        frames: runtime.publisher("~/tactile", qos::output())?,
        points: runtime.publisher("~/points", qos::output())?,
        topic: images::topic(&runtime),
        rest: points::at_rest(&hands),
        hands,
        predictor,
        input: Arc::clone(&input),
        tally: tally.clone(),
        poses: Arc::clone(&poses),
        parameters: Arc::clone(runtime.parameters()),
        clock: runtime.clock().clone(),
        log: log.clone(),
        info: info_publisher,
        slot,
        exchanged: false,
        model_id: Arc::clone(&model_id),
        sequence: 0,
    };
    subscribe_pose(&mut runtime, poses)?;
    serve_set_enabled(&mut runtime)?;
    let reliable = Arc::new(AtomicBool::new(false));
    report(&mut runtime, &input, &tally, model_id, Arc::clone(&reliable))?;
    input::subscribe(&mut runtime, Input { images: input, tally, reliable })?;

    let stop = shutdown.clone();
    let worker = std::thread::Builder::new().name("inference".into()).spawn(move || {
        let _guard = stop.when_dropped();
        worker.work(&stop);
        Ok(())
    })?;
    runtime.spin(shutdown);
    let result = runtime::join(worker, "inference");
    drop(runtime);
    result
}

/// Keeps the newest pose of each hand.
fn subscribe_pose(runtime: &mut Runtime, poses: Poses) -> anyhow::Result<()> {
    let log = runtime.log().clone();
    runtime.subscribe::<HandPose>("hand_pose", qos::sensor_input(false).keep_last(4), move |pose| {
        match pose.and_then(|pose| Ok((pose.side()?, pose))) {
            Ok((side, pose)) => poses.lock().unwrap_or_else(PoisonError::into_inner)[side as usize] = Some(pose),
            Err(error) => log.warn_throttled("hand_pose", format!("hand_pose: {error}")),
        }
    })
}

fn serve_set_enabled(runtime: &mut Runtime) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    runtime.service::<SetBool::Service>("~/set_enabled", move |request| {
        let set = parameters.set([("enabled".to_owned(), request.data.into())]);
        SetBool::Response { success: set.is_ok(), message: set.err().unwrap_or_default() }
    })
}

/// Reports on the input and what became of it.
fn report(
    runtime: &mut Runtime,
    input: &Arc<Mailbox<Vec<u8>>>,
    tally: &Tally,
    model_id: ModelId,
    reliable: Arc<AtomicBool>,
) -> anyhow::Result<()> {
    let (input, tally, topic) = (Arc::clone(input), tally.clone(), images::topic(runtime));
    let mut refused_before = 0;
    let model_id = move || worker::locked(&model_id).clone();
    diagnostics::publish(runtime, model_id, move |runtime| {
        tally.set_dropped("superseded", input.superseded());
        let mut counts = tally.counts();
        let rates = counts.rates();
        let refused = ["malformed", "failed"].iter().filter_map(|cause| counts.drops.get(cause)).sum();
        let newly_refused = refused > std::mem::replace(&mut refused_before, refused);
        let unheard = reliable.load(Ordering::Relaxed)
            && runtime.publishers_are_reliable(&topic).is_ok_and(|all| all.contains(&false));
        let (level, message) = if !runtime.parameters().get::<bool>("enabled") {
            (Level::Ok, "disabled".to_owned())
        } else if unheard {
            (Level::Error, format!("a best-effort publisher on {topic} can't be heard by a reliable subscription"))
        } else if rates.0 == 0.0 {
            (Level::Stale, format!("no images on {topic}"))
        } else if newly_refused {
            (Level::Warn, format!("images on {topic} could not be used"))
        } else {
            (Level::Ok, format!("{:.1} of {:.1} images per second", rates.1, rates.0))
        };
        if level == Level::Error {
            runtime.log().warn_throttled("unheard", &message);
        }
        Report { task: "images", level, message, values: counts.values(rates) }
    })
}
