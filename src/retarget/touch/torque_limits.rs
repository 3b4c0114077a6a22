//! Torque limits of a robot's joints.

use crate::mujoco::parts::Pull;
use crate::retarget::robot::Robot;
use crate::retarget::robot::coupling::JointDrive;

/// Greatest torque or force of each free coordinate by its actuators in the rest pose, N m or N; infinite for coordinates
/// without actuators.
pub fn torque_limits(robot: &Robot) -> Vec<f64> {
    let n = robot.coupling.len();
    let mut limits = vec![0.0; n];
    let mut is_driven = vec![false; n];
    for actuator in &robot.parts.actuators {
        let most = actuator.force_range[0].abs().max(actuator.force_range[1].abs());
        match actuator.pull {
            Pull::Joint(joint) => {
                if let JointDrive::Coupled { coordinate, ratio, .. } = robot.coupling.joints[joint] {
                    limits[coordinate] += most * (actuator.gear * ratio).abs();
                    is_driven[coordinate] = true;
                }
            }
            Pull::Tendon(tendon) => {
                for (joint, leverage) in &robot.parts.tendons[tendon].joints {
                    if let JointDrive::Coupled { coordinate, ratio, .. } = robot.coupling.joints[*joint] {
                        limits[coordinate] += most * (actuator.gear * ratio * leverage).abs();
                        is_driven[coordinate] = true;
                    }
                }
            }
            Pull::Other => {}
        }
    }
    for (joint, drive) in robot.parts.joints.iter().zip(&robot.coupling.joints) {
        let JointDrive::Coupled { coordinate, ratio, .. } = *drive else { continue };
        let most = joint.force_range[0].abs().max(joint.force_range[1].abs());
        if most.is_finite() && is_driven[coordinate] {
            limits[coordinate] = limits[coordinate].min(most / ratio.abs().max(1e-9));
        }
    }
    // A coordinate without an actuator in the model has a real drive of unknown strength.
    limits.iter().zip(is_driven).map(|(limit, is_driven)| if is_driven { *limit } else { f64::INFINITY }).collect()
}
