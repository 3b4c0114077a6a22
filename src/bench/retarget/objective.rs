//! A peer's objective, solved by our solver: time, and how near the best known optimum it ends.

use glam::DVec3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::follow::{jerk, lag, percentile};
use super::trajectory::{RATE, Trajectory};
use crate::bench::sim::clock::Stopwatch;
use crate::error::Result;
use crate::hand::Side;
use crate::retarget::Robot;
use crate::retarget::filter::Smoother;
use crate::retarget::human::{Hand, keypoint};
use crate::retarget::peer::{Kind, Peer};
use crate::retarget::robot::lookup::joint;
use crate::retarget::solver::Stop;

/// Delay of slow motion at which jerk is compared, s: with it the joints, measured, lag by 50 ms.
const LAG: f64 = 0.039;
/// Other starts that the best known optimum is looked for from.
const STARTS: usize = 8;

/// What peers are told of a robot.
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

/// How the objective was solved.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Solved {
    /// Processor time per frame, median, microseconds.
    pub median_us: f64,
    /// Time per frame that 99 of 100 frames keep, microseconds.
    pub p99_us: f64,
    /// Steps of the solver, mean.
    pub iterations: f64,
    /// Share of the frames looked at that end within 1.001 of the best known objective.
    pub within: f64,
    /// Objective over the best known, in 999 of 1000 frames at most.
    pub ratio_p999: f64,
    /// Frames for which the optimum was looked for.
    pub compared: usize,
}

/// How calm the joints are.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Calm {
    /// Jerk without smoothing, rad/s³.
    pub jerk: f64,
    /// Jerk behind the retargeter's filter with a lag of 50 ms, rad/s³.
    pub jerk_50ms: f64,
    /// What the filter delays by, measured, s.
    pub lag_secs: f64,
}

/// Wrist-to-tip vectors of a trajectory in the robot's frame, (T, fingers), m, as the human has them.
pub fn vectors(robot: &Robot, setup: &Setup, trajectory: &Trajectory) -> Result<Vec<Vec<DVec3>>> {
    smooth_vectors(robot, setup, trajectory, 0.0)
}

/// As [`vectors`], of keypoints smoothed with a delay, s.
fn smooth_vectors(robot: &Robot, setup: &Setup, trajectory: &Trajectory, delay: f64) -> Result<Vec<Vec<DVec3>>> {
    let axes = robot.wrist.world_axes(&robot.world);
    let mut smoother = Smoother::new(delay);
    let one = |keypoints| -> Result<Vec<DVec3>> {
        let points = smoother.push(&Hand::new(keypoints, Side::Right)?.points, 1.0 / RATE);
        Ok((0..setup.tips.len()).map(|finger| axes * points[keypoint(finger, 3)]).collect())
    };
    trajectory.keypoints.iter().map(one).collect()
}

/// How calm the joints are: jerk as solved, jerk with the keypoints smoothed as the retargeter does, and the lag of that.
///
/// # Errors
/// If a link is not in the model.
pub fn calm(robot: &mut Robot, setup: &Setup, trajectory: &Trajectory, stop: Stop) -> Result<Calm> {
    let raw = smoothed(robot, setup, trajectory, stop, 0.0)?;
    let smooth = smoothed(robot, setup, trajectory, stop, LAG)?;
    Ok(Calm { jerk: jerk(&raw), jerk_50ms: jerk(&smooth), lag_secs: lag(&raw, &smooth) })
}

/// Joint positions, frame by frame, with the keypoints smoothed by a filter of this delay, s.
fn smoothed(
    robot: &mut Robot,
    setup: &Setup,
    trajectory: &Trajectory,
    stop: Stop,
    delay: f64,
) -> Result<Vec<Vec<f64>>> {
    let tips: Vec<&str> = setup.tips.iter().map(String::as_str).collect();
    let mut peer = Peer::new(robot, Kind::Vector, &setup.wrist, &tips, setup.scale)?;
    let mut qpos = Vec::with_capacity(trajectory.keypoints.len());
    for targets in smooth_vectors(robot, setup, trajectory, delay)? {
        peer.aim(&targets);
        peer.solve(robot, stop)?;
        qpos.push(robot.world.qpos().to_vec());
    }
    Ok(qpos)
}

/// Another program's objective, over ours from the same last pose.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// Median.
    pub median: f64,
    /// Of 99 of 100 frames at most.
    pub p99: f64,
    /// Share of frames in which theirs is at most 1.001 of ours.
    pub within: f64,
    /// Share of frames in which ours is at most 1.001 of theirs.
    pub ours_within: f64,
}

/// Compares another program's poses, of joints with these names, with the ones we find from its last pose.
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
    let mut peer = Peer::new(robot, Kind::Vector, &setup.wrist, &tips, setup.scale)?;
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
    let still = Stop { iterations: 0, ..Stop::default() };
    let mut ratios = Vec::with_capacity(poses.len());
    for (targets, poses) in vectors[1.min(vectors.len())..].iter().zip(poses.windows(2)) {
        peer.u = free(robot, &poses[0]);
        peer.aim(targets);
        let theirs = peer.solve_from(robot, still, &mut free(robot, &poses[1]))?.cost;
        let mut ours = peer.u.clone();
        let ours = peer.solve_from(robot, Stop::default(), &mut ours)?.cost;
        ratios.push(theirs / ours);
    }
    let share =
        |fits: fn(f64) -> bool| ratios.iter().filter(|ratio| fits(**ratio)).count() as f64 / ratios.len().max(1) as f64;
    Ok(Compared {
        median: percentile(&ratios, 0.5),
        p99: percentile(&ratios, 0.99),
        within: share(|ratio| ratio <= 1.001),
        ours_within: share(|ratio| ratio >= 1.0 / 1.001),
    })
}

/// Solves frame after frame; every `every`-th is compared with a multi-start from the same last pose.
///
/// # Errors
/// If a link is not in the model.
pub fn solve(robot: &mut Robot, setup: &Setup, vectors: &[Vec<DVec3>], stop: Stop, every: usize) -> Result<Solved> {
    let tips: Vec<&str> = setup.tips.iter().map(String::as_str).collect();
    let mut peer = Peer::new(robot, Kind::Vector, &setup.wrist, &tips, setup.scale)?;
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut times = Vec::with_capacity(vectors.len());
    let mut ratios = Vec::new();
    let mut iterations = 0;
    for (frame, targets) in vectors.iter().enumerate() {
        let last = peer.u.clone();
        let began = Stopwatch::start();
        peer.aim(targets);
        let ours = peer.solve(robot, stop)?;
        times.push(1e6 * began.seconds());
        iterations += ours.iterations;
        if every > 0 && frame % every == every - 1 {
            let mut best = ours.cost;
            let thorough = Stop { iterations: 200, tolerance: 1e-9 };
            let mut starts = vec![last.clone(), peer.u.clone()];
            for _ in 0..STARTS {
                let near = |k: usize| {
                    let (low, high) = (robot.coupling.low[k], robot.coupling.high[k]);
                    (low, high)
                };
                starts.push((0..last.len()).map(near).map(|(low, high)| rng.random_range(low..=high)).collect());
            }
            for start in &mut starts {
                best = best.min(peer.solve_from(robot, thorough, start)?.cost);
            }
            ratios.push(ours.cost / best);
        }
    }
    let within = ratios.iter().filter(|ratio| **ratio <= 1.001).count() as f64 / ratios.len().max(1) as f64;
    Ok(Solved {
        median_us: percentile(&times, 0.5),
        p99_us: percentile(&times, 0.99),
        iterations: iterations as f64 / vectors.len().max(1) as f64,
        within,
        ratio_p999: percentile(&ratios, 0.999),
        compared: ratios.len(),
    })
}
