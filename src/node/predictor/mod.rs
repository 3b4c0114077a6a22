//! The node `predictor`: predicts touch on both hands from images.

mod camera;
mod certainty;
mod fusion;
mod inference;
mod input;
mod load;
mod load_model;
mod model_id;
mod reports;
mod stream;
mod views;

use std::process::ExitCode;
use std::sync::Arc;

use super::allowed_folder::{self, AllowedFolder};
use super::enabled::serve_set_enabled;
use super::images::ImageTransport;
use super::input_topics::reliability_parameter;
use super::mailbox::Mailbox;
use super::params::{Allowed, Parameter};
use super::rectify::Rectification;
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::threads::Threads;
use super::worker_thread::WorkerThread;
use super::{device, hand_confidence, program, qos};
use crate::hand::{HandModel, Side};
use crate::model::{Precision, Unknown, View};
use camera::Camera;
use fusion::Fusion;
use inference::Inference;
use input::Input;
use load::LoadedNetwork;
use load_model::{ModelRequirements, PendingModel};
use model_id::ModelId;
use stream::CameraStream;

/// Runs the program `egotac_predictor`.
pub fn main() -> ExitCode {
    program::run("predictor", "Predicts touch on both hands from images.", parameters(), start)
}

/// Parameters of the node.
fn parameters() -> Vec<Parameter> {
    let [threads, pin_cores] = Threads::parameters();
    vec![
        Parameter::fixed(
            "model",
            "",
            Allowed::Any,
            "Checkpoint file; empty = the checkpoint shipped with egotac. With latency_budget_ms also a folder of checkpoints.",
        ),
        device::parameter(),
        Parameter::fixed(
            "precision",
            "f32",
            Allowed::OneOf(&Precision::NAMES),
            "Number format of the network; ignored if latency_budget_ms is above 0.",
        ),
        Parameter::fixed(
            "latency_budget_ms",
            0.0,
            Allowed::Doubles(0.0, 60_000.0),
            "Longest inference time per image, milliseconds: take the best checkpoint and number format that keep it on this \
             machine; 0 = take model and precision as given.",
        ),
        Parameter::fixed(
            "view",
            "checkpoint",
            Allowed::OneOf(&View::NAMES),
            "View of pictures: crop (the centre), letterbox (all of it, hands smaller), squash (all of it, squeezed), or checkpoint = \
             as the network was trained.",
        ),
        Parameter::fixed(
            "locator",
            "",
            Allowed::Any,
            "Network of whole pictures that finds the hands, for a network that sees single hands; empty = the shipped one.",
        ),
        Parameter::fixed(
            "unknown",
            "nan",
            Allowed::OneOf(&Unknown::NAMES),
            "Form of touch that the network does not know (an image unlike the training's, a hand that is not in it): nan, \
             zero, or guess = the network's output as it is.",
        ),
        Parameter::fixed(
            "familiarity_threshold",
            -1.0,
            Allowed::Doubles(-1.0, 1.0),
            "Familiarity of an image below which touch is unknown; below 0 = the checkpoint's threshold.",
        ),
        Parameter::fixed(
            "presence_threshold",
            -1.0,
            Allowed::Doubles(-1.0, 1.0),
            "Presence of a hand below which its touch is unknown; below 0 = the checkpoint's threshold.",
        ),
        Parameter::fixed(
            "reuse_below",
            0.0,
            Allowed::Doubles(0.0, 255.0),
            "Mean change of a patch, grey levels: an image none of whose patches differs more from the last encoded one is not \
             encoded, which saves the time of the encoder; 0 = encode every image.",
        ),
        Parameter::fixed(
            "mano_left",
            "",
            Allowed::Any,
            "Left MANO file: the results are then on MANO's vertices; needs mano_right.",
        ),
        Parameter::fixed("mano_right", "", Allowed::Any, "Right MANO file; needs mano_left."),
        Camera::parameter(),
        Fusion::parameter(),
        threads,
        pin_cores,
        ImageTransport::parameter(),
        reliability_parameter("best_effort"),
        Rectification::parameter(),
        Parameter::new(
            "max_age_ms",
            0.0,
            Allowed::Doubles(0.0, 60_000.0),
            "Age above which an image is dropped when its turn comes, milliseconds; 0 = no limit.",
        ),
        Parameter::new(
            "contact_threshold",
            0.5,
            Allowed::Doubles(0.0, 1.0),
            "Contact probability above which ~/points marks a vertex as touching, and ~/contacts lists its region.",
        ),
        Parameter::new("publish_points", true, Allowed::Any, "Publish ~/points while it has a subscriber."),
        Parameter::new("publish_contacts", true, Allowed::Any, "Publish ~/contacts while it has a subscriber."),
        hand_confidence::parameter(),
        Parameter::fixed(
            "frame_prefix",
            "",
            Allowed::Any,
            "Start of the names of the frames of ~/wrench/*, so that those of several predictors differ.",
        ),
        Parameter::new("enabled", true, Allowed::Any, "Process images; ~/set_enabled sets it, too."),
        allowed_folder::parameter(),
    ]
}

/// Loads the checkpoint that the parameters name and runs the node until `shutdown`.
///
/// # Errors
/// If there is no usable checkpoint; otherwise as [`run`].
fn start(runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let threads = Threads::of(runtime.parameters(), runtime.log())?;
    let (parameters, log) = (runtime.parameters(), runtime.log());
    let network = threads.run(|| load::load(parameters, log))?;
    run(runtime, network, threads, shutdown)
}

/// Runs the node with a loaded network until `shutdown`. `~/load_model` loads the file of this network if a request names
/// none, and runs other networks with the same options.
///
/// # Errors
/// If ROS refuses a topic or service, or the network cannot process an image.
fn run(mut runtime: Runtime, network: LoadedNetwork, threads: Threads, shutdown: &Shutdown) -> anyhow::Result<()> {
    let cameras = Camera::all(runtime.parameters())?;
    let (inference, loader) = prepare(&mut runtime, shutdown, network, &threads, cameras)?;
    serve_set_enabled(&mut runtime)?;
    reports::publish(&mut runtime, &inference)?;
    for stream in &inference.streams {
        stream.input.subscribe(&mut runtime)?;
    }
    let worker = WorkerThread::spawn("inference", shutdown, move |shutdown| {
        threads.run(|| inference.run(shutdown));
        Ok(())
    })?;
    runtime.spin(shutdown);
    let loaded = loader.join();
    runtime.finish(worker).and(loaded)
}

/// Publishes `~/model_info`, offers `~/load_model` with its thread, and creates the inference loop of all cameras.
fn prepare(
    runtime: &mut Runtime,
    shutdown: &Shutdown,
    network: LoadedNetwork,
    threads: &Threads,
    cameras: Vec<Camera>,
) -> anyhow::Result<(Inference, WorkerThread)> {
    let LoadedNetwork { predictor, path, options, mano } = network;
    let log = runtime.log().clone();
    log.info(format!("one image takes {:.0} ms", threads.run(|| load::measure_inference(&predictor))? * 1e3));
    let model_info = load::model_info(&predictor, runtime.clock().now())?;
    if let Some(warning) = predictor.warning() {
        log.warn(warning);
    }
    if model_info.vertex_region.is_empty() {
        log.warn(
            "MANO's vertices need mano_left and mano_right: ~/model_info has no regions, and of the views of touch only ~/tactile \
             is published",
        );
    }
    let info = runtime.publisher("~/model_info", qos::latched())?;
    info.publish(&model_info)?;

    let pending = PendingModel::default();
    let topology = predictor.topology();
    let hands = match &mano {
        Some(mano) => mano.mano().clone(),
        None => Side::BOTH.map(HandModel::builtin),
    };
    let allowed = AllowedFolder::of(runtime.parameters())?;
    let requirements =
        ModelRequirements { default_path: path, options, topology, allowed, mano, threads: threads.clone() };
    let loader = load_model::serve(runtime, shutdown, pending.clone(), requirements, model_info.model_id.clone())?;

    let model_id = ModelId::new(model_info.model_id);
    let newest = Arc::new(Mailbox::new(cameras.len()));
    let fusion = match cameras.iter().any(Camera::is_named) {
        true => Some(Fusion::create(runtime, &cameras, (topology == hands[0].topology).then_some(&hands))?),
        false => None,
    };
    let mut streams = Vec::new();
    for (source, camera) in cameras.into_iter().enumerate() {
        let input = Input::create(runtime, camera, source, &newest)?;
        streams.push(CameraStream::create(
            runtime,
            input,
            predictor.another_stream(),
            model_id.clone(),
            hands.clone(),
        )?);
    }
    Ok((Inference { streams, newest, fusion, model_id, pending, info, log }, loader))
}
