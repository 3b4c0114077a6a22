//! Time of our solver on dex-retargeting's objective, and the distance of its results from the best known optimum.

use egotac::error::Result;
use egotac::hand::Side;
use egotac::retarget::Robot;
use egotac::retarget::filter::Smoother;
use egotac::retarget::human::{Hand, keypoint};
use egotac::retarget::robot::lookup::joint;
use egotac::retarget::solver::Stop;
use egotac::sim::budget::clock::Stopwatch;
use egotac::statistics::{median, percentile};
use glam::DVec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::dex::VectorObjective;
use super::follow::{jerk, lag};
use super::trajectory::{RATE, Trajectory};

/// Delay of the filter behind which jerk is compared, s: with it the joints lag by 50 ms, measured on this trajectory.
const FILTER_DELAY: f64 = 0.039;
/// Random starts of the search for the best optimum, beside the last pose and our result.
const STARTS: usize = 8;

/// Links and scale that define the objective on a robot; peers get the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// Name of the robot.
    pub robot: String,
    /// Link at the wrist.
    pub wrist: String,
    /// Links at the fingertips, thumb first.
    pub tips: Vec<String>,
    /// Robot metres per human metre.
    pub scale: f64,
}

/// Time and results of our solver.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Solved {
    /// Processor time per frame, median, microseconds.
    pub median_us: f64,
    /// Processor time per frame, 99th percentile, microseconds.
    pub p99_us: f64,
    /// Mean steps of the solver per frame.
    pub iterations: f64,
    /// Share of the compared frames that end within 1.001 of the best known objective.
    pub within: f64,
    /// Objective over the best known, 99.9th percentile.
    pub ratio_p999: f64,
    /// Frames for which the best optimum was searched.
    pub compared: usize,
}

/// Jerk of the joints with and without smoothing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Smoothness {
    /// Jerk without smoothing, rad/s³.
    pub jerk: f64,
    /// Jerk behind the retargeter's own filter with a lag of 50 ms, rad/s³.
    pub jerk_50ms: f64,
    /// Lag of the filter, measured on the joints, s.
    pub lag_secs: f64,
}

/// Computes the human's vectors from the wrist to each fingertip, (T, fingers), in the robot's frame, m.
///
/// # Errors
/// If the keypoints are not those of a hand.
pub fn vectors(robot: &Robot, setup: &Setup, trajectory: &Trajectory) -> Result<Vec<Vec<DVec3>>> {
    smooth_vectors(robot, setup, trajectory, 0.0)
}

/// Computes [`vectors`] of keypoints that a filter of this delay smoothed, s.
fn smooth_vectors(robot: &Robot, setup: &Setup, trajectory: &Trajectory, delay: f64) -> Result<Vec<Vec<DVec3>>> {
    let axes = robot.wrist.world_axes(&robot.world);
    let mut smoother = Smoother::new(delay);
    let one = |keypoints| -> Result<Vec<DVec3>> {
        let points = smoother.push(&Hand::new(keypoints, Side::Right)?.points, 1.0 / RATE);
        Ok((0..setup.tips.len()).map(|finger| axes * points[keypoint(finger, 3)]).collect())
    };
    trajectory.keypoints.iter().map(one).collect()
}

/// Measures jerk as solved, jerk with the keypoints smoothed as the retargeter smooths them, and the lag of the latter.
///
/// # Errors
/// If a link is not in the model.
pub fn smoothness(robot: &mut Robot, setup: &Setup, trajectory: &Trajectory, stop: Stop) -> Result<Smoothness> {
    let raw = smoothed(robot, setup, trajectory, stop, 0.0)?;
    let smooth = smoothed(robot, setup, trajectory, stop, FILTER_DELAY)?;
    Ok(Smoothness { jerk: jerk(&raw), jerk_50ms: jerk(&smooth), lag_secs: lag(&raw, &smooth) })
}

/// Solves frame after frame with the keypoints smoothed by a filter of this delay, s; returns the joint positions.
fn smoothed(
    robot: &mut Robot,
    setup: &Setup,
    trajectory: &Trajectory,
    stop: Stop,
    delay: f64,
) -> Result<Vec<Vec<f64>>> {
    let tips: Vec<&str> = setup.tips.iter().map(String::as_str).collect();
    let mut objective = VectorObjective::new(robot, &setup.wrist, &tips, setup.scale)?;
    let mut qpos = Vec::with_capacity(trajectory.keypoints.len());
    for targets in smooth_vectors(robot, setup, trajectory, delay)? {
        objective.set_targets(&targets);
        objective.solve(robot, stop)?;
        qpos.push(robot.world.qpos().to_vec());
    }
    Ok(qpos)
}

/// Ratio of another program's objective to ours from the same last pose.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// Median.
    pub median: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Share of frames in which the other is at most 1.001 of ours.
    pub within: f64,
    /// Share of frames in which ours is at most 1.001 of the other.
    pub ours_within: f64,
}

/// Compares another program's `poses` of the joints `names`, frame by frame, with the pose that we find from its last one.
///
/// # Errors
/// If a joint or link is not in the model, or the poses are not of these joints.
pub fn compare(
    robot: &mut Robot,
    setup: &Setup,
    vectors: &[Vec<DVec3>],
    names: &[String],
    poses: &[Vec<f64>],
) -> Result<Compared> {
    let tips: Vec<&str> = setup.tips.iter().map(String::as_str).collect();
    let mut objective = VectorObjective::new(robot, &setup.wrist, &tips, setup.scale)?;
    let joints = names.iter().map(|name| joint(&robot.parts, name)).collect::<Result<Vec<_>>>()?;
    let free = |robot: &Robot, pose: &[f64]| {
        let mut qpos = robot.world.qpos().to_vec();
        for (joint, position) in joints.iter().zip(pose) {
            qpos[robot.parts.joints[*joint].qpos] = *position;
        }
        let mut u = vec![0.0; robot.coupling.len()];
        robot.coupling.reduce(&robot.parts, &qpos, &mut u);
        u
    };
    let evaluate = Stop { iterations: 0, ..Stop::default() };
    let mut ratios = Vec::with_capacity(poses.len());
    for (targets, poses) in vectors[1.min(vectors.len())..].iter().zip(poses.windows(2)) {
        objective.u = free(robot, &poses[0]);
        objective.set_targets(targets);
        let theirs = objective.solve_from(robot, evaluate, &mut free(robot, &poses[1]))?.cost;
        let mut ours = objective.u.clone();
        let ours = objective.solve_from(robot, Stop::default(), &mut ours)?.cost;
        ratios.push(theirs / ours);
    }
    let share =
        |fits: fn(f64) -> bool| ratios.iter().filter(|ratio| fits(**ratio)).count() as f64 / ratios.len().max(1) as f64;
    Ok(Compared {
        median: median(ratios.iter().copied()),
        p99: percentile(ratios.iter().copied(), 0.99),
        within: share(|ratio| ratio <= 1.001),
        ours_within: share(|ratio| ratio >= 1.0 / 1.001),
    })
}

/// Solves frame after frame; every `every`-th is compared with the best of several starts from the same last pose.
///
/// # Errors
/// If a link is not in the model.
pub fn solve(robot: &mut Robot, setup: &Setup, vectors: &[Vec<DVec3>], stop: Stop, every: usize) -> Result<Solved> {
    let tips: Vec<&str> = setup.tips.iter().map(String::as_str).collect();
    let mut objective = VectorObjective::new(robot, &setup.wrist, &tips, setup.scale)?;
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut times = Vec::with_capacity(vectors.len());
    let mut ratios = Vec::new();
    let mut iterations = 0;
    for (frame, targets) in vectors.iter().enumerate() {
        let last = objective.u.clone();
        let stopwatch = Stopwatch::start();
        objective.set_targets(targets);
        let ours = objective.solve(robot, stop)?;
        times.push(1e6 * stopwatch.seconds());
        iterations += ours.iterations;
        if every > 0 && frame % every == every - 1 {
            let best = best_of_starts(&mut objective, robot, last, &mut rng)?.min(ours.cost);
            ratios.push(ours.cost / best);
        }
    }
    let within = ratios.iter().filter(|ratio| **ratio <= 1.001).count() as f64 / ratios.len().max(1) as f64;
    Ok(Solved {
        median_us: median(times.iter().copied()),
        p99_us: percentile(times, 0.99),
        iterations: iterations as f64 / vectors.len().max(1) as f64,
        within,
        compared: ratios.len(),
        ratio_p999: percentile(ratios, 0.999),
    })
}

/// Returns the least objective from the last pose, our result and [`STARTS`] random poses, with many steps each.
fn best_of_starts(
    objective: &mut VectorObjective,
    robot: &mut Robot,
    last: Vec<f64>,
    rng: &mut ChaCha8Rng,
) -> Result<f64> {
    let thorough = Stop { iterations: 200, tolerance: 1e-9 };
    let count = last.len();
    let mut starts = vec![last, objective.u.clone()];
    for _ in 0..STARTS {
        let random = |k: usize| rng.random_range(robot.coupling.low[k]..=robot.coupling.high[k]);
        starts.push((0..count).map(random).collect());
    }
    let mut best = f64::INFINITY;
    for start in &mut starts {
        best = best.min(objective.solve_from(robot, thorough, start)?.cost);
    }
    Ok(best)
}
