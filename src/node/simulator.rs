//! The node `simulator`: rollouts of scenes as a camera topic, with the truth beside it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ::image::RgbImage;
use ::image::codecs::jpeg::JpegEncoder;
use anyhow::Context as _;
use glam::{DQuat, DVec3};

use super::diagnostics::{self, Level, Report, Tally};
use super::log::Log;
use super::params::{Allowed, Parameter, Parameters};
use super::runtime::{self, Publisher, RosClock, Runtime};
use super::{Shutdown, qos};
use crate::camera::{Distortion, Intrinsics};
use crate::geometry::SIGMA;
use crate::hand::{HandModel, Side};
use crate::message::{
    CameraInfo, Clock, CompressedImage, HandPose, Header, Image, Point, Quaternion, RegionOfInterest, TactileFrame,
    TactileTruth, Time,
};
use crate::sim::camera::CameraPose;
use crate::sim::{Rollout, RolloutOptions, SHIPPED, Scene, SimFrame};

/// How long the last messages have to reach their subscribers before the node goes.
const LINGER: Duration = Duration::from_millis(500);
/// Nobody joined for so long: everybody who was starting is there.
const SETTLED: Duration = Duration::from_millis(1500);
/// Far below a frame's interval and far above the rounding of a sum of them, s.
const ROUNDING: f64 = 1e-6;
/// JPEG quality of the compressed topic.
const QUALITY: u8 = 90;

/// The node's parameters.
pub fn parameters() -> Vec<Parameter> {
    let scenes: Vec<String> = SHIPPED.iter().map(|(name, _)| (*name).to_owned()).collect();
    vec![
        Parameter::fixed(
            "scenes",
            scenes,
            Allowed::Any,
            "Scenes to play in turn: names of shipped ones, or YAML files.",
        ),
        Parameter::fixed("seed", 0, Allowed::Integers(0, i64::MAX), "Seed of the first episode; each next one adds 1."),
        Parameter::fixed("episodes", 0, Allowed::Integers(0, i64::MAX), "End after this many episodes; 0 = never."),
        Parameter::fixed(
            "duration",
            0.0,
            Allowed::Doubles(0.0, 1e6),
            "End after this many simulated seconds; 0 = never.",
        ),
        Parameter::fixed(
            "pace",
            "wall",
            Allowed::OneOf(&["wall", "clock", "fast"]),
            "wall: frames at their rate by the node's time, which is /clock's with use_sim_time; clock: at their rate by \
             the wall clock, stamped with simulated time, which this node publishes on /clock; fast: as clock, but as fast \
             as it goes.",
        ),
        Parameter::fixed("width", 224, Allowed::Integers(16, 4096), "Width of the image, pixels."),
        Parameter::fixed("height", 224, Allowed::Integers(16, 4096), "Height of the image, pixels."),
        Parameter::fixed(
            "sigma",
            SIGMA,
            Allowed::Doubles(1e-4, 0.05),
            "Standard deviation of the Gaussian that spreads a contact's force over vertices, m.",
        ),
        Parameter::fixed("compressed", false, Allowed::Any, "Publish image_raw/compressed (JPEG) as well."),
        Parameter::fixed("frame_id", "camera_optical", Allowed::Any, "Name of the camera's optical frame."),
        Parameter::fixed(
            "wait_secs",
            0.0,
            Allowed::Doubles(0.0, 3600.0),
            "Before the first image, wait at most this long for somebody to listen, seconds.",
        ),
        Parameter::fixed(
            "wait_listeners",
            1,
            Allowed::Integers(1, 1000),
            "How many must listen to the images before `wait_secs` ends early.",
        ),
        Parameter::use_sim_time(),
    ]
}

/// Creates the node and runs until the last frame or `shutdown`.
///
/// # Errors
/// As [`run`].
pub fn start(shutdown: &Shutdown) -> anyhow::Result<()> {
    run(Runtime::create("simulator", &parameters())?, shutdown)
}

/// Runs the node until the last frame its parameters ask for, or `shutdown`.
///
/// # Errors
/// If a scene can't be loaded or built, there is no OpenGL, or ROS refuses something.
pub fn run(mut runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let names = parameters.get::<Vec<String>>("scenes");
    let scenes = names.iter().map(|name| Scene::load(name)).collect::<crate::Result<Vec<_>>>()?;
    anyhow::ensure!(!scenes.is_empty(), "parameter scenes: expected at least one scene, got none");
    let tally = Tally::default();
    let producer = Producer {
        outputs: Outputs::create(&mut runtime, &parameters)?,
        pace: Pace::new(&parameters, runtime.clock().clone()),
        scenes,
        seed: u64::try_from(parameters.get::<i64>("seed"))?,
        episodes: u64::try_from(parameters.get::<i64>("episodes"))?,
        duration: parameters.get("duration"),
        wait: Duration::from_secs_f64(parameters.get("wait_secs")),
        awaited: usize::try_from(parameters.get::<i64>("wait_listeners"))?,
        options: RolloutOptions {
            picture: Some((side(&parameters, "width")?, side(&parameters, "height")?)),
            sigma: parameters.get("sigma"),
            ..RolloutOptions::default()
        },
        tally: tally.clone(),
        log: runtime.log().clone(),
    };
    diagnostics::publish(&mut runtime, String::new, move |_| {
        let mut counts = tally.counts();
        let rates = counts.rates();
        let level = if rates.1 > 0.0 { Level::Ok } else { Level::Stale };
        Report {
            task: "frames",
            level,
            message: format!("{:.1} frames per second", rates.1),
            values: counts.values(rates),
        }
    })?;

    let stop = shutdown.clone();
    let worker = std::thread::Builder::new().name("rollout".into()).spawn(move || {
        let _guard = stop.when_dropped();
        let result = producer.produce(&stop);
        if result.is_ok() && !stop.requested() {
            std::thread::sleep(LINGER);
        }
        result
    })?;
    runtime.spin(shutdown);
    let result = runtime::join(worker, "rollout");
    drop(runtime);
    result
}

fn side(parameters: &Parameters, name: &str) -> anyhow::Result<u32> {
    Ok(u32::try_from(parameters.get::<i64>(name))?)
}

/// Plays episodes on a thread of its own: the one that owns the OpenGL context.
struct Producer {
    scenes: Vec<Scene>,
    seed: u64,
    episodes: u64,
    duration: f64,
    wait: Duration,
    awaited: usize,
    options: RolloutOptions,
    outputs: Outputs,
    pace: Pace,
    tally: Tally,
    log: Log,
}

impl Producer {
    fn produce(mut self, stop: &Shutdown) -> anyhow::Result<()> {
        let mut before = 0.0;
        let mut waited = false;
        for episode in 0u64.. {
            if self.episodes > 0 && episode == self.episodes {
                break;
            }
            let scene = &self.scenes[(episode % self.scenes.len() as u64) as usize];
            let seed = self.seed.wrapping_add(episode);
            let mut rollout = Rollout::new(scene, seed, &self.options)
                .with_context(|| format!("scene {} with seed {seed}", scene.name))?;
            let (name, interval) = (scene.name.clone(), rollout.interval());
            if !std::mem::replace(&mut waited, true) {
                self.wait_for_listeners(stop);
            }
            self.log.info(format!("episode {episode}: {name}, seed {seed}, {} frames", rollout.frame_count()));
            let mut last = 0.0;
            while let Some(frame) = rollout.next_frame()? {
                let simulated = before + frame.frame.timestamp;
                if stop.requested() || (self.duration > 0.0 && simulated >= self.duration - ROUNDING) {
                    return Ok(());
                }
                self.tally.received();
                let stamp = self.pace.wait(simulated, stop);
                self.outputs.publish(&frame, &name, rollout.intrinsics(), stamp)?;
                self.tally.processed(None);
                self.tally.set_dropped("late", self.pace.late);
                last = frame.frame.timestamp;
            }
            before += last + interval;
        }
        Ok(())
    }

    /// Waits until enough listen to the images, then until nobody has joined for a moment: whoever starts
    /// together with the first listener gets the first frame as well.
    fn wait_for_listeners(&self, stop: &Shutdown) {
        let started = Instant::now();
        let (mut listeners, mut joined) = (0, started);
        while started.elapsed() < self.wait && !stop.requested() {
            let now = self.outputs.listeners();
            if now != listeners {
                (listeners, joined) = (now, Instant::now());
            }
            if self.outputs.watchers() >= self.awaited && joined.elapsed() > SETTLED {
                break;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// When frames go out, and which stamp they carry.
struct Pace {
    /// None = as fast as it goes.
    start: Option<Instant>,
    paced: bool,
    simulated_stamps: bool,
    /// Where the node's time at the first frame lies, s, if somebody else's /clock paces.
    follows: Option<Option<f64>>,
    /// The newest time that was followed, s: an earlier one means that the clock jumped back.
    followed: f64,
    clock: RosClock,
    late: u64,
}

impl Pace {
    fn new(parameters: &Parameters, clock: RosClock) -> Self {
        let pace = parameters.get::<String>("pace");
        let follows = (pace == "wall" && parameters.get("use_sim_time")).then_some(None);
        Self {
            start: None,
            paced: pace != "fast",
            simulated_stamps: pace != "wall",
            follows,
            followed: 0.0,
            clock,
            late: 0,
        }
    }

    /// Waits until the frame of `simulated` seconds since the first one is due; returns its stamp.
    fn wait(&mut self, simulated: f64, stop: &Shutdown) -> Time {
        if self.follows.is_some() {
            return self.follow(simulated, stop);
        }
        if self.paced {
            let offset = Duration::from_secs_f64(simulated);
            let now = Instant::now();
            let start = *self.start.get_or_insert_with(|| now.checked_sub(offset).unwrap_or(now));
            let due = start + offset;
            if now > due + Duration::from_millis(5) {
                // Too slow for real time: go on from here instead of hurrying after.
                self.late += 1;
                self.start = now.checked_sub(offset);
            }
            while let Some(left) = due.checked_duration_since(Instant::now()) {
                if stop.requested() {
                    break;
                }
                std::thread::sleep(left.min(Duration::from_millis(50)));
            }
        }
        match self.simulated_stamps {
            // From 1 s on: a stamp of zero means "not set".
            true => Time::from_nanos(((simulated + 1.0) * 1e9).round() as i64),
            false => self.clock.now(),
        }
    }
}

impl Pace {
    /// Waits until /clock, which somebody else publishes, has come as far as the frame; returns its time. A clock that
    /// stands still holds the frames back, one that jumps back begins anew.
    fn follow(&mut self, simulated: f64, stop: &Shutdown) -> Time {
        loop {
            let now = self.clock.now();
            let secs = now.secs();
            if secs < self.followed {
                self.follows = Some(None);
            }
            self.followed = secs;
            // Zero: nobody has said what time it is.
            if !now.is_zero() {
                let start = self.follows.flatten().unwrap_or(secs - simulated);
                self.follows = Some(Some(start));
                if secs >= start + simulated - ROUNDING {
                    return now;
                }
            }
            if stop.requested() {
                return now;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// The topics of one frame.
struct Outputs {
    frame_id: String,
    image: Publisher<Image>,
    compressed: Option<Publisher<CompressedImage>>,
    camera_info: Publisher<CameraInfo>,
    truth: Publisher<TactileTruth>,
    hand_pose: Publisher<HandPose>,
    clock: Option<Publisher<Clock>>,
    hands: [HandModel; 2],
    sequence: u64,
}

impl Outputs {
    fn create(runtime: &mut Runtime, parameters: &Parameters) -> anyhow::Result<Self> {
        let compressed = parameters.get::<bool>("compressed");
        let compressed_topic = format!("{}/compressed", runtime.resolve("image_raw"));
        let with_clock = parameters.get::<String>("pace") != "wall";
        Ok(Self {
            frame_id: parameters.get("frame_id"),
            image: runtime.publisher("image_raw", qos::image_output())?,
            compressed: compressed.then(|| runtime.publisher(&compressed_topic, qos::image_output())).transpose()?,
            camera_info: runtime.publisher("camera_info", qos::every_output())?,
            truth: runtime.publisher("truth/tactile", qos::every_output())?,
            hand_pose: runtime.publisher("truth/hand_pose", qos::every_output())?,
            clock: with_clock.then(|| runtime.publisher("/clock", qos::every_output())).transpose()?,
            hands: Side::BOTH.map(HandModel::builtin),
            sequence: 0,
        })
    }

    fn watchers(&self) -> usize {
        self.image.listeners() + self.compressed.as_ref().map_or(0, Publisher::listeners)
    }

    fn listeners(&self) -> usize {
        self.watchers() + self.camera_info.listeners() + self.truth.listeners() + self.hand_pose.listeners()
    }

    /// Publishes everything of one frame under one stamp: truth first, so that it is there when predictions come.
    fn publish(&mut self, frame: &SimFrame, scene: &str, intrinsics: Intrinsics, stamp: Time) -> anyhow::Result<()> {
        if let Some(clock) = &self.clock {
            clock.publish(&Clock { clock: stamp })?;
        }
        let header = Header { stamp, frame_id: self.frame_id.clone() };
        let data = &frame.frame;
        let poses = [&data.left_hand_pose, &data.right_hand_pose];
        let mut truth = TactileFrame::from_field(header.clone(), &data.field)?;
        for (hand, pose) in truth.hands.iter_mut().zip(poses) {
            hand.score = f32::from(u8::from(pose.is_some()));
        }
        truth.sequence = self.sequence;
        truth.model_id = format!("simulator/{scene}");
        self.sequence += 1;
        self.truth.publish(&TactileTruth::new(truth, data.validity))?;
        for (model, params) in self.hands.iter().zip(poses) {
            if let Some(params) = params {
                let mut pose = HandPose::from_params(header.clone(), model, params);
                into_camera(&mut pose, &frame.camera);
                self.hand_pose.publish(&pose)?;
            }
        }
        self.camera_info.publish(&camera_info(header.clone(), intrinsics))?;
        if let Some(compressed) = &self.compressed {
            compressed.publish(&jpeg(header.clone(), &data.camera_ego_rgb)?)?;
        }
        self.image.publish(&Image::from_rgb(header, &data.camera_ego_rgb))
    }
}

/// From the world frame to the camera's optical frame, which the header names.
fn into_camera(pose: &mut HandPose, camera: &CameraPose) {
    let Point { x, y, z } = pose.wrist.position;
    let position = camera.camera_from_world(DVec3::new(x, y, z));
    let Quaternion { x, y, z, w } = pose.wrist.orientation;
    let orientation = (camera.orientation.inverse() * DQuat::from_xyzw(x, y, z, w)).normalize();
    pose.wrist.position = Point { x: position.x, y: position.y, z: position.z };
    pose.wrist.orientation = Quaternion { x: orientation.x, y: orientation.y, z: orientation.z, w: orientation.w };
}

fn camera_info(header: Header, intrinsics: Intrinsics) -> CameraInfo {
    let Intrinsics { width, height, fx, fy, cx, cy, distortion: Distortion([k1, k2]) } = intrinsics;
    CameraInfo {
        header,
        height,
        width,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![k1, k2, 0.0, 0.0, 0.0],
        k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        binning_x: 0,
        binning_y: 0,
        roi: RegionOfInterest::default(),
    }
}

fn jpeg(header: Header, image: &RgbImage) -> anyhow::Result<CompressedImage> {
    let mut data = Vec::new();
    JpegEncoder::new_with_quality(&mut data, QUALITY).encode_image(image).context("cannot compress the image")?;
    Ok(CompressedImage { header, format: "rgb8; jpeg compressed bgr8".to_owned(), data })
}
