//! The node `retargeter`: a hand's pose and touch to a robot hand's joints and forces, at a fixed rate.

mod control;
mod hands;
mod state;

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
use control::Worker;
use hands::{Hands, Seen};
use state::State;

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
            "Model in place of the one the robot's file names; empty = that one.",
        ),
        Parameter::fixed(
            "object",
            "",
            Allowed::Any,
            "Object that links stay out of and touching fingertips lie on, which the topic object says the place of: a model \
             (MJCF, URDF) or mesh (OBJ, STL; its convex hull counts); empty = none.",
        ),
        Parameter::fixed(
            "object_timeout_ms",
            200.0,
            Allowed::Doubles(0.0, 60_000.0),
            "A pose of the object counts for hands whose stamps differ by at most this, milliseconds.",
        ),
        Parameter::fixed(
            "side",
            "robot",
            Allowed::OneOf(&["robot", "left", "right"]),
            "Which human hand is followed; robot = the robot's own side.",
        ),
        Parameter::fixed(
            "rate_hz",
            60.0,
            Allowed::Doubles(1.0, 1000.0),
            "Joints are published so often, hertz, whether hands come or not.",
        ),
        Parameter::fixed(
            "sync_slop_ms",
            20.0,
            Allowed::Doubles(0.0, 1000.0),
            "A touch belongs to a hand when their stamps differ by at most this, milliseconds.",
        ),
        Parameter::fixed(
            "touch_wait_ms",
            200.0,
            Allowed::Doubles(0.0, 60_000.0),
            "How long a hand waits for its touch while touches come, milliseconds; 0 = not at all.",
        ),
        Parameter::fixed("mano_left", "", Allowed::Any, "Left MANO file, for hands of the topology mano."),
        Parameter::fixed("mano_right", "", Allowed::Any, "Right MANO file, likewise."),
        Parameter::new("enabled", true, Allowed::Any, "Whether the robot follows; also ~/set_enabled."),
        Parameter::use_sim_time(),
    ]
}

/// Loads the robot and runs the node until `shutdown`.
///
/// # Errors
/// If ROS refuses something, or the robot or a MANO file can't be used.
fn start(runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let model = path_of(&parameters, "model");
    let object =
        path_of(&parameters, "object").map(|path| Shapes::read(&path)).transpose().context("parameter object")?;
    let name = parameters.get::<String>("robot");
    let robot = Robot::load_beside(&name, model.as_deref(), object.as_ref()).context("parameter robot")?;
    run(runtime, robot, shutdown)
}

/// Runs the node with a robot until `shutdown`.
///
/// # Errors
/// If ROS refuses something, the robot can't take a pose, or a MANO file can't be read.
fn run(mut runtime: Runtime, robot: Robot, shutdown: &Shutdown) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let side = match parameters.get::<String>("side").as_str() {
        "left" => Side::Left,
        "right" => Side::Right,
        _ => robot.side(),
    };
    let name = robot.spec.robot.clone();
    runtime.log().info(format!("{name} from {}, follows the {} hand", robot.origin, side.name()));
    for lost in &robot.lost {
        runtime.log().warn(format!("{name}: mesh {lost} could not be loaded; its shape is left out"));
    }
    let hands = Hands::load(&parameters, side)?;
    let retargeter = Retargeter::with_options(robot, Options { side: Some(side), ..Options::default() })?;

    let slop = 1e-3 * parameters.get::<f64>("sync_slop_ms");
    let patience = Duration::from_secs_f64(1e-3 * parameters.get::<f64>("touch_wait_ms"));
    let inputs = Arc::new(Mutex::new(ApproximateSync::new(slop, patience)));
    let object = Arc::new(LatestObjectPose::new(1e-3 * parameters.get::<f64>("object_timeout_ms")));
    if retargeter.robot().object.is_some() {
        subscribe_object(&mut runtime, &object)?;
    }
    let state = State::default();
    let worker = Worker::new(&mut runtime, retargeter, hands, object, Arc::clone(&inputs), state.clone())?;
    let source = Source { inputs: Arc::clone(&inputs), side, state: state.clone(), parameters };
    subscribe(&mut runtime, &source)?;
    serve_set_enabled(&mut runtime)?;
    state::report(&mut runtime, inputs, state, name)?;

    let worker = WorkerThread::spawn("control", shutdown, move |shutdown| {
        worker.work(shutdown);
        Ok(())
    })?;
    runtime.spin(shutdown);
    runtime.finish(worker)
}

fn path_of(parameters: &Parameters, name: &str) -> Option<PathBuf> {
    Some(parameters.get::<String>(name)).filter(|path| !path.is_empty()).map(PathBuf::from)
}

type Inputs = Arc<Mutex<ApproximateSync<Seen, TactileFrame>>>;

/// What the subscriptions feed.
#[derive(Clone)]
struct Source {
    inputs: Inputs,
    side: Side,
    state: State,
    parameters: Arc<Parameters>,
}

impl Source {
    fn hand(&self, header: &Header, hand: Seen, clock: &RosClock) {
        self.state.hands.received();
        if !self.parameters.get::<bool>("enabled") {
            return self.state.hands.dropped("disabled");
        }
        // Without a stamp the order of arrival is all there is.
        let stamp = if header.stamp.is_zero() { clock.now() } else { header.stamp };
        self.inputs.lock().unwrap_or_else(PoisonError::into_inner).push_hand(stamp, hand, Instant::now());
    }

    fn refuse(&self, topic: &str, error: &Error, log: &Log) {
        self.state.hands.dropped("malformed");
        log.warn_throttled(topic, format!("{topic}: message left out: {error}"));
    }
}

fn subscribe(runtime: &mut Runtime, source: &Source) -> anyhow::Result<()> {
    let (clock, log) = (runtime.clock().clone(), runtime.log().clone());
    let poses = (source.clone(), clock.clone(), log.clone());
    runtime.subscribe::<HandPose>("hand_pose", qos::every_input(), move |pose| {
        let (source, clock, log) = &poses;
        match pose.and_then(|pose| Ok((pose.side()?, pose))) {
            Ok((side, pose)) if side == source.side => {
                source.hand(&pose.header.clone(), Seen::Pose(Box::new(pose)), clock);
            }
            Ok(_) => {} // the other hand's
            Err(error) => source.refuse("hand_pose", &error, log),
        }
    })?;
    let arrays = (source.clone(), clock.clone(), log.clone());
    runtime.subscribe::<PoseArray>("keypoints", qos::every_input(), move |array| {
        let (source, clock, log) = &arrays;
        match array {
            Ok(array) => source.hand(&array.header.clone(), Seen::Keypoints(Box::new(array)), clock),
            Err(error) => source.refuse("keypoints", &error, log),
        }
    })?;
    let touches = source.clone();
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
