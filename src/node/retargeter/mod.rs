//! Node `retargeter`: pose and touch of a human hand to joints and expected forces of a robot hand, at a fixed rate.

mod control;
mod hands;
mod statistics;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context as _;

use super::approximate_sync::ApproximateSync;
use super::clock::RosClock;
use super::enabled::serve_set_enabled;
use super::log::Log;
use super::object_pose::LatestObjectPose;
use super::params::{Allowed, Parameter, Parameters};
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::worker_thread::WorkerThread;
use super::{program, qos};
use crate::error::Error;
use crate::hand::Side;
use crate::message::{HandPose, Header, PoseArray, PoseStamped, TactileFrame};
use crate::mujoco::object::Shapes;
use crate::retarget::{Options, Retargeter, Robot};
use control::ControlLoop;
use hands::{HandMessage, HandModels};
use statistics::Statistics;

/// Runs the program `egotac_retargeter`.
pub fn main() -> ExitCode {
    program::run("retargeter", "Follows a hand and its touch with a robot hand.", &parameters(), start)
}

/// The node's parameters.
fn parameters() -> Vec<Parameter> {
    vec![
        Parameter::fixed(
            "robot",
            "four_finger",
            Allowed::Any,
            "Robot hand: a name of `egotac retarget list`, a YAML file, or a model (MJCF or URDF).",
        ),
        Parameter::fixed(
            "model",
            "",
            Allowed::Any,
            "Model file in place of the one that the robot's file names; empty = that one.",
        ),
        Parameter::fixed(
            "object",
            "",
            Allowed::Any,
            "Object that the hand holds: links stay out of it and touching fingertips lie on it. A model (MJCF, URDF) or mesh \
             (OBJ, STL; its convex hull counts); empty = none. The topic object carries its pose.",
        ),
        Parameter::fixed(
            "object_timeout_ms",
            200.0,
            Allowed::Doubles(0.0, 60_000.0),
            "Greatest difference of the stamps of a hand and the object pose that is used for it, milliseconds.",
        ),
        Parameter::fixed(
            "side",
            "robot",
            Allowed::OneOf(&["robot", "left", "right"]),
            "Side of the human hand that is followed; robot = the robot's own side.",
        ),
        Parameter::fixed(
            "rate_hz",
            60.0,
            Allowed::Doubles(1.0, 1000.0),
            "Rate at which joints are published, whether hands come or not, hertz.",
        ),
        Parameter::fixed(
            "sync_slop_ms",
            20.0,
            Allowed::Doubles(0.0, 1000.0),
            "Greatest difference of the stamps of a hand and its touch, milliseconds.",
        ),
        Parameter::fixed(
            "touch_wait_ms",
            200.0,
            Allowed::Doubles(0.0, 60_000.0),
            "Greatest time that a hand waits for its touch while touch messages come, milliseconds; 0 = never.",
        ),
        Parameter::fixed("mano_left", "", Allowed::Any, "Left MANO file, for hands of the topology mano."),
        Parameter::fixed("mano_right", "", Allowed::Any, "Right MANO file, for hands of the topology mano."),
        Parameter::new("enabled", true, Allowed::Any, "True to follow hands; also set by ~/set_enabled."),
        Parameter::use_sim_time(),
    ]
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
    let retargeter = Retargeter::with_options(robot, Options { side: Some(side), ..Options::default() })?;

    let slop = 1e-3 * parameters.get::<f64>("sync_slop_ms");
    let patience = Duration::from_secs_f64(1e-3 * parameters.get::<f64>("touch_wait_ms"));
    let inputs = Arc::new(Mutex::new(ApproximateSync::new(slop, patience)));
    let object = Arc::new(LatestObjectPose::new(1e-3 * parameters.get::<f64>("object_timeout_ms")));
    if retargeter.robot().object.is_some() {
        subscribe_object(&mut runtime, &object)?;
    }
    let statistics = Statistics::default();
    let control = ControlLoop::new(&mut runtime, retargeter, models, object, Arc::clone(&inputs), statistics.clone())?;
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

/// Returns the path of a parameter; None if it is empty.
fn path_of(parameters: &Parameters, name: &str) -> Option<PathBuf> {
    Some(parameters.get::<String>(name)).filter(|path| !path.is_empty()).map(PathBuf::from)
}

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
        self.inputs.lock().unwrap_or_else(PoisonError::into_inner).push_hand(stamp, hand, Instant::now());
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
    runtime.subscribe::<HandPose>("hand_pose", qos::every_input(), move |pose| {
        let (receiver, clock, log) = &poses;
        match pose.and_then(|pose| Ok((pose.side()?, pose))) {
            Ok((side, pose)) if side == receiver.side => {
                receiver.hand(&pose.header.clone(), HandMessage::Pose(Box::new(pose)), clock);
            }
            Ok(_) => {} // Of the other hand.
            Err(error) => receiver.refuse("hand_pose", &error, log),
        }
    })?;
    let arrays = (receiver.clone(), clock.clone(), log.clone());
    runtime.subscribe::<PoseArray>("keypoints", qos::every_input(), move |array| {
        let (receiver, clock, log) = &arrays;
        match array {
            Ok(array) => receiver.hand(&array.header.clone(), HandMessage::Keypoints(Box::new(array)), clock),
            Err(error) => receiver.refuse("keypoints", &error, log),
        }
    })?;
    let touches = receiver.clone();
    runtime.subscribe::<TactileFrame>("tactile", qos::every_input(), move |frame| match frame {
        Ok(frame) => {
            let mut inputs = touches.inputs.lock().unwrap_or_else(PoisonError::into_inner);
            inputs.push_touch(frame.header.stamp, frame, Instant::now());
        }
        Err(error) => touches.refuse("tactile", &error, &log),
    })
}

fn subscribe_object(runtime: &mut Runtime, object: &Arc<LatestObjectPose>) -> anyhow::Result<()> {
    let (object, log) = (Arc::clone(object), runtime.log().clone());
    runtime.subscribe::<PoseStamped>("object", qos::every_input(), move |pose| match pose {
        Ok(pose) => object.update(pose),
        Err(error) => log.warn_throttled("object", format!("object: message left out: {error}")),
    })
}
