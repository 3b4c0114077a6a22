//! The node `retargeter`: a hand's pose and touch to a robot hand's joints and forces, at a fixed rate.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use glam::DVec3;
use r2r::std_srvs::srv::SetBool;

use super::diagnostics::{self, Level, Report, Tally, percentile};
use super::held_object::HeldObject;
use super::log::Log;
use super::matching::{Matched, Matching};
use super::params::{Allowed, Parameter, Parameters};
use super::runtime::{self, Publisher, RosClock, Runtime};
use super::{Shutdown, qos};
use crate::error::{Error, Result};
use crate::hand::{HandModel, N_KEYPOINTS, Side};
use crate::message::{
    self, HandPose, Header, JointState, JointTrajectory, JointTrajectoryPoint, LinkTouch, PoseArray, PoseStamped,
    RobotTouch, TactileFrame, Time, Vector3, Wrench,
};
use crate::mujoco::object::Shapes;
use crate::retarget::human::Hand;
use crate::retarget::touch::LinkFeel;
use crate::retarget::{Input, Options, Output, Pool, Retargeter, Robot, Status, Touch};
use crate::tactile::Topology;

/// The newest times of the solver that percentiles look back on.
const WINDOW: usize = 500;

/// The node's parameters.
pub fn parameters() -> Vec<Parameter> {
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

/// Creates the node, loads its robot, and runs until `shutdown`.
///
/// # Errors
/// If ROS refuses something, or the robot or a MANO file can't be used.
pub fn start(shutdown: &Shutdown) -> anyhow::Result<()> {
    let runtime = Runtime::create("retargeter", &parameters())?;
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
pub fn run(mut runtime: Runtime, robot: Robot, shutdown: &Shutdown) -> anyhow::Result<()> {
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
    let inputs = Arc::new(Mutex::new(Matching::new(slop, patience)));
    let object = Arc::new(HeldObject::new(1e-3 * parameters.get::<f64>("object_timeout_ms")));
    if retargeter.robot().object.is_some() {
        subscribe_object(&mut runtime, &object)?;
    }
    let state = State::default();
    let worker = Worker {
        outputs: Outputs {
            joint_states: runtime.publisher("~/joint_states", qos::output())?,
            joint_trajectory: runtime.publisher("~/joint_trajectory", qos::output())?,
            touch: runtime.publisher("~/touch", qos::output())?,
        },
        names: Names::of(retargeter.robot()),
        period: Duration::from_secs_f64(1.0 / parameters.get::<f64>("rate_hz")),
        inputs: Arc::clone(&inputs),
        state: state.clone(),
        clock: runtime.clock().clone(),
        log: runtime.log().clone(),
        parameters: Arc::clone(&parameters),
        given: None,
        before: Time::default(),
        retargeter,
        hands,
        object,
    };
    let source = Source { inputs: Arc::clone(&inputs), side, state: state.clone(), parameters };
    subscribe(&mut runtime, &source)?;
    serve_set_enabled(&mut runtime)?;
    report(&mut runtime, inputs, state, name)?;

    let stop = shutdown.clone();
    let worker = std::thread::Builder::new().name("control".into()).spawn(move || {
        let _guard = stop.when_dropped();
        worker.work(&stop);
        Ok(())
    })?;
    runtime.spin(shutdown);
    let result = runtime::join(worker, "control");
    drop(runtime);
    result
}

fn path_of(parameters: &Parameters, name: &str) -> Option<PathBuf> {
    Some(parameters.get::<String>(name)).filter(|path| !path.is_empty()).map(PathBuf::from)
}

/// A hand as it came.
enum Seen {
    Pose(Box<HandPose>),
    Keypoints(Box<PoseArray>),
}

impl Seen {
    fn header(&self) -> &Header {
        match self {
            Self::Pose(pose) => &pose.header,
            Self::Keypoints(array) => &array.header,
        }
    }
}

type Inputs = Arc<Mutex<Matching<Seen, TactileFrame>>>;

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
        self.inputs.lock().unwrap_or_else(PoisonError::into_inner).hand(stamp, hand, Instant::now());
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
            inputs.touch(frame.header.stamp, frame, Instant::now());
        }
        Err(error) => touches.refuse("tactile", &error, &log),
    })
}

fn subscribe_object(runtime: &mut Runtime, object: &Arc<HeldObject>) -> anyhow::Result<()> {
    let (object, log) = (Arc::clone(object), runtime.log().clone());
    runtime.subscribe::<PoseStamped>("object", qos::every_input(), move |pose| match pose {
        Ok(pose) => object.see(pose),
        Err(error) => log.warn_throttled("object", format!("object: message left out: {error}")),
    })
}

fn serve_set_enabled(runtime: &mut Runtime) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    runtime.service::<SetBool::Service>("~/set_enabled", move |request| {
        let set = parameters.set([("enabled".to_owned(), request.data.into())]);
        SetBool::Response { success: set.is_ok(), message: set.err().unwrap_or_default() }
    })
}

/// What the control loop tells the diagnostics.
#[derive(Clone, Default)]
struct State {
    hands: Tally,
    counts: Arc<Mutex<Counts>>,
}

#[derive(Default)]
struct Counts {
    with_touch: u64,
    statuses: [u64; Status::ALL.len()],
    solve_secs: VecDeque<f64>,
    /// Times that the loop missed.
    late: u64,
    /// What is wrong with the newest hand, if anything.
    refused: Option<String>,
}

impl State {
    fn counts(&self) -> std::sync::MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn report(runtime: &mut Runtime, inputs: Inputs, state: State, robot: String) -> anyhow::Result<()> {
    let topics = format!("{} or {}", runtime.resolve("hand_pose"), runtime.resolve("keypoints"));
    diagnostics::publish(runtime, robot, move |runtime| {
        let (overtaken, touched) = {
            let inputs = inputs.lock().unwrap_or_else(PoisonError::into_inner);
            (inputs.overtaken(), inputs.touch_flows(Instant::now()))
        };
        state.hands.set_dropped("superseded", overtaken);
        let mut tally = state.hands.counts();
        let rates = tally.rates();
        let mut counts = state.counts();
        let (level, message) = if !runtime.parameters().get::<bool>("enabled") {
            (Level::Ok, "disabled".to_owned())
        } else if let Some(error) = &counts.refused {
            (Level::Warn, format!("holds the last pose: {error}"))
        } else if rates.0 == 0.0 {
            (Level::Stale, format!("no hands on {topics}"))
        } else {
            let touch = if touched { "with touch" } else { "no touch" };
            (Level::Ok, format!("follows {:.1} hands per second, {touch}", rates.1))
        };
        let mut values = tally.values(rates);
        values.push(("with_touch".to_owned(), counts.with_touch.to_string()));
        values.push(("late_cycles".to_owned(), counts.late.to_string()));
        for (name, count) in STATUS_NAMES.into_iter().zip(counts.statuses) {
            values.push((format!("status_{name}"), count.to_string()));
        }
        for (name, q) in [("p50", 0.5), ("p99", 0.99), ("max", 1.0)] {
            let secs = percentile(counts.solve_secs.make_contiguous().iter().copied(), q);
            values.push((format!("solve_{name}_us"), format!("{:.0}", 1e6 * secs)));
        }
        Report { task: "hands", level, message, values }
    })
}

/// Names of [`Status::ALL`] in diagnostics.
const STATUS_NAMES: [&str; Status::ALL.len()] = ["solved", "repaired", "limited", "capped", "held"];

/// Models of the hand that is followed.
struct Hands {
    side: Side,
    /// With what its vertices pool to.
    models: Vec<(HandModel, Pool)>,
}

impl Hands {
    fn load(parameters: &Parameters, side: Side) -> anyhow::Result<Self> {
        let mut models = vec![HandModel::builtin(side)];
        let name = match side {
            Side::Left => "mano_left",
            Side::Right => "mano_right",
        };
        if let Some(path) = path_of(parameters, name) {
            models.push(load_mano(&path, side).with_context(|| format!("parameter {name}"))?);
        }
        let models = models.into_iter().map(|model| Ok((Pool::new(&model)?, model)).map(|(pool, model)| (model, pool)));
        Ok(Self { side, models: models.collect::<Result<_>>()? })
    }

    fn of(&self, topology: Topology) -> Result<&(HandModel, Pool)> {
        let found = self.models.iter().find(|(model, _)| model.topology == topology);
        let expected = format!("{}, or the parameter mano_{}", Topology::EgotacHand1.id(), self.side.name());
        found.ok_or_else(|| Error::value("topology", expected, topology.id()))
    }

    /// The keypoints of a hand, m.
    fn keypoints(&self, seen: &Seen) -> Result<[DVec3; N_KEYPOINTS]> {
        match seen {
            Seen::Pose(pose) => {
                let (model, _) = self.of(Topology::from_id(&pose.topology)?)?;
                Ok(Hand::of_model(model, &pose.to_params(model)?))
            }
            Seen::Keypoints(array) => {
                let points: Vec<DVec3> = array
                    .poses
                    .iter()
                    .map(|pose| DVec3::new(pose.position.x, pose.position.y, pose.position.z))
                    .collect();
                points.try_into().map_err(|points: Vec<_>| Error::shape("poses", N_KEYPOINTS, [points.len()]))
            }
        }
    }

    /// The touch of a frame; None if it says nothing about this hand.
    fn touch(&self, frame: &TactileFrame) -> Result<Option<Touch>> {
        if !frame.hands.iter().any(|hand| hand.side == self.side as u8) {
            return Ok(None);
        }
        let (_, pool) = self.of(Topology::from_id(&frame.topology)?)?;
        let field = frame.to_field()?;
        let mut touch = Touch::default();
        pool.add(&field.force[self.side.range()], &field.contact[self.side.range()], &mut touch)?;
        Ok(Some(touch))
    }
}

fn load_mano(path: &Path, side: Side) -> Result<HandModel> {
    HandModel::load(path, side)
}

/// Names that the messages carry.
struct Names {
    robot: String,
    joints: Vec<String>,
    /// Joints that move on their own.
    masters: Vec<String>,
    /// Their places among all.
    places: Vec<usize>,
}

impl Names {
    fn of(robot: &Robot) -> Self {
        let all: Vec<usize> = robot.output_joints().collect();
        let masters = || robot.coupling.masters.iter().copied();
        Self {
            robot: robot.spec.robot.clone(),
            joints: robot.joint_names().into_iter().map(str::to_owned).collect(),
            masters: masters().map(|joint| robot.parts.joints[joint].name.clone()).collect(),
            places: masters().filter_map(|joint| all.iter().position(|other| *other == joint)).collect(),
        }
    }
}

struct Outputs {
    joint_states: Publisher<JointState>,
    joint_trajectory: Publisher<JointTrajectory>,
    touch: Publisher<RobotTouch>,
}

/// The control loop, on a thread of its own.
struct Worker {
    retargeter: Retargeter,
    hands: Hands,
    object: Arc<HeldObject>,
    names: Names,
    period: Duration,
    inputs: Inputs,
    outputs: Outputs,
    state: State,
    clock: RosClock,
    log: Log,
    parameters: Arc<Parameters>,
    /// Stamp of the hand that was taken last, and the node's time then.
    given: Option<(Time, Time)>,
    /// The node's time in the last cycle.
    before: Time,
}

impl Worker {
    fn work(mut self, stop: &Shutdown) {
        let mut next = Instant::now();
        while !stop.requested() {
            let now = Instant::now();
            if let Some(left) = next.checked_duration_since(now) {
                std::thread::sleep(left);
            } else if now > next + self.period {
                // Cycles that were missed are left out.
                self.state.counts().late += 1;
                next = now;
            }
            next += self.period;
            if self.parameters.get::<bool>("enabled") {
                self.cycle();
            }
        }
    }

    fn cycle(&mut self) {
        let now = self.clock.now();
        if now < std::mem::replace(&mut self.before, now) {
            // Simulated time began anew.
            self.retargeter.reset();
            self.given = self.given.map(|(stamp, _)| (stamp, now));
        }
        let matched = self.inputs.lock().unwrap_or_else(PoisonError::into_inner).take(Instant::now());
        let followed = match matched {
            Some(matched) => self.follow(matched, now),
            None => false,
        };
        let Some((stamp, taken)) = self.given else { return };
        let stamp = Time::from_nanos(stamp.nanos() + now.nanos() - taken.nanos());
        // Between hands and in their silence the robot goes on to where it was told to go, and stays there.
        if !followed && let Err(error) = self.retargeter.advance(now.secs()) {
            return self.log.warn_throttled("advance", format!("no command: {error}"));
        }
        if let Err(error) = self.publish(stamp) {
            self.log.warn_throttled("publish", format!("a command could not be sent: {error:#}"));
        }
    }

    /// Takes a hand at the node's time; whether the robot follows it.
    fn follow(&mut self, matched: Matched<Seen, TactileFrame>, now: Time) -> bool {
        let Matched { stamp, hand, touch, began_anew } = matched;
        if began_anew {
            self.log.warn_throttled("anew", "stamps went back: begins anew");
            self.retargeter.reset();
        }
        let touched = touch.as_ref().map(|(stamp, _)| *stamp);
        let pushed = self.input(stamp, &hand, touch).and_then(|input| {
            let has_touch = input.touch.is_some();
            self.retargeter.push_at(&input, now.secs()).map(|output| (has_touch, output.status, output.solve_secs))
        });
        let mut counts = self.state.counts();
        let (has_touch, status, secs) = match pushed {
            Ok(pushed) => pushed,
            Err(error) => {
                counts.statuses[Status::Held as usize] += 1;
                counts.refused = Some(error.to_string());
                drop(counts);
                self.state.hands.dropped("refused");
                let kind = format!("refused {}", cause(&error));
                self.log.warn_throttled(&kind, format!("a hand was left out, the last pose is held: {error}"));
                return false;
            }
        };
        counts.refused = None;
        counts.statuses[status as usize] += 1;
        counts.with_touch += u64::from(has_touch);
        if counts.solve_secs.len() == WINDOW {
            counts.solve_secs.pop_front();
        }
        counts.solve_secs.push_back(secs);
        drop(counts);
        self.given = Some((stamp, now));
        self.state.hands.processed(self.clock.secs_since(stamp));
        if let (true, Some(touched)) = (has_touch, touched) {
            let header = Header { stamp: touched, frame_id: hand.header().frame_id.clone() };
            let message = robot_touch(header, stamp, &self.names, self.retargeter.output());
            if let Err(error) = self.outputs.touch.publish(&message) {
                self.log.warn_throttled("touch", format!("~/touch: {error:#}"));
            }
        }
        true
    }

    fn input(&self, stamp: Time, hand: &Seen, touch: Option<(Time, TactileFrame)>) -> Result<Input> {
        let mut input = Input::new(self.hands.keypoints(hand)?, stamp.secs());
        if let Some((_, frame)) = touch {
            match self.hands.touch(&frame) {
                Ok(touch) => input.touch = touch,
                // The pose is good all the same.
                Err(error) => self.log.warn_throttled("tactile", format!("tactile: message left out: {error}")),
            }
        }
        match self.object.at(stamp, &hand.header().frame_id) {
            Ok(object) => input.object = object,
            // As are pose and touch.
            Err(error) => self.log.warn_throttled("object", format!("object: message left out: {error}")),
        }
        Ok(input)
    }

    fn publish(&self, stamp: Time) -> anyhow::Result<()> {
        let output = self.retargeter.output();
        let header = Header { stamp, frame_id: String::new() };
        self.outputs.joint_states.publish(&JointState {
            header,
            name: self.names.joints.clone(),
            position: output.qpos.clone(),
            velocity: Vec::new(),
            effort: Vec::new(),
        })?;
        let point = JointTrajectoryPoint {
            positions: self.names.places.iter().map(|place| output.qpos[*place]).collect(),
            velocities: Vec::new(),
            accelerations: Vec::new(),
            effort: Vec::new(),
            time_from_start: message::Duration {
                sec: self.period.as_secs() as i32,
                nanosec: self.period.subsec_nanos(),
            },
        };
        // A controller begins at once with a trajectory without stamp; the image's stamp is in its past.
        self.outputs.joint_trajectory.publish(&JointTrajectory {
            header: Header::default(),
            joint_names: self.names.masters.clone(),
            points: vec![point],
        })
    }
}

/// What is wrong with a hand, without what came: each cause has warnings of its own.
fn cause(error: &Error) -> &str {
    match error {
        Error::Value { name, .. } | Error::Shape { name, .. } => name,
        _ => "",
    }
}

fn robot_touch(header: Header, hand_stamp: Time, names: &Names, output: &Output) -> RobotTouch {
    let feel = &output.feel;
    RobotTouch {
        header,
        robot: names.robot.clone(),
        hand_stamp,
        links: feel.links.iter().map(link_touch).collect(),
        joint_names: names.masters.clone(),
        joint_torques: feel.torque.clone(),
        clipped: feel.clipped,
        net_force: vector(feel.asked),
        left_out: feel.left_out,
    }
}

fn link_touch(link: &LinkFeel) -> LinkTouch {
    let DVec3 { x, y, z } = link.body_position;
    LinkTouch {
        link: link.name.clone(),
        normal_force: link.normal_force,
        wrench: Wrench { force: vector(link.body_force), torque: vector(link.body_position.cross(link.body_force)) },
        position: message::Point { x, y, z },
        contact: link.contact,
    }
}

fn vector(vector: DVec3) -> Vector3 {
    Vector3 { x: vector.x, y: vector.y, z: vector.z }
}
