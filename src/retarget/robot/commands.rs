//! Commands for a robot's drivers: set points of its position servos, or joint positions if it has none.

use super::coupling::Coupling;
use super::spec::CommandOrder;
use crate::mujoco::World;
use crate::mujoco::parts::{Actuator, Parts, Pull};

/// Commands in their order.
#[derive(Debug, Clone)]
pub struct Commands {
    /// Name of each command: an actuator's, or a joint's.
    pub names: Vec<String>,
    kind: CommandKind,
}

/// Quantity that the commands set.
#[derive(Debug, Clone)]
enum CommandKind {
    /// Set points of position servos, in the actuators' units.
    Servos(Vec<Actuator>),
    /// Positions of joints, by their indices in `qpos`, rad or m.
    Joints(Vec<usize>),
}

impl Commands {
    /// Chooses the commands of a model: servos if they are wanted and every actuator is one, otherwise the joints of the free
    /// coordinates.
    pub fn new(parts: &Parts, coupling: &Coupling, order: CommandOrder) -> Self {
        let is_servo =
            |actuator: &Actuator| actuator.pull != Pull::Other && actuator.bias_length != 0.0 && actuator.gain != 0.0;
        let servos: Vec<Actuator> = parts.actuators.iter().filter(|actuator| is_servo(actuator)).cloned().collect();
        if order == CommandOrder::Actuators && !servos.is_empty() && servos.len() == parts.actuators.len() {
            return Self {
                names: servos.iter().map(|servo| servo.name.clone()).collect(),
                kind: CommandKind::Servos(servos),
            };
        }
        let joints = coupling.masters.iter().map(|joint| &parts.joints[*joint]);
        Self {
            names: joints.clone().map(|joint| joint.name.clone()).collect(),
            kind: CommandKind::Joints(joints.map(|joint| joint.qpos).collect()),
        }
    }

    /// Writes the commands that hold the present pose of the world.
    pub fn write(&self, world: &mut World, commands: &mut [f64]) {
        match &self.kind {
            CommandKind::Joints(joints) => {
                for (command, qpos) in commands.iter_mut().zip(joints) {
                    *command = world.qpos()[*qpos];
                }
            }
            CommandKind::Servos(servos) => {
                world.update_lengths();
                for (command, servo) in commands.iter_mut().zip(servos) {
                    // The servo's force, gain * ctrl + bias + bias_length * length, is zero at its set point.
                    let length = world.actuator_lengths()[servo.output];
                    let set_point = -(servo.bias + servo.bias_length * length) / servo.gain;
                    *command = set_point.clamp(servo.ctrl_range[0], servo.ctrl_range[1]);
                }
            }
        }
    }
}
