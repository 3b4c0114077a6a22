//! Solve of a goal, with no link in another.
//!
//! Distances of geoms take most of the time of a cost evaluation, so only pairs that are near at the start of a solve are
//! terms of the cost. After the solve all pairs are checked; if one penetrates, it becomes a term and the solve is repeated.

use super::{CollisionTerm, Goal};
use crate::error::Result;
use crate::retarget::robot::Robot;
use crate::retarget::solver::{Solved, Stop};

/// Weight of the distance of links that penetrate or are nearer than their margin, 1/m^2 of a fingertip's error.
const COLLISION_WEIGHT: f64 = 1000.0;
/// Distance at the start of a solve below which a pair of links is a term of the cost, m.
const WATCH_DISTANCE: f64 = 0.012;
/// Repeated solves after links were found to penetrate.
const MAX_REPEATS: usize = 3;
/// Distance up to which penetration is measured exactly, m.
const DEPTH_RANGE: f64 = 1e-3;

impl Goal {
    /// Finds the pose with the least cost from `u`, without penetration.
    ///
    /// Penetration is not checked if the cost is at least `max_cost`: then the pose is of no use to the caller.
    ///
    /// # Errors
    /// If a target is not finite.
    pub fn solve(&mut self, robot: &mut Robot, stop: Stop, max_cost: f64, u: &mut [f64]) -> Result<Solved> {
        let first = self.first_collision;
        self.problem.active.retain(|gap| *gap < first);
        self.problem.gaps[first..].iter_mut().for_each(|gap| gap.weight = 0.0);
        if !self.collisions.is_empty() {
            robot.set_pose(u);
            self.watch_pairs(robot, WATCH_DISTANCE);
        }
        self.start.copy_from_slice(u);
        let mut solved = self.solve_active(robot, stop, u)?;
        for _ in 0..MAX_REPEATS {
            // A pair added to the cost only raises it, so a useless pose stays useless.
            if solved.cost >= max_cost || self.watch_pairs(robot, 0.0) == 0 {
                break;
            }
            // From within a link the shortest way out may lead through it: start again from outside.
            u.copy_from_slice(&self.start);
            let repeated = self.solve_active(robot, stop, u)?;
            solved = Solved { iterations: solved.iterations + repeated.iterations, ..repeated };
        }
        Ok(solved)
    }

    /// Solves as [`Self::solve`], with each free coordinate within `reach` of `centre`.
    ///
    /// # Errors
    /// As [`Self::solve`].
    pub fn solve_within(
        &mut self,
        robot: &mut Robot,
        stop: Stop,
        [centre, reach]: [&[f64]; 2],
        u: &mut [f64],
    ) -> Result<Solved> {
        self.solver.narrow(centre, reach);
        let solved = self.solve(robot, stop, f64::INFINITY, u);
        self.solver.widen();
        solved
    }

    /// Finds a start for [`Self::solve`]: the best pose if links could penetrate each other and no fingertips touched.
    ///
    /// # Errors
    /// As [`Self::solve`].
    pub fn solve_without_gaps(&mut self, robot: &mut Robot, stop: Stop, u: &mut [f64]) -> Result<()> {
        let active = std::mem::take(&mut self.problem.active);
        let solved = self.solve_active(robot, stop, u);
        self.problem.active = active;
        solved.map(|_| ())
    }

    fn solve_active(&mut self, robot: &mut Robot, stop: Stop, u: &mut [f64]) -> Result<Solved> {
        let Robot { world, parts, coupling, .. } = robot;
        self.solver.solve(&mut self.problem, world, parts, coupling, stop, u)
    }

    /// Makes terms of the pairs nearer than `distance`, or than their margin, in the robot's present pose; returns how many
    /// were added.
    fn watch_pairs(&mut self, robot: &mut Robot, distance: f64) -> usize {
        let mut added = 0;
        for (centre, geom) in self.centres.iter_mut().zip(0..) {
            *centre = robot.world.geom_place(geom);
        }
        for CollisionTerm { gap, geoms: [a, b], radii } in self.collisions.iter().copied() {
            let reach = radii + distance;
            let is_far = self.centres[a].distance_squared(self.centres[b]) > reach * reach;
            if is_far || self.problem.gaps[gap].weight > 0.0 {
                continue;
            }
            let limit = distance.max(self.problem.gaps[gap].target);
            if robot.world.geom_distance([a, b], limit).0 < limit {
                self.problem.weigh(gap, COLLISION_WEIGHT);
                added += 1;
            }
        }
        added
    }

    /// Greatest penetration of links that must not penetrate each other in the robot's present pose, m; negative = none.
    pub fn deepest(&self, robot: &mut Robot) -> f64 {
        let mut deepest = f64::NEG_INFINITY;
        for CollisionTerm { geoms: [a, b], radii, .. } in self.collisions.iter().copied() {
            if robot.world.geom_place(a).distance(robot.world.geom_place(b)) < radii {
                deepest = deepest.max(-robot.world.geom_distance([a, b], DEPTH_RANGE).0);
            }
        }
        deepest
    }
}
