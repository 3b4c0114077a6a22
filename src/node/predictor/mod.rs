//! The node `predictor`: images to touch.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use ::image::RgbImage;
use anyhow::{Context as _, bail};
use candle_core::Device;
use r2r::std_srvs::srv::SetBool;

use super::diagnostics::{self, Level, Report, Tally};
use super::exchange::{self, Loaded, Slot, Terms};
use super::log::Log;
use super::mailbox::Mailbox;
use super::params::{Allowed, Parameter, Parameters};
use super::points::{self, Posed};
use super::runtime::{self, Publisher, RosClock, Runtime};
use super::{Shutdown, qos};
use crate::hand::{HandModel, N_VERTICES, Side};
use crate::image::{self, RawImage};
use crate::message::{
    CompressedImage, HandModelInfo, HandPose, Header, Image, Message as _, PointCloud2, TactileFrame, Time,
};
use crate::model::budget::{self, Tried};
use crate::model::predictor::{Options, Predictor};
use crate::model::{Precision, shipped};
use crate::tactile::{TactileField, Topology};

/// A hand pose counts for an image whose stamp differs by at most this, s.
const POSE_SLOP: f64 = 0.2;

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
        Parameter::fixed(
            "image_transport",
            "raw",
            Allowed::OneOf(&["raw", "compressed"]),
            "Take sensor_msgs/Image on image, or sensor_msgs/CompressedImage (JPEG, PNG) on image/compressed.",
        ),
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
    let (predictor, path, options) = load(runtime.parameters(), runtime.log())?;
    run(runtime, predictor, (path, options), shutdown)
}

/// Runs the node with a network that is already loaded until `shutdown`; `origin` is the file that `~/load_model` takes
/// when it is told none, and how networks are run.
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
    log.info(format!("one image takes {:.0} ms", try_out(&mut predictor)? * 1e3));
    let info = model_info(&predictor, runtime.clock().now())?;
    if info.vertex_region.is_empty() {
        log.warn("regions of MANO's vertices are unknown without its file: ~/model_info has none, ~/points is off");
    }
    let info_publisher = runtime.publisher("~/model_info", qos::latched())?;
    info_publisher.publish(&info)?;

    let slot = Slot::default();
    let terms = Terms { path, options, topology: predictor.metadata().topology };
    exchange::serve(&mut runtime, slot.clone(), terms, info.model_id.clone())?;

    let hands = Side::BOTH.map(HandModel::builtin);
    let input = Arc::new(Mailbox::default());
    let tally = Tally::default();
    let poses = Arc::new(Mutex::new([None, None]));
    let model_id = Arc::new(Mutex::new(info.model_id));
    let worker = Worker {
        frames: runtime.publisher("~/tactile", qos::output())?,
        points: runtime.publisher("~/points", qos::output())?,
        topic: image_topic(&runtime),
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
    subscribe_image(&mut runtime, Source { input, tally, reliable })?;

    let stop = shutdown.clone();
    let worker = std::thread::Builder::new().name("inference".into()).spawn(move || {
        let _guard = stop.when_dropped();
        worker.work(&stop)
    })?;
    runtime.spin(shutdown);
    let result = runtime::join(worker, "inference");
    drop(runtime);
    result
}

/// The network that the parameters ask for, its file, and how it is run.
fn load(parameters: &Parameters, log: &Log) -> anyhow::Result<(Predictor, PathBuf, Options)> {
    let path = match parameters.get::<String>("model") {
        path if path.is_empty() => {
            shipped::path().context("without `-p model:=PATH` the predictor takes the shipped checkpoint")?
        }
        path => PathBuf::from(path),
    };
    let device = match parameters.get::<String>("device").as_str() {
        "cuda" => Device::new_cuda(0).context("device cuda")?,
        _ => Device::Cpu,
    };
    let precision = parameters.get::<String>("precision").parse()?;
    let options = Options { device, precision, ..Options::default() };
    let budget_ms = parameters.get::<f64>("latency_budget_ms");
    if budget_ms > 0.0 {
        let (predictor, choice) = budget::pick(&budget::candidates(&path)?, budget_ms, &options)?;
        match choice.fits {
            true => log.info(format!("model {choice}")),
            false => log.warn(format!("model: {choice}")),
        }
        let Tried { path, precision, .. } = choice.chosen;
        return Ok((predictor, path, Options { precision, ..options }));
    }
    let predictor = load_file(&path, options.clone())?;
    log.info(format!("model {} in {precision}", path.display()));
    Ok((predictor, path, options))
}

/// Loads a checkpoint file.
///
/// # Errors
/// If there is none, or it can't be used.
pub(super) fn load_file(path: &Path, options: Options) -> anyhow::Result<Predictor> {
    if !path.is_file() {
        bail!("model {}: no such file; give a checkpoint with -p model:=PATH", path.display());
    }
    Ok(Predictor::load(path, options)?)
}

/// Seconds that one image takes; the first one, which takes longer, goes before.
pub(super) fn try_out(predictor: &mut Predictor) -> anyhow::Result<f64> {
    let black = RgbImage::new(64, 48);
    predictor.push(&black, 0.0).context("the model can't process an image")?;
    let started = Instant::now();
    predictor.push(&black, 1.0)?;
    predictor.reset();
    Ok(started.elapsed().as_secs_f64())
}

/// What a network is, for those who listen.
pub(super) fn model_info(predictor: &Predictor, now: Time) -> anyhow::Result<HandModelInfo> {
    let (metadata, config) = (predictor.metadata(), predictor.config());
    let hash = predictor.sha256();
    // The built-in hand's regions are those of both sides; MANO's need a file that predicting does not.
    let (hand_model, vertex_region) = match metadata.topology {
        Topology::EgotacHand1 => {
            let regions = HandModel::builtin(Side::Right).regions();
            ("egotac built-in hand", regions.into_iter().map(|region| region.name().to_owned()).collect())
        }
        Topology::Mano => ("MANO", Vec::new()),
    };
    Ok(HandModelInfo {
        header: Header { stamp: now, frame_id: String::new() },
        model_id: format!("{}/{}", metadata.name, hash.get(..12).unwrap_or(hash)),
        model_name: metadata.name.clone(),
        weights_sha256: hash.to_owned(),
        hand_model: hand_model.to_owned(),
        topology: metadata.topology.id().to_owned(),
        vertex_count: N_VERTICES as u32,
        vertex_region,
        horizon: u32::try_from(config.horizon)?,
        frame_dt: metadata.frame_dt,
        input_size: u32::try_from(config.image)?,
        force_scale: if metadata.has_force { metadata.force_scale } else { f32::NAN },
    })
}

/// The resolved topic that images come on.
fn image_topic(runtime: &Runtime) -> String {
    let image = runtime.resolve("image");
    match is_compressed(runtime.parameters()) {
        true => runtime.resolve(&format!("{image}/compressed")),
        false => image,
    }
}

fn is_compressed(parameters: &Parameters) -> bool {
    parameters.get::<String>("image_transport") == "compressed"
}

/// What a subscription to images feeds.
struct Source {
    input: Arc<Mailbox<Vec<u8>>>,
    tally: Tally,
    /// Whether the subscription is reliable, once there is one.
    reliable: Arc<AtomicBool>,
}

/// Subscribes now, or with reliability `match` as soon as there is a publisher to match.
fn subscribe_image(runtime: &mut Runtime, source: Source) -> anyhow::Result<()> {
    let reliability = runtime.parameters().get::<String>("reliability");
    if reliability != "match" {
        return subscribe_image_as(runtime, reliability == "reliable", source);
    }
    let topic = image_topic(runtime);
    let mut waiting = Some(source);
    runtime.every(Duration::from_millis(100), move |runtime| {
        let reliable = match runtime.publishers_are_reliable(&topic) {
            Ok(publishers) if publishers.is_empty() => return,
            Ok(publishers) => publishers.iter().all(|reliable| *reliable),
            Err(error) => return runtime.log().warn_throttled("match", format!("{topic}: {error:#}")),
        };
        let Some(source) = waiting.take() else { return };
        if let Err(error) = subscribe_image_as(runtime, reliable, source) {
            runtime.log().error(format!("{topic}: {error:#}"));
        }
    });
    Ok(())
}

fn subscribe_image_as(runtime: &mut Runtime, reliable: bool, source: Source) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let Source { input, tally, .. } = source;
    source.reliable.store(reliable, Ordering::Relaxed);
    let take = move |payload: Vec<u8>| {
        tally.received();
        match parameters.get("enabled") {
            true => input.put(payload),
            false => tally.dropped("disabled"),
        }
    };
    let topic = image_topic(runtime);
    let kind = if reliable { "reliable" } else { "best effort" };
    runtime.log().info(format!("images from {topic}, {kind}"));
    match is_compressed(runtime.parameters()) {
        true => runtime.subscribe_bytes::<CompressedImage>(&topic, qos::sensor_input(reliable), take),
        false => runtime.subscribe_bytes::<Image>("image", qos::sensor_input(reliable), take),
    }
}

/// Id of the network in use: frames and diagnostics name it.
type ModelId = Arc<Mutex<String>>;

fn locked(model_id: &ModelId) -> MutexGuard<'_, String> {
    model_id.lock().unwrap_or_else(PoisonError::into_inner)
}

type Poses = Arc<Mutex<[Option<HandPose>; 2]>>;

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
    let (input, tally, topic) = (Arc::clone(input), tally.clone(), image_topic(runtime));
    let mut refused_before = 0;
    let model_id = move || locked(&model_id).clone();
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

/// What is wrong with an image, without what came: each cause has warnings of its own.
fn cause(error: &crate::Error) -> &str {
    match error {
        crate::Error::Value { name, .. } | crate::Error::Shape { name, .. } => name,
        crate::Error::Unknown { kind, .. } => kind,
        _ => "image",
    }
}

/// Turns the newest image into messages, on a thread of its own.
struct Worker {
    predictor: Predictor,
    model_id: ModelId,
    hands: [HandModel; 2],
    rest: Vec<Posed>,
    topic: String,
    input: Arc<Mailbox<Vec<u8>>>,
    poses: Poses,
    tally: Tally,
    parameters: Arc<Parameters>,
    clock: RosClock,
    log: Log,
    frames: Publisher<TactileFrame>,
    points: Publisher<PointCloud2>,
    info: Publisher<HandModelInfo>,
    slot: Slot,
    exchanged: bool,
    sequence: u64,
}

impl Worker {
    fn work(mut self, stop: &Shutdown) -> anyhow::Result<()> {
        while !stop.requested() {
            let payload = self.input.take(Duration::from_millis(50));
            if let Some(loaded) = self.slot.take() {
                self.exchange(loaded);
            }
            if let Some(payload) = payload {
                self.process(&payload);
            }
        }
        Ok(())
    }

    /// Goes on with another network; its window fills anew.
    fn exchange(&mut self, Loaded { predictor, info }: Loaded) {
        self.predictor = predictor;
        self.exchanged = true;
        locked(&self.model_id).clone_from(&info.model_id);
        if let Err(error) = self.info.publish(&info) {
            self.log.warn_throttled("publish", format!("~/model_info: {error:#}"));
        }
    }

    fn process(&mut self, payload: &[u8]) {
        let started = Instant::now();
        let (header, image) = match self.decode(payload) {
            Ok(image) => image,
            Err(error) => {
                self.tally.dropped("malformed");
                let kind = format!("malformed {}", cause(&error));
                return self.log.warn_throttled(&kind, format!("image on {} left out: {error}", self.topic));
            }
        };
        let max_age = self.parameters.get::<f64>("max_age_ms") * 1e-3;
        if max_age > 0.0 && self.clock.secs_since(header.stamp).is_some_and(|age| age > max_age) {
            return self.tally.dropped("stale");
        }
        // Without a stamp the order of arrival is all there is.
        let stamp = if header.stamp.is_zero() { self.clock.now() } else { header.stamp };
        let prediction = match self.predictor.push(&image, stamp.secs()) {
            Ok(prediction) => prediction,
            Err(error) => {
                self.tally.dropped("failed");
                return self.log.warn_throttled("failed", format!("image on {} left out: {error}", self.topic));
            }
        };
        // Another network has seen nothing yet.
        if prediction.restarted && self.sequence > 0 && !std::mem::take(&mut self.exchanged) {
            self.log.warn_throttled("restart", "the image stream restarted: its stamps went back or paused");
        }
        let sent = self.frame(&header, &prediction.field, prediction.warming_up, started).and_then(|frame| {
            self.frames.publish(&frame)?;
            self.sequence += 1;
            self.tally.processed(self.clock.secs_since(header.stamp));
            self.publish_points(header, &prediction.field)
        });
        if let Err(error) = sent {
            self.log.warn_throttled("publish", format!("a result could not be sent: {error:#}"));
        }
    }

    fn decode(&self, payload: &[u8]) -> crate::Result<(Header, RgbImage)> {
        if is_compressed(&self.parameters) {
            let CompressedImage { header, data, .. } = CompressedImage::from_cdr(payload)?;
            return Ok((header, image::decode(&data)?));
        }
        let Image { header, height, width, encoding, step, data, .. } = Image::from_cdr(payload)?;
        let raw = RawImage { width, height, encoding: &encoding, step, data: &data };
        let image = raw.to_rgb()?;
        Ok((header, image))
    }

    fn frame(
        &self,
        header: &Header,
        field: &TactileField,
        warming_up: bool,
        started: Instant,
    ) -> anyhow::Result<TactileFrame> {
        Ok(TactileFrame {
            sequence: self.sequence,
            inference_secs: started.elapsed().as_secs_f64(),
            model_id: locked(&self.model_id).clone(),
            warming_up,
            ..TactileFrame::from_field(header.clone(), field)?
        })
    }

    fn publish_points(&self, header: Header, field: &TactileField) -> anyhow::Result<()> {
        let wanted = self.parameters.get::<bool>("publish_points") && self.points.is_heard();
        if !wanted || field.topology != Topology::EgotacHand1 {
            return Ok(());
        }
        let threshold = self.parameters.get::<f64>("contact_threshold") as f32;
        let cloud = match self.posed(&header) {
            Some((frame_id, hands)) => {
                points::cloud(Header { stamp: header.stamp, frame_id }, field, &hands, threshold)
            }
            None => points::cloud(header, field, &self.rest, threshold),
        };
        self.points.publish(&cloud)
    }

    /// The hands whose pose is known at the image's time, and the frame they are in.
    fn posed(&self, image: &Header) -> Option<(String, Vec<Posed>)> {
        let poses = self.poses.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mut frame_id = None;
        let mut hands = Vec::new();
        for (pose, model) in poses.iter().zip(&self.hands) {
            let Some(pose) = pose else { continue };
            if (pose.header.stamp.secs() - image.stamp.secs()).abs() > POSE_SLOP {
                continue;
            }
            if *frame_id.get_or_insert_with(|| pose.header.frame_id.clone()) != pose.header.frame_id {
                self.log.warn_throttled("frames", "hand_pose: the hands are in different frames; only one is drawn");
                continue;
            }
            match pose.to_params(model) {
                Ok(params) => hands.push(Posed { side: model.side, vertices: model.forward(&params).vertices }),
                Err(error) => self.log.warn_throttled("hand_pose", format!("hand_pose: {error}")),
            }
        }
        (!hands.is_empty()).then(|| (frame_id.unwrap_or_default(), hands))
    }
}
