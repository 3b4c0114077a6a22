//! `egotac retarget`: transfer of a human hand's pose and touch to a robot hand.

#[cfg(feature = "sim")]
mod demo;
#[cfg(feature = "sim")]
mod inspect;
#[cfg(feature = "sim")]
mod list;
#[cfg(feature = "sim")]
mod portrait;
#[cfg(feature = "sim")]
mod run;

use std::path::PathBuf;
use std::process::ExitCode;

use super::options::{Json, Time};

/// Arguments of `egotac retarget`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Follow recorded hands with a robot.
    Run(Run),
    /// Print and draw the facts that are derived from a robot's model.
    Inspect(Inspect),
    /// Write a starting YAML file for a model.
    New(New),
    /// List the robots that are part of the program, with their models here or where to get them.
    List(List),
    /// Simulate a grasping hand, follow it with a robot, and draw both with their forces.
    Demo(Demo),
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Input (safetensors): keypoints (T, 21, 3) m, in the order wrist, then thumb, index, middle, ring, \
    little, each from base to tip; or MANO's hand_pose (T, 45), global_orient, transl, betas. Optional: timestamps (T) s, \
    tip_contact (T, 5), tip_force (T, 5, 3) N, force and contact (T, 778) or (T, 1556).\n\
    Output: qpos (T, n) with joint_names in the metadata, ctrl, tip_force (T, 5, 3) in the frame of the keypoints, \
    objective, solve_time_us, status, and the expected touch of each link.\n\
    A frame that is not a hand is reported on standard error; the last good pose is held, and the field `status` is 4."
)]
struct Run {
    /// Robot: a name of `egotac retarget list` or its start, a YAML file, or a model (MJCF or URDF).
    #[arg(long, value_name = "NAME|YAML|MODEL")]
    robot: String,
    /// Model file in place of the one that the robot's YAML file names.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Hands to follow.
    #[arg(long, value_name = "FILE")]
    input: PathBuf,
    /// Object that the hand holds: links stay out of it and touching fingertips lie on it. A model (MJCF, URDF) or mesh (OBJ,
    /// STL; its convex hull counts). The input's `object_pose` holds its poses.
    #[arg(long, value_name = "FILE")]
    object: Option<PathBuf>,
    /// File to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Frame rate of an input without timestamps, 1/s [default: 30].
    #[arg(long, value_name = "F", value_parser = super::positive)]
    fps: Option<f64>,
    /// Side of the recorded hand [default: that of the input's metadata, or else the robot's].
    #[arg(long, value_parser = ["left", "right"])]
    side: Option<String>,
    /// Smoothing delay in place of that of the robot's file, such as 50ms; 0 = no smoothing.
    #[arg(long, value_name = "TIME")]
    smooth: Option<Time>,
    #[command(flatten)]
    hands: super::hands::Hands,
}

#[derive(Debug, clap::Args)]
struct Inspect {
    /// Robot: a name of `egotac retarget list` or its start, a YAML file, or a model (MJCF or URDF).
    #[arg(value_name = "NAME|YAML|MODEL")]
    robot: String,
    /// Model file in place of the one that the robot's YAML file names.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// PNG file to draw: the robot at rest and half closed.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    json: Json,
}

#[derive(Debug, clap::Args)]
struct New {
    /// Model (MJCF or URDF).
    #[arg(value_name = "MODEL")]
    model: PathBuf,
    /// YAML file to write [default: standard output].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct List {
    #[command(flatten)]
    json: Json,
}

#[derive(Debug, clap::Args)]
struct Demo {
    /// Robot: a name of `egotac retarget list` or its start, a YAML file, or a model (MJCF or URDF).
    #[arg(long, value_name = "NAME|YAML|MODEL", default_value = "four_finger")]
    robot: String,
    /// Model file in place of the one that the robot's YAML file names.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Scene to play: a name of `egotac sim list`, or a YAML file.
    #[arg(long, default_value = "lift_mug")]
    scene: String,
    /// Seed of the rollout.
    #[arg(long, default_value_t = 900_000)]
    seed: u64,
    /// Source of touch: the simulator's truth, or the network's prediction from the images.
    #[arg(long, default_value = "truth", value_parser = ["truth", "predicted"])]
    touch: String,
    /// Checkpoint for predicted touch [default: the shipped one].
    #[arg(long, value_name = "FILE|shipped", value_parser = super::options::checkpoint())]
    checkpoint: Option<PathBuf>,
    /// Folder for the picture (retarget.png) and the report (retarget.json).
    #[arg(long, value_name = "FOLDER", default_value = "out/demo-retarget")]
    out: PathBuf,
}

/// Reports that the feature is missing.
///
/// # Errors
/// Always.
#[cfg(not(feature = "sim"))]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let name = match args.command {
        Command::Run(_) => "retarget run",
        Command::Inspect(_) => "retarget inspect",
        Command::New(_) => "retarget new",
        Command::List(_) => "retarget list",
        Command::Demo(_) => "retarget demo",
    };
    Err(super::feature_off(name, "sim"))
}

/// Runs the command.
///
/// # Errors
/// If the subcommand fails.
#[cfg(feature = "sim")]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.command {
        Command::Run(args) => return run::run(&args),
        Command::Inspect(args) => inspect::inspect(&args)?,
        Command::New(args) => inspect::new(&args)?,
        Command::List(args) => list::list(&args)?,
        Command::Demo(args) => demo::demo(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}
