//! Control loop: takes hands as they come and commands the robot at a fixed rate.

use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use glam::DVec3;

use super::Inputs;
use super::hands::{HandMessage, HandModels};
use super::statistics::Statistics;
use crate::error::{Error, Result};
use crate::message::{
    self, Header, JointState, JointTrajectory, JointTrajectoryPoint, LinkTouch, RobotTouch, TactileFrame, Time,
    Vector3, Wrench,
};
use crate::node::approximate_sync::SyncedHand;
use crate::node::clock::RosClock;
use crate::node::log::Log;
use crate::node::object_pose::LatestObjectPose;
use crate::node::params::Parameters;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::node::shutdown::Shutdown;
use crate::retarget::touch::ExpectedLinkTouch;
use crate::retarget::{Input, Output, Retargeter, Robot};

/// Names in the messages.
struct Names {
    robot: String,
    /// Names of all joints, in the order of [`Output::qpos`].
    joints: Vec<String>,
    /// Names of the joints of the free coordinates.
    masters: Vec<String>,
    /// Index of each of them in [`Output::qpos`].
    master_indices: Vec<usize>,
}

impl Names {
    fn of(robot: &Robot) -> Self {
        let all: Vec<usize> = robot.output_joints().collect();
        let masters = || robot.coupling.masters.iter().copied();
        Self {
            robot: robot.spec.robot.clone(),
            joints: robot.joint_names().into_iter().map(str::to_owned).collect(),
            masters: masters().map(|joint| robot.parts.joints[joint].name.clone()).collect(),
            master_indices: masters().filter_map(|joint| all.iter().position(|other| *other == joint)).collect(),
        }
    }
}

/// Publishers of the robot's topics.
struct Outputs {
    joint_states: Publisher<JointState>,
    joint_trajectory: Publisher<JointTrajectory>,
    touch: Publisher<RobotTouch>,
}

/// Control loop, on a thread of its own.
pub struct ControlLoop {
    retargeter: Retargeter,
    models: HandModels,
    object: Arc<LatestObjectPose>,
    names: Names,
    period: Duration,
    inputs: Inputs,
    outputs: Outputs,
    statistics: Statistics,
    clock: RosClock,
    log: Log,
    parameters: Arc<Parameters>,
    /// Stamp of the last hand that was followed, and the node's time at which it was.
    followed: Option<(Time, Time)>,
    /// The node's time in the last cycle.
    last_cycle: Time,
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
        object: Arc<LatestObjectPose>,
        inputs: Inputs,
        statistics: Statistics,
    ) -> anyhow::Result<Self> {
        let parameters = Arc::clone(runtime.parameters());
        Ok(Self {
            outputs: Outputs {
                joint_states: runtime.publisher("~/joint_states", qos::output())?,
                joint_trajectory: runtime.publisher("~/joint_trajectory", qos::output())?,
                touch: runtime.publisher("~/touch", qos::output())?,
            },
            names: Names::of(retargeter.robot()),
            period: Duration::from_secs_f64(1.0 / parameters.get::<f64>("rate_hz")),
            clock: runtime.clock().clone(),
            log: runtime.log().clone(),
            followed: None,
            last_cycle: Time::default(),
            retargeter,
            models,
            object,
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
            if self.parameters.get::<bool>("enabled") {
                self.cycle();
            }
        }
    }

    /// Follows the next hand if there is one, and publishes a command.
    fn cycle(&mut self) {
        let now = self.clock.now();
        if now < std::mem::replace(&mut self.last_cycle, now) {
            // Simulated time was reset.
            self.retargeter.reset();
            self.followed = self.followed.map(|(stamp, _)| (stamp, now));
        }
        let matched = self.inputs.lock().unwrap_or_else(PoisonError::into_inner).take(Instant::now());
        let has_followed = match matched {
            Some(matched) => self.follow(matched, now),
            None => false,
        };
        let Some((stamp, taken)) = self.followed else { return };
        let stamp = Time::from_nanos(stamp.nanos() + now.nanos() - taken.nanos());
        // Without a new hand the robot moves on to the last pose, and stays there.
        if !has_followed && let Err(error) = self.retargeter.advance(now.secs()) {
            return self.log.warn_throttled("advance", format!("no command: {error}"));
        }
        if let Err(error) = self.publish(stamp) {
            self.log.warn_throttled("publish", format!("a command could not be sent: {error:#}"));
        }
    }

    /// Follows a hand at the node's time `now`; returns false if the hand is refused.
    fn follow(&mut self, matched: SyncedHand<HandMessage, TactileFrame>, now: Time) -> bool {
        let SyncedHand { stamp, hand, touch, restarted } = matched;
        if restarted {
            self.log.warn_throttled("anew", "stamps went back: begins anew");
            self.retargeter.reset();
        }
        let touched = touch.as_ref().map(|(stamp, _)| *stamp);
        let pushed = self.input(stamp, &hand, touch).and_then(|input| {
            let has_touch = input.touch.is_some();
            self.retargeter.push_at(&input, now.secs()).map(|output| (has_touch, output.status, output.solve_secs))
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
        self.statistics.hands.processed(self.clock.secs_since(stamp));
        if let (true, Some(touched)) = (has_touch, touched) {
            let header = Header { stamp: touched, frame_id: hand.header().frame_id.clone() };
            let message = robot_touch(header, stamp, &self.names, self.retargeter.output());
            if let Err(error) = self.outputs.touch.publish(&message) {
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
        match self.object.pose_at(stamp, &hand.header().frame_id) {
            Ok(object) => input.object = object,
            Err(error) => self.log.warn_throttled("object", format!("object: message left out: {error}")),
        }
        Ok(input)
    }

    /// Publishes the present pose and the command.
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
            positions: self.names.master_indices.iter().map(|index| output.qpos[*index]).collect(),
            velocities: Vec::new(),
            accelerations: Vec::new(),
            effort: Vec::new(),
            time_from_start: message::Duration {
                sec: self.period.as_secs() as i32,
                nanosec: self.period.subsec_nanos(),
            },
        };
        // A controller starts a trajectory without stamp at once. The image's stamp would be in the controller's past.
        self.outputs.joint_trajectory.publish(&JointTrajectory {
            header: Header::default(),
            joint_names: self.names.masters.clone(),
            points: vec![point],
        })
    }
}

/// Returns the field that is wrong with a hand, without its value: warnings are throttled for each field.
fn cause(error: &Error) -> &str {
    match error {
        Error::Value { name, .. } | Error::Shape { name, .. } => name,
        _ => "",
    }
}

fn robot_touch(header: Header, hand_stamp: Time, names: &Names, output: &Output) -> RobotTouch {
    let touch = &output.expected_touch;
    RobotTouch {
        header,
        robot: names.robot.clone(),
        hand_stamp,
        links: touch.links.iter().map(link_touch).collect(),
        joint_names: names.masters.clone(),
        joint_torques: touch.torque.clone(),
        clipped: touch.clipped,
        net_force: vector(touch.net_force),
        left_out: touch.unassigned_force,
    }
}

fn link_touch(link: &ExpectedLinkTouch) -> LinkTouch {
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
