//! The way to a pose: no faster than the joints may, and through no link.

use super::robot::Robot;
use super::robot::coupling::Driven;
use super::{Retargeter, Way};
use crate::error::Result;
use crate::mujoco::parts::Motion;

/// Longest time between two frames that the velocity limit gives room for, s.
const LONGEST_STEP: f64 = 0.5;
/// Time that the velocity limit takes to have passed before the first good frame, s.
const FIRST_STEP: f64 = 1.0 / 60.0;
/// A slide's velocity limit in m/s over a hinge's in rad/s.
const SLIDE_SHARE: f64 = 0.1;
/// A way to another pose is looked at in so many steps; links may be no deeper in each other there, m.
const WAY: u32 = 12;
const DEEP: f64 = 5e-4;
/// Share of a way that is worth going where all of it would bring links into each other.
const SHORTEST_SHARE: f64 = 0.1;

/// A pose that links are looked at in.
#[derive(Debug, Clone, Copy)]
enum Pose {
    /// The one given out last.
    Last,
    /// One on the way from it.
    Between,
}

impl Retargeter {
    /// Whether no link runs into another on the way from the present pose to `other`, which may be far from it.
    pub(super) fn way_is_free(&mut self) -> bool {
        if !self.gave_out {
            return true;
        }
        for step in 1..WAY {
            let share = f64::from(step) / f64::from(WAY);
            for (k, position) in self.between.iter_mut().enumerate() {
                *position = self.u[k] + share * (self.other[k] - self.u[k]);
            }
            if self.deepest(Pose::Between) > DEEP {
                return false;
            }
        }
        true
    }

    /// Moves towards the pose found as far as the joints' speeds allow and no link runs into another; whether all of the
    /// way was possible.
    pub(super) fn limit(&mut self, time: f64, way: Way) -> Result<bool> {
        if !self.gave_out {
            // Until a pose has been given out there is none to be near to.
            self.u.copy_from_slice(&self.next);
            return Ok(false);
        }
        // Since a pose was last given out, a held one too.
        let dt = self.given_at.map_or(FIRST_STEP, |given| (time - given).clamp(0.0, LONGEST_STEP));
        let mut limited = false;
        for (k, u) in self.u.iter().enumerate() {
            let most = self.speed[k] * dt;
            let change = self.next[k] - u;
            limited |= change.abs() > most;
            let (low, high) = (self.robot.coupling.low[k], self.robot.coupling.high[k]);
            self.reach[k] = most;
            self.between[k] = (u + change.clamp(-most, most)).clamp(low, high);
        }
        if limited && way == Way::Near {
            // Each joint as near as it can come to the pose found is not the best pose within reach.
            self.solver.narrow(&self.u, &self.reach);
            let stop = self.options.stop;
            let solved = self.goal.solve(&mut self.solver, &mut self.robot, stop, f64::INFINITY, &mut self.between);
            self.solver.widen();
            solved?;
        }
        // Halve the way until it is free; where it began, it was, or else it must lead out.
        let mut depth = self.deepest(Pose::Between);
        if depth > DEEP {
            limited = true;
            let allowed = self.deepest(Pose::Last).max(DEEP);
            let mut share = 1.0;
            while depth > allowed {
                share *= 0.5;
                if share < SHORTEST_SHARE {
                    return Ok(true);
                }
                for (k, position) in self.between.iter_mut().enumerate() {
                    *position = 0.5 * (*position + self.u[k]);
                }
                depth = self.deepest(Pose::Between);
            }
        }
        self.u.copy_from_slice(&self.between);
        Ok(limited)
    }

    /// How deep links are in each other in a pose, m.
    fn deepest(&mut self, pose: Pose) -> f64 {
        let Robot { world, parts, coupling, .. } = &mut self.robot;
        let u = match pose {
            Pose::Last => &self.u,
            Pose::Between => &self.between,
        };
        coupling.expand(parts, u, world.qpos_mut());
        world.update_poses();
        self.goal.deepest(&mut self.robot)
    }
}

/// Most change of each free coordinate per second.
pub(super) fn speeds(robot: &Robot) -> Vec<f64> {
    let mut speed = vec![f64::INFINITY; robot.coupling.len()];
    for (joint, driven) in robot.parts.joints.iter().zip(&robot.coupling.joints) {
        let Driven::By { coordinate, ratio, .. } = *driven else { continue };
        let share = if joint.motion == Motion::Slide { SLIDE_SHARE } else { 1.0 };
        speed[coordinate] = speed[coordinate].min(share * robot.spec.limits.velocity / ratio.abs());
    }
    speed
}
