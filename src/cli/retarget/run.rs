//! `egotac retarget run`.

use std::collections::HashMap;
use std::process::ExitCode;

use anyhow::{Context, bail, ensure};

use super::Run;
use crate::hand::{HandModel, Side, Topology};
use crate::mujoco::object::Shapes;
use crate::retarget::file::{Followed, Hands};
use crate::retarget::{Options, Pool, Retargeter, Robot, Status};
use crate::statistics::percentile;

/// Frames per second of hands that say nothing of time.
const RATE: f64 = 30.0;
/// Bad frames that are named one by one.
const NAMED: usize = 10;

pub fn run(args: &Run) -> anyhow::Result<ExitCode> {
    let object = args.object.as_deref().map(Shapes::read).transpose()?;
    let mut robot = Robot::load_beside(&args.robot, args.model.as_deref(), object.as_ref())?;
    if let Some(delay) = args.smooth {
        ensure!(delay <= 2.0, "--smooth: expected at most 2 s, got {delay}");
        robot.spec.filter.time_constant = delay;
    }
    let robot_side = robot.side();
    let files = args.hands.files()?;
    let model = |topology: Option<Topology>, side: Option<Side>| -> crate::Result<HandModel> {
        let side = asked_side(args).or(side).unwrap_or(robot_side);
        match (&files, topology) {
            (Some(files), _) => Ok(files[side as usize].clone()),
            (None, Some(Topology::Mano)) => {
                Err(crate::Error::value("topology mano", "--mano-left and --mano-right beside it", "no MANO files"))
            }
            (None, _) => Ok(HandModel::builtin(side)),
        }
    };
    let hands = Hands::read(&args.input, model)?;
    let has_poses = hands.object_pose.iter().any(Option::is_some);
    if object.is_some() != has_poses {
        let (given, missing) = if has_poses { ("object_pose", "--object") } else { ("--object", "object_pose") };
        bail!("{}: {given} without {missing}: an object's shape and its poses belong together", args.input.display());
    }
    let side = asked_side(args).or(hands.side).unwrap_or(robot_side);
    let pool = match hands.force.is_empty() && hands.contact.is_empty() {
        true => None,
        false => Some(Pool::new(&model(hands.topology, Some(side))?)?),
    };
    let sign = if hands.forces_point_out(side) { -1.0 } else { 1.0 };
    let options = Options { side: Some(side), ..Options::default() };
    let mut retargeter = Retargeter::with_options(robot, options)?;
    let mut followed = Followed::by(&retargeter);
    let dt = 1.0 / args.rate.unwrap_or(RATE);
    let mut held = 0;
    for frame in 0..hands.len() {
        let input = hands.input(frame, dt, side, pool.as_ref(), sign);
        let result = match &input {
            Ok(input) => retargeter.push(input).map(|_| ()).map_err(|error| error.to_string()),
            Err(error) => {
                retargeter.hold(hands.time(frame, dt));
                Err(error.to_string())
            }
        };
        if let Err(error) = result {
            held += 1;
            if held <= NAMED {
                eprintln!("egotac: frame {frame}: {error}; the last good pose is held");
            }
        }
        followed.push(retargeter.output(), sign);
    }
    if held > NAMED {
        eprintln!("egotac: {} more frames were bad", held - NAMED);
    }
    if held == hands.len() && held > 0 {
        bail!("{}: no frame is a hand", args.input.display());
    }
    let metadata = HashMap::from([
        ("robot".to_owned(), retargeter.robot().spec.robot.clone()),
        ("model".to_owned(), retargeter.robot().origin.clone()),
        ("side".to_owned(), side.name().to_owned()),
        ("tip_force_frame".to_owned(), "that of the keypoints".to_owned()),
    ]);
    followed.write(&args.out, metadata).context("output")?;
    let time_us = |q: f64| percentile(followed.times_us().iter().copied().map(f64::from), q);
    println!(
        "{}: {} frames, {} held, {} repaired; {:.0} us per frame (median), {:.0} us (p99)",
        args.out.display(),
        hands.len(),
        followed.count(Status::Held),
        followed.count(Status::Repaired),
        time_us(0.5),
        time_us(0.99),
    );
    Ok(ExitCode::SUCCESS)
}

fn asked_side(args: &Run) -> Option<Side> {
    args.side.as_deref().map(|side| if side == "left" { Side::Left } else { Side::Right })
}
