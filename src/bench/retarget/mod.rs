//! What retargeting costs and how exact it is: time, objective, limits, touch, jitter, beside other programs.

pub mod follow;
pub mod grip;
pub mod objective;
pub mod peer;
pub mod plot;
pub mod table;
pub mod trajectory;

use serde::{Deserialize, Serialize};

use self::follow::{Followed, follow, jerk, lag};
use self::grip::{Grips, Hold};
use self::objective::{Calm, Setup, Solved, calm, solve, vectors};
use self::trajectory::{Noise, Trajectory};
use crate::bench::Machine;
use crate::error::Result;
use crate::retarget::Robot;
use crate::retarget::robot::spec::PairSelection;
use crate::retarget::solver::Stop;

/// Frames for which the best objective is looked for.
const COMPARED: usize = 2000;
/// Objects that are gripped.
const GRIPS: usize = 100;

/// What to measure.
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
    /// What else the machine did, if anybody says so.
    pub load: Option<String>,
}

/// All that was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The command.
    pub command: String,
    /// Version of the program.
    pub version: String,
    /// The machine.
    pub machine: Machine,
    /// What else it did.
    pub load: Option<String>,
    /// Frames per run.
    pub frames: usize,
    /// Seed.
    pub seed: u64,
    /// Objectives of peers, solved.
    pub objectives: Vec<Objective>,
    /// Robots that followed with everything on.
    pub robots: Vec<Row>,
    /// Time against exactness.
    pub costs: Vec<Cost>,
    /// Balls gripped in simulation.
    pub grips: Grips,
}

/// A peer's objective on one robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Objective {
    /// Robot and links.
    pub setup: Setup,
    /// Noise on the keypoints, mm.
    pub noise_mm: f64,
    /// Ours.
    pub ours: Solved,
    /// How calm ours is.
    pub calm: Calm,
    /// Peers on the same vectors.
    pub peers: Vec<peer::Timing>,
}

/// A robot that followed with everything on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the robot.
    pub robot: String,
    /// What was done to the keypoints.
    pub input: String,
    /// What was seen.
    pub seen: Followed,
    /// Delay behind the unsmoothed run, s.
    pub lag_secs: f64,
    /// Jerk of the unsmoothed run on clean input, rad/s³: the motion's own.
    pub own_jerk: f64,
    /// Deviation of the joints from the clean run, root mean square, rad.
    pub deviation: f64,
}

/// What a choice costs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Name of the robot.
    pub robot: String,
    /// The choice.
    pub choice: String,
    /// Time per frame, median, microseconds.
    pub median_us: f64,
    /// Objective over the best known, in 999 of 1000 frames at most; NaN where it is another objective.
    pub ratio_p999: f64,
    /// Fingertips' distance from their targets, mean, mm; NaN where not measured.
    pub tip_error_mm: f64,
}

/// Links by which peers' objectives are set up, with scales fitted to the models.
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

/// Measures.
///
/// # Errors
/// If a robot can't be loaded, or the peer fails.
pub fn run(plan: &Plan, mut say: impl FnMut(&str)) -> Result<Report> {
    let clean = Trajectory::generate(plan.frames, plan.seed)?;
    let inputs = [
        ("clean", 0.0, clean.clone()),
        ("2 mm noise", 2.0, clean.with(Noise::White(0.002), plan.seed + 1)),
        ("5 mm noise", 5.0, clean.with(Noise::White(0.005), plan.seed + 2)),
        ("spikes", f64::NAN, clean.with(Noise::Spikes, plan.seed + 3)),
    ];
    let mut report = Report {
        command: plan.command.clone(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        machine: Machine::this(),
        load: plan.load.clone(),
        frames: plan.frames,
        seed: plan.seed,
        objectives: Vec::new(),
        robots: Vec::new(),
        costs: Vec::new(),
        grips: Grips::default(),
    };
    for setup in setups().into_iter().filter(|setup| plan.robots.contains(&setup.robot)) {
        let mut robot = bare(&setup)?;
        for (name, noise_mm, trajectory) in &inputs[..3] {
            say(&format!("{}, objective, {name}", setup.robot));
            let targets = vectors(&robot, &setup, trajectory)?;
            let every = (plan.frames / COMPARED).max(1);
            let ours = solve(&mut robot, &setup, &targets, Stop::default(), every)?;
            let calm = calm(&mut robot, &setup, trajectory, Stop::default())?;
            let mut peers = Vec::new();
            for command in &plan.peers {
                say(&format!("{}, {name}, {command}", setup.robot));
                peers.push(peer::run(command, &mut robot, &setup, &targets)?);
            }
            report.objectives.push(Objective { setup: setup.clone(), noise_mm: *noise_mm, ours, calm, peers });
        }
        let targets = vectors(&robot, &setup, &inputs[2].2)?;
        let few = &targets[..targets.len().min(2000)];
        for iterations in [1, 2, 3, 4, 6, 10, 30] {
            say(&format!("{}, at most {iterations} iterations", setup.robot));
            let stop = Stop { iterations, ..Stop::default() };
            let solved = solve(&mut robot, &setup, few, stop, (few.len() / 200).max(1))?;
            report.costs.push(Cost {
                robot: setup.robot.clone(),
                choice: format!("at most {iterations} iterations"),
                median_us: solved.median_us,
                ratio_p999: solved.ratio_p999,
                tip_error_mm: f64::NAN,
            });
        }
    }
    for name in &plan.robots {
        let load = || Robot::load(name, None);
        let mut raw = load()?;
        raw.spec.filter.time_constant = 0.0;
        say(&format!("{name}, unsmoothed"));
        let raw = follow(raw, &clean, true)?;
        let mut reference: Vec<Vec<f64>> = Vec::new();
        for (input, _, trajectory) in &inputs {
            say(&format!("{name}, {input}"));
            let seen = follow(load()?, trajectory, true)?;
            if reference.is_empty() {
                reference.clone_from(&seen.qpos);
            }
            report.robots.push(Row {
                robot: name.clone(),
                input: (*input).to_owned(),
                lag_secs: lag(&raw.qpos, &seen.qpos),
                own_jerk: jerk(&raw.qpos),
                deviation: deviation(&seen.qpos, &reference),
                seen,
            });
        }
        report.costs.extend(choices(name, &inputs[1].2, &mut say)?);
    }
    say("grips in simulation");
    report.grips = grip::measure(&clean, GRIPS, Hold::Free)?;
    Ok(report)
}

/// The robot as peers see it: its model alone.
fn bare(setup: &Setup) -> Result<Robot> {
    let known = Robot::load(&setup.robot, None)?;
    Robot::load(&known.origin, None)
}

/// What parts of the whole cost.
fn choices(name: &str, trajectory: &Trajectory, say: &mut impl FnMut(&str)) -> Result<Vec<Cost>> {
    let count = trajectory.keypoints.len().min(2000);
    let short = Trajectory {
        keypoints: trajectory.keypoints[..count].to_vec(),
        tip_contact: trajectory.tip_contact[..count].to_vec(),
        tip_force: trajectory.tip_force[..count].to_vec(),
    };
    let mut costs = Vec::new();
    for choice in ["everything", "without touch", "without collisions", "without posture", "tips alone"] {
        say(&format!("{name}, {choice}"));
        let mut robot = Robot::load(name, None)?;
        let alone = choice == "tips alone";
        if alone || choice == "without collisions" {
            robot.spec.collision.pairs = PairSelection::None;
            robot.collision_pairs.clear();
        }
        if alone || choice == "without posture" {
            robot.spec.weights.posture = 1e-3;
        }
        let with_touch = !alone && choice != "without touch";
        if alone {
            robot.spec.weights.pinch = 0.0;
        }
        let seen = follow(robot, &short, with_touch)?;
        costs.push(Cost {
            robot: name.to_owned(),
            choice: choice.to_owned(),
            median_us: seen.median_us,
            ratio_p999: f64::NAN,
            tip_error_mm: seen.tip_error_mm,
        });
    }
    Ok(costs)
}

fn deviation(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let squares = a.iter().zip(b).flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)));
    let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
    f64::sqrt(sum / f64::max(count, 1.0))
}
