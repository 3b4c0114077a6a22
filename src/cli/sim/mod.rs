//! `egotac sim`: simulated hand-object scenes.

#[cfg(feature = "sim")]
mod explain;
#[cfg(feature = "sim")]
mod record;
#[cfg(feature = "sim")]
mod replay;
#[cfg(feature = "sim")]
mod shared;
#[cfg(feature = "sim")]
mod show;
#[cfg(feature = "sim")]
mod trial;

use std::path::PathBuf;
use std::process::ExitCode;

use super::hands::{Hands, Kernel};
use super::label_physics::Bodies;
use super::options::{Json, Time};
#[cfg(feature = "sim")]
pub(super) use shared::{load, picture};

/// Arguments of `egotac sim`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// List the scenes that are part of the program.
    List(List),
    /// Render a scene to a PNG: one instant, or a sheet of several.
    Show(Show),
    /// Print a scene's effects: on or off, the reason, and the measured cost.
    Explain(Explain),
    /// Simulate one episode and write it as a Zarr store.
    Run(Run),
    /// Simulate many episodes and write them as one Zarr store; the same command resumes an interrupted run.
    Generate(Generate),
    /// Compute the engine's contact forces along the poses of a store, and compare them with the store's forces.
    Replay(Replay),
    /// Record the episodes requested on standard input; `generate` starts this command.
    #[command(hide = true)]
    Worker(Worker),
    /// Load a model within limits of memory and time; commands and nodes that load models of others start this first.
    #[command(hide = true)]
    Trial(Trial),
}

#[derive(Debug, clap::Args)]
struct List {
    /// Only the scenes of this split, train or ood, under the names that the other commands take.
    #[arg(long)]
    split: Option<String>,
}

#[derive(Debug, clap::Args)]
struct Show {
    /// Name of a scene (`egotac sim list`), or a YAML file.
    scene: String,
    /// Seed of all values that the scene leaves open.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Simulated time to show [default: the middle of the episode].
    #[arg(long, value_name = "TIME", conflicts_with = "sheet")]
    time: Option<Time>,
    /// Show this many instants side by side, evenly spread over the episode.
    #[arg(long)]
    sheet: Option<usize>,
    /// Paint the contact force (label c) on the hands' vertices in the picture.
    #[arg(long)]
    touch: bool,
    /// List the contacts of each instant: bodies, normal force, penetration depth.
    #[arg(long)]
    contacts: bool,
    /// Width and height of a picture, pixels.
    #[arg(long, default_value_t = 448)]
    size: u32,
    /// PNG file to write.
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    rollout: RolloutArgs,
}

#[derive(Debug, clap::Args)]
struct Explain {
    /// Name of a scene (`egotac sim list`), or a YAML file.
    scene: String,
    /// Seed of the episode in which costs are measured.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Width and height of the picture, pixels.
    #[arg(long, default_value_t = 224)]
    size: u32,
    /// Do not measure costs.
    #[arg(long)]
    no_cost: bool,
    #[command(flatten)]
    json: Json,
}

#[derive(Debug, clap::Args)]
struct Run {
    /// Name of a scene (`egotac sim list`), or a YAML file.
    scene: String,
    /// Seed of all values that the scene leaves open.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Width and height of the picture, pixels.
    #[arg(long, default_value_t = 224)]
    size: u32,
    /// Store to write; must not exist.
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    accuracy: Accuracy,
    #[command(flatten)]
    rollout: RolloutArgs,
}

#[derive(Debug, clap::Args)]
struct Generate {
    /// Names of scenes, or YAML files, used in turn.
    #[arg(required_unless_present = "split")]
    scenes: Vec<String>,
    /// All scenes of this split (sim/splits.yaml): train, or ood, which no training may see.
    #[arg(long, value_name = "NAME", conflicts_with = "scenes")]
    split: Option<String>,
    /// Number of episodes.
    #[arg(long, default_value_t = 100)]
    episodes: usize,
    /// Seed of the first episode; each next episode has the next seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Width and height of the picture, pixels.
    #[arg(long, default_value_t = 112)]
    size: u32,
    /// Number of episodes simulated at a time, each in its own process.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    /// Simulate in threads of this process: a fatal error of the engine in one episode then ends all.
    #[arg(long)]
    in_process: bool,
    /// Write the store without failed episodes, and name them; otherwise a failed episode is an error.
    #[arg(long, conflicts_with = "in_process")]
    skip_failed: bool,
    /// Store to write; must not exist.
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    accuracy: Accuracy,
    #[command(flatten)]
    rollout: RolloutArgs,
}

#[derive(Debug, clap::Args)]
struct Replay {
    /// Store with poses of hands and objects: of the simulator or of `egotac data import`; also one that `egotac label --physics`
    /// made of it.
    store: PathBuf,
    #[command(flatten)]
    bodies: Bodies,
    #[command(flatten)]
    hands: Hands,
    #[command(flatten)]
    json: Json,
}

/// Options for pictures, labels and hands of an episode.
#[derive(Debug, clap::Args)]
struct RolloutArgs {
    /// Render shadows (a picture takes about five times as long).
    #[arg(long)]
    shadows: bool,
    /// Effects that make pictures richer, in place of the scene's: plain (none), varied (painted skin and gloves, textures,
    /// clutter, lamps, shade in creases), photo (also the wearer, other cameras with their rolling shutter, and the processing of
    /// a real camera).
    #[arg(long, value_name = "STYLE", value_parser = ["plain", "varied", "photo"])]
    look: Option<String>,
    /// Folder of PNG and JPEG photographs: each episode shows one on the walls and, every other time, on floor and table; needs
    /// the look varied or photo.
    #[arg(long, value_name = "FOLDER")]
    backgrounds: Option<PathBuf>,
    /// Folder of OBJ and STL meshes that take the place of the drawn clutter; needs the look varied or photo.
    #[arg(long, value_name = "FOLDER")]
    objects: Option<PathBuf>,
    /// Hands in the scene, in place of its own: none (the objects alone), left or right (the acting hand alone, on this side),
    /// both (also the hand that is there sometimes).
    #[arg(long = "hands", value_name = "HANDS", value_parser = ["none", "left", "right", "both"])]
    present: Option<String>,
    #[command(flatten)]
    kernel: Kernel,
    #[command(flatten)]
    hands: Hands,
}

/// Accuracy of the physics, instead of the scene's.
#[derive(Debug, clap::Args)]
struct Accuracy {
    /// Physics preset: replay, fast, default, precise, reference or stiff.
    #[arg(long, conflicts_with_all = ["budget", "error"])]
    preset: Option<String>,
    /// Largest computation time per simulated second, without labels and pictures, e.g. 20ms: selects the most exact preset
    /// within it, from the table of `egotac bench sim` in this program, scaled to this machine's speed (measured once, in
    /// half a second, and kept in ~/.cache/egotac).
    #[arg(long, value_name = "TIME", value_parser = parse_budget)]
    budget: Option<f64>,
    /// Largest error of quasi-static forces, e.g. 1%: selects the cheapest preset within it, from the same table.
    #[arg(long, value_name = "PERCENT", value_parser = parse_error)]
    error: Option<f64>,
}

#[derive(Debug, clap::Args)]
struct Trial {
    /// Process that waits for the answer.
    #[arg(long)]
    parent: u32,
    /// Load, in JSON.
    request: String,
}

#[derive(Debug, clap::Args)]
struct Worker {
    /// Process that sends the requests.
    #[arg(long)]
    parent: u32,
    /// Names of scenes, or YAML files.
    #[arg(required = true)]
    scenes: Vec<String>,
    /// Width and height of the picture, pixels.
    #[arg(long)]
    size: u32,
    #[command(flatten)]
    accuracy: Accuracy,
    /// This machine's time over that of the table's machine, as measured by the process that starts the workers.
    #[arg(long)]
    budget_factor: Option<f64>,
    #[command(flatten)]
    rollout: RolloutArgs,
}

/// Parses a time above 0 with its unit, s: `20ms`, `0.5s`.
fn parse_budget(text: &str) -> Result<f64, String> {
    let has_unit = text.ends_with(char::is_alphabetic);
    let time = text.parse::<Time>().ok().filter(|time| has_unit && time.0 > 0.0);
    time.map(|time| time.0).ok_or_else(|| "expected a time above 0 with its unit, such as 20ms or 0.5s".into())
}

/// Parses a share in percent: `1%`.
fn parse_error(text: &str) -> Result<f64, String> {
    let share = text.strip_suffix('%').and_then(|text| text.trim().parse::<f64>().ok()).map(|value| value / 100.0);
    share.filter(|s| s.is_finite() && *s >= 0.0).ok_or_else(|| "expected a share in percent, such as 1%".into())
}

/// Runs the command.
#[cfg(not(feature = "sim"))]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let name = match args.command {
        Command::List(_) => "sim list",
        Command::Show(_) => "sim show",
        Command::Explain(_) => "sim explain",
        Command::Run(_) => "sim run",
        Command::Generate(_) => "sim generate",
        Command::Replay(_) => "sim replay",
        Command::Worker(_) => "sim worker",
        Command::Trial(_) => "sim trial",
    };
    Err(super::feature_off(name, "sim"))
}

/// Runs the command.
#[cfg(feature = "sim")]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.command {
        Command::List(args) => show::list(&args)?,
        Command::Show(args) => show::show(&args)?,
        Command::Explain(args) => explain::explain(&args)?,
        Command::Run(args) => record::run(&args)?,
        Command::Generate(args) => record::generate(&args)?,
        Command::Replay(args) => replay::run(&args)?,
        Command::Worker(args) => record::work(&args)?,
        Command::Trial(args) => trial::serve(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_and_errors_need_units() {
        for (text, seconds) in [("20ms", 0.02), ("0.5s", 0.5), ("1.5 ms", 0.0015)] {
            assert!((parse_budget(text).unwrap() - seconds).abs() < 1e-12, "{text}");
        }
        for text in ["20", "ms", "-1ms", "0s", "infs", "20us", "NaNs", ""] {
            assert!(parse_budget(text).is_err(), "{text}");
        }
        assert!((parse_error("1%").unwrap() - 0.01).abs() < 1e-12 && parse_error("0.5 %").unwrap() == 0.005);
        for text in ["1", "0.01", "-1%", "%", "inf%", "one%"] {
            assert!(parse_error(text).is_err(), "{text}");
        }
    }
}
