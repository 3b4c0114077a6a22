//! What a robot's drivers are told: controls of its position servos, or joint positions where it has none.

use super::coupling::Coupling;
use super::spec::Order;
use crate::mujoco::World;
use crate::mujoco::parts::{Actuator, Parts, Pull};

/// The commands and their order.
#[derive(Debug, Clone)]
pub struct Commands {
    /// Name of each command: an actuator's, or a joint's.
    pub names: Vec<String>,
    kind: Kind,
}

#[derive(Debug, Clone)]
enum Kind {
    /// Position servos.
    Servos(Vec<Actuator>),
    /// Positions of joints, by their index in `qpos`.
    Joints(Vec<usize>),
}

impl Commands {
    /// Chooses the commands of a model.
    pub fn new(parts: &Parts, coupling: &Coupling, order: Order) -> Self {
        let is_servo =
            |actuator: &Actuator| actuator.pull != Pull::Other && actuator.bias_length != 0.0 && actuator.gain != 0.0;
        let servos: Vec<Actuator> = parts.actuators.iter().filter(|actuator| is_servo(actuator)).cloned().collect();
        if order == Order::Actuators && !servos.is_empty() && servos.len() == parts.actuators.len() {
            return Self { names: servos.iter().map(|servo| servo.name.clone()).collect(), kind: Kind::Servos(servos) };
        }
        let joints = coupling.masters.iter().map(|joint| &parts.joints[*joint]);
        Self {
            names: joints.clone().map(|joint| joint.name.clone()).collect(),
            kind: Kind::Joints(joints.map(|joint| joint.qpos).collect()),
        }
    }

    /// Whether the commands are positions of joints.
    pub fn are_joints(&self) -> bool {
        matches!(self.kind, Kind::Joints(_))
    }

    /// Writes the commands that hold the pose which the world is in.
    pub fn write(&self, world: &mut World, commands: &mut [f64]) {
        match &self.kind {
            Kind::Joints(joints) => {
                for (command, qpos) in commands.iter_mut().zip(joints) {
                    *command = world.qpos()[*qpos];
                }
            }
            Kind::Servos(servos) => {
                world.update_lengths();
                for (command, servo) in commands.iter_mut().zip(servos) {
                    // Where the servo's force is zero.
                    let length = world.actuator_lengths()[servo.output];
                    let there = -(servo.bias + servo.bias_length * length) / servo.gain;
                    *command = there.clamp(servo.ctrl_range[0], servo.ctrl_range[1]);
                }
            }
        }
    }
}
