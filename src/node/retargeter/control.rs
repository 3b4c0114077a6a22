//! Control loop: takes hands as they come and commands the robot at a fixed rate.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::Inputs;
use super::hands::{HandMessage, HandModels};
use super::hold::{Deadman, Hold};
use super::measured::MeasuredJoints;
use super::outputs::Outputs;
use super::statistics::Statistics;
use crate::error::{Error, Result};
use crate::message::{Header, TactileFrame, Time};
use crate::node::approximate_sync::SyncedHand;
use crate::node::clock::RosClock;
use crate::node::lock::lock;
use crate::node::log::Log;
use crate::node::object_pose::LatestObjectPose;
use crate::node::params::Parameters;
use crate::node::runtime::Runtime;
use crate::node::shutdown::Shutdown;
use crate::retarget::{Input, Retargeter};

/// Distance of a measured joint from the pose that the robot can start at above which a warning says so, rad or m.
const START_TOLERANCE: f64 = 0.05;

/// Inputs of the control loop beside hands and touch; the subscriptions update them.
#[derive(Clone)]
pub struct Sensors {
    /// Pose of the held object.
    pub object: Arc<LatestObjectPose>,
    /// Measured joint positions.
    pub measured: Arc<MeasuredJoints>,
    /// Deadman switch.
    pub deadman: Arc<Deadman>,
}

/// Control loop, on a thread of its own.
pub struct ControlLoop {
    retargeter: Retargeter,
    models: HandModels,
    period: Duration,
    inputs: Inputs,
    sensors: Sensors,
    outputs: Outputs,
    statistics: Statistics,
    clock: RosClock,
    log: Log,
    parameters: Arc<Parameters>,
    /// Stamp of the last hand that was followed, and the node's time at which it was; None while the robot gets no commands.
    followed: Option<(Time, Time)>,
    /// True once the robot got a command.
    has_commanded: bool,
    /// Arrival of the last hand that was followed.
    last_hand: Instant,
    /// Reason for which the robot holds its pose, if it does.
    hold: Option<Hold>,
    /// The node's time in the last cycle.
    last_cycle: Time,
    /// Sum of the periods in which the robot could move, s; the time of the retargeter's motion.
    motion_secs: f64,
}

impl ControlLoop {
    /// Creates the loop and its publishers; it commands nothing before [`Self::run`].
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub fn new(
        runtime: &mut Runtime,
        retargeter: Retargeter,
        models: HandModels,
        sensors: Sensors,
        inputs: Inputs,
        statistics: Statistics,
    ) -> anyhow::Result<Self> {
        let parameters = Arc::clone(runtime.parameters());
        let period = 1.0 / parameters.get::<f64>("rate_hz");
        Ok(Self {
            outputs: Outputs::create(runtime, retargeter.robot(), period)?,
            period: Duration::from_secs_f64(period),
            clock: runtime.clock().clone(),
            log: runtime.log().clone(),
            followed: None,
            has_commanded: false,
            last_hand: Instant::now(),
            hold: None,
            last_cycle: Time::default(),
            motion_secs: 0.0,
            retargeter,
            models,
            sensors,
            inputs,
            statistics,
            parameters,
        })
    }

    /// Commands the robot until `stop`.
    pub fn run(mut self, stop: &Shutdown) {
        let mut next = Instant::now();
        while !stop.requested() {
            let now = Instant::now();
            if let Some(left) = next.checked_duration_since(now) {
                std::thread::sleep(left);
            } else if now > next + self.period {
                // Skip missed cycles: a burst of commands would help no controller.
                self.statistics.missed_cycle();
                next = now;
            }
            next += self.period;
            self.cycle();
        }
    }

    /// Follows the next hand if there is one, and publishes a command.
    fn cycle(&mut self) {
        let (now, instant) = (self.clock.now(), Instant::now());
        self.advance_time(now);
        let matched = lock(&self.inputs).take(instant);
        if let Some(hold) = self.must_hold(instant) {
            if matched.is_some() {
                self.statistics.hands.dropped(hold.counter());
            }
            return self.hold(hold, now);
        }
        let timeout = Duration::from_secs_f64(1e-3 * self.parameters.get::<f64>("input_timeout_ms"));
        let is_late = |arrived: Instant| !timeout.is_zero() && instant.saturating_duration_since(arrived) > timeout;
        let matched = match matched {
            // A hand from before a pause shows nothing of the hand now.
            Some(matched) if is_late(matched.arrived) => {
                self.statistics.hands.dropped("late");
                None
            }
            matched => matched,
        };
        let Some(matched) = matched else {
            if self.followed.is_some() && is_late(self.last_hand) {
                return self.hold(Hold::NoInput(timeout.as_secs_f64()), now);
            }
            return self.go_on(now);
        };
        if let Err(hold) = self.start(instant) {
            self.statistics.hands.dropped(hold.counter());
            return self.hold(hold, now);
        }
        self.last_hand = matched.arrived;
        match self.follow(matched, now) {
            true => self.publish(now),
            false => self.go_on(now),
        }
    }

    /// Counts the time in which the robot can move: a period per cycle, unless the node's time stands still.
    fn advance_time(&mut self, now: Time) {
        let last = std::mem::replace(&mut self.last_cycle, now);
        if now < last {
            // Simulated time was reset.
            self.retargeter.reset();
            self.followed = self.followed.map(|(stamp, _)| (stamp, now));
        }
        let (period, elapsed) = (self.period.as_secs_f64(), 1e-9 * (now.nanos() - last.nanos()) as f64);
        // Cycles are uneven by some milliseconds, commands are not. Simulated time may run slower than the loop.
        self.motion_secs += if elapsed >= 0.5 * period { period } else { elapsed.max(0.0) };
    }

    /// Returns the reason for which the robot must not follow a hand; None if it may.
    fn must_hold(&self, now: Instant) -> Option<Hold> {
        if !self.parameters.get::<bool>("enabled") {
            return Some(Hold::Disabled);
        }
        let timeout = Duration::from_secs_f64(1e-3 * self.parameters.get::<f64>("deadman_timeout_ms"));
        let needs_deadman = self.parameters.get::<bool>("deadman");
        (needs_deadman && !self.sensors.deadman.is_held(timeout, now)).then_some(Hold::Deadman)
    }

    /// Brakes, holds the pose and says so. A disabled node gives no further command once the robot stands still.
    fn hold(&mut self, hold: Hold, now: Time) {
        if self.hold.as_ref() != Some(&hold) {
            match hold {
                Hold::Disabled => self.log.info("disabled"),
                _ => self.log.warn(hold.to_string()),
            }
        }
        // Hands that wait now must not be followed later.
        let waiting = lock(&self.inputs).clear();
        (0..waiting).for_each(|_| self.statistics.hands.dropped(hold.counter()));
        self.statistics.set_hold(Some(hold.clone()));
        if self.followed.is_some() {
            if let Err(error) = self.retargeter.brake(self.motion_secs) {
                self.log.warn_throttled("brake", format!("no command: {error}"));
            }
            self.publish(now);
            if hold == Hold::Disabled && !self.retargeter.is_moving() {
                self.followed = None;
            }
        }
        self.hold = Some(hold);
    }

    /// Prepares the robot for a hand: from its measured pose if it got no commands, and slowly after a pause.
    fn start(&mut self, now: Instant) -> std::result::Result<(), Hold> {
        if self.followed.is_none() {
            self.start_from_pose(now)?;
        }
        if let Some(hold) = self.hold.take() {
            self.retargeter.begin_ramp();
            self.statistics.set_hold(None);
            self.log.info(format!("follows hands again, after: {hold}"));
        }
        Ok(())
    }

    fn start_from_pose(&mut self, now: Instant) -> std::result::Result<(), Hold> {
        let names = &self.outputs.names;
        // The robot stands where the last command left it, unless its joints say otherwise.
        let mut pose = match self.has_commanded {
            true => self.retargeter.output().qpos.clone(),
            false => self.retargeter.robot().rest_positions(),
        };
        if self.parameters.get::<String>("start") == "measured" {
            let measured = self.sensors.measured.positions(&names.masters, now);
            let missing = names.masters.iter().zip(&measured).filter(|(_, position)| position.is_none());
            let missing: Vec<String> = missing.map(|(name, _)| name.clone()).collect();
            if !missing.is_empty() {
                return Err(Hold::NoMeasurement(missing));
            }
            for (index, position) in names.master_indices.iter().zip(measured.into_iter().flatten()) {
                pose[*index] = position;
            }
        }
        if let Err(error) = self.retargeter.start_from(&pose) {
            self.log.warn_throttled("start", format!("joint_states: {error}"));
            return Err(Hold::NoMeasurement(names.masters.clone()));
        }
        let start = &self.retargeter.output().qpos;
        for (name, index) in names.masters.iter().zip(&names.master_indices) {
            if (start[*index] - pose[*index]).abs() > START_TOLERANCE {
                self.log.warn_throttled(
                    "beyond",
                    format!(
                        "joint {name} is at {:.3}, beyond its limit of {:.3}: it moves there at once",
                        pose[*index], start[*index]
                    ),
                );
            }
        }
        Ok(())
    }

    /// Moves on to the last hand's pose, and stays there.
    fn go_on(&mut self, now: Time) {
        if self.followed.is_none() {
            return;
        }
        if let Err(error) = self.retargeter.advance(self.motion_secs) {
            return self.log.warn_throttled("advance", format!("no command: {error}"));
        }
        self.publish(now);
    }

    /// Follows a hand at the node's time `now`; returns false if the hand is refused.
    fn follow(&mut self, matched: SyncedHand<HandMessage, TactileFrame>, now: Time) -> bool {
        let SyncedHand { stamp, hand, touch, restarted, .. } = matched;
        if restarted {
            self.log.warn_throttled("anew", "stamps went back: begins anew");
            self.retargeter.reset();
        }
        let touched = touch.as_ref().map(|(stamp, _)| *stamp);
        let pushed = self.input(stamp, &hand, touch).and_then(|input| {
            let has_touch = input.touch.is_some();
            let pushed = self.retargeter.push_at(&input, self.motion_secs);
            pushed.map(|output| (has_touch, output.status, output.solve_secs))
        });
        let (has_touch, status, secs) = match pushed {
            Ok(pushed) => pushed,
            Err(error) => {
                self.statistics.refused(&error);
                let kind = format!("refused {}", cause(&error));
                self.log.warn_throttled(&kind, format!("a hand was left out, the last pose is held: {error}"));
                return false;
            }
        };
        self.statistics.followed(status, has_touch, secs);
        self.followed = Some((stamp, now));
        self.has_commanded = true;
        self.statistics.hands.processed(self.clock.secs_since(stamp));
        if let (true, Some(touched)) = (has_touch, touched) {
            let header = Header { stamp: touched, frame_id: hand.header().frame_id.clone() };
            if let Err(error) = self.outputs.publish_touch(header, stamp, self.retargeter.output()) {
                self.log.warn_throttled("touch", format!("~/touch: {error:#}"));
            }
        }
        true
    }

    /// Converts messages to the retargeter's input; a bad touch or object pose is dropped, because the hand is still good.
    fn input(&self, stamp: Time, hand: &HandMessage, touch: Option<(Time, TactileFrame)>) -> Result<Input> {
        let mut input = Input::new(self.models.keypoints(hand)?, stamp.secs());
        if let Some((_, frame)) = touch {
            match self.models.touch(&frame) {
                Ok(touch) => input.touch = touch,
                Err(error) => self.log.warn_throttled("tactile", format!("tactile: message left out: {error}")),
            }
        }
        match self.sensors.object.pose_at(stamp, &hand.header().frame_id, Instant::now()) {
            Ok(object) => input.object = object,
            Err(error) => self.log.warn_throttled("object", format!("object: message left out: {error}")),
        }
        Ok(input)
    }

    /// Publishes the present pose and the command, at the node's time `now`.
    fn publish(&self, now: Time) {
        let Some((stamp, taken)) = self.followed else { return };
        let stamp = Time::from_nanos(stamp.nanos() + now.nanos() - taken.nanos());
        if let Err(error) = self.outputs.publish(stamp, self.retargeter.output()) {
            self.log.warn_throttled("publish", format!("a command could not be sent: {error:#}"));
        }
    }
}

/// Returns the field that is wrong with a hand, without its value: warnings are throttled for each field.
fn cause(error: &Error) -> &str {
    match error {
        Error::Value { name, .. } | Error::Shape { name, .. } => name,
        _ => "",
    }
}
