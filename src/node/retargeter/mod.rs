//! Node `retargeter`: pose and touch of a human hand to joints and expected forces of a robot hand, at a fixed rate.

mod control;
mod hands;
mod hold;
mod keypoint_layout;
mod measured;
mod outputs;
mod parameters;
mod statistics;

use std::process::ExitCode;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::Context as _;

use super::approximate_sync::ApproximateSync;
use super::clock::RosClock;
use super::enabled::serve_set_enabled;
use super::input_topics::{InputTopic, Need};
use super::lock::lock;
use super::log::Log;
use super::object_pose::LatestObjectPose;
use super::params::Parameters;
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::transforms::Transforms;
use super::worker_thread::WorkerThread;
use super::{hand_confidence, program, qos};
use crate::error::Error;
use crate::hand::Side;
use crate::message::{Bool, HandPose, HandPoses, Header, JointState, PoseArray, PoseStamped, TactileFrame};
use crate::mujoco::object::Shapes;
use crate::retarget::{Options, Retargeter, Robot};
use control::{ControlLoop, Sensors};
use hands::{HandMessage, HandModels};
use outputs::Names;
use parameters::{live_options, parameters, path_of};
use statistics::Statistics;

/// Runs the program `egotac_retargeter`.
pub fn main() -> ExitCode {
    program::run("retargeter", "Follows a hand and its touch with a robot hand.", parameters(), start)
}

/// Creates the node, loads its robot, and runs until `shutdown`.
///
/// # Errors
/// If a ROS call fails, or the robot or a MANO file can't be used.
fn start(runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let model = path_of(&parameters, "model");
    let object =
        path_of(&parameters, "object").map(|path| Shapes::read(&path)).transpose().context("parameter object")?;
    let name = parameters.get::<String>("robot");
    let robot = Robot::load_with_object(&name, model.as_deref(), object.as_ref()).context("parameter robot")?;
    run(runtime, robot, shutdown)
}

/// Runs the node with a robot until `shutdown`.
///
/// # Errors
/// If a ROS call fails, or a MANO file can't be read.
fn run(mut runtime: Runtime, robot: Robot, shutdown: &Shutdown) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let side = match parameters.get::<String>("side").as_str() {
        "left" => Side::Left,
        "right" => Side::Right,
        _ => robot.side(),
    };
    let name = robot.spec.robot.clone();
    runtime.log().info(format!("{name} from {}, follows the {} hand", robot.origin, side.name()));
    for mesh in &robot.missing_meshes {
        runtime.log().warn(format!("{name}: mesh {mesh} could not be loaded; its shape is missing"));
    }
    let models = HandModels::load(&parameters, side)?;
    let options = Options { side: Some(side), live: Some(live_options(&parameters)), ..Options::default() };
    let retargeter = Retargeter::with_options(robot, options)?;

    let slop = 1e-3 * parameters.get::<f64>("sync_slop_ms");
    let patience = Duration::from_secs_f64(1e-3 * parameters.get::<f64>("touch_wait_ms"));
    let inputs = Arc::new(Mutex::new(ApproximateSync::new(slop, patience)));
    let transforms = match retargeter.robot().object.is_some() {
        true => Transforms::subscribe(&mut runtime)?,
        false => Transforms::default(),
    };
    let millis = |name: &str| Duration::from_secs_f64(1e-3 * parameters.get::<f64>(name));
    let object = LatestObjectPose::new(transforms, millis("object_timeout_ms").as_secs_f64(), millis("tf_timeout_ms"));
    let object = Arc::new(object);
    let sensors = Sensors { object, measured: Arc::default(), deadman: Arc::default() };
    if retargeter.robot().object.is_some() {
        subscribe_object(&mut runtime, &sensors.object)?;
    }
    subscribe_robot(&mut runtime, &sensors, Names::of(retargeter.robot()).masters)?;
    let statistics = Statistics::default();
    let control = ControlLoop::new(&mut runtime, retargeter, models, sensors, Arc::clone(&inputs), statistics.clone())?;
    let receiver = Receiver { inputs: Arc::clone(&inputs), side, statistics: statistics.clone(), parameters };
    subscribe(&mut runtime, &receiver)?;
    serve_set_enabled(&mut runtime)?;
    statistics::report(&mut runtime, inputs, statistics, name)?;

    let worker = WorkerThread::spawn("control", shutdown, move |shutdown| {
        control.run(shutdown);
        Ok(())
    })?;
    runtime.spin(shutdown);
    runtime.finish(worker)
}

/// A hand comes on one of three topics.
const HANDS: Need = Need::OneOf("hands");

/// Hands that wait for their touch.
type Inputs = Arc<Mutex<ApproximateSync<HandMessage, TactileFrame>>>;

/// Receiver of the messages of all subscriptions.
#[derive(Clone)]
struct Receiver {
    inputs: Inputs,
    side: Side,
    statistics: Statistics,
    parameters: Arc<Parameters>,
}

impl Receiver {
    /// Queues a hand.
    fn hand(&self, header: &Header, hand: HandMessage, clock: &RosClock) {
        self.statistics.hands.received();
        if !self.parameters.get::<bool>("enabled") {
            return self.statistics.hands.dropped("disabled");
        }
        // A hand without stamp counts as observed when it arrives.
        let stamp = if header.stamp.is_zero() { clock.now() } else { header.stamp };
        lock(&self.inputs).push_hand(stamp, hand, Instant::now());
    }

    /// Queues the pose of a hand if it is the one to follow and its confidence is high enough.
    fn pose(&self, side: Side, pose: HandPose, clock: &RosClock) {
        if side != self.side {
            return;
        }
        match hand_confidence::is_enough(&self.parameters, pose.confidence) {
            true => self.hand(&pose.header.clone(), HandMessage::Pose(Box::new(pose)), clock),
            false => {
                self.statistics.hands.received();
                self.statistics.hands.dropped("unsure");
            }
        }
    }

    /// Counts and logs a malformed message.
    fn refuse(&self, topic: &str, error: &Error, log: &Log) {
        self.statistics.hands.dropped("malformed");
        log.warn_throttled(topic, format!("{topic}: message left out: {error}"));
    }
}

fn subscribe(runtime: &mut Runtime, receiver: &Receiver) -> anyhow::Result<()> {
    let (clock, log) = (runtime.clock().clone(), runtime.log().clone());
    let poses = (receiver.clone(), clock.clone(), log.clone());
    let input = InputTopic::new(runtime, "hand_pose", "hands", qos::every_input(), HANDS);
    runtime.input::<HandPose>(input, move |pose| {
        let (receiver, clock, log) = &poses;
        match pose.and_then(|pose| Ok((pose.side()?, pose))) {
            Ok((side, pose)) => receiver.pose(side, pose, clock),
            Err(error) => receiver.refuse("hand_pose", &error, log),
        }
    })?;
    let both = (receiver.clone(), clock.clone(), log.clone());
    let input = InputTopic::new(runtime, "hand_poses", "hands", qos::every_input(), HANDS);
    runtime.input::<HandPoses>(input, move |poses| {
        let (receiver, clock, log) = &both;
        match poses.and_then(HandPoses::into_poses) {
            Ok(poses) => poses.into_iter().for_each(|(side, pose)| receiver.pose(side, pose, clock)),
            Err(error) => receiver.refuse("hand_poses", &error, log),
        }
    })?;
    let arrays = (receiver.clone(), clock.clone(), log.clone());
    let input = InputTopic::new(runtime, "keypoints", "hands", qos::every_input(), HANDS);
    runtime.input::<PoseArray>(input, move |array| {
        let (receiver, clock, log) = &arrays;
        match array {
            Ok(array) => receiver.hand(&array.header.clone(), HandMessage::Keypoints(Box::new(array)), clock),
            Err(error) => receiver.refuse("keypoints", &error, log),
        }
    })?;
    let touches = receiver.clone();
    let input = InputTopic::new(runtime, "tactile", "touch", qos::every_input(), Need::Optional);
    runtime.input::<TactileFrame>(input, move |frame| match frame {
        Ok(frame) => {
            lock(&touches.inputs).push_touch(frame.header.stamp, frame, Instant::now());
        }
        Err(error) => touches.refuse("tactile", &error, &log),
    })
}

fn subscribe_object(runtime: &mut Runtime, object: &Arc<LatestObjectPose>) -> anyhow::Result<()> {
    let (object, log) = (Arc::clone(object), runtime.log().clone());
    let input = InputTopic::new(runtime, "object", "poses of the object", qos::every_input(), Need::Required);
    runtime.input::<PoseStamped>(input, move |pose| match pose {
        Ok(pose) => object.update(pose, Instant::now()),
        Err(error) => log.warn_throttled("object", format!("object: message left out: {error}")),
    })
}

/// Subscribes to the measured positions of `joints` and to the deadman switch, where the parameters ask for them.
fn subscribe_robot(runtime: &mut Runtime, sensors: &Sensors, joints: Vec<String>) -> anyhow::Result<()> {
    if runtime.parameters().get::<String>("start") == "measured" {
        let (measured, log) = (Arc::clone(&sensors.measured), runtime.log().clone());
        let input = InputTopic::new(runtime, "joint_states", "measured joints", qos::every_input(), Need::Required);
        runtime.input::<JointState>(input, move |state| match state {
            Ok(state) => measured.update(&state, &joints, Instant::now()),
            Err(error) => log.warn_throttled("joint_states", format!("joint_states: message left out: {error}")),
        })?;
    }
    if runtime.parameters().get::<bool>("deadman") {
        let (deadman, log) = (Arc::clone(&sensors.deadman), runtime.log().clone());
        let input = InputTopic::new(runtime, "deadman", "deadman switch", qos::newest_input(), Need::Required);
        runtime.input::<Bool>(input, move |held| match held {
            Ok(Bool { data }) => deadman.update(data, Instant::now()),
            Err(error) => log.warn_throttled("deadman", format!("deadman: message left out: {error}")),
        })?;
    }
    Ok(())
}
