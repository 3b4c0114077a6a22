//! The node `simulator`: plays simulated scenes as a camera topic, with the true touch.

mod outputs;
mod pace;
mod player;

use std::process::ExitCode;

use super::diagnostics::{self, Level, Tally, TaskReport};
use super::enabled::serve_set_enabled;
use super::params::{Allowed, Parameter};
use super::program;
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::worker_thread::WorkerThread;
use crate::geometry::SIGMA;
use crate::sim::{SHIPPED, Scene};
use player::Player;

/// Runs the program `egotac_simulator`.
pub fn main() -> ExitCode {
    program::run("simulator", "Plays simulated scenes as a camera topic, with the true touch.", parameters(), run)
}

/// Parameters of the node.
fn parameters() -> Vec<Parameter> {
    let scenes: Vec<String> = SHIPPED.iter().map(|(name, _)| (*name).to_owned()).collect();
    vec![
        Parameter::fixed(
            "scenes",
            scenes,
            Allowed::Any,
            "Scenes to play in turn: names of shipped scenes (egotac sim list), or YAML files.",
        ),
        Parameter::fixed(
            "seed",
            0,
            Allowed::Integers(0, i64::MAX),
            "Seed of the first episode; each further episode adds 1.",
        ),
        Parameter::fixed(
            "episodes",
            0,
            Allowed::Integers(0, i64::MAX),
            "Number of episodes after which the node ends; 0 = no limit.",
        ),
        Parameter::fixed(
            "duration",
            0.0,
            Allowed::Doubles(0.0, 1e6),
            "Simulated time after which the node ends, seconds; 0 = no limit.",
        ),
        Parameter::fixed(
            "pace",
            "wall",
            Allowed::OneOf(&["wall", "clock", "fast"]),
            "wall: publish at the scene's rate, stamped with the node's time (with use_sim_time, that of /clock); clock: \
             publish at the scene's rate by the wall clock, stamped with simulated time, which this node publishes on \
             /clock; fast: as clock, without waiting between frames.",
        ),
        Parameter::fixed("width", 224, Allowed::Integers(16, 4096), "Width of the images, pixels."),
        Parameter::fixed("height", 224, Allowed::Integers(16, 4096), "Height of the images, pixels."),
        Parameter::fixed(
            "sigma",
            SIGMA,
            Allowed::Doubles(1e-4, 0.05),
            "Standard deviation of the Gaussian that spreads a contact's force over vertices, m.",
        ),
        Parameter::fixed("compressed", false, Allowed::Any, "Publish image_raw/compressed (JPEG) as well."),
        Parameter::fixed("frame_id", "camera_optical", Allowed::Any, "Name of the camera's optical frame."),
        Parameter::fixed(
            "wait_secs",
            0.0,
            Allowed::Doubles(0.0, 3600.0),
            "Longest wait for subscribers before the first image, seconds.",
        ),
        Parameter::fixed(
            "wait_listeners",
            1,
            Allowed::Integers(1, 1000),
            "Number of image subscribers that end the wait of `wait_secs` early.",
        ),
        Parameter::new("enabled", true, Allowed::Any, "Play; false: pause. ~/set_enabled sets it, too."),
        // The pace is chosen at start.
        Parameter { read_only: true, ..Parameter::use_sim_time() },
    ]
}

/// Runs the node until the last frame that its parameters ask for, or `shutdown`.
///
/// # Errors
/// If a scene cannot be loaded or simulated, OpenGL is missing, or ROS refuses a topic.
fn run(mut runtime: Runtime, shutdown: &Shutdown) -> anyhow::Result<()> {
    let names = runtime.parameters().get::<Vec<String>>("scenes");
    let scenes = names.iter().map(|name| Scene::load(name)).collect::<crate::Result<Vec<_>>>()?;
    anyhow::ensure!(!scenes.is_empty(), "parameter scenes: expected at least one scene, got none");
    let tally = Tally::default();
    let player = Player::new(&mut runtime, scenes, tally.clone())?;
    serve_set_enabled(&mut runtime)?;
    diagnostics::publish(&mut runtime, String::new, move |runtime| {
        vec![task_report(&tally, runtime.parameters().get::<bool>("enabled"))]
    })?;
    let worker = WorkerThread::spawn("rollout", shutdown, move |shutdown| player.play(shutdown))?;
    runtime.spin(shutdown);
    runtime.finish(worker)
}

fn task_report(tally: &Tally, enabled: bool) -> TaskReport {
    let mut counts = tally.counts();
    let rates = counts.rates();
    let level = if rates.processed > 0.0 || !enabled { Level::Ok } else { Level::Stale };
    let message = match enabled {
        true => format!("{:.1} frames per second", rates.processed),
        false => "disabled".to_owned(),
    };
    TaskReport { task: "frames".into(), level, message, values: counts.values(rates) }
}
