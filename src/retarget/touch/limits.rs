//! How much torque a robot's joints bear.

use crate::mujoco::parts::Pull;
use crate::retarget::robot::Robot;
use crate::retarget::robot::coupling::Driven;

/// Most torque of each free coordinate by the actuators that pull at it, in the rest pose.
pub fn of(robot: &Robot) -> Vec<f64> {
    let n = robot.coupling.len();
    let mut limits = vec![0.0; n];
    let mut pulled = vec![false; n];
    for actuator in &robot.parts.actuators {
        let most = actuator.force_range[0].abs().max(actuator.force_range[1].abs());
        match actuator.pull {
            Pull::Joint(joint) => {
                if let Driven::By { coordinate, ratio, .. } = robot.coupling.joints[joint] {
                    limits[coordinate] += most * (actuator.gear * ratio).abs();
                    pulled[coordinate] = true;
                }
            }
            Pull::Tendon(tendon) => {
                for (joint, leverage) in &robot.parts.tendons[tendon].joints {
                    if let Driven::By { coordinate, ratio, .. } = robot.coupling.joints[*joint] {
                        limits[coordinate] += most * (actuator.gear * ratio * leverage).abs();
                        pulled[coordinate] = true;
                    }
                }
            }
            Pull::Other => {}
        }
    }
    for (joint, driven) in robot.parts.joints.iter().zip(&robot.coupling.joints) {
        let Driven::By { coordinate, ratio, .. } = *driven else { continue };
        let most = joint.force_range[0].abs().max(joint.force_range[1].abs());
        if most.is_finite() && pulled[coordinate] {
            limits[coordinate] = limits[coordinate].min(most / ratio.abs().max(1e-9));
        }
    }
    // What no actuator of the model pulls at is driven by something unknown.
    limits.iter().zip(pulled).map(|(limit, pulled)| if pulled { *limit } else { f64::INFINITY }).collect()
}
