//! Training on several ranks: measured on this machine, and computed for more ranks and for networks between machines.

mod model;
mod store;
mod table;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use egotac::error::{Error, Result};
use egotac::machine::Machine;
use egotac::model::Config;
use egotac::statistics::median;
use serde::Serialize;

pub use model::{Computed, step_secs};

/// Windows of each clip; every rank takes one clip per step.
const WINDOWS: usize = 4;

/// Arguments of a measurement.
#[derive(Debug, Clone)]
pub struct Options {
    /// Presets.
    pub presets: Vec<String>,
    /// Ranks, and threads of the one process beside them.
    pub ranks: usize,
    /// Timed steps of each run; one more comes before them.
    pub steps: usize,
    /// Runs of each kind, in turn.
    pub rounds: usize,
    /// `egotac`, built with the feature `mpi`.
    pub program: PathBuf,
    /// Command that starts several processes; their number and the program follow.
    pub launcher: String,
}

/// Speed of a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Run {
    /// Median time of a step, s.
    pub step_secs: f64,
    /// Windows of all ranks over the time of all timed steps, 1/s.
    pub windows_per_s: f64,
    /// Share of the time that rank 0 spends in messages or waiting for other ranks.
    pub exchange_share: f64,
    /// Bytes that a rank gives to the sum of the gradients in one step.
    pub exchange_bytes: f64,
}

/// Runs of one preset, one value per round.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Name of the preset.
    pub preset: String,
    /// One process with one thread and the batch of one rank.
    pub one_thread: Vec<Run>,
    /// One process with as many threads as ranks, and the batch of all ranks.
    pub threads: Vec<Run>,
    /// All ranks, with one thread each.
    pub ranks: Vec<Run>,
}

/// Results of all presets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RanksReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of egotac.
    pub egotac: &'static str,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// Processes that ran or waited to run, in the mean of the minute before the measurement; this program does not count.
    pub load_before: f64,
    /// First line of what the launcher says of itself.
    pub launcher: String,
    /// Number of ranks.
    pub n_ranks: usize,
    /// Measured runs.
    pub rows: Vec<Row>,
    /// Computed steps of more ranks.
    pub computed: Vec<Computed>,
}

/// Trains short runs on random pictures: one process with one thread, one with a thread per rank, and all ranks.
///
/// # Errors
/// If a preset is unknown, a program can't be started, or a run fails.
pub fn measure(command: String, options: &Options, mut progress: impl FnMut(&str)) -> Result<RanksReport> {
    let load = fs::read_to_string("/proc/loadavg").map_err(Error::io("/proc/loadavg"))?;
    let load_before = load.split(' ').next().and_then(|text| text.parse().ok()).unwrap_or(f64::NAN);
    let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir()))?;
    let mut rows = Vec::new();
    for preset in &options.presets {
        let geometry = Config::preset(preset)?;
        let data = folder.path().join(format!("{preset}.zarr"));
        store::write(&data, geometry.image as u32)?;
        let mut row = Row { preset: preset.clone(), one_thread: vec![], threads: vec![], ranks: vec![] };
        for round in 0..options.rounds {
            progress(preset);
            let out = |kind: &str| folder.path().join(format!("{preset}-{kind}-{round}"));
            row.one_thread.push(train(options, preset, &data, &out("one"), 1, 1, 0)?);
            row.threads.push(train(options, preset, &data, &out("threads"), options.ranks, options.ranks, 0)?);
            row.ranks.push(train(options, preset, &data, &out("ranks"), 1, 1, options.ranks)?);
        }
        rows.push(row);
    }
    let computed = rows.iter().flat_map(model::computed).collect();
    let launcher = launcher_version(&options.launcher)?;
    let (egotac, machine, n_ranks) = (egotac::VERSION, Machine::this(), options.ranks);
    Ok(RanksReport { command, egotac, machine, load_before, launcher, n_ranks, rows, computed })
}

/// Trains with `clips` clips per rank on `threads` threads per process: `ranks` processes, or one without the launcher for 0.
fn train(
    options: &Options,
    preset: &str,
    data: &Path,
    out: &Path,
    clips: usize,
    threads: usize,
    ranks: usize,
) -> Result<Run> {
    let file = out.with_extension("yaml");
    let config = format!(
        "name: bench\ndata: [{}]\nout: {}\nmodel: {preset}\nseed: 1\nsteps: {}\nframe_dt: {}\nthreads: 1\n\
         batch: {{ clips: {clips}, windows: {WINDOWS} }}\n",
        data.display(),
        out.display(),
        options.steps + 1,
        store::FRAME_SECS
    );
    fs::write(&file, config).map_err(Error::io(&file))?;
    let mut words = options.launcher.split_whitespace();
    let mut command = match (ranks, words.next()) {
        (0, _) => Command::new(&options.program),
        (_, Some(launcher)) => {
            let mut command = Command::new(launcher);
            command.args(words).arg(ranks.to_string()).arg(&options.program);
            command
        }
        (_, None) => return Err(Error::value("launcher", "a command", "nothing")),
    };
    command.args(["train", "--quiet", "--config"]).arg(&file).env("RAYON_NUM_THREADS", threads.to_string());
    // Open MPI refuses to run as root, which the user of a container often is.
    command.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
    let output = command.output().map_err(Error::io(command.get_program()))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        return Err(Error::value(format!("training of {preset}"), "success", format!("{}: {said}", output.status)));
    }
    let log = out.join("log.csv");
    read_log(&fs::read_to_string(&log).map_err(Error::io(&log))?).map_err(|error| Error::file(&log, error))
}

/// Reads the speed of a run from its log, without the first step, which also pays for the page faults of its memory.
fn read_log(text: &str) -> Result<Run> {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.skip(1).map(|line| line.split(',').map(|value| value.parse().unwrap_or(f64::NAN)).collect()).collect();
    let column = |name: &str| -> Result<Vec<f64>> {
        let at = names.iter().position(|other| *other == name);
        let at = at.ok_or_else(|| Error::value("log", format!("a column {name}"), names.join(",")))?;
        Ok(rows.iter().map(|row| row.get(at).copied().unwrap_or(f64::NAN)).collect())
    };
    let (secs, windows) = (column("secs")?, column("windows")?);
    let (exchange, bytes) = (column("exchange_secs")?, column("exchange_bytes")?);
    let total = secs.iter().sum::<f64>();
    Ok(Run {
        step_secs: median(secs),
        windows_per_s: windows.iter().sum::<f64>() / total,
        exchange_share: exchange.iter().sum::<f64>() / total,
        exchange_bytes: median(bytes),
    })
}

fn launcher_version(launcher: &str) -> Result<String> {
    let program = launcher.split_whitespace().next().unwrap_or_default();
    let output = Command::new(program).arg("--version").output().map_err(Error::io(program))?;
    Ok(String::from_utf8_lossy(&output.stdout).lines().next().unwrap_or_default().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_speed_is_that_of_the_steps_after_the_first() {
        let text =
            "step,loss,windows,secs,exchange_secs,exchange_bytes\n1,9,8,100,1,40\n2,9,8,2,0.5,40\n3,9,4,1,0.25,40\n";
        let run = read_log(text).unwrap();
        assert_eq!((run.windows_per_s, run.exchange_share, run.exchange_bytes), (4.0, 0.25, 40.0));
        assert_eq!(run.step_secs, 1.5);
        assert!(read_log("step,loss\n1,2\n").unwrap_err().to_string().contains("a column secs"));
    }
}
