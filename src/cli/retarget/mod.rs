//! `egotac retarget`: a human hand's pose and touch, carried over to a robot hand.

#[cfg(feature = "sim")]
mod demo;
#[cfg(feature = "sim")]
mod inspect;
#[cfg(feature = "sim")]
mod run;

use std::path::PathBuf;
use std::process::ExitCode;

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
    /// Say what is derived from a robot's model, and draw it.
    Inspect(Inspect),
    /// Write a starting YAML file for a model.
    New(New),
    /// List the robots that are part of the program.
    List,
    /// Simulate a hand that grasps, follow it with a robot, and draw both with their forces.
    Demo(Demo),
}

#[derive(Debug, clap::Args)]
#[command(
    after_help = "Input (safetensors): keypoints (T, 21, 3) m, in the order wrist, then thumb, index, middle, ring, \
    little, each from base to tip; or MANO's hand_pose (T, 45), global_orient, transl, betas. Optional: timestamps (T) s, \
    tip_contact (T, 5), tip_force (T, 5, 3) N, force and contact (T, 778) or (T, 1556).\n\
    Output: qpos (T, n) with joint_names in the metadata, ctrl, tip_force (T, 5, 3) in the frame of the keypoints, \
    objective, solve_time_us, status, and what each link is to feel.\n\
    A frame that is no hand is named on standard error; the last good pose is held (status 4)."
)]
struct Run {
    /// Robot: a name of `egotac retarget list`, a YAML file, or a model (MJCF or URDF).
    #[arg(long, value_name = "NAME|YAML|MODEL")]
    robot: String,
    /// Model in place of the one that the robot's YAML names.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Hands to follow.
    #[arg(long, value_name = "FILE")]
    input: PathBuf,
    /// Object that links stay out of and touching fingertips lie on: a model (MJCF, URDF) or mesh (OBJ, STL; its convex hull
    /// counts). The input's `object_pose` says where it is.
    #[arg(long, value_name = "FILE")]
    object: Option<PathBuf>,
    /// File to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Frames per second of an input without timestamps.
    #[arg(long, value_name = "F", value_parser = super::positive)]
    rate: Option<f64>,
    /// Which hand the input is; without it, what its metadata says, else the robot's side.
    #[arg(long, value_parser = ["left", "right"])]
    side: Option<String>,
    /// Smoothing delay in place of the robot's own, s; 0 = none.
    #[arg(long, value_name = "S")]
    smooth: Option<f64>,
    #[command(flatten)]
    hands: super::hands::Hands,
}

#[derive(Debug, clap::Args)]
struct Inspect {
    /// Robot: a name of `egotac retarget list`, a YAML file, or a model (MJCF or URDF).
    #[arg(value_name = "NAME|YAML|MODEL")]
    robot: String,
    /// Model in place of the one that the robot's YAML names.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// PNG file to draw: the robot at rest and half closed.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print JSON in place of the text.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct New {
    /// Model (MJCF or URDF).
    #[arg(value_name = "MODEL")]
    model: PathBuf,
    /// YAML file to write; standard output without it.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct Demo {
    /// Robot: a name of `egotac retarget list`, a YAML file, or a model (MJCF or URDF).
    #[arg(long, value_name = "NAME|YAML|MODEL", default_value = "four_finger")]
    robot: String,
    /// Model in place of the one that the robot's YAML names.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Scene to play: a name of `egotac sim list`, or a YAML file.
    #[arg(long, default_value = "lift_mug")]
    scene: String,
    /// Seed of the rollout.
    #[arg(long, default_value_t = 900_000)]
    seed: u64,
    /// Where touch comes from: the simulator's truth, or what the network sees in the images.
    #[arg(long, default_value = "truth", value_parser = ["truth", "predicted"])]
    touch: String,
    /// Checkpoint for predicted touch; the shipped one if absent.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// Folder for the picture (retarget.png) and the report (retarget.json).
    #[arg(long, value_name = "FOLDER", default_value = "out/demo-retarget")]
    out: PathBuf,
}

/// Runs the command.
#[cfg(not(feature = "sim"))]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let name = match args.command {
        Command::Run(_) => "retarget run",
        Command::Inspect(_) => "retarget inspect",
        Command::New(_) => "retarget new",
        Command::List => "retarget list",
        Command::Demo(_) => "retarget demo",
    };
    Err(super::feature_off(name, "sim"))
}

/// Runs the command.
#[cfg(feature = "sim")]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.command {
        Command::Run(args) => return run::run(&args),
        Command::Inspect(args) => inspect::inspect(&args)?,
        Command::New(args) => inspect::new(&args)?,
        Command::List => crate::retarget::robot::source::names().for_each(|name| println!("{name}")),
        Command::Demo(args) => demo::demo(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}
