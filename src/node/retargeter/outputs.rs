//! Topics of the robot: joint states, commands and expected touch.

use glam::DVec3;

use crate::message::{
    self, Float64MultiArray, Header, JointState, JointTrajectory, JointTrajectoryPoint, LinkTouch, MultiArrayLayout,
    RobotTouch, Time, Vector3, Wrench,
};
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::retarget::touch::ExpectedLinkTouch;
use crate::retarget::{Output, Robot};

/// Names in the messages.
pub struct Names {
    robot: String,
    /// Names of all joints, in the order of [`Output::qpos`].
    pub joints: Vec<String>,
    /// Names of the joints of the free coordinates.
    pub masters: Vec<String>,
    /// Index of each of them in [`Output::qpos`].
    pub master_indices: Vec<usize>,
}

impl Names {
    /// Collects the names of a robot.
    pub fn of(robot: &Robot) -> Self {
        let all: Vec<usize> = robot.output_joints().collect();
        let masters = || robot.coupling.masters.iter().copied();
        Self {
            robot: robot.spec.robot.clone(),
            joints: robot.joint_names().into_iter().map(str::to_owned).collect(),
            masters: masters().map(|joint| robot.parts.joints[joint].name.clone()).collect(),
            master_indices: masters().filter_map(|joint| all.iter().position(|other| *other == joint)).collect(),
        }
    }

    /// Returns the values of the joints of the free coordinates.
    fn of_masters(&self, values: &[f64]) -> Vec<f64> {
        self.master_indices.iter().filter_map(|index| values.get(*index).copied()).collect()
    }
}

/// Publishers of the robot's topics.
pub struct Outputs {
    /// Names of the robot's joints.
    pub names: Names,
    joint_states: Publisher<JointState>,
    joint_trajectory: Publisher<JointTrajectory>,
    positions: Option<Publisher<Float64MultiArray>>,
    touch: Publisher<RobotTouch>,
    /// Time between two commands, s.
    period: f64,
}

impl Outputs {
    /// Creates the publishers.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub fn create(runtime: &mut Runtime, robot: &Robot, period: f64) -> anyhow::Result<Self> {
        let wants_positions = runtime.parameters().get::<bool>("publish_positions");
        let positions = wants_positions.then(|| runtime.publisher("~/position_commands", qos::output()));
        Ok(Self {
            names: Names::of(robot),
            positions: positions.transpose()?,
            joint_states: runtime.publisher("~/joint_states", qos::output())?,
            joint_trajectory: runtime.publisher("~/joint_trajectory", qos::output())?,
            touch: runtime.publisher("~/touch", qos::output())?,
            period,
        })
    }

    /// Publishes the present pose with `stamp`, and the command.
    ///
    /// # Errors
    /// If the middleware refuses a message.
    pub fn publish(&self, stamp: Time, output: &Output) -> anyhow::Result<()> {
        self.joint_states.publish(&JointState {
            header: Header { stamp, frame_id: String::new() },
            name: self.names.joints.clone(),
            position: output.qpos.clone(),
            velocity: output.qvel.clone(),
            effort: Vec::new(),
        })?;
        if let Some(positions) = &self.positions {
            let data = self.names.of_masters(&output.qpos);
            positions.publish(&Float64MultiArray { layout: MultiArrayLayout::default(), data })?;
        }
        // A controller starts a trajectory without stamp at once. The image's stamp would be in the controller's past.
        self.joint_trajectory.publish(&JointTrajectory {
            header: Header::default(),
            joint_names: self.names.masters.clone(),
            points: self.points(output),
        })
    }

    /// Publishes the expected touch.
    ///
    /// # Errors
    /// If the middleware refuses the message.
    pub fn publish_touch(&self, header: Header, hand_stamp: Time, output: &Output) -> anyhow::Result<()> {
        self.touch.publish(&robot_touch(header, hand_stamp, &self.names, output))
    }

    /// Returns the point one period ahead and, for a robot in motion, the point at which it stops if no further command comes.
    fn points(&self, output: &Output) -> Vec<JointTrajectoryPoint> {
        let point = |positions: &[f64], velocities: &[f64], accelerations: &[f64], secs: f64| JointTrajectoryPoint {
            positions: self.names.of_masters(positions),
            velocities: self.names.of_masters(velocities),
            accelerations: self.names.of_masters(accelerations),
            effort: Vec::new(),
            time_from_start: duration(secs),
        };
        let mut points = vec![point(&output.qpos, &output.qvel, &output.qacc, self.period)];
        if output.stop_secs > 0.0 {
            let still = vec![0.0; output.qpos.len()];
            points.push(point(&output.stop_qpos, &still, &still, self.period + output.stop_secs));
        }
        points
    }
}

fn duration(secs: f64) -> message::Duration {
    let time = std::time::Duration::from_secs_f64(secs);
    message::Duration { sec: i32::try_from(time.as_secs()).unwrap_or(i32::MAX), nanosec: time.subsec_nanos() }
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
