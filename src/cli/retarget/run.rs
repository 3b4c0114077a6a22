//! `egotac retarget run`.

use std::collections::BTreeMap;
use std::process::ExitCode;

use anyhow::{Context, bail, ensure};

use super::Run;
use crate::cli::options::Time;
use crate::hand::{HandModel, Side, Topology};
use crate::mujoco::object::Shapes;
use crate::retarget::file::{HandRecording, RobotTrajectory};
use crate::retarget::{Options, Retargeter, Robot, Status, TouchPooling};
use crate::statistics::percentile;
use crate::text::tell;

/// Frame rate of recordings without timestamps, Hz.
const DEFAULT_RATE: f64 = 30.0;
/// Number of bad frames that are reported one by one; the rest is counted.
const MAX_REPORTED: usize = 10;
/// Greatest value of `--smooth`, s, as in a robot's file.
const MAX_SMOOTH_SECS: f64 = 2.0;

/// Runs the command.
///
/// # Errors
/// If the robot or a file can't be used, or no frame is a hand.
pub fn run(args: &Run) -> anyhow::Result<ExitCode> {
    let object = args.object.as_deref().map(Shapes::read).transpose()?;
    let mut robot = Robot::load_with_object(&args.robot, args.model.as_deref(), object.as_ref())?;
    if let Some(Time(delay)) = args.smooth {
        ensure!(delay <= MAX_SMOOTH_SECS, "--smooth: expected at most {MAX_SMOOTH_SECS} s, got {delay}");
        robot.spec.filter.time_constant = delay;
    }
    let files = args.hands.files()?;
    let requested = args.side.as_deref().map(|side| if side == "left" { Side::Left } else { Side::Right });
    let side_of = |recorded: Option<Side>| requested.or(recorded).unwrap_or(robot.side());
    let model = |topology: Option<Topology>, side: Option<Side>| -> crate::Result<HandModel> {
        match (&files, topology) {
            (Some(files), _) => Ok(files[side_of(side) as usize].clone()),
            (None, Some(Topology::Mano)) => {
                Err(crate::Error::value("topology mano", "--mano-left and --mano-right beside it", "no MANO files"))
            }
            (None, _) => Ok(HandModel::builtin(side_of(side))),
        }
    };
    let hands = HandRecording::read(&args.input, model)?;
    let has_poses = hands.object_pose.iter().any(Option::is_some);
    if object.is_some() != has_poses {
        let (given, missing) = if has_poses { ("object_pose", "--object") } else { ("--object", "object_pose") };
        bail!("{}: {given} without {missing}: give both the object's shape and its poses", args.input.display());
    }
    let side = side_of(hands.side);
    let pooling = match hands.force.is_empty() && hands.contact.is_empty() {
        true => None,
        false => Some(TouchPooling::new(&model(hands.topology, Some(side))?)?),
    };
    let options = Options { side: Some(side), ..Options::default() };
    let mut retargeter = Retargeter::with_options(robot, options)?;
    let trajectory = follow(args, &hands, side, pooling.as_ref(), &mut retargeter)?;
    let metadata = BTreeMap::from([
        ("robot".to_owned(), retargeter.robot().spec.robot.clone()),
        ("model".to_owned(), retargeter.robot().origin.clone()),
        ("side".to_owned(), side.name().to_owned()),
        ("tip_force_frame".to_owned(), "that of the keypoints".to_owned()),
    ]);
    trajectory.write(&args.out, metadata).context("output")?;
    println!("{}: {}", args.out.display(), summary(&trajectory));
    Ok(ExitCode::SUCCESS)
}

/// Follows all frames of a recording; reports bad frames on standard error.
fn follow(
    args: &Run,
    hands: &HandRecording,
    side: Side,
    pooling: Option<&TouchPooling>,
    retargeter: &mut Retargeter,
) -> anyhow::Result<RobotTrajectory> {
    let sign = if hands.forces_point_out(side) { -1.0 } else { 1.0 };
    let dt = 1.0 / args.fps.unwrap_or(DEFAULT_RATE);
    let mut trajectory = RobotTrajectory::of(retargeter);
    let mut held = 0;
    for frame in 0..hands.len() {
        let result = match hands.input(frame, dt, side, pooling, sign) {
            Ok(input) => retargeter.push(&input).map(|_| ()),
            Err(error) => {
                retargeter.hold(hands.time(frame, dt));
                Err(error)
            }
        };
        if let Err(error) = result {
            held += 1;
            if held <= MAX_REPORTED {
                tell(format_args!("egotac: frame {frame}: {error}; the last good pose is held"));
            }
        }
        trajectory.push(retargeter.output(), sign);
    }
    if held > MAX_REPORTED {
        tell(format_args!("egotac: {} more frames were bad", held - MAX_REPORTED));
    }
    ensure!(held < hands.len() || held == 0, "{}: no frame is a hand", args.input.display());
    Ok(trajectory)
}

fn summary(trajectory: &RobotTrajectory) -> String {
    let time_us = |q: f64| percentile(trajectory.times_us().iter().copied().map(f64::from), q);
    format!(
        "{} frames, {} held, {} repaired; {:.0} us per frame (median), {:.0} us (p99)",
        trajectory.times_us().len(),
        trajectory.count(Status::Held),
        trajectory.count(Status::Repaired),
        time_us(0.5),
        time_us(0.99),
    )
}
