//! Many configurations, each in a process with its own memory and threads.

use std::path::{Path, PathBuf};
use std::process::Command;

use egotac::error::{Error, Result};
use egotac::machine::Machine;
use egotac::model::Precision;
use serde::{Deserialize, Serialize};

use super::measure::Row;
use super::peer::{self, Rounds, Timing};

/// Configurations to measure.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The command that measures the same again.
    pub command: String,
    /// Presets, with random weights.
    pub presets: Vec<String>,
    /// Preset whose horizon, input size and threads are varied one at a time, in the first number format.
    pub vary: Option<String>,
    /// Observation horizons; empty = each preset's own.
    pub horizons: Vec<usize>,
    /// Input sizes, pixels; empty = each preset's own.
    pub images: Vec<usize>,
    /// Number formats.
    pub precisions: Vec<Precision>,
    /// Threads.
    pub threads: Vec<usize>,
    /// Timed runs of each kind.
    pub runs: usize,
    /// Checkpoints, with their own geometry.
    pub checkpoints: Vec<PathBuf>,
    /// Held-out stores that checkpoints are scored on.
    pub data: Vec<PathBuf>,
    /// Command of a peer, and the number of rounds in which it takes turns with ours.
    pub peer: Option<(String, usize)>,
}

/// Results of all configurations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of egotac.
    pub egotac: String,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// Timed runs of each kind.
    pub runs: usize,
    /// One row per configuration.
    pub rows: Vec<Row>,
    /// Rows of one preset with one parameter varied at a time.
    #[serde(default)]
    pub varied: Vec<Row>,
    /// Command of the peer.
    pub peer: Option<String>,
    /// Timings beside the peer, one entry per preset.
    pub rounds: Vec<Rounds>,
}

/// Measures all configurations; `progress(what, done, all)` is called before each process.
///
/// # Errors
/// If a process fails; the error holds what it printed.
pub fn run(plan: &Plan, mut progress: impl FnMut(&str, usize, usize)) -> Result<ModelReport> {
    let commands = commands(plan);
    let varied = plan.vary.as_ref().map(|preset| varied(plan, preset)).unwrap_or_default();
    let rounds = plan.peer.as_ref().map_or(0, |(_, rounds)| *rounds);
    let all = commands.len() + varied.len() + rounds * plan.presets.len();
    let mut done = 0;
    let mut measure = |commands: &[Vec<String>]| -> Result<Vec<Row>> {
        let mut rows = Vec::new();
        for arguments in commands {
            progress(&arguments[2..].join(" "), done, all);
            rows.push(child(arguments)?);
            done += 1;
        }
        Ok(rows)
    };
    let (rows, varied) = (measure(&commands)?, measure(&varied)?);
    let mut beside = Vec::new();
    for (i, preset) in plan.presets.iter().enumerate() {
        let Some((command, rounds)) = &plan.peer else { break };
        let mut pair =
            Rounds { preset: preset.clone(), ours: vec![], ours_bf16: vec![], ours_int8: vec![], peer: vec![] };
        let threads = plan.threads.iter().copied().max().unwrap_or(1);
        for round in 0..*rounds {
            progress(&format!("{preset} beside the peer"), done + i * rounds + round, all);
            let ours = [&mut pair.ours, &mut pair.ours_bf16, &mut pair.ours_int8];
            for (precision, timings) in Precision::ALL.into_iter().zip(ours) {
                let row = child(&arguments(preset, threads, precision, plan.runs))?;
                timings.push(Timing {
                    encoder_ms: row.encoder.p50,
                    streaming_ms: row.streaming.p50,
                    clip_ms: row.clip.p50,
                    peak_memory_mb: Some(row.peak_memory_mb),
                    ..Timing::default()
                });
            }
            pair.peer.push(peer::run(command, preset, threads, plan.runs)?);
        }
        beside.push(pair);
    }
    Ok(ModelReport {
        command: plan.command.clone(),
        egotac: egotac::VERSION.into(),
        machine: Machine::this(),
        runs: plan.runs,
        rows,
        varied,
        peer: plan.peer.as_ref().map(|(command, _)| command.clone()),
        rounds: beside,
    })
}

fn arguments(preset: &str, threads: usize, precision: Precision, runs: usize) -> Vec<String> {
    let words =
        format!("bench model --preset {preset} --threads {threads} --precision {precision} --runs {runs} --json");
    words.split(' ').map(str::to_owned).collect()
}

/// Parameters that are varied one at a time: option and values.
const VARIED: [(&str, &[usize]); 3] =
    [("--horizon", &[1, 2, 4, 8]), ("--size", &[112, 168, 224, 336]), ("--threads", &[1, 2, 4, 8, 16])];

/// Returns the arguments of each process that varies one parameter.
fn varied(plan: &Plan, preset: &str) -> Vec<Vec<String>> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let most = plan.threads.iter().copied().max().unwrap_or(1);
    let precision = plan.precisions.first().copied().unwrap_or(Precision::F32);
    let mut commands = Vec::new();
    for (option, values) in VARIED {
        for value in values.iter().filter(|value| option != "--threads" || **value <= cores.max(most)) {
            let threads = if option == "--threads" { *value } else { most };
            let mut words = arguments(preset, threads, precision, plan.runs);
            if option != "--threads" {
                words.extend([option.to_owned(), value.to_string()]);
            }
            commands.push(words);
        }
    }
    commands
}

/// Returns the arguments of each process.
fn commands(plan: &Plan) -> Vec<Vec<String>> {
    let own = |values: &[usize]| -> Vec<Option<usize>> {
        if values.is_empty() { vec![None] } else { values.iter().copied().map(Some).collect() }
    };
    let mut commands = Vec::new();
    for threads in &plan.threads {
        for precision in &plan.precisions {
            for preset in &plan.presets {
                for horizon in own(&plan.horizons) {
                    for image in own(&plan.images) {
                        let mut words = arguments(preset, *threads, *precision, plan.runs);
                        for (name, value) in [("--horizon", horizon), ("--size", image)] {
                            words.extend(value.into_iter().flat_map(|value| [name.to_owned(), value.to_string()]));
                        }
                        commands.push(words);
                    }
                }
            }
            for checkpoint in &plan.checkpoints {
                let mut words = arguments("pocket", *threads, *precision, plan.runs);
                words.extend(["--checkpoint".to_owned(), checkpoint.display().to_string()]);
                if !plan.data.is_empty() {
                    words.push("--data".into());
                    words.extend(plan.data.iter().map(|store| store.display().to_string()));
                }
                commands.push(words);
            }
        }
    }
    commands
}

/// Runs this program as a child process and reads the row that it prints.
fn child(arguments: &[String]) -> Result<Row> {
    let program = std::env::current_exe().map_err(Error::io(Path::new("egotac")))?;
    let output = Command::new(&program).args(arguments).output().map_err(Error::io(&program))?;
    let what = format!("egotac {}", arguments.join(" "));
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        return Err(Error::value(what, "success", format!("{}: {said}", output.status)));
    }
    serde_json::from_slice(&output.stdout).map_err(|error| Error::value(what, "a row in JSON", error))
}
