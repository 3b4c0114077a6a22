//! Time and accuracy of retargeting: objective, limits, touch, jitter, beside other programs.

pub mod dex;
pub mod follow;
pub mod grip;
pub mod objective;
pub mod peer;
pub mod plot;
pub mod table;
pub mod trajectory;

use egotac::error::Result;
use egotac::machine::Machine;
use egotac::retarget::Robot;
use egotac::retarget::robot::spec::PairSelection;
use egotac::retarget::solver::Stop;
use serde::{Deserialize, Serialize};

use self::follow::{Followed, follow, jerk, lag};
use self::grip::{Grips, Hold};
use self::objective::{Setup, Smoothness, Solved, smoothness, solve, vectors};
use self::trajectory::{Noise, Trajectory};

/// Frames for which the best objective is searched.
const COMPARED: usize = 2000;
/// Objects that are gripped.
const GRIPS: usize = 100;
/// Frames of a measurement of one choice.
const COST_FRAMES: usize = 2000;
/// Times that each choice is measured, in turn with the others of its robot: other load of the machine comes and goes.
pub const COST_ROUNDS: usize = 5;

/// Settings of a measurement.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The command that measures the same again.
    pub command: String,
    /// Robots: names, YAML files or models.
    pub robots: Vec<String>,
    /// Frames of the trajectory.
    pub frames: usize,
    /// Seed of the trajectory and its noise.
    pub seed: u64,
    /// Commands that run peers.
    pub peers: Vec<String>,
    /// Other load of the machine, in words.
    pub load: Option<String>,
}

/// Results of a measurement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RetargetReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of the program.
    pub version: String,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// Other load of the machine, in words.
    pub load: Option<String>,
    /// Frames per run.
    pub frames: usize,
    /// Seed.
    pub seed: u64,
    /// Results on the peers' objective.
    pub objectives: Vec<Objective>,
    /// Results of whole retargeters.
    pub robots: Vec<Row>,
    /// Time and accuracy of single choices.
    pub costs: Vec<Cost>,
    /// Grips in simulation.
    pub grips: Grips,
}

/// Results on the peers' objective for one robot and input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Objective {
    /// Robot and links.
    pub setup: Setup,
    /// Noise on the keypoints, mm.
    pub noise_mm: f64,
    /// Results of our solver.
    pub ours: Solved,
    /// Jerk of our joints.
    #[serde(rename = "calm")]
    pub smoothness: Smoothness,
    /// Peers on the same vectors.
    pub peers: Vec<peer::Timing>,
}

/// Results of one robot that followed one input, with touch, collisions and smoothing on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the robot.
    pub robot: String,
    /// Kind of noise on the keypoints.
    pub input: String,
    /// Measurements along the way.
    pub seen: Followed,
    /// Delay behind the unsmoothed run, s.
    pub lag_secs: f64,
    /// Jerk of the unsmoothed run on clean input, rad/s³: that of the motion itself.
    pub own_jerk: f64,
    /// Root mean square deviation of the joints from the run on clean input, rad.
    pub deviation: f64,
}

/// Time and accuracy of one choice.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Name of the robot.
    pub robot: String,
    /// The choice.
    pub choice: String,
    /// Time per frame, median, the least of [`COST_ROUNDS`] rounds, microseconds.
    pub median_us: f64,
    /// Objective over the best known, 99.9th percentile; NaN if the objective is another one.
    pub ratio_p999: f64,
    /// Mean distance of fingertips from their targets, mm; NaN if not measured.
    pub tip_error_mm: f64,
}

/// Returns the robots that peers know, with links and scales fitted to the models.
fn setups() -> Vec<Setup> {
    let setup = |robot: &str, wrist: &str, tips: &[&str], scale| Setup {
        robot: robot.into(),
        wrist: wrist.into(),
        tips: tips.iter().map(|tip| (*tip).to_owned()).collect(),
        scale,
    };
    vec![
        setup("allegro_urdf_right", "wrist", &["link_15.0_tip", "link_3.0_tip", "link_7.0_tip", "link_11.0_tip"], 1.26),
        setup(
            "leap_urdf_right",
            "base",
            &["thumb_tip_head", "index_tip_head", "middle_tip_head", "ring_tip_head"],
            1.19,
        ),
        setup("shadow_urdf_right", "palm", &["thtip", "fftip", "mftip", "rftip", "lftip"], 1.01),
    ]
}

/// A trajectory with noise of some kind.
struct NoisyInput {
    name: &'static str,
    /// Standard deviation of white noise, mm; NaN for spikes.
    noise_mm: f64,
    trajectory: Trajectory,
}

/// Measures objectives beside the peers, then whole retargeters, then grips; `say` hears what is being measured.
///
/// # Errors
/// If a robot can't be loaded, or a peer fails.
pub fn run(plan: &Plan, mut say: impl FnMut(&str)) -> Result<RetargetReport> {
    let clean = Trajectory::generate(plan.frames, plan.seed)?;
    let noisy = |noise: Noise, seed: u64| clean.with(noise, plan.seed + seed);
    let inputs = [
        NoisyInput { name: "clean", noise_mm: 0.0, trajectory: clean.clone() },
        NoisyInput { name: "2 mm noise", noise_mm: 2.0, trajectory: noisy(Noise::White(0.002), 1) },
        NoisyInput { name: "5 mm noise", noise_mm: 5.0, trajectory: noisy(Noise::White(0.005), 2) },
        NoisyInput { name: "spikes", noise_mm: f64::NAN, trajectory: noisy(Noise::Spikes, 3) },
    ];
    let [_, mild, strong, _] = &inputs;
    let (mut objectives, mut robots, mut costs) = (Vec::new(), Vec::new(), Vec::new());
    for setup in setups().into_iter().filter(|setup| plan.robots.contains(&setup.robot)) {
        objectives.extend(objectives_of(plan, &setup, &inputs[..3], &mut say)?);
        costs.extend(iteration_costs(&setup, &strong.trajectory, &mut say)?);
    }
    for name in &plan.robots {
        robots.extend(followed(name, &inputs, &mut say)?);
        costs.extend(choices(name, &mild.trajectory, &mut say)?);
    }
    say("grips in simulation");
    Ok(RetargetReport {
        command: plan.command.clone(),
        version: egotac::VERSION.to_owned(),
        machine: Machine::this(),
        load: plan.load.clone(),
        frames: plan.frames,
        seed: plan.seed,
        objectives,
        robots,
        costs,
        grips: grip::measure(&clean, GRIPS, Hold::Free)?,
    })
}

/// Solves the peers' objective on each input, and runs the peers on the same vectors.
fn objectives_of(
    plan: &Plan,
    setup: &Setup,
    inputs: &[NoisyInput],
    say: &mut impl FnMut(&str),
) -> Result<Vec<Objective>> {
    let mut robot = bare(setup)?;
    let every = (plan.frames / COMPARED).max(1);
    let mut objectives = Vec::new();
    for NoisyInput { name, noise_mm, trajectory } in inputs {
        say(&format!("{}, objective, {name}", setup.robot));
        let targets = vectors(&robot, setup, trajectory)?;
        let ours = solve(&mut robot, setup, &targets, Stop::default(), every)?;
        let smoothness = smoothness(&mut robot, setup, trajectory, Stop::default())?;
        let mut peers = Vec::new();
        for command in &plan.peers {
            say(&format!("{}, {name}, {command}", setup.robot));
            peers.push(peer::run(command, &mut robot, setup, &targets)?);
        }
        objectives.push(Objective { setup: setup.clone(), noise_mm: *noise_mm, ours, smoothness, peers });
    }
    Ok(objectives)
}

/// Measures what a cap on the solver's steps saves and costs.
fn iteration_costs(setup: &Setup, trajectory: &Trajectory, say: &mut impl FnMut(&str)) -> Result<Vec<Cost>> {
    let mut robot = bare(setup)?;
    let targets = vectors(&robot, setup, trajectory)?;
    let targets = &targets[..targets.len().min(COST_FRAMES)];
    let caps = [1, 2, 3, 4, 6, 10, 30].map(|iterations| Stop { iterations, ..Stop::default() });
    let mut costs = Vec::new();
    for stop in caps {
        let choice = format!("at most {} iterations", stop.iterations);
        say(&format!("{}, {choice}", setup.robot));
        let solved = solve(&mut robot, setup, targets, stop, (targets.len() / 200).max(1))?;
        costs.push(Cost {
            robot: setup.robot.clone(),
            choice,
            median_us: solved.median_us,
            ratio_p999: solved.ratio_p999,
            tip_error_mm: f64::NAN,
        });
    }
    measure_again(&mut costs, |index, _| Ok(solve(&mut robot, setup, targets, caps[index], 0)?.median_us))?;
    Ok(costs)
}

/// Measures choices again, in turn, with a function that returns the median of a choice by its index and name; the least counts.
fn measure_again(costs: &mut [Cost], mut median_us: impl FnMut(usize, &str) -> Result<f64>) -> Result<()> {
    for _ in 1..COST_ROUNDS {
        for (index, cost) in costs.iter_mut().enumerate() {
            cost.median_us = cost.median_us.min(median_us(index, &cost.choice)?);
        }
    }
    Ok(())
}

/// Lets a robot follow each input with everything on. The first input is the clean one.
fn followed(name: &str, inputs: &[NoisyInput], say: &mut impl FnMut(&str)) -> Result<Vec<Row>> {
    let load = || Robot::load(name, None);
    let mut unsmoothed = load()?;
    unsmoothed.spec.filter.time_constant = 0.0;
    say(&format!("{name}, unsmoothed"));
    let unsmoothed = follow(unsmoothed, &inputs[0].trajectory, true)?;
    let mut clean: Vec<Vec<f64>> = Vec::new();
    let mut rows = Vec::new();
    for NoisyInput { name: input, trajectory, .. } in inputs {
        say(&format!("{name}, {input}"));
        let seen = follow(load()?, trajectory, true)?;
        if clean.is_empty() {
            clean.clone_from(&seen.qpos);
        }
        rows.push(Row {
            robot: name.to_owned(),
            input: (*input).to_owned(),
            lag_secs: lag(&unsmoothed.qpos, &seen.qpos),
            own_jerk: jerk(&unsmoothed.qpos),
            deviation: deviation(&seen.qpos, &clean),
            seen,
        });
    }
    Ok(rows)
}

/// Loads the robot as peers load it: its model without our description.
fn bare(setup: &Setup) -> Result<Robot> {
    let known = Robot::load(&setup.robot, None)?;
    Robot::load(&known.origin, None)
}

/// Measures whole retargeters with one part switched off.
fn choices(name: &str, trajectory: &Trajectory, say: &mut impl FnMut(&str)) -> Result<Vec<Cost>> {
    let count = trajectory.keypoints.len().min(COST_FRAMES);
    let short = Trajectory {
        keypoints: trajectory.keypoints[..count].to_vec(),
        tip_contact: trajectory.tip_contact[..count].to_vec(),
        tip_force: trajectory.tip_force[..count].to_vec(),
    };
    let measured = |choice: &str| -> Result<Followed> {
        let mut robot = Robot::load(name, None)?;
        let tips_alone = choice == "tips alone";
        if tips_alone || choice == "without collisions" {
            robot.spec.collision.pairs = PairSelection::None;
            robot.collision_pairs.clear();
        }
        if tips_alone || choice == "without posture" {
            robot.spec.weights.posture = 1e-3;
        }
        let with_touch = !tips_alone && choice != "without touch";
        if tips_alone {
            robot.spec.weights.pinch = 0.0;
        }
        follow(robot, &short, with_touch)
    };
    let mut costs = Vec::new();
    for choice in ["everything", "without touch", "without collisions", "without posture", "tips alone"] {
        say(&format!("{name}, {choice}"));
        let seen = measured(choice)?;
        costs.push(Cost {
            robot: name.to_owned(),
            choice: choice.to_owned(),
            median_us: seen.median_us,
            ratio_p999: f64::NAN,
            tip_error_mm: seen.tip_error_mm,
        });
    }
    measure_again(&mut costs, |_, choice| Ok(measured(choice)?.median_us))?;
    Ok(costs)
}

/// Computes the root mean square difference of two runs over frames and joints, rad.
fn deviation(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let squares = a.iter().zip(b).flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)));
    let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
    f64::sqrt(sum / f64::max(count, 1.0))
}
