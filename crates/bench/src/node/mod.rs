//! ROS 2 nodes under load and faults, measured from outside by rclpy (`measure.py`).

mod report;

use std::path::{Path, PathBuf};
use std::process::Command;

use egotac::error::{Error, Result};
use egotac::machine::Machine;
use egotac::model::Config;
use egotac::node::own_domain::OwnDomain;
use serde_json::{Value, json};

use crate::faults::input;
pub use report::{Goal, NodeReport};

/// Files of the peer.
const SCRIPTS: [(&str, &str); 2] = [("graph.py", include_str!("graph.py")), ("measure.py", include_str!("measure.py"))];

/// File of a network that four cameras are too many for, on any machine.
const SLOW_MODEL: &str = "slow.safetensors";

/// Names of the measurements.
pub const MEASUREMENTS: [&str; 5] = ["overhead", "overload", "soak", "faults", "kills"];

/// Share of the cores that other programs may occupy before times count as measured beside other work.
const IDLE_SHARE: f64 = 0.25;

/// Extent of the measurements.
#[derive(Debug, Clone)]
pub struct Options {
    /// Folder of the nodes' programs.
    pub programs: PathBuf,
    /// Python with rclpy and egotac's messages.
    pub python: PathBuf,
    /// Folder for checkpoints, logs and recordings.
    pub folder: PathBuf,
    /// Names of the measurements to take; see [`MEASUREMENTS`].
    pub only: Vec<String>,
    /// Duration of each measurement of latency, s.
    pub secs: f64,
    /// Duration of the soak, s.
    pub soak_secs: f64,
}

/// Takes the measurements; `tell` gets the name of each before it begins.
///
/// # Errors
/// If a program is missing, or a measurement can't be taken.
pub fn measure(options: &Options, command: String, mut tell: impl FnMut(&str)) -> Result<NodeReport> {
    for name in ["predictor", "retargeter", "simulator", "trainer", "verifier"] {
        let program = options.programs.join(format!("egotac_{name}"));
        if !program.is_file() {
            let expected = "a program; build it with `cargo build --release --features ros,sim`";
            return Err(Error::value(program.display().to_string(), expected, "no file"));
        }
    }
    let toy = options.folder.join("toy.safetensors");
    input::checkpoint(&toy, 1)?;
    let slow = Config { vision_width: 384, vision_depth: 12, image: 224, ..Config::toy() };
    input::checkpoint_of(&options.folder.join(SLOW_MODEL), &slow, 1)?;
    for (name, text) in SCRIPTS {
        egotac::file::write(&options.folder.join(name), text.as_bytes())?;
    }
    let machine = Machine::this();
    let load = load_average();
    let mut report = NodeReport {
        command,
        version: env!("CARGO_PKG_VERSION"),
        beside_other_work: load > IDLE_SHARE * machine.cores as f64,
        load_average: load,
        machine,
        measurements: serde_json::Map::new(),
        goals: Vec::new(),
    };
    for name in MEASUREMENTS.into_iter().filter(|name| options.only.iter().any(|only| only == name)) {
        tell(name);
        let mut value = run(options, name, &toy)?;
        if name == "kills" {
            count_recorded(&mut value)?;
        }
        report.measurements.insert(name.to_owned(), value);
    }
    report.goals = report::goals(&report.measurements);
    Ok(report)
}

/// Runs one measurement in a ROS domain of its own and returns its JSON.
fn run(options: &Options, name: &str, toy: &Path) -> Result<Value> {
    let logs = options.folder.join(name);
    std::fs::create_dir_all(&logs).map_err(Error::io(&logs))?;
    let secs = if name == "soak" { options.soak_secs } else { options.secs };
    let settings = json!({
        "programs": options.programs, "logs": logs, "toy_model": toy, "slow_model": options.folder.join(SLOW_MODEL), "secs": secs,
    });
    let file = options.folder.join(format!("{name}.json"));
    egotac::file::write(&file, settings.to_string().as_bytes())?;
    let domain = OwnDomain::take();
    let output = Command::new(&options.python)
        .arg(options.folder.join("measure.py"))
        .arg(name)
        .arg(&file)
        .env("ROS_DOMAIN_ID", domain.id().to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env("ROS_LOG_DIR", &logs)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .env("OPENBLAS_NUM_THREADS", "1")
        .output()
        .map_err(Error::io(&options.python))?;
    let said = String::from_utf8_lossy(&output.stdout);
    let last = said.trim().lines().last().unwrap_or_default();
    serde_json::from_str(last).map_err(|_| {
        let told = String::from_utf8_lossy(&output.stderr);
        let end: Vec<&str> = told.trim().lines().rev().take(6).collect();
        let end: Vec<&str> = end.into_iter().rev().collect();
        Error::value(format!("measurement {name}"), "a result", format!("{}: {}", output.status, end.join(" | ")))
    })
}

/// Replaces the names of recorded episodes by the number of frames that can be read from them.
fn count_recorded(kills: &mut Value) -> Result<()> {
    let Some(rows) = kills["rows"].as_array_mut() else { return Ok(()) };
    for row in rows.iter_mut().filter(|row| row["killed"] == "trainer") {
        let episodes: Vec<PathBuf> = serde_json::from_value(row["episodes"].take()).unwrap_or_default();
        let mut frames = 0;
        for episode in &episodes {
            let reader = egotac::dataset::zarr::ZarrReader::open(episode)?;
            for index in 0..reader.len() {
                reader.image(index)?;
            }
            frames += reader.len();
        }
        row["episodes"] = episodes.len().into();
        row["frames_read_back"] = frames.into();
    }
    Ok(())
}

/// Returns the mean number of busy cores over the last minute; 0 if the system does not tell.
fn load_average() -> f64 {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().next().and_then(|word| word.parse().ok()).unwrap_or(0.0)
}
